"""Spectra of a recording: forcing lines, what signals hold there, and the recorder's floors.

A recorder adds noise and rounding, whose spectrum is flat: a floor, which shows near half the
sampling rate, where nobody moves a stick.  A frequency at which an input of the pilot is little
above its floor tells little of the pilot, and what it tells is wrong: the inputs are taken for
exact.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pilotid.recording.recording import ABSENT, Recording, remembered
from pilotid.support.types import ComplexArray, FloatArray, IntArray

#: A bin is a line if its amplitude is at least this share of the largest one.
SMALLEST = 1e-3
#: Share of the window by which it may miss whole periods: 30 ms of 82 s made 51 lines of 10, and a
#: fifth of sound fits contradict them.  Leakage is that of so many lines.
MISSED, STRONGEST = 1e-3, 100
SAME = 0.02  # e + x below this share of e is no target
#: rad/s below which the lines of forcing functions for people are; above lie the images of lines
#: where a signal was held between samples.
FASTEST_LINE = 50.0
#: Least share of a forcing function's power at the lines that a file names.
GIVEN_SHARE = 0.1
#: A multisine leaves most of the bins between its first and last line to the remnant.
CROWDED = 0.34
#: Share of the lines that may lie directly above another one.
BROAD = 0.6
#: A run has a line if its amplitude is at least this share of the root mean square over the runs.
ABSENT_LINE = 0.05
ALIKE = 0.1  # share in which a line of both functions may go together over the runs
FEWEST_LINES = 5  # lines of a target that tell which signal is which
BESIDE = 8  # bins beside a line that tell leakage and noise in it
#: How many times those beside it, and what share of the target's rms, a step is that is a jump.
JUMP = 10.0
#: Bins that tell of a forcing function that was not recorded, how many times the median beside it
#: each is in one run, and how many times it the others are that it has.
FEWEST_HIDDEN, HIDDEN, AMONG = 3, 20.0, 8.0
LOUD = 4.0  # times the noise from which a line of one run stands out
#: Shares of half the sampling rate between which the floor is measured.
FLOOR_FROM, FLOOR_TO = 0.6, 0.95
#: Half the width of the running median that smooths a spectrum [rad/s]; a line of a forcing
#: function is one bin of many there, and does not count.
HALF_WIDTH = 0.75
#: Multiple of the floor that is taken off a spectrum.  The floor is known from few bins, and a
#: share of signal that is taken too large does more harm than one too small.
SAFE = 1.5


class NotMultisineError(Exception):
    """A forcing function is no multisine with a whole number of periods; says what it is."""


@remembered
def forcing_lines(recording: Recording) -> dict[str, IntArray]:
    """Lines of the forcing functions, as multiples of 2 pi / T of the measurement window.

    They are those that the recording names, or else the bins that hold power.

    Returns
    -------
    Ascending lines by signal, ``ft`` and ``fd``, without those that do not force.

    Raises
    ------
    NotMultisineError
        If a forcing function is not periodic in the window, or no sum of a few sines.
    """
    every = {name: lines_of(recording, name) for name in ("ft", "fd")}
    return {name: lines for name, lines in every.items() if lines.size}


@remembered
def known_lines(recording: Recording) -> dict[str, IntArray]:
    """`forcing_lines`, none where a forcing function is no multisine."""
    try:
        return forcing_lines(recording)
    except NotMultisineError:
        return {}


def forcing_of(recording: Recording, name: str) -> FloatArray | None:
    """A forcing function, shape (runs, run-in + samples); None if it is not known.

    A target that was not recorded is e + x.
    """
    if name != "ft" or recording.ft is not None or recording.origin.get("x") == ABSENT:
        return recording.arrays.get(name)
    target = recording.input("ft")
    return target if float(np.std(target)) > SAME * float(np.std(recording.e)) else None


def lines_of(recording: Recording, name: str) -> IntArray:
    """The lines of one forcing function, see `forcing_lines`; none if it does not force."""
    given, forcing = recording.lines.get(name), forcing_of(recording, name)
    if given:
        lines = np.unique(np.array(given, dtype=int))
        if lines[0] < 1 or lines[-1] >= recording.samples / 2:
            raise NotMultisineError(
                f"the lines of {name} must lie between 1 and half the number of samples"
            )
        if forcing is not None:
            power = np.sum(np.abs(np.fft.rfft(recording.window(forcing))[:, 1:]) ** 2, axis=0)
            share = float(power[lines - 1].sum() / (power.sum() or 1.0))
            if share < GIVEN_SHARE:
                raise NotMultisineError(
                    f"the lines of {name} that are given hold {100.0 * share:.0f} % of its power: "
                    "correct them (multiples of 1 / T, the first is 1), or leave them out"
                )
        return lines
    if forcing is None:
        return np.zeros(0, dtype=int)
    signal = recording.window(forcing)
    top = _above_lines(recording)
    power = np.mean(np.abs(np.fft.rfft(signal)[:, 1:top]) ** 2, axis=0)
    # A constant leaves rounding errors.
    if power.max() <= (1e-12 * signal.shape[1] * np.max(np.abs(signal), initial=0.0)) ** 2:
        return np.zeros(0, dtype=int)
    lines = 1 + np.flatnonzero(power >= SMALLEST**2 * power.max())
    strong = lines[np.argsort(power[lines - 1])[-STRONGEST:]]
    # What lines leak to a bin where the window misses whole periods by a share of its length.
    apart = np.abs(lines[:, None] - strong)
    leaked = np.sum(
        strong * np.sqrt(power[strong - 1]) * (apart > 0) / np.maximum(apart, 1), axis=1
    )
    lines = lines[np.sqrt(power[lines - 1]) > MISSED * leaked]
    rest = power.sum() - power[lines - 1].sum()
    # Pairs of lines side by side are fewer.
    beside = np.count_nonzero(np.diff(lines) == 1)
    is_crowded = lines.size > max(2.0, CROWDED * lines[-1]) or beside > BROAD * lines.size
    if is_crowded or rest > 1e-3 * power.sum():
        if getattr(recording, name) is None:
            return np.zeros(0, dtype=int)
        raise NotMultisineError(
            f"{name} is no multisine with whole periods in the measurement window: "
            f"{lines.size} of the {lines[-1]} bins up to its highest hold power"
        )
    return np.asarray(lines)


def _above_lines(recording: Recording) -> int:
    """The bin from which on there are no lines."""
    fastest = math.ceil(FASTEST_LINE * recording.duration / (2.0 * math.pi))
    return min(fastest, recording.samples // 2)


@remembered
def hidden_lines(recording: Recording) -> IntArray:
    """Bins of the control that stand out of those beside them: lines of what was not recorded."""
    top = _above_lines(recording)
    power = np.mean(np.abs(np.fft.rfft(recording.window(recording.u))[:, :top]) ** 2, axis=0)
    around = np.lib.stride_tricks.sliding_window_view(
        np.pad(power, BESIDE, mode="reflect"), 2 * BESIDE + 1
    )
    # Of several runs the mean scatters less.
    usual = np.maximum(np.median(around, axis=1), 1e-300)
    ratio = 1.0 + (power / usual - 1.0) * np.sqrt(recording.runs)
    ratio[power <= SMALLEST**2 * power.max()] = 0.0
    for lines in known_lines(recording).values():
        ratio[lines[lines < power.size]] = 0.0
    is_forced = np.count_nonzero(ratio > HIDDEN) >= FEWEST_HIDDEN
    return np.flatnonzero(ratio > AMONG) if is_forced else np.zeros(0, dtype=int)


def coefficients_at(recording: Recording, name: str, lines: IntArray) -> ComplexArray | None:
    """Transform of a forcing function at its lines in each run, shape (runs, lines).

    Zero where a run does not have the line; None where the function was not recorded.
    """
    forcing = forcing_of(recording, name)
    if forcing is None:
        return None
    transform = np.fft.rfft(recording.window(forcing))[:, lines]
    size = np.abs(transform)
    return np.where(size < ABSENT_LINE * np.sqrt(np.mean(size**2, axis=0)), 0.0, transform)


@remembered
def same_lines(recording: Recording) -> tuple[tuple[int, ...], ...]:
    """Runs, from 0, whose forcing functions have the same lines, in the order of the first ones.

    All runs are together where forcing functions are no multisines.
    """
    every = known_lines(recording)
    groups: dict[bytes, list[int]] = {}
    coefficients = [coefficients_at(recording, name, lines) for name, lines in every.items()]
    having = [rows != 0.0 for rows in coefficients if rows is not None]
    for run in range(recording.runs):
        key = b"".join(rows[run].tobytes() for rows in having)
        groups.setdefault(key, []).append(run)
    return tuple(map(tuple, groups.values()))


@remembered
def told_apart(recording: Recording) -> bool:
    """Whether answers to target and disturbance differ at every line that both have.

    They do where no run has the line in both, and where phases or signs between runs differ.
    """
    every = forcing_lines(recording)
    if len(every) < 2:
        return True
    common = np.intersect1d(every["ft"], every["fd"])
    target, disturbance = (coefficients_at(recording, name, common) for name in ("ft", "fd"))
    if not common.size:
        return True
    if target is None or disturbance is None:
        return False
    size = np.linalg.norm(target, axis=0) * np.linalg.norm(disturbance, axis=0)
    shared = np.abs(np.sum(target * disturbance.conj(), axis=0))
    return bool(np.all(shared <= ALIKE * size))


def forcing_sines(recording: Recording) -> dict[str, dict[str, object]]:
    """The forcing functions as sums of sines, plain objects by signal.

    Amplitudes are root mean squares over the runs, phases at the start of the window those of the
    first; ``alternating`` says whether every other run has the other sign.  Runs with different
    lines have no functions in common: there are none, and none that are no sums of a few sines.
    """
    sines: dict[str, dict[str, object]] = {}
    every = known_lines(recording)
    for name, lines in every.items() if len(same_lines(recording)) == 1 else ():
        signal = forcing_of(recording, name)
        if signal is None:
            continue
        phasors = 2j * np.fft.rfft(recording.window(signal))[:, lines] / recording.samples
        turned = (phasors @ phasors[0].conj()).real < 0.0
        sines[name] = {
            "lines": lines.tolist(),
            "amplitudes": np.sqrt(np.mean(np.abs(phasors) ** 2, axis=0)).tolist(),
            "phases": np.angle(phasors[0]).tolist(),
            "period": recording.duration,
            "alternating": bool(turned.any() and (turned == np.arange(turned.size) % 2).all()),
        }
    return sines


def answers(recording: Recording) -> dict[str, tuple[int, float]]:
    """How the control answers to each forcing function that is a multisine, by its name.

    Returns
    -------
    Number of lines that stand out of the noise, and the share of the control's power at a line that
    is not noise, of the median line.
    """
    every, result = known_lines(recording), {}
    for name, lines in every.items():
        control, noise = at_lines(recording, recording.u, lines, every)
        ratio = np.mean(np.abs(control) ** 2, axis=0) / noise
        coherence = 1.0 - 1.0 / np.maximum(ratio, 1.0)
        loud = 1.0 + (LOUD - 1.0) / np.sqrt(recording.runs)  # a mean of runs scatters less
        stand_out = int(np.count_nonzero(coherence > 1.0 - 1.0 / loud))
        result[name] = stand_out, float(np.median(coherence))
    return result


def target_lines(recording: Recording) -> dict[str, IntArray] | None:
    """Lines of the forcing functions, None where the target's are too few to tell anything."""
    lines = known_lines(recording)
    return lines if "ft" in lines and lines["ft"].size >= FEWEST_LINES else None


