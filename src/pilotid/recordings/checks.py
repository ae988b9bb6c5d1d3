"""What a user must know about a recording before believing any estimate from it.

Every check looks at the signals alone, without a model of the pilot, and gives one sentence
that says what is wrong and what to do.  Limits were set so that no sound recording is
remarked on: simulations of every scenario, and 110 files of recorded human pilots, stay
below half of most of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from pilotid.recordings.lines import NotMultisineError, forcing_lines
from pilotid.recordings.recording import Recording
from pilotid.recordings.repetition import repeated
from pilotid.types import BoolArray, ComplexArray, FloatArray, IntArray

IDENTITY = 0.01  # rms of e - (ft - x) over that of e; recordings reach 3e-6
STILL = 1e-9  # standard deviation over the size of the signal: it does not move
LONGEST_HOLD = {"e": 0.3, "x": 8.0, "u": 10.0}  # seconds; pilots rest on a breakout for 6.5
SPIKE = 100.0  # times the usual size; a control after steps reaches 27, pilots 8
AT_EXTREME = 0.06  # share of the samples at the largest or smallest value; pilots reach .044
DRIFT = 2.5  # of the control over the run, in standard deviations of what is left, at 82 s
BLOCK = 5.0  # seconds whose mean is one observation of an offset
OFFSET = 4.0  # standard errors of the mean; simulations stay below 1, pilots below 1.4
SHOWN = 0.5  # share of the target's fast lines that the error must show
FEWEST = 5  # lines of a target that tell which signal is which
#: How much later than x the control may seem [s], up to when it is looked for, and by how much
#: smoother the phase must be then, of 1 at the most.  Sound recordings show 0.02 s at the most.
LATE, LATEST, SMOOTHER = 0.1, 3.0, 0.3
BESIDE = 8  # bins beside a line that tell leakage and noise in it


def remarks(recording: Recording) -> tuple[str, ...]:
    """What is wrong with a recording, a sentence each; empty for a sound one."""
    found = [check(recording) for check in CHECKS]
    return tuple(sentence for sentence in found if sentence)


def motionless(recording: Recording, name: str) -> bool:
    """Whether a signal does not move in the measurement window of any run."""
    window = recording.window(getattr(recording, name))
    # By what they usually are: one spike would make all else look still.
    size = max(_usual(recording, n) for n in {"e", "x", name})
    return bool(np.all(np.std(window, axis=1) <= STILL * size))


def _usual(recording: Recording, name: str) -> float:
    """Root mean square of a signal without the largest hundredth of its samples."""
    square = np.sort(recording.window(getattr(recording, name)) ** 2, axis=None)
    return float(np.sqrt(np.mean(square[: max(1, round(0.99 * square.size))])))


def _spikes(recording: Recording) -> str | None:
    """A sample far beyond all others is a code for a missing value, or a fault."""
    for name in ("e", "u", "x"):
        window = np.abs(recording.window(getattr(recording, name)))
        usual = _usual(recording, name)
        run, sample = divmod(int(np.argmax(window)), window.shape[1])
        if usual > 0.0 and window[run, sample] > SPIKE * usual:
            return (
                f"{name} is {window[run, sample]:.3g} at t = {sample * recording.dt:.4g} s of run "
                f"{run + 1}, {window[run, sample] / usual:.2g} times its usual size: a code for a "
                "missing value or a fault; repair it or leave that part out"
            )
    return None


def _still(recording: Recording) -> str | None:
    names = [n for n in ("e", "x") if motionless(recording, n)]
    if not names:
        return None
    which = " and ".join(names)
    return f"{which} does not move: map it to the recorded signal, or record it"


def _names(recording: Recording) -> str | None:
    """Signs and names: the first thing that is wrong explains the others."""
    if any(motionless(recording, name) for name in ("e", "x")):
        return None
    return _identity(recording) or _swapped(recording)


def _identity(recording: Recording) -> str | None:
    """The error of a compensatory task is the target less the output."""
    if recording.ft is None:
        return None
    e, x, ft = (recording.window(s) for s in (recording.e, recording.x, recording.ft))
    size = _rms(e)
    off = _rms(e - (ft - x))
    if off <= IDENTITY * size or size == 0.0:
        return None
    for what, trial, advice in (
        ("e has the wrong sign", -e - (ft - x), "flip it with --map e=-e"),
        ("x has the wrong sign", e - (ft + x), "flip it with --map x=-x"),
        ("ft has the wrong sign", e - (-ft - x), "flip it with --map ft=-ft"),
        ("e and ft - x differ by a constant", _centred(e - (ft - x)), "remove the offset"),
    ):
        if _rms(trial) <= IDENTITY * size:
            return f"e is not ft - x: {what}; {advice}"
    return (
        f"e is not ft - x: they differ by {100.0 * off / size:.3g} % of e; check signs, units and "
        "the names that --map gives"
    )


def _swapped(recording: Recording) -> str | None:
    """A loop cannot follow the fast lines of a target, so that the error shows all of them."""
    lines = _lines(recording)
    if lines is None or recording.ft is None:
        return None
    fast = lines["ft"][lines["ft"].size // 2 :]
    error, noise = _at_lines(recording, recording.e, fast, lines)
    target = np.fft.rfft(recording.window(recording.ft))[:, fast]
    weight = np.abs(target) ** 2 / noise
    shown = float(np.sum(weight * np.real(error / target)) / np.sum(weight))
    if shown >= SHOWN:
        return None
    return (
        f"e shows {100.0 * shown:.0f} % of the fast lines of the target, which no loop follows: e "
        "and x seem to be exchanged; correct the names with --map e=x,x=e"
    )


def _late(recording: Recording) -> str | None:
    """The output answers to the control, not before it: their phase does not grow with frequency.

    At the target's lines x is the controlled element's answer to u alone.  Of all times the one
    sought makes the phase from line to line the smoothest.
    """
    every = _lines(recording)
    if every is None:
        return None
    lines = every["ft"]
    control, output = (
        _at_lines(recording, signal, lines, every)[0] for signal in (recording.u, recording.x)
    )
    ratio = np.sum(output * control.conj(), axis=0)
    turns = ratio[1:] * ratio[:-1].conj()
    if not np.abs(turns).all():
        return None
    times = np.arange(-LATEST, LATEST, 0.02)
    apart = 2.0 * np.pi * np.diff(lines) / recording.duration
    smooth = np.real(np.exp(-1j * np.outer(times, apart)) @ (turns / np.abs(turns))) / turns.size
    best = int(np.argmax(smooth))
    if times[best] <= LATE or smooth[best] - np.interp(0.0, times, smooth) < SMOOTHER:
        return None
    return (
        f"u is recorded {times[best]:.2g} s after x has answered to it: the two are shifted in "
        "time; bring them together"
    )


def _lines(recording: Recording) -> dict[str, IntArray] | None:
    """Lines of the forcing functions, None where the target's are too few to tell anything."""
    try:
        lines = forcing_lines(recording)
    except NotMultisineError:
        return None
    return lines if "ft" in lines and lines["ft"].size >= FEWEST else None


