"""What a user must know about a recording before believing any estimate from it.

Every check looks at the signals alone, without a model of the pilot.  It is a row of `CHECKS`: a
code, a limit, and a function that yields statistics, each with a sentence that says what is wrong
and what to do; the first beyond the limit is told.  Limits were set so that no sound recording is
remarked on: simulations of every scenario, and 110 files of recorded human pilots, stay below half
of most of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from pilotid.checks.detectors import findings, step_between, unit_conversion
from pilotid.checks.element_fit import unexplained
from pilotid.checks.plant import element_changes, opposed, plant_of, runs_apart, unrelated
from pilotid.recording.recording import ABSENT, Recording, remembered
from pilotid.recording.spectra import at_lines, known_lines, same_lines, target_lines
from pilotid.recording.windows import longest_run, of_runs
from pilotid.support.limits import RECORDER, SIGNAL
from pilotid.support.numbers import rms
from pilotid.support.remarks import Remark, gravest_first
from pilotid.support.types import FloatArray

Found = Iterator[tuple[float, str]]
NameCheck = Callable[[Recording], Remark | None]
#: Findings that tell why x seems not to answer to u and fd.
RELATED = ("late-signal", "wrong-unit", "rounded")


CHECKS: list[NameCheck] = []


def check(code: str, limit: float = 0.0) -> Callable[[Callable[[Recording], Found]], NameCheck]:
    """Put a function into the table: what it says first of a statistic beyond the limit is told."""

    def listed(find: Callable[[Recording], Found]) -> NameCheck:
        def checked(recording: Recording) -> Remark | None:
            sentences = (sentence for size, sentence in find(recording) if size > limit)
            return next((Remark(code, sentence) for sentence in sentences), None)

        CHECKS.append(checked)
        return checked

    return listed


@remembered
def remarks(recording: Recording) -> tuple[Remark, ...]:
    """What was done to a recording and what is wrong with it, a sentence each.

    Empty for a sound one that is as it was recorded.
    """
    tabled = [row(recording) for row in CHECKS]
    faults = [f for f in findings(recording) if f.grade != "note"]
    lost = any(row.code == "lost-samples" for row in tabled if row)
    # Lost samples do so, too, but no wrong name explains them.
    others = [f for f in faults if f.code in (*RELATED, "lost-samples") and f.signal != "e"]
    is_related = lost or any(not f.is_turned for f in others)
    named = _names_by_lines(recording, ABOUT_ERROR if is_related else ABOUT_ERROR + ABOUT_OUTPUT)
    if lost or any(f.code == "late-signal" for f in faults):  # which tells why e is not ft - x
        named = None if named and named.code in ("not-the-error", "wrong-unit") else named
    if named:  # explains what times and gains seem to be
        faults = [f for f in faults if f.code not in RELATED]
    every = [named, *tabled, *(Remark(f.code, f.sentence, f.grade) for f in faults)]
    if all(remark is None or remark.grade == "note" for remark in every):
        every.append(unexplained(recording))
    treated = (
        sentence if isinstance(sentence, Remark) else Remark("preprocessed", sentence)
        for sentence in recording.treatment
    )
    return (*treated, *gravest_first(remark for remark in every if remark))


def motionless(recording: Recording, name: str) -> bool:
    """Whether a signal does not move in the measurement window of any run."""
    window = recording.window(recording.input(name))
    # By what they usually are: one spike would make all else look still.
    size = max(_usual(recording, n) for n in {"e", "x", name})
    return bool(np.all(np.std(window, axis=1) <= SIGNAL.still * size))


@remembered
def _usual(recording: Recording, name: str) -> float:
    """Root mean square of a signal without the largest hundredth of its samples, nor a code."""
    signal = recording.window(recording.input(name)).ravel()
    # A code for missing values may stand for seconds, but it is one value.
    others = signal[signal != signal[np.argmax(np.abs(signal))]]
    square = (others if others.size else signal) ** 2
    count = max(1, round(0.99 * square.size))
    square.partition(count - 1)
    return float(np.sqrt(np.mean(square[:count])))


@check("lost-samples", SIGNAL.spike)
def _spikes(recording: Recording) -> Found:
    """A sample far beyond all others is a code for a missing value, or a fault.

    One alone is so sooner: no hand is back within two samples of .025 s.
    """
    for name in ("e", "u", "x", *recording.extra):
        window = recording.window(recording.input(name))
        usual = _usual(recording, name)
        run, sample = divmod(int(np.argmax(np.abs(window))), window.shape[1])
        value = float(window[run, sample])
        beside = np.abs(window[run, [max(sample - 1, 0), min(sample + 1, window.shape[1] - 1)]])
        alone = recording.dt <= 0.025 and beside.max() < 0.2 * abs(value)
        if usual > 0.0:
            size = abs(value) / usual
            yield (
                size * (SIGNAL.spike / SIGNAL.alone if alone else 1.0),
                f"{name} is {value:.6g} at t = {sample * recording.dt:.4g} s "
                f"of run {run + 1}, {size:.2g} times its usual size: a code for a "
                "missing value or a fault; repair it or leave that part out",
            )


@check("motionless")
def _still(recording: Recording) -> Found:
    still = [n for n in ("e", "x") if n in recording.signals and motionless(recording, n)]
    yield len(still), f"{' and '.join(still)} does not move: map it to the recorded signal"


def _names_by_lines(recording: Recording, checks: Sequence[NameCheck]) -> Remark | None:
    """`_names` of runs whose forcing functions have the same lines, which it takes for granted.

    Where e is not ft - x for no reason that all runs share, each run is asked.
    """
    groups = same_lines(recording)
    whole = _names(recording, checks) if len(groups) == 1 else None
    if len(groups) == 1 and (whole is None or whole.code != "not-the-error"):
        return whole
    if whole:
        groups = tuple((run,) for run in range(recording.runs))
    named = []
    for group in groups:
        words = f"{'run' if len(group) == 1 else 'runs'} {', '.join(str(1 + run) for run in group)}"
        named.append((words, _names(of_runs(recording, [1 + run for run in group], words), checks)))
    wrong = [(words, remark) for words, remark in named if remark]
    if not wrong or (whole and len(wrong) == len(named)):
        return whole
    words, remark = wrong[0]
    fault, _, cure = remark.partition("; ")
    if len(wrong) < len(named):  # --map would change the other runs as well
        cure = f"mend {words} in the file, or leave {words} out with --runs"
    return Remark(remark.code, f"{words}: {fault}; {cure}", remark.grade)


def _names(recording: Recording, checks: Sequence[NameCheck]) -> Remark | None:
    """Units, names and signs: the first thing that is wrong explains the others."""
    absent = recording.origin.get("x") == ABSENT
    if absent or motionless(recording, "e") or motionless(recording, "x"):
        return None
    return next(filter(None, (check(recording) for check in checks)), None)


@check("lost-samples", 1.0)
def _held(recording: Recording) -> Found:
    for name, longest in (("e", SIGNAL.hold_e), ("x", SIGNAL.hold_x), ("u", SIGNAL.hold_u)):
        if motionless(recording, name):
            continue
        window = recording.window(recording.input(name))
        for run, row in enumerate(window):
            first, count = longest_run(np.diff(row) == 0.0)
            # What rounding holds goes on by a step.
            around = row[[max(first - 1, 0), min(first + count + 1, row.size - 1)]]
            if np.max(np.abs(around - row[first])) > SIGNAL.jump * step_between(row):
                yield (
                    count * recording.dt / longest,
                    f"{name} keeps one value for {count * recording.dt:.3g} s from "
                    f"t = {first * recording.dt:.4g} s on in run {run + 1}: samples seem to be "
                    "lost; leave that part or that run out",
                )


@check("rounded", SIGNAL.at_extreme)
def _clipped(recording: Recording) -> Found:
    window = recording.window(recording.u)
    ends = window.max(axis=1, keepdims=True), window.min(axis=1, keepdims=True)
    share = np.mean((window == ends[0]) | (window == ends[1]), axis=1)
    run = int(np.argmax(share))
    yield (
        float(share[run]),
        f"u is at its largest or smallest value in {100.0 * share[run]:.0f} % of run {run + 1}: it "
        "is clipped or has few levels, and no linear model describes it",
    )


@check("drift", 1.0)
def _drifting(recording: Recording) -> Found:
    """A trend of the control that no signal of the loop shares is the recorder's."""
    names = [n for n in ("e", "x", "ft", "fd") if getattr(recording, n) is not None]
    for run in range(recording.runs):
        u = recording.window(recording.u)[run]
        signals = [recording.window(recording.input(n))[run] for n in names]
        trend = np.linspace(-0.5, 0.5, u.size)
        table, wanted = np.stack([np.ones_like(u), *signals], 1), np.stack([trend, u], 1)
        rest_of_trend, left = (wanted - table @ np.linalg.lstsq(table, wanted)[0]).T
        share = float(rest_of_trend @ rest_of_trend) / float(trend @ trend)
        if share < SIGNAL.own_trend:
            continue  # a signal of the loop is a trend itself
        slope = float(rest_of_trend @ left) / float(rest_of_trend @ rest_of_trend)
        rest = max(float(np.std(left - slope * rest_of_trend)), 1e-300)
        longer = max(1.0, (82.0 / recording.duration) ** 1.5)
        # What the loop's own trends could have made of it as well counts for nothing.
        yield (
            abs(slope) * math.sqrt(share) / rest / longer / SIGNAL.drift,
            f"u drifts by {slope:.3g} over run {run + 1}, "
            f"{abs(slope) / rest:.1f} standard deviations of the rest, and no other signal does: "
            "take it out with --detrend",
        )