def at_lines(
    recording: Recording, signal: FloatArray, lines: IntArray, every: dict[str, IntArray]
) -> tuple[ComplexArray, FloatArray]:
    """Transforms of a signal at lines, shape (runs, lines), and the power of the noise there.

    What transients leak is smooth in frequency, so that the bins beside a line tell it.
    """
    spectrum = np.fft.rfft(recording.window(signal))
    free = np.ones(spectrum.shape[1], dtype=bool)
    free[np.concatenate([[0], hidden_lines(recording), *every.values()])] = False
    between = np.flatnonzero(free)
    # The nearest are among so many on either side.
    first = np.searchsorted(between, lines) - BESIDE
    first = np.clip(first, 0, max(0, between.size - 2 * BESIDE))
    around = between[first[:, None] + np.arange(min(2 * BESIDE, between.size))]
    order = np.argsort(np.abs(around - lines[:, None]), axis=1, kind="stable")[:, :BESIDE]
    values, beside = spectrum[:, lines], spectrum[:, np.take_along_axis(around, order, axis=1)]
    noise = np.mean(np.var(beside, axis=2), axis=0) + 1e-12 * np.max(np.abs(values)) ** 2
    return values - beside.mean(axis=2), noise


def jumps_of(recording: Recording) -> FloatArray:
    """By how much the target jumps just before each sample, shape (runs, samples); else zeros."""
    target = recording.input("ft")
    steps = np.diff(target, axis=1, prepend=target[:, :1])
    size = np.abs(steps)
    is_large = size > np.std(target) / JUMP
    if not is_large.any():  # as of most: what follows takes memory
        return np.zeros_like(target)
    # Of a signal that is held for some samples every step is one.
    near = np.lib.stride_tricks.sliding_window_view(np.pad(size, ((0, 0), (4, 4))), 9, axis=1)
    beside = np.maximum(near[..., :4].max(axis=-1), near[..., 5:].max(axis=-1))
    return np.where(is_large & (size > JUMP * beside), steps, 0.0)


