"""The controlled element as a recording shows it: the output's answer to control and disturbance.

The output holds no noise of its own: x = Hc (u + fd) at every frequency, remnant or not.  So the
coherence of the two is close to one wherever names, signs and times are right, and the slope of
the magnitude tells which phase a positive element has (Bode's relation for minimum phase).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np

from pilotid.recording.recording import Recording, remembered
from pilotid.recording.spectra import at_lines, target_lines
from pilotid.support.limits import ELEMENT
from pilotid.support.remarks import Remark
from pilotid.support.types import ComplexArray, FloatArray, IntArray

BANDS = 12  # equally wide on a logarithmic scale
LOWEST, HIGHEST = 0.5, 15.0  # rad/s
FEWEST_BINS = 4  # of all runs, of which the coherence of a band is made
FEWEST_BANDS = 4


@dataclass(frozen=True, eq=False)
class Plant:
    """What the output makes of control and disturbance, by bands of frequency.

    Attributes
    ----------
    omega
        Frequencies [rad/s], shape (bands,).
    response
        x over u + fd (or over fd - u, if `opposed`), complex, shape (bands,).
    coherence
        Squared coherence, shape (bands,).
    size
        Root mean square of x, in any unit, shape (bands,).
    polarity
        Cosine of the angle to what the slope says: 1 positive, -1 negative; 0 if untold.
    opposed
        Whether x answers to fd - u: control and disturbance have opposite signs.
    """

    omega: FloatArray
    response: ComplexArray
    coherence: FloatArray
    size: FloatArray
    polarity: float = 0.0
    opposed: bool = False

    @property
    def mean_coherence(self) -> float:
        """Mean of the squared coherence, by weights of the root of x's size.

        Fast remnant that sampling folds down is in u and not in x; it counts where x is small.
        """
        return float(np.average(self.coherence, weights=np.sqrt(self.size)))


@remembered
def plant_of(recording: Recording, run: int | None = None) -> Plant | None:
    """The controlled element that a recording shows, None where it is too short to show one.

    Parameters
    ----------
    recording
        The recording.
    run
        One of its runs alone; None for all.
    """
    rows = slice(None) if run is None else slice(run, run + 1)
    output, control = (_spectrum(recording, signal[rows]) for signal in (recording.x, recording.u))
    forcing = None if recording.fd is None else _spectrum(recording, recording.fd[rows])
    plants = []
    for sign in (1.0,) if forcing is None else (1.0, -1.0):
        drive = control if forcing is None else sign * control + forcing
        plant = _answer(output, drive, recording.duration)
        if plant is None:
            return None
        if recording.fd is None:
            polarity = _polarity_at_target(recording, rows)
        else:
            good = plant.coherence >= ELEMENT.coherent
            polarity = _polarity(plant.omega[good], plant.response[good])
        plants.append(replace(plant, polarity=polarity, opposed=sign < 0.0))
    return max(plants, key=lambda plant: plant.mean_coherence - ELEMENT.clearly * plant.opposed)


@lru_cache
def _bands(duration: float, runs: int, count: int) -> tuple[FloatArray, IntArray]:
    """Middles of the bands [rad/s], and the first and the end of each one's bins, (bands, 2)."""
    bins = np.arange(count) * 2.0 * np.pi / duration
    edges = np.searchsorted(bins, np.geomspace(LOWEST, HIGHEST, BANDS + 1))
    bands = [(a, b) for a, b in pairwise(edges.tolist()) if b - a >= max(2.0, FEWEST_BINS / runs)]
    omega = [float(np.exp(np.mean(np.log(bins[a:b])))) for a, b in bands]
    return np.array(omega), np.array(bands, dtype=int).reshape(-1, 2)


def _polarity(omega: FloatArray, response: ComplexArray) -> float:
    if omega.size < FEWEST_BANDS:
        return 0.0
    slope = np.clip(np.gradient(np.log(np.abs(response)), np.log(omega)), -2.0, 0.0)
    return float(np.mean(np.cos(np.angle(response) - 0.5 * np.pi * slope)))


def _polarity_at_target(recording: Recording, rows: slice) -> float:
    """The same where fd was not recorded: there may be a disturbance, but not at these lines."""
    every = target_lines(recording)
    if every is None:
        return 0.0
    lines = every["ft"]
    omega = np.asarray(lines * 2.0 * np.pi / recording.duration, dtype=float)
    good = (omega >= LOWEST) & (omega <= HIGHEST)
    values = []
    for signal in (recording.u, recording.x):
        at, noise = at_lines(recording, signal, lines, every)
        values.append(at[rows])
        good &= np.mean(np.abs(at[rows]) ** 2, axis=0) > ELEMENT.stands_out * noise
    control, output = values
    response = np.mean(output * control.conj(), axis=0) / np.mean(np.abs(control) ** 2, axis=0)
    return _polarity(omega[good], response[good])


