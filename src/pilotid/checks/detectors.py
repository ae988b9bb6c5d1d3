"""What a recorder did to signals, each fault with its size.

Nothing here knows a model of the pilot.  Each detector rests on what a sound recording has
whoever flies: spectra fall smoothly, x is the smooth answer of an element to u + fd, and
e = ft - x.  Limits stand in `pilotid.support.limits`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from itertools import pairwise, permutations

import numpy as np

from pilotid.checks.element_forms import drive_of, fits_of, simplest, spectra_of
from pilotid.checks.plant import (
    MUCH,
    Answered,
    against_forcing,
    answered,
    derivatives,
    regression,
    runs_apart,
    shifted,
)
from pilotid.model.element import parsed_element
from pilotid.recording.recording import Recording, remembered
from pilotid.recording.windows import of_runs
from pilotid.support.limits import ELEMENT, RECORDER
from pilotid.support.remarks import GRADES, Grade, Remark
from pilotid.support.types import FloatArray


@dataclass(frozen=True)
class Finding:
    """A fault of the recorder.

    Attributes
    ----------
    code, signal
        What it is, see `pilotid.support.remarks.CODES`, and of which signal.
    grade
        ``wrong`` if a fit is wrong for it, ``doubt`` if it may be, ``note`` if fits allow for it.
    size, unit
        How large it is.
    sentence
        What is wrong, how large it is, and what to do.
    usable
        Highest frequency up to which the signal can be used [Hz].
    """

    code: str
    signal: str
    grade: Grade
    size: float
    unit: str
    sentence: str
    usable: float = math.inf

    @property
    def is_turned(self) -> bool:
        """Whether fd has another sign and the same size, which `opposed` tells more surely."""
        return self.code == "wrong-unit" and abs(self.size + 1.0) <= RECORDER.gain


@remembered
def findings(recording: Recording) -> tuple[Finding, ...]:
    """All faults of the recorder that the signals show, the gravest first."""
    look = _Look(recording)
    if not {"e", "u"} <= set(look.signals):
        return ()
    with np.errstate(all="ignore"):  # a signal may be of any size
        faults = [*_ends(recording), *look.lost(), *look.steps()]
        if not any(f.code == "lost-samples" for f in faults):
            faults += look.identity()
            faults += look.times(faults)
        faults += look.copies()
    once = {(f.code, f.signal): f for f in reversed(faults)}
    return tuple(sorted(once.values(), key=lambda finding: GRADES.index(finding.grade)))


@remembered
def _ends(recording: Recording) -> tuple[Finding, ...]:
    """What ends the band of a signal, so that nothing is left of it above."""
    with np.errstate(all="ignore"):
        look = _Look(recording)
        # What is interpolated falls as well: of one signal the first is told.
        return (*look.grids(), *look.falls())


def band_end(recording: Recording) -> float:
    """Frequency above which a filter or an interpolation left nothing of a signal [rad/s]."""
    return 2.0 * math.pi * min((f.usable for f in _ends(recording)), default=math.inf)


def is_resampled(recording: Recording, name: str) -> bool:
    """Whether a signal was recorded at a lower rate, and held or interpolated between."""
    return any(f.signal == name and f.usable < f.size for f in _ends(recording))


class _Look:
    """The signals of a recording that move, and what several detectors use of them."""

    def __init__(self, recording: Recording) -> None:
        self.recording, self.dt = recording, recording.dt
        every = {name: recording.window(recording.input(name)) for name in recording.signals}
        self.signals = {name: s for name, s in every.items() if np.any(np.diff(s, axis=1))}
        self.answers = {n: s for n, s in self.signals.items() if n not in ("ft", "fd")}

    def falls(self) -> Iterator[Finding]:
        """Low-pass filters: spectra of pilots and elements fall, but nowhere that steeply."""
        bands = _bands(self.recording.samples, self.dt)
        if len(bands) < 10:
            return
        hertz = np.array([math.sqrt(a * b) for a, b in bands]) / self.recording.duration
        bins = np.diff(bands, axis=1).ravel() * self.recording.runs
        for name, half, whole in zip("ux", RECORDER.half_octave, RECORDER.octave, strict=True):
            if name not in self.signals:
                continue
            signal = self.signals[name] - self.signals[name].mean(axis=1, keepdims=True)
            # The side lobes of a window cos^4 fall by 30 dB an octave.
            transform = np.fft.rfft(signal * np.hanning(signal.shape[1]) ** 2)
            power = np.mean(np.abs(transform) ** 2, axis=0)
            # Medians, by sorting: what numpy has for it takes ten times as long for so few.
            halves = [np.sort(power[a:b])[[(b - a - 1) // 2, (b - a) // 2]] for a, b in bands]
            middle = np.mean(halves, axis=1)
            level = 10.0 * np.log10(middle + 1e-300)
            slope, at = level[3:] - level[:-3], hertz[:-3]
            known = (at > 1.0) & (bins[:-3] >= 10)  # of fewer bins no level is told
            if not known.any():
                continue
            steepest = first = int(np.argmin(np.where(known, slope, 0.0)))
            between = known[:-3] & (hertz[:-6] < 9.0)
            octave = float(np.min((level[6:] - level[:-6])[between], initial=0.0))
            if slope[steepest] >= half and octave >= whole:
                continue
            while first > 0 and slope[first - 1] < RECORDER.goes_on:
                first -= 1
            usable = float(at[first])
            # Between the lines of a recording without remnant there is next to nothing anyway.
            density = 10.0 * np.log10(power + 1e-300)
            out = [np.max(density[begin:end]) for begin, end in bands] - level
            if np.max(out) > RECORDER.lines[0] or np.max(out[steepest + 3 :]) > RECORDER.lines[1]:
                continue
            words = (
                "a low-pass filter or an interpolation begins there; fits end there, and record "
                "without it, or with the same causal filter on all signals"
            )
            yield _band_ends(name, usable, usable, words)

    def grids(self) -> Iterator[Finding]:
        """Signals resampled from a lower rate: every k-th difference is small."""
        for name, signal in self.answers.items():
            score, step = _grid(signal)
            rate = 1.0 / (step * self.dt) if step else 0.0
            # Edges of a target like a square wave repeat as slowly as nobody records.
            if score > RECORDER.grid and rate >= RECORDER.slowest:
                words = (
                    f"it was recorded at {rate:.3g} Hz, and held or interpolated between; give the "
                    "samples as they were recorded"
                )
                yield _band_ends(name, rate, 0.25 / (step * self.dt), words)

    def steps(self) -> Iterator[Finding]:
        """Rounding, by a converter or by the decimals of a text file."""
        for name, signal in self.answers.items():
            step, rms = step_of(self.recording, name), float(np.std(signal))
            if step > RECORDER.coarse * rms:
                words = (
                    f"{name} has steps of {step:.3g}, {100.0 * step / rms:.3g} % of its rms: small "
                    "movements are lost, and the controlled element may not show; record with "
                    "finer steps, and name the element with --element"
                )
                unit = self.recording.units.get(name, "")
                yield Finding("rounded", name, "doubt", step, unit, words)

    def lost(self) -> Iterator[Finding]:
        """Samples of x lost, repeated or spiked: x cannot be told from its past and its drive."""
        forced = [self.signals[n] for n in ("ft", "fd") if n in self.signals]
        stepped = any(_is_stepped(signal) for signal in forced)
        if "x" not in self.signals or stepped or is_resampled(self.recording, "x"):
            return
        x, drive = self.signals["x"], self.recording.window(drive_of(self.recording))
        # What stands still between steps of a converter is told without error.
        by_steps = RECORDER.converter_steps * step_of(self.recording, "x") / float(np.std(x))
        share, count, run, sample = _outliers(x, drive, self.dt, max(RECORDER.outlier[1], by_steps))
        if not count:
            return
        at, why = sample * self.dt, "samples are lost or spiked; leave these parts out"
        if any(_begins_again(signal, sample) for signal in forced):
            why = f"runs follow one another; give each a column, or take one: --span 0:{at:.6g}"
        words = (
            f"x jumps {count} times, first at t = {at:.4g} s of run {run + 1}, by up to "
            f"{100.0 * share:.3g} % of its rms where u + fd do not: {why}"
        )
        yield Finding("lost-samples", "x", "wrong", float(count), "samples", words)

    def identity(self) -> Iterator[Finding]:
        """E = ft - x: how much later than in e target and output are recorded."""
        if not {"x", "ft"} <= set(self.signals) or _is_stepped(self.signals["ft"]):
            return
        e, x, ft = (self.signals[n] for n in ("e", "x", "ft"))
        if np.std(e - ft + x) < RECORDER.own * np.std(e):
            return
        every = max(1, round(0.045 / self.dt))
        (error,), (output, rate), (target, speed) = (
            [d[:, ::every] for d in derivatives(s, self.dt, order)]
            for s, order in ((e, 0), (x, 1), (ft, 1))
        )
        values, errors, left = regression(
            error, [target, -output, -speed, rate, np.ones_like(error)], every * self.dt
        )
        if not left < 0.01 or min(abs(values[0]), abs(values[1])) < 0.5:
            return
        least = np.maximum(RECORDER.errors * errors[2:4], RECORDER.identity * self.dt)
        late = -values[2:4] / values[:2]
        if np.all(np.abs(late) > least) and abs(late[0] - late[1]) <= least.max():
            yield _late("e", "ft - x", -float(late.mean()))
            return
        for name, shift, limit in zip(("ft", "x"), late.tolist(), least.tolist(), strict=True):
            if abs(shift) > limit:
                yield _late(name, "e", shift)

    def times(self, faults: Sequence[Finding]) -> list[Finding]:
        """Times of u, fd and x against one another, and what the drive holds of fd."""
        if "x" not in self.signals:
            return []
        late = list(self.against_forcing())
        # With another share of fd in the drive the element's answer is none.
        if not late and not any(f.code == "late-signal" for f in faults):
            late = [*self._late_in_a_run()] or [*self._against_element()]
        return late

    def _late_in_a_run(self) -> Iterator[Finding]:
        """One run whose output has other times: its phase differs in proportion to frequency."""
        for others, omega, ratios in runs_apart(self.recording):
            weight = float(omega @ omega)
            times = -ratios.imag @ omega / weight
            scatter = np.std(ratios.imag + times[:, None] * omega, axis=1) / math.sqrt(weight)
            surely = np.abs(times) > np.maximum(RECORDER.errors * scatter, RECORDER.run_apart)
            run = int(np.argmax(np.abs(times)))
            name, other = ("x", "u") if times[run] > 0.0 else ("u", "x")
            words = (
                f"run {run + 1}: {name} is {1e3 * abs(times[run]):.3g} ms later against {other} "
                f"than in {others}, and delays are wrong by as much; shift it in the file, or "
                f"leave run {run + 1} out with --runs"
            )
            if surely[run]:
                yield Finding("late-signal", name, "wrong", abs(float(times[run])), "s", words)

    def _of_some_runs(self) -> Iterator[Finding]:
        """Times and gains of u and fd that are wrong in some runs alone."""
        told: dict[tuple[str, str], dict[int, Finding]] = {}
        for run in range(1, self.recording.runs + 1):
            for fault in _Look(of_runs(self.recording, [run], f"run {run}")).against_forcing():
                told.setdefault((fault.code, fault.signal), {})[run] = fault
        if len(set[int]().union(*told.values())) == self.recording.runs:
            return  # which all of them together tell best
        for faults in told.values():
            each = [f"run {run}: {f.sentence.partition('; ')[0]}" for run, f in faults.items()]
            runs = f"run {', '.join(map(str, faults))}"
            cure = f"mend {runs} in the file, or leave {runs} out with --runs"
            first = next(iter(faults.values()))
            yield replace(first, sentence="; ".join([*each, cure]))

    def against_forcing(self) -> Iterator[Finding]:
        """Times and gains of u and fd against one another, whatever the element is."""
        if "fd" not in self.signals or _is_stepped(self.signals["fd"]):
            return
        best = against_forcing(self.signals, self.dt)
        if best.left > MUCH and self.recording.runs > 1 and (found := [*self._of_some_runs()]):
            yield from found
            return
        if not best.left < RECORDER.left:
            return
        # Noise on x, which stands on the right-hand side, moves times and shares.
        biased = RECORDER.biased * best.left
        surely = RECORDER.errors * best.error
        least = max(surely, RECORDER.apart[0] * self.dt, RECORDER.apart[1])
        # A simulation that holds u for a sample answers to it half a sample later.
        held = abs(best.late / self.dt + 0.5) <= max(0.1, min(surely / self.dt, 0.5))
        if best.error < RECORDER.told and not held and abs(best.late) > least + biased:
            # Where x answers to the two before fd moves, fd is late and u is not.
            moved = shifted(self.recording.u, self.dt, best.late)
            answer = _answer(replace(self.recording, u=moved)) if best.late < 0.0 else None
            if answer and abs(answer.late - best.late) < abs(answer.late):
                yield _late("fd", "u", -best.late)
            else:
                yield _late("u", "fd", best.late)
        least = RECORDER.errors * best.share_error
        told = best.share_error < 0.05 * max(1.0, abs(best.share)) and best.left <= RECORDER.exact
        if told and abs(best.share - 1.0) > max(least, RECORDER.gain):
            size = float(np.std(self.signals["u"]) / np.std(self.signals["fd"]))
            if abs(best.share) <= max(least, RECORDER.no_share) and size > RECORDER.with_fd:
                words = "u includes fd: x is the answer to u alone; subtract fd from u"
                yield Finding("wrong-unit", "u", "wrong", best.share, "", words)
                return
            factor, unit = unit_conversion(best.share)
            why = f"is in {unit} and u is not" if unit else "or u has another gain than recorded"
            words = (
                f"x answers to u {best.share:+.3g} fd: fd {why}; "
                f"use --map {self.recording.scaled('fd', factor)}"
            )
            yield Finding("wrong-unit", "u", "doubt", best.share, "", words)

    def _against_element(self) -> Iterator[Finding]:
        """X against the answer of the element that the recording names, or else shows.

        What it shows tells nothing of an x that is late: the element may have that delay.
        """
        answer, named = _answer(self.recording), parsed_element(self.recording.controlled_element)
        if answer is None or not answer.error < RECORDER.told:
            return
        late, u = answer.late, self.signals["u"]
        # Of rounding, as a share of u.
        noise = (step_of(self.recording, "u") / float(np.std(u))) ** 2 / 12.0
        least = RECORDER.biased * noise + max(
            RECORDER.errors * answer.error, RECORDER.answer[0] * self.dt, RECORDER.answer[1]
        )
        if named is not None and abs(late) > least:
            yield _late("x", f"the answer of the controlled element {named.name}", late)
        elif named is None and late < -least:
            yield _late("u", "x", -late)

    def copies(self) -> Iterator[Finding]:
        """Runs whose control is the same to the last bit."""
        prints = fingerprints(self.recording)
        for other, digest in enumerate(prints):
            if (one := prints.index(digest)) < other:
                words = (
                    f"runs {one + 1} and {other + 1} have the same control: one is a copy of the "
                    "other; leave it out"
                )
                yield Finding("copied-run", "u", "wrong", 1.0, "", words)


def _band_ends(name: str, size: float, usable: float, why: str) -> Finding:
    grade: Grade = "note" if usable >= RECORDER.enough else "doubt"
    words = f"{name} is usable up to {usable:.2g} Hz: {why}"
    return Finding("low-pass", name, grade, size, "Hz", words, usable)


def _late(name: str, other: str, late: float) -> Finding:
    word, by = ("late", "earlier") if late > 0 else ("early", "later")
    words = (
        f"{name} is {1e3 * abs(late):.3g} ms {word} against {other}, and delays are wrong by as "
        f"much; take {name} so much {by}"
    )
    grade: Grade = "doubt" if name in ("ft", "fd") else "wrong"
    return Finding("late-signal", name, grade, late, "s", words)


def _answer(recording: Recording) -> Answered | None:
    """How much later x answers to u and fd than the element says that is named, or else shows."""
    if element := parsed_element(recording.controlled_element):
        return answered(spectra_of(recording), element)
    fits = fits_of(recording)
    best = simplest(fits) if fits else None
    if best is None or best.left > ELEMENT.sound:
        return None
    return Answered(float(best.values[-1]), float(np.linalg.norm(best.steps[:, -1])))


def _bands(samples: int, dt: float) -> tuple[tuple[int, int], ...]:
    """First and end of the bins of bands of a sixth of an octave, of those with five bins."""
    lowest, top = 0.3, 0.48 / dt  # Hz
    edges = np.geomspace(lowest, top, max(2, int(6 * math.log2(top / lowest)) + 1))
    bins = np.unique(np.ceil(edges * samples * dt).astype(int)).tolist()
    return tuple((a, b) for a, b in pairwise(bins) if b - a >= 5)


def _is_stepped(signal: FloatArray) -> bool:
    return bool(np.mean(np.diff(signal, axis=1) == 0.0) > 0.5)


def _begins_again(signal: FloatArray, sample: int) -> bool:
    """Whether a forcing function is from a sample on what it was from the first one on."""
    count = min(sample, signal.shape[1] - sample)
    apart = signal[:, sample : sample + count] - signal[:, :count]
    return bool(np.std(apart) <= RECORDER.again * np.std(signal))


def _grid(signal: FloatArray, largest: int = 25) -> tuple[float, int]:
    """Mean difference over that of the smallest phase of every k, and that k; 0 for no grid."""
    scores = []
    for order in (1, 2, 4):
        size = np.abs(np.diff(signal, order, axis=1))
        most = int(0.99 * (size.size - 1))
        size = np.minimum(size, np.partition(size, most, axis=None)[most]).mean(axis=0)
        means: dict[int, FloatArray] = {}
        for step in range(min(largest, size.size // 40), 1, -1):
            # Of a multiple's phases the mean takes less time than of the signal.
            wider = next((each for each in means if each % step == 0), 0)
            whole = means[wider] if wider else size[: size.size // step * step]
            phases = np.add.reduce(whole.reshape(-1, step)) * (step / whole.size)
            means[step] = phases
            if 3.0 * np.minimum.reduce(phases) < np.add.reduce(phases) / step:  # or none is small
                score, share = _of_phases(phases)
                scores.append((share, -order, -step, score))
    share, order, step, score = max(scores, default=(0.0, 0, 0, 0.0))
    if not share:
        return 0.0, 0
    # A forcing function that steps is no grid: without the largest fifth a grid still is one.
    size = np.abs(np.diff(signal, -order, axis=1)).mean(axis=0)
    blocks = np.sort(size[: size.size // -step * -step].reshape(-1, -step), axis=0)
    score, share = _of_phases(blocks[: math.ceil(0.8 * len(blocks))].mean(axis=0))
    return (score, -step) if share else (0.0, 0)


def _of_phases(phases: FloatArray) -> tuple[float, float]:
    """Mean over the smallest of phases, and the share of those far below the mean."""
    mean = float(phases.mean())
    score = mean / (float(phases.min()) + 1e-12 * float(phases.max()) + 1e-300)
    return score, float(np.mean(phases < mean / 3.0))


@remembered
def step_of(recording: Recording, name: str) -> float:
    """The step of which all differences of a signal's values are multiples; 0 if there is none."""
    return step_between(recording.window(recording.input(name)))