def _at_lines(
    recording: Recording, signal: FloatArray, lines: IntArray, every: dict[str, IntArray]
) -> tuple[ComplexArray, FloatArray]:
    """Transforms of a signal at lines, shape (runs, lines), and the power of the noise there.

    What transients leak is smooth in frequency, so that the bins beside a line tell it.
    """
    spectrum = np.fft.rfft(recording.window(signal))
    forced = np.concatenate(list(every.values()))
    between = np.setdiff1d(np.arange(1, spectrum.shape[1]), forced)
    nearest = np.argsort(np.abs(between - lines[:, None]), axis=1, kind="stable")[:, :BESIDE]
    beside = spectrum[:, between[nearest]]
    noise = np.mean(np.var(beside, axis=2), axis=0) + 1e-12 * np.max(np.abs(spectrum)) ** 2
    return spectrum[:, lines] - beside.mean(axis=2), noise


def _held(recording: Recording) -> str | None:
    for name, longest in LONGEST_HOLD.items():
        if motionless(recording, name):
            continue
        for run, row in enumerate(recording.window(getattr(recording, name))):
            first, count = _longest_run(np.diff(row) == 0.0)
            if count * recording.dt > longest:
                return (
                    f"{name} keeps one value for {count * recording.dt:.3g} s from "
                    f"t = {first * recording.dt:.4g} s on in run {run + 1}: samples seem to be "
                    "lost; leave that part or that run out"
                )
    return None