def not_the_error(recording: Recording) -> Remark | None:
    """What is wrong where e is not ft - x, as in a compensatory task; None if it is."""
    if recording.ft is None:
        return _without_target(recording)
    signals = {name: recording.window(getattr(recording, name)) for name in ("e", "x", "ft")}
    e, x, ft = signals.values()
    rest, size = e - ft + x, rms(e) or 1.0
    rest -= rest.mean(axis=1, keepdims=True)  # an offset, which every method takes out
    off, least = rms(rest) / size, SIGNAL.identity * size
    if off <= SIGNAL.identity:
        return None
    explained = _explainer(x, ft)
    # What no signal explains is noise of the recorder, which each channel has of its own.
    if off <= SIGNAL.noise and explained(rest) <= least:
        return None
    others = {"e": ft - x, "x": ft - e, "ft": e + x}
    for name, wanted in others.items():
        if explained(signals[name] + wanted) <= least:
            cure = recording.flipped(name)
            words = f"e is not ft - x: {name} has the wrong sign; flip it with --map {cure}"
            return Remark("wrong-sign", words)
    for name in ("x", "e", "ft"):
        wanted, given = others[name], signals[name]
        factor = float(np.sum(wanted * given) / (np.sum(given**2) or 1.0))
        fits = factor and explained(wanted - factor * given) <= SIGNAL.identity * rms(wanted)
        if fits and abs(factor - 1.0) > SIGNAL.scaled:
            return Remark("wrong-unit", f"e is not ft - x: {_scaled(recording, name, factor)}")
    return Remark(
        "not-the-error",
        f"e is not ft - x: they differ by {100.0 * off:.3g} % of e; check signs and units "
        "and the names that --map gives",
    )


