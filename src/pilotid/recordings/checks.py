"""What a user must know about a recording before believing any estimate from it.

Every check looks at the signals alone, without a model of the pilot, and gives one sentence
that says what is wrong and what to do.  Limits were set so that no sound recording is
remarked on: simulations of every scenario, and 110 files of recorded human pilots, stay
below half of most of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from pilotid.recordings.detectors import findings
from pilotid.recordings.identity import exchanged, not_the_error, units_differ
from pilotid.recordings.lines import unanswered
from pilotid.recordings.plant import element_changes, late, opposed, unrelated
from pilotid.recordings.recording import ABSENT, Recording, remembered
from pilotid.recordings.runs import repeated, unlike
from pilotid.remarks import Remark, gravest_first
from pilotid.types import BoolArray, FloatArray

STILL = 1e-9  # standard deviation over the size of the signal: it does not move
LONGEST_HOLD = {"e": 0.3, "x": 8.0, "u": 10.0}  # seconds; pilots rest on a breakout for 6.5
SPIKE = 100.0  # times the usual size; a control after steps reaches 27, pilots 8
AT_EXTREME = 0.06  # share of the samples at the largest or smallest value; pilots reach .044
DRIFT = 2.0  # of the control over the run, in standard deviations of what is left, at 82 s
OWN = 0.1  # share of a trend that the signals of the loop must leave, for it to be told from them
BLOCK = 5.0  # seconds whose mean is one observation of an offset
LATE = ("late-signal", "late-forcing", "clock-drifts")
OFFSET = 4.0  # standard errors of the mean; simulations stay below 1, pilots below 1.4


def remarks(recording: Recording) -> tuple[Remark, ...]:
    """What was done to a recording and what is wrong with it, a sentence each.

    Empty for a sound one that is as it was recorded.
    """
    found = [check(recording) for check in CHECKS]
    named = _names(recording)
    faults = [f for f in findings(recording) if f.grade != "note"]
    if named and named.code == "not-the-error" and any(f.code in LATE for f in faults):
        named = None  # that tells why e is not ft - x
    if named:  # explains what times and gains seem to be
        faults = [f for f in faults if f.code not in (*LATE, "gain-differs", "includes-fd")]
    told = [named, *found, *(Remark(f.code, f.sentence, f.grade) for f in faults)]
    treated = (Remark("preprocessed", sentence) for sentence in recording.treatment)
    return (*treated, *gravest_first(remark for remark in told if remark))


def motionless(recording: Recording, name: str) -> bool:
    """Whether a signal does not move in the measurement window of any run."""
    window = recording.window(getattr(recording, name))
    # By what they usually are: one spike would make all else look still.
    size = max(_usual(recording, n) for n in {"e", "x", name})
    return bool(np.all(np.std(window, axis=1) <= STILL * size))


@remembered
def _usual(recording: Recording, name: str) -> float:
    """Root mean square of a signal without the largest hundredth of its samples."""
    square = recording.window(getattr(recording, name)).ravel() ** 2
    count = max(1, round(0.99 * square.size))
    square.partition(count - 1)
    return float(np.sqrt(np.mean(square[:count])))


def _spikes(recording: Recording) -> Remark | None:
    """A sample far beyond all others is a code for a missing value, or a fault."""
    for name in ("e", "u", "x"):
        window = np.abs(recording.window(getattr(recording, name)))
        usual = _usual(recording, name)
        run, sample = divmod(int(np.argmax(window)), window.shape[1])
        if usual > 0.0 and window[run, sample] > SPIKE * usual:
            return Remark(
                "spike",
                f"{name} is {window[run, sample]:.3g} at t = {sample * recording.dt:.4g} s of run "
                f"{run + 1}, {window[run, sample] / usual:.2g} times its usual size: a code for a "
                "missing value or a fault; repair it or leave that part out",
            )
    return None


def _still(recording: Recording) -> Remark | None:
    names = [n for n in ("e", "x") if n in recording.signals and motionless(recording, n)]
    if not names:
        return None
    which = " and ".join(names)
    return Remark(
        "motionless", f"{which} does not move: map it to the recorded signal, or record it"
    )


def _names(recording: Recording) -> Remark | None:
    """Units, names and signs: the first thing that is wrong explains the others."""
    if motionless(recording, "e"):
        return None
    if recording.origin.get("x") == ABSENT or motionless(recording, "x"):
        return None
    for check in (
        not_the_error,
        units_differ,
        exchanged,
        late,
        opposed,
        element_changes,
        unrelated,
    ):
        if sentence := check(recording):
            return sentence
    return None


def _held(recording: Recording) -> Remark | None:
    for name, longest in LONGEST_HOLD.items():
        if motionless(recording, name):
            continue
        for run, row in enumerate(recording.window(getattr(recording, name))):
            first, count = _longest_run(np.diff(row) == 0.0)
            if count * recording.dt > longest:
                return Remark(
                    "held-samples",
                    f"{name} keeps one value for {count * recording.dt:.3g} s from "
                    f"t = {first * recording.dt:.4g} s on in run {run + 1}: samples seem to be "
                    "lost; leave that part or that run out",
                )
    return None


def _clipped(recording: Recording) -> Remark | None:
    window = recording.window(recording.u)
    ends = window.max(axis=1, keepdims=True), window.min(axis=1, keepdims=True)
    share = np.mean((window == ends[0]) | (window == ends[1]), axis=1)
    run = int(np.argmax(share))
    if share[run] <= AT_EXTREME:
        return None
    return Remark(
        "clipped",
        f"u is at its largest or smallest value in {100.0 * share[run]:.0f} % of run {run + 1}: it "
        "is clipped or has few levels, and no linear model describes it",
    )


def _drifting(recording: Recording) -> Remark | None:
    """A trend of the control that no signal of the loop shares was added by the recorder."""
    names = [n for n in ("e", "x", "ft", "fd") if getattr(recording, n) is not None]
    limit = DRIFT * max(1.0, (82.0 / recording.duration) ** 1.5)
    for run in range(recording.runs):
        u = recording.window(recording.u)[run]
        signals = [recording.window(getattr(recording, n))[run] for n in names]
        trend = np.linspace(-0.5, 0.5, u.size)
        basis = _orthonormal([np.ones_like(u), *signals])
        own, left = (v - basis @ (basis.T @ v) for v in (trend, u))
        if own @ own < OWN * (trend @ trend):
            continue  # a signal of the loop is a trend itself
        slope = float(own @ left) / float(own @ own)
        rest = float(np.std(left - slope * own))
        # What the loop's own trends could have made of it as well counts for nothing.
        share = float(np.sqrt((own @ own) / (trend @ trend)))
        if abs(slope) * share > limit * rest:
            return Remark(
                "drift",
                f"u drifts by {slope:.3g} over run {run + 1}, {abs(slope) / max(rest, 1e-300):.1f} "
                "standard deviations of the rest, and no other signal does: take it out with "
                "--detrend",
            )
    return None


def _offset(recording: Recording) -> Remark | None:
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
    return Remark(
        "offset",
        f"u has an offset of {mean:.3g}, which mmle3 and arx do not model and which biases them: "
        "remove it, or use another method",
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


#: All checks, the gravest first.
CHECKS: tuple[Callable[[Recording], Remark | None], ...] = (
    _spikes,
    _still,
    _held,
    _clipped,
    _drifting,
    _offset,
    unlike,
    unanswered,
    repeated,
)