def _answer(output: ComplexArray, drive: ComplexArray, duration: float) -> Plant | None:
    """What the output (runs, bins) makes of its drive; None where they are too short to show it."""
    omega, bands = _bands(duration, *output.shape)
    if len(bands) < FEWEST_BANDS:
        return None
    end = bands[-1, 1] + 1  # a sum ends before the bin that is named
    output, drive = output[:, :end], drive[:, :end]
    cross, power, size = (
        np.add.reduceat((one * other.conj()).sum(axis=0), bands.ravel())[::2]
        for one, other in ((output, drive), (drive, drive), (output, output))
    )
    if not (np.all(power.real > 0.0) and np.all(size.real > 0.0)):
        return None
    coherence = np.abs(cross) ** 2 / (power.real * size.real)
    return Plant(omega, cross / power.real, coherence, np.sqrt(size.real))


def _spectrum(recording: Recording, signal: FloatArray, part: slice = slice(None)) -> ComplexArray:
    window = recording.window(signal)[:, part]
    window = window - window.mean(axis=1, keepdims=True)
    return np.asarray(np.fft.rfft(window * np.hanning(window.shape[1])))


def opposed(recording: Recording) -> Remark | None:
    """The sign of the control, from what the output makes of it and of the disturbance.

    A pilot's response tells nothing: with a negative element he would turn his own sign round.
    """
    runs: list[int | None] = list(range(recording.runs)) if recording.runs > 1 else [None]
    signs = {run: _signs(recording, run) for run in runs}
    known = {run: names for run, names in signs.items() if names is not None}
    wrong = {run: names for run, names in known.items() if names}
    if not wrong and not known:  # what no run tells may show in all of them together
        wrong = {None: names} if (names := _signs(recording, None)) else {}
    if not wrong:
        return None
    first, names = next(iter(wrong.items()))
    some = len(wrong) < len(known)  # others are known to be right
    where = f" in run {first + 1}" if some and first is not None else ""
    remedy = (
        "turn it round in the file, or leave that run out with --runs"
        if where
        else f"flip with --map {recording.flipped(*names)}"
    )
    return Remark(
        "wrong-sign",
        f"{' and '.join(names)} {'have' if len(names) > 1 else 'has'} the wrong sign{where}: the "
        f"pilot's gain is negative, unless the controlled element's is; {remedy}",
    )


def _signs(recording: Recording, run: int | None) -> tuple[str, ...] | None:
    """The signals of a run whose signs must be turned round for a positive element.

    None if it cannot be told; no run means all of them.
    """
    plant = plant_of(recording, run)
    if plant is None or (not plant.opposed and abs(plant.polarity) < -ELEMENT.negative):
        return None
    if not plant.opposed:
        wrong = ("u",) if recording.fd is None else ("u", "fd")
        return wrong if plant.polarity < 0.0 else ()
    return ("fd",) if plant.polarity < ELEMENT.negative else ("u",)


def is_gain(recording: Recording) -> bool:
    """Whether the output answers at once: its response is flat over frequency."""
    plant = plant_of(recording)
    if plant is None:
        return False
    known = plant.response[plant.coherence >= ELEMENT.coherent]
    off = np.abs(known / np.mean(known) - 1.0) if known.size else np.ones(1)
    return known.size >= FEWEST_BANDS and bool(np.max(off) <= ELEMENT.flat)


def element_changes(recording: Recording) -> Remark | None:
    """An element that is another one in the second half of the recording than in the first."""
    half = recording.samples // 2
    drive = recording.u if recording.fd is None else recording.u + recording.fd
    first, second = (
        _answer(
            _spectrum(recording, recording.x, part),
            _spectrum(recording, drive, part),
            half * recording.dt,
        )
        for part in (slice(half), slice(-half, None))
    )
    if first is None or second is None:
        return None
    good = np.minimum(first.coherence, second.coherence) >= ELEMENT.coherent
    if np.count_nonzero(good) < FEWEST_BANDS:
        return None
    ratio = second.response[good] / first.response[good]
    apart = float(np.median(np.abs(np.log(ratio))))
    if apart <= ELEMENT.changed:
        return None
    return Remark(
        "element-varies",
        "the controlled element of the second half differs from that of the first by a factor of "
        f"{float(np.exp(np.max(np.abs(np.log(np.abs(ratio)))))):.2g} at some frequencies: no "
        "single transfer function describes it; fit the halves separately, or use a time-varying "
        "model",
    )


def unrelated(recording: Recording) -> Remark | None:
    """An output that is not the control's answer belongs to another run or time."""
    plant = plant_of(recording)
    least = ELEMENT.unrelated_without_fd if recording.fd is None else ELEMENT.unrelated
    if plant is None or plant.mean_coherence >= least:
        return None
    what = "u" if recording.fd is None else "u + fd"
    return Remark(
        "output-unrelated",
        f"x is not the answer to {what}: their coherence is {plant.mean_coherence:.2f} where an "
        "element without noise has 1; the signals are of different runs, times, axes or units, "
        "another disturbance acts, or the element changes during the recording",
    )