@dataclass(frozen=True, eq=False)
class Floors:
    """Spectra of signals, and the floors of the recorder.

    Attributes
    ----------
    omega
        Frequencies [rad/s], shape (n,).
    power
        Smoothed power density by signal, the unit of the signal squared per rad/s, shape (n,).
    floor
        The recorder's, of the same unit, by signal.
    """

    omega: FloatArray
    power: dict[str, FloatArray]
    floor: dict[str, float]

    def share(self, names: Iterable[str]) -> FloatArray:
        """Share of the power of signals that is not the recorder's, of the worst, shape (n,).

        It falls with frequency from where it is largest: what follows a floor is no signal.
        """
        share = np.ones(self.omega.size)
        for name in names:
            above = 1.0 - SAFE * self.floor[name] / np.maximum(self.power[name], 1e-300)
            share = np.minimum(share, np.clip(above, 0.0, 1.0))
        largest = int(np.argmax(share))
        share[largest:] = np.minimum.accumulate(share[largest:])
        return share

    def usable(self, names: Iterable[str]) -> float:
        """Frequency up to which half of the power of signals is not the recorder's [rad/s]."""
        above = self.omega[self.share(names) >= 0.5]
        return float(above[-1] if above.size else self.omega[0])


@remembered
def floors_of(recording: Recording) -> Floors:
    """Spectra and floors of the signals that pilots act on, and of the control."""
    nyquist = math.pi / recording.dt
    signals = {name: recording.input(name) for name in ("e", "x", "ft", "u", *recording.extra)}
    power, floor = {}, {}
    for name, signal in signals.items():
        density, step = periodogram(signal, recording.dt)
        omega, power[name] = running_median(density, step)
        top = slice(int(FLOOR_FROM * nyquist / step) + 1, int(FLOOR_TO * nyquist / step) + 1)
        floor[name] = float(density[:, top].mean())
    if recording.ft is not None:  # a target that steps has all frequencies, and is no noise
        noise = periodogram(recording.e - recording.ft, recording.dt)[0][:, top]
        floor["e"] = min(floor["e"], float(noise.mean()))
    with suppress(NotMultisineError):
        if lines_of(recording, "ft").size:  # what lies between is no noise, and no signal either
            floor["ft"] = 0.0
    return Floors(omega, power, floor)