def step_between(signal: FloatArray) -> float:
    """As `step_of`, of numbers of any shape."""
    values = np.unique(signal)
    apart = np.sort(np.diff(values))
    apart = apart[apart > 1e-9 * (values[-1] - values[0])]
    if apart.size < 20:
        return float(apart[0]) if apart.size else 0.0
    step = float(apart[0])
    for top in (3, 10, 30, 100):  # it grows sharper with every decade
        near = apart[apart < (top + 0.5) * step]
        whole = np.round(near / step)
        step = float(whole @ near) / float(whole @ whole)
    near = apart[apart < 100.5 * step] / step
    return step if near.size > 10 and float(np.std(near - np.round(near))) < 0.1 else 0.0


def unit_conversion(factor: float) -> tuple[float, str]:
    """What a signal must be multiplied with, and the unit that it is in, empty if it is unknown."""
    for exact, unit in ((math.degrees(1.0), "radians"), (math.radians(1.0), "degrees")):
        if abs(factor / exact - 1.0) <= RECORDER.unit:
            return exact, unit
    return float(f"{factor:.3g}"), ""


def _outliers(
    output: FloatArray, drive: FloatArray, dt: float, least: float, order: int = 8
) -> tuple[float, int, int, int]:
    """Largest error, over rms, of x told from its past and its drive, of those that stand out.

    Then how many stand out, and run and sample of the first.  Differences take the place of past
    values, which are all but equal.
    """
    past = [output / (float(np.std(output)) or 1.0)]
    for _ in range(order):
        past.append(np.diff(past[-1], axis=1))
    wanted = past.pop()
    count = wanted.shape[1]
    columns = [p[:, order - 1 - i : order - 1 - i + count] for i, p in enumerate(past)]
    columns += [drive[:, order - i : order - i + count] for i in range(4)]
    sizes = np.array([math.sqrt(float(np.mean(c**2))) + 1e-300 for c in columns])
    kept = np.ones(wanted.shape, dtype=bool)
    for _ in range(3):
        # One by one, as a table of all of them is large.
        parts = (column * kept for column in columns)
        products = np.array([[np.vdot(part, b) for b in (*columns, wanted)] for part in parts])
        products /= np.outer(sizes, [*sizes, 1.0])
        values = np.linalg.lstsq(products[:, :-1], products[:, -1], rcond=1e-13)[0] / sizes
        error = wanted.copy()
        for value, column in zip(values, columns, strict=True):
            error -= value * column
        np.abs(error, out=error)
        usual = float(np.median(error)) / 0.6745 + 1e-13
        kept = error < 6.0 * usual
    if error.max() <= max(RECORDER.outlier[0] * usual, least):
        return 0.0, 0, 0, 0
    near = RECORDER.outlier[0] * _usual_near(error, drive, usual, dt)
    far = np.flatnonzero(error > np.maximum(near, least))
    events = int(np.count_nonzero(np.diff(far, prepend=-order - 1) > order))
    run, sample = divmod(int(far[0]) if far.size else 0, count)
    return float(error.ravel()[far].max(initial=0.0)), events, run, sample + order


