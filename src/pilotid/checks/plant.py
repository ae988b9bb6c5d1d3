"""The controlled element as a recording shows it: the output's answer to control and disturbance.

Times of signals against one another follow from regressions on their derivatives behind a filter.

The output holds no noise of its own: x = Hc (u + fd) at every frequency, remnant or not.  So the
coherence of the two is close to one wherever names, signs and times are right, and the slope of
the magnitude tells which phase a positive element has (Bode's relation for minimum phase).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from pilotid.checks.element_forms import INDEPENDENT, Spectra, drive_of
from pilotid.model.element import ControlledElement
from pilotid.recording.recording import Recording, remembered
from pilotid.recording.spectra import at_lines, target_lines
from pilotid.support.limits import ELEMENT, RECORDER
from pilotid.support.remarks import Remark
from pilotid.support.types import ComplexArray, FloatArray, IntArray

# ------------------------------------------------------------ times of signals against one another

#: Standard deviation of the Gaussian that all signals pass before times are compared [s].
SMOOTH = 0.06
#: Share of the control left unexplained from which shifts are sought.
MUCH = 1e-3
LATEST = 1.2  # s, by which an output may be late


def derivatives(signal: FloatArray, dt: float, order: int) -> list[FloatArray]:
    """A signal and its derivatives behind a Gaussian filter, without what ends reach."""
    omega = 2.0 * np.pi * np.fft.rfftfreq(signal.shape[1], dt)
    spectrum = np.fft.rfft(signal - signal.mean(axis=1, keepdims=True))
    spectrum *= np.exp(-0.5 * (omega * SMOOTH) ** 2)
    edge = math.ceil(6.5 * SMOOTH / dt)
    signals = []
    for _ in range(order + 1):  # in place: an hour at 1 kHz is large
        signals.append(np.fft.irfft(spectrum, n=signal.shape[1])[:, edge:-edge])
        spectrum *= omega
        spectrum *= 1j
    return signals


def regression(
    wanted: FloatArray, columns: Sequence[FloatArray], step: float
) -> tuple[FloatArray, FloatArray, float]:
    """Least squares: values, their standard errors by blocks of 2 s, and the share left."""
    table = np.stack([c.ravel() for c in columns], axis=1)
    size = np.sqrt(np.mean(table**2, axis=0)) + 1e-300
    table /= size
    target = wanted.ravel()
    inverse = np.linalg.inv(table.T @ table + 1e-12 * len(table) * np.eye(table.shape[1]))
    values = inverse @ (table.T @ target)
    left = target - table @ values
    blocks = np.arange(0, left.size, max(1, int(2.0 / step)))
    scores = np.add.reduceat(table * left[:, None], blocks)
    covariance = inverse @ (scores.T @ scores) @ inverse
    share = float(left @ left) / (float(target @ target) or 1.0)
    return values / size, np.sqrt(np.maximum(np.diag(covariance), 0.0)) / size, share


class Answered(NamedTuple):
    """How much later x answers than an element says [s], and its standard error."""

    late: float
    error: float


def shifted(signal: FloatArray, dt: float, earlier: float) -> FloatArray:
    """A signal so much earlier, by straight lines between samples; its ends stay."""
    time = dt * np.arange(signal.shape[1])
    return np.array([np.interp(time + earlier, time, row) for row in signal])


def answered(spectra: Spectra, element: ControlledElement) -> Answered | None:
    """The time by which an output lags the answer of an element to its input.

    A disturbance that was not recorded spoils the bins near its lines, so that a median over bins
    is taken.

    Parameters
    ----------
    spectra
        Of input and output.
    element
        The element, with two derivatives of the input and `HIGHEST` of the output at most.
    """
    top, bottom = np.array(element.numerator), np.array(element.denominator)
    if len(bottom) > len(spectra.output):
        return None
    output = bottom[::-1] @ spectra.output[: len(bottom)]
    ratio = output / (top[::-1] @ spectra.inputs(len(top), element.delay))
    omega, unit = spectra.powers[1, 2].imag, ratio / np.abs(ratio)
    times = np.arange(-LATEST, LATEST, 0.01)
    late = float(times[np.argmax(np.real(np.exp(1j * np.outer(times, omega)) @ (omega * unit)))])
    for _ in range(3):
        off = -np.angle(unit * np.exp(1j * omega * late))
        late += float(np.quantile(off / omega, 0.5, weights=omega, method="inverted_cdf"))
    turned = ratio * np.exp(1j * omega * late)
    gain = float(np.median(turned.real))
    left = float(np.median(np.abs(turned / gain - 1.0)))
    if not left**2 < RECORDER.left:
        return None
    # A median has 1.25 times the error of a mean; independent bins of the window are fewer.
    scatter = 1.25 * 1.48 * float(np.median(np.abs(np.angle(turned))))
    return Answered(late, scatter / math.sqrt(INDEPENDENT * float(omega @ omega)))


class Best(NamedTuple):
    """How much later u is than fd [s], the share of fd, and what is left of u unexplained."""

    late: float
    error: float
    share: float
    share_error: float
    left: float


def against_forcing(signals: dict[str, FloatArray], dt: float) -> Best:
    """How u, fd and x go together with the least left, of all shifts if without them much is.

    (1 + z d/dt)(u(t + a) + b fd) = sum of c_j times the j-th derivative of x(t + c).
    Shifts are 1.2 s of u and .45 s of x at most, in steps of 50 ms, and finer within .12 s.  Where
    all leave much, one counts that leaves a fifth of what none leaves, or that is long while x
    answers to u and fd alike; else errors are infinite.
    """
    reach, every = int(1.2 / dt), max(1, int(0.045 / dt))
    control, forcing, output = (
        derivatives(signals[name], dt, order) for name, order in (("u", 1), ("fd", 1), ("x", 4))
    )

    def cut(several: list[FloatArray], shift: int, runs: int | None) -> list[FloatArray]:
        end = several[0].shape[1] - reach + shift
        return [signal[:runs, reach + shift : end : every] for signal in several]

    def at(
        shifts: tuple[int, int], runs: int | None = None
    ) -> tuple[FloatArray, FloatArray, float]:
        (u, rate), (fd, forced) = cut(control, shifts[0], runs), cut(forcing, 0, runs)
        columns = [-rate, -fd, -(rate + forced), np.ones_like(u), *cut(output, shifts[1], runs)]
        return regression(u, columns, every * dt)

    def about(shifts: tuple[int, int]) -> Best:
        """The relation about shifts of u and x, as the derivative is right for small ones alone."""
        for _ in range(5):
            values, errors, left = at(shifts)
            share = float(values[1]) or 1.0
            late = float(values[0] + values[2] * (1.0 - 1.0 / share)) + shifts[0] * dt
            parts = errors[0], errors[2] * (1.0 - 1.0 / share), values[2] * errors[1] / share**2
            error = math.hypot(*map(float, parts))
            near = int(np.clip(round(late / dt), -reach, reach)), shifts[1]
            if near == shifts:
                break
            shifts = near
        return Best(late, error, share, float(errors[1]), left)

    best = about((0, 0))
    if best.left <= MUCH:
        return best
    small, step, most = round(0.12 / dt), max(1, round(0.05 / dt)), round(0.45 / dt)
    fine = range(-small, small + 1, max(1, small // 10))
    # x goes with fd if u is late, and with u if fd is.
    grid = sorted({*fine, *range(-(reach // step) * step, reach, step)})
    tried = [(u, x) for u in grid for x in {0, u} if abs(x) <= most]
    shifted_best = about(min(tried, key=lambda pair: at(pair, 1)[2]))
    best = min(best, shifted_best, key=lambda best: best.left)
    is_long = abs(best.late) > RECORDER.long and abs(best.share - 1.0) <= RECORDER.alike
    is_told = is_long or best.left <= max(MUCH, 0.2 * at((0, 0))[2])
    return best if is_told else best._replace(error=math.inf, share_error=math.inf)


# ------------------------------------------------------------------------ the answer of the output


LOWEST, HIGHEST = 0.5, 15.0  # rad/s
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
    signals = (s[rows] for s in (recording.x, recording.u, recording.fd) if s is not None)
    output, control, *forcing = (_spectrum(recording, signal) for signal in signals)
    plants = list[Plant]()
    for drive in [forcing[0] + control, forcing[0] - control] if forcing else [control]:
        if (plant := _answer(output, drive, recording.duration)) is None:
            return None
        good = plant.coherence >= ELEMENT.coherent
        polarity = _polarity(plant.omega[good], plant.response[good])
        if not forcing:
            polarity = _polarity_at_target(recording, rows)
        plants.append(replace(plant, polarity=polarity, opposed=bool(plants)))
    return max(plants, key=lambda plant: plant.mean_coherence - ELEMENT.clearly * plant.opposed)


def _bands(duration: float, runs: int, count: int) -> tuple[FloatArray, IntArray]:
    """Middles of the bands [rad/s], and the first and the end of each one's bins, (bands, 2).

    They are twelve, equally wide on a logarithmic scale, less those whose coherence would be made
    of fewer than four bins of all runs.
    """
    bins = np.arange(count) * 2.0 * np.pi / duration
    edges = np.searchsorted(bins, np.geomspace(LOWEST, HIGHEST, 13))
    bands = [(a, b) for a, b in pairwise(edges.tolist()) if b - a >= max(2.0, 4.0 / runs)]
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
    signs = {run: _signs(recording, plant_of(recording, run)) for run in range(recording.runs)}
    known = {run: names for run, names in signs.items() if names is not None}
    # What no run tells may show in all of them together.
    known = known or {0: _signs(recording, plant_of(recording)) or ()}
    wrong = {run: names for run, names in known.items() if names}
    if not wrong:
        return None
    first, names = next(iter(wrong.items()))
    where, cure = "", f"flip with --map {recording.flipped(*names)}"
    if len(wrong) < len(known):  # others are right
        where = f" in run {first + 1}"
        cure = "turn it round in the file, or leave that run out with --runs"
    return Remark(
        "wrong-sign",
        f"{' and '.join(names)} {'have' if len(names) > 1 else 'has'} the wrong sign{where}: the "
        f"pilot's gain is negative, unless the controlled element's is; {cure}",
    )


def _signs(recording: Recording, plant: Plant | None) -> tuple[str, ...] | None:
    """The signals whose signs must be turned round for a positive element; None if untold."""
    if plant is None or (not plant.opposed and abs(plant.polarity) < -ELEMENT.negative):
        return None
    if recording.fd is not None and plant.mean_coherence < ELEMENT.unrelated:
        return None  # x is not the answer to either
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


def response_ratios(
    plants: Sequence[Plant | None],
) -> tuple[FloatArray, ComplexArray] | None:
    """Frequencies where all are coherent, and logarithms of responses over the first one there.

    Shapes (bands,) and (plants, bands); None if a plant is not known, or too few bands are coherent
    in all.
    """
    known = [plant for plant in plants if plant is not None]
    if len(known) < max(2, len(plants)):
        return None
    good = np.all([plant.coherence >= ELEMENT.coherent for plant in known], axis=0)
    ratios = np.array([plant.response[good] / known[0].response[good] for plant in known])
    return (known[0].omega[good], np.log(ratios)) if len(ratios.T) >= FEWEST_BANDS else None


def runs_apart(recording: Recording) -> Iterator[tuple[str, FloatArray, ComplexArray]]:
    """What the other runs are called, and how far each run's response is from theirs.

    Frequencies and logarithms of ratios as in `response_ratios`; nothing where they are not known.
    """
    told = response_ratios([plant_of(recording, run) for run in range(recording.runs)])
    if told is not None:
        omega, ratios = told
        if recording.runs > 2:
            ratios -= np.median(ratios.real, axis=0) + 1j * np.median(ratios.imag, axis=0)
        yield "the other" + "s" * (recording.runs > 2), omega, ratios


def element_changes(recording: Recording) -> Remark | None:
    """An element that is another one in the second half of the recording than in the first."""
    half = recording.samples // 2
    signals, halves = (recording.x, drive_of(recording)), (slice(half), slice(-half, None))
    spectra = ([_spectrum(recording, signal, part) for signal in signals] for part in halves)
    told = response_ratios([_answer(x, v, half * recording.dt) for x, v in spectra])
    second = np.zeros(1) if told is None else told[1][1]
    if np.median(np.abs(second)) <= ELEMENT.changed:
        return None
    factor = float(np.exp(np.max(np.abs(second.real))))
    return Remark(
        "element-differs",
        "the controlled element of the second half differs from that of the first by a factor of "
        f"{factor:.2g} at some frequencies: no single transfer function describes it; fit the "
        "halves separately, or use a time-varying model",
    )


def unrelated(recording: Recording) -> Remark | None:
    """An output that is not the control's answer belongs to another run or time."""
    is_forced = recording.fd is not None
    least = ELEMENT.unrelated if is_forced else ELEMENT.unrelated_without_fd
    plant, what = plant_of(recording), "u + fd" if is_forced else "u"
    if plant is None:
        return None
    every = {run: plant_of(recording, run) for run in range(recording.runs)}
    wrong = [str(run + 1) for run, p in every.items() if p and p.mean_coherence < least]
    coherence = min(p.mean_coherence for p in (plant, *every.values()) if p)
    in_part = coherence >= least
    if in_part and (is_forced or plant.mean_coherence >= ELEMENT.unrelated_in_part):
        return None
    where = f" in run {', '.join(wrong)}" if 0 < len(wrong) < recording.runs else ""
    return Remark(
        "output-unrelated",
        f"x is {'in part only' if in_part else 'not'} the answer to {what}{where}: their coherence "
        f"is {coherence:.2f} where an element without noise has 1; signals are of different runs, "
        "times, axes or units, a disturbance is not recorded (give it as fd), or the element "
        "changes",
        "note" if in_part else "wrong",
    )