def _explainer(*signals: FloatArray) -> Callable[[FloatArray], float]:
    """What gives the rms of what signals, their slopes and a constant explain of another."""
    columns = [np.ones_like(signals[0]), *signals]
    columns += [np.gradient(signal, axis=1) for signal in signals]
    scaled = [column / (rms(column) or 1.0) for column in columns]
    gram = np.array([[np.vdot(a, b) for a in scaled] for b in scaled]) / scaled[0].size
    inverse = np.linalg.pinv(gram, hermitian=True)

    def explained(signal: FloatArray) -> float:
        along = np.array([np.vdot(a, signal) for a in scaled]) / signal.size
        return math.sqrt(max(float(along @ inverse @ along), 0.0))

    return explained


def _without_target(recording: Recording) -> Remark | None:
    """What the disturbance does to the output it does to the error, with the other sign."""
    lines = known_lines(recording).get("fd")
    if lines is None:
        return None
    error, output = (
        np.fft.rfft(recording.window(signal))[:, lines] for signal in (recording.e, recording.x)
    )
    if not np.abs(output).all():
        return None
    # Remnant and transients are in both alike; a target that is no multisine makes them differ.
    factors = -error / output
    factor = float(np.median(factors.real))
    off = float(np.median(np.abs(factors - factor)))
    if off > SIGNAL.same_factor * abs(factor) or abs(factor - 1.0) <= SIGNAL.scaled:
        return None
    if abs(factor + 1.0) <= SIGNAL.scaled:
        return Remark(
            "wrong-sign",
            "e and x have the same sign at the lines of fd, though e = ft - x; flip one of them, "
            f"with --map {recording.flipped('e')} or --map {recording.flipped('x')}",
        )
    return Remark(
        "wrong-unit", f"e is not -x at the lines of fd: {_scaled(recording, 'x', factor)}"
    )