def periodogram(signals: FloatArray, dt: float) -> tuple[FloatArray, float]:
    """Power densities of signals (runs, samples) behind a Blackman-Harris window.

    Returns
    -------
    Densities, shape (runs, bins), and the distance of bins [rad/s].
    """
    samples = signals.shape[1]
    centred = signals - signals.mean(axis=1, keepdims=True)
    spectra: ComplexArray = np.fft.rfft(_blackman_harris(samples) * centred)
    return np.abs(spectra) ** 2 * (dt / np.pi), 2.0 * math.pi / (samples * dt)


@lru_cache(maxsize=1)
def _blackman_harris(samples: int) -> FloatArray:
    """The window, of unit power: several signals of as many samples follow one another."""
    turn = 2.0 * np.pi * np.arange(samples) / samples
    window = 0.35875 - 0.48829 * np.cos(turn) + 0.14128 * np.cos(2 * turn)
    window -= 0.01168 * np.cos(3 * turn)
    return np.asarray(window / np.linalg.norm(window))


def running_median(density: FloatArray, step: float) -> tuple[FloatArray, FloatArray]:
    """Smoothed densities of all runs.

    The median of a periodogram of noise is ln 2 of its mean.

    Parameters
    ----------
    density
        Periodograms, shape (runs, bins).
    step
        Distance of bins [rad/s].

    Returns
    -------
    Frequencies [rad/s] and densities there, shape (n,).
    """
    reach = max(2, int(HALF_WIDTH / step))
    count = density.shape[1] // reach
    blocks = density[:, : count * reach].reshape(len(density), count, reach)
    pairs = np.concatenate([blocks[:, :-1], blocks[:, 1:]], axis=2)
    medians = np.median(pairs.transpose(1, 0, 2).reshape(count - 1, -1), axis=1)
    omega = (np.arange(1, count) * reach - 0.5) * step
    return omega, medians / math.log(2.0)