def _usual_near(error: FloatArray, drive: FloatArray, usual: float, dt: float) -> FloatArray:
    """The usual error at each sample, which is larger where the drive moves between samples.

    Pulses do so all the time, so that most blocks have such errors; of a remnant in bursts it is
    the median near by, and no more than the drive's fourth differences there make elsewhere.
    """
    from scipy.ndimage import median_filter

    block = min(max(8, round(0.25 / dt)), error.shape[1])
    largest = error[:, : error.shape[1] // block * block].reshape(-1, block).max(axis=1)
    moves = np.abs(np.diff(drive[:, -error.shape[1] - 4 :], 4, axis=1))
    beside, moved = (np.array([median_filter(row, 25) for row in s]) for s in (error, moves))
    busy = moved >= np.quantile(moved, 0.9)
    moved *= np.median(beside[busy] / (moved[busy] + 1e-300))
    always = max(usual, float(np.quantile(largest, 0.7)) / 3.0)
    return np.asarray(np.maximum(always, np.minimum(beside, moved) / 0.6745))


def fingerprints(recording: Recording) -> tuple[str, ...]:
    """A digest of the control of each run, the same for runs that are the same to the last bit."""
    return tuple(sha256(run.tobytes()).hexdigest() for run in recording.window(recording.u))


def copies_among(names: Sequence[str], prints: Sequence[Sequence[str]]) -> dict[int, list[Remark]]:
    """What to say of recordings whose runs are copies of those of another recording.

    Parameters
    ----------
    names
        The recordings, for messages.
    prints
        Their `fingerprints`.
    """
    copies: dict[int, list[Remark]] = {}
    for (i, one), (j, other) in permutations(enumerate(prints), 2):
        copy = next((digest for digest in one if digest in other), None)
        if copy and i not in copies:
            words = (
                f"run {one.index(copy) + 1} has the same control as run {other.index(copy) + 1} of "
                f"{names[j]}: one is a copy of the other; leave it out"
            )
            copies[i] = [Remark("copied-run", words, "wrong")]
    return copies