def _scaled(recording: Recording, name: str, factor: float) -> str:
    """What is wrong with a signal that must be multiplied with a factor, and the cure."""
    exact, unit = unit_conversion(factor)
    times = f"{1.0 / factor:.4g} times what the others make it"
    why = f"in {unit} and the others are not" if unit else times
    return f"{name} is {why}; convert it: --map {recording.scaled(name, exact)}"


def exchanged(recording: Recording) -> Remark | None:
    """A loop cannot follow the fast lines of a target, so that the error shows all of them.

    Where there are none, the output answers to u and fd with one sign and high coherence.
    """
    named, other = plant_of(recording), replace(recording, x=recording.e, e=recording.x)
    if recording.fd is not None and named and named.polarity < 0.0:
        swapped = plant_of(other)
        least = named.mean_coherence + SIGNAL.more_coherent
        if swapped and swapped.polarity > 0.0 and swapped.mean_coherence > least:
            return Remark("exchanged", f"not x but e answers to u; {_exchange(recording)}", "wrong")
    lines = target_lines(recording)
    if lines is None or recording.ft is None:
        return None
    fast = lines["ft"][lines["ft"].size // 2 :]
    fast = fast[fast > SIGNAL.fastest_loop * recording.duration / (2.0 * np.pi)]
    if not fast.size:
        return None
    error, noise = at_lines(recording, recording.e, fast, lines)
    target = np.fft.rfft(recording.window(recording.ft))[:, fast]
    weight = np.abs(target) ** 2 / noise
    shown = float(np.sum(weight * np.real(error / target)) / np.sum(weight))
    if not shown + RECORDER.errors / math.sqrt(2.0 * float(np.sum(weight))) < SIGNAL.shown:
        return None
    # People who see a target ahead follow its fast lines, but x still answers to u: with coherence
    # at all frequencies, or at the target's lines if a disturbance may not be recorded.
    what = "polarity" if recording.fd is None else "mean_coherence"
    as_named, turned = (getattr(plant, what, 0.0) for plant in (named, plant_of(other)))
    if not turned >= as_named:  # nor where one is no number
        return None
    return Remark(
        "exchanged",
        f"e shows {100.0 * shown:.0f} % of the fast lines of the target, which no loop follows: e "
        f"and x seem to be exchanged, unless the target is seen ahead; {_exchange(recording)}",
        "wrong" if turned > as_named else "doubt",
    )


def _exchange(recording: Recording) -> str:
    """How to exchange the names of e and x, of which one may follow from the other."""
    places = {name: recording.origin.get(name, name) for name in ("e", "x")}
    for name, other in (("x", "e"), ("e", "x")):
        if places[name] == f"ft - {other}":
            return f"name the column {places[other]} {name} in the file"
    return f"correct the names with --map e={places['x']},x={places['e']}"


#: Units, names and signs, by e = ft - x and by x as the answer to u and fd.
ABOUT_ERROR: tuple[NameCheck, ...] = (not_the_error, exchanged)
ABOUT_OUTPUT: tuple[NameCheck, ...] = (opposed, element_changes, unrelated)


@check("element-differs", math.log(SIGNAL.unlike_element))
def _unlike(recording: Recording) -> Found:
    """One run of another element: the output holds no noise, so that each run shows its own."""
    for others, _, ratios in runs_apart(recording):
        # A band in which one run differs may lie at a resonance; an element differs in most.
        apart = np.median(np.abs(ratios.real), axis=1)
        run = int(np.argmax(apart))
        yield (
            float(apart[run]),
            f"the controlled element of run {run + 1} differs from that of {others} by a factor of "
            f"{np.exp(apart[run]):.2g}: they are not of one condition, or not in one unit; leave "
            "it out, or fit runs one by one",
        )