def _clipped(recording: Recording) -> str | None:
    window = recording.window(recording.u)
    ends = window.max(axis=1, keepdims=True), window.min(axis=1, keepdims=True)
    share = np.mean((window == ends[0]) | (window == ends[1]), axis=1)
    run = int(np.argmax(share))
    if share[run] <= AT_EXTREME:
        return None
    return (
        f"u is at its largest or smallest value in {100.0 * share[run]:.0f} % of run {run + 1}: it "
        "is clipped or has few levels, and no linear model describes it"
    )


def _drifting(recording: Recording) -> str | None:
    """A trend of the control that no signal of the loop shares was added by the recorder."""
    names = [n for n in ("e", "x", "ft", "fd") if getattr(recording, n) is not None]
    limit = DRIFT * max(1.0, (82.0 / recording.duration) ** 1.5)
    for run in range(recording.runs):
        u = recording.window(recording.u)[run]
        signals = [recording.window(getattr(recording, n))[run] for n in names]
        trend = np.linspace(-0.5, 0.5, u.size)
        basis = _orthonormal([np.ones_like(u), *signals])
        own, left = (v - basis @ (basis.T @ v) for v in (trend, u))
        if own @ own < 1e-3 * (trend @ trend):
            continue  # a signal of the loop is a trend itself
        slope = float(own @ left) / float(own @ own)
        rest = float(np.std(left - slope * own))
        if abs(slope) > limit * rest:
            return (
                f"u drifts by {slope:.3g} over run {run + 1}, {abs(slope) / max(rest, 1e-300):.1f} "
                "standard deviations of the rest, and no other signal does: take the drift out"
            )
    return None


def _offset(recording: Recording) -> str | None:
    """A t-test of the control's mean, by blocks so long that the remnant forgets itself."""
    length = round(BLOCK / recording.dt)
    window = recording.window(recording.u)
    count = window.shape[1] // length
    blocks = window[:, : count * length].reshape(recording.runs, count, length).mean(axis=2)
    if blocks.size < 6:
        return None
    mean, error = float(np.mean(blocks)), float(np.std(blocks, ddof=1)) / np.sqrt(blocks.size)
    if abs(mean) <= OFFSET * error:
        return None
    return (
        f"u has an offset of {mean:.3g}, which mmle3 and arx do not model and which biases them: "
        "remove it, or use another method"
    )


def _orthonormal(columns: Sequence[FloatArray]) -> FloatArray:
    """A basis of what the columns span, shape (samples, dimensions)."""
    table = np.stack([c / (np.linalg.norm(c) or 1.0) for c in columns], axis=1)
    left, size, _ = np.linalg.svd(table, full_matrices=False)
    return np.asarray(left[:, size > 1e-6 * size[0]])


def _longest_run(held: BoolArray) -> tuple[int, int]:
    """Where the longest run of true entries begins, and its length."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], held, [False]]).astype(int)))
    begins, ends = edges[::2], edges[1::2]
    if not begins.size:
        return 0, 0
    longest = int(np.argmax(ends - begins))
    return int(begins[longest]), int(ends[longest] - begins[longest])


def _rms(signal: FloatArray) -> float:
    return float(np.sqrt(np.mean(signal**2)))


def _centred(signal: FloatArray) -> FloatArray:
    return np.asarray(signal - signal.mean(axis=1, keepdims=True))


#: All checks, the gravest first.
CHECKS: tuple[Callable[[Recording], str | None], ...] = (
    _spikes,
    _still,
    _names,
    _late,
    _held,
    _clipped,
    _drifting,
    _offset,
    repeated,
)
