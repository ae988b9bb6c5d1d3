"""Runs that are not of one condition, and stretches that come twice."""

from __future__ import annotations

import numpy as np

from pilotid.recordings.plant import COHERENT, plant_of
from pilotid.recordings.recording import Recording
from pilotid.remarks import Remark

GAIN = 1.3  # between the controlled elements of two runs; sound ones differ by 1.06 at most
SIZE, SCATTERS = 2.5, 5.0  # of one run against the rest, and in scatters of these
USUAL = 0.1  # scatter of the size between runs, at least
FEWEST_BANDS = 4
BY_SIZE = 3  # runs from which a scatter can be told
REPEATED = 0.5  # seconds of a signal that recur to the last digit
VALUES = 20  # different values that such a stretch must have: rest and saturation do recur


def unlike(recording: Recording) -> Remark | None:
    """One run that is not of the same condition as the others."""
    if recording.runs < 2:
        return None
    return _other_element(recording) or _other_size(recording)


def _other_element(recording: Recording) -> Remark | None:
    """The output holds no noise, so that the element of every run shows by itself."""
    plants = [plant_of(recording, run) for run in range(recording.runs)]
    known = [plant for plant in plants if plant is not None]
    if len(known) < recording.runs:
        return None
    good = np.all([plant.coherence >= COHERENT for plant in known], axis=0)
    if np.count_nonzero(good) < FEWEST_BANDS:
        return None
    size = np.array([np.log(np.abs(plant.response[good])) for plant in known])
    # A band in which one run differs may lie at a resonance; an element differs in most.
    middle = np.median(size, axis=0) if recording.runs > 2 else size[0]
    off = np.abs(size - middle)
    apart = np.median(off, axis=1)
    run = int(np.argmax(apart))
    if apart[run] <= np.log(GAIN):
        return None
    if recording.runs == 2:
        return Remark(
            "unlike-runs",
            "the controlled elements of the two runs differ by a factor of "
            f"{np.exp(apart[run]):.2g}: they are not of one condition, or not in one unit; fit "
            "them one by one",
        )
    return Remark(
        "unlike-runs",
        f"the controlled element of run {run + 1} differs from that of the others by a factor of "
        f"{np.exp(apart[run]):.2g}: it is not of their condition, or not in their unit; leave it "
        "out",
    )


def _other_size(recording: Recording) -> Remark | None:
    """A run in which a signal is far larger or smaller than in the others."""
    if recording.runs < BY_SIZE:
        return None
    for name in ("u", "e", "x"):
        if name not in recording.signals:
            continue
        spread = np.std(recording.window(getattr(recording, name)), axis=1)
        if not spread.all():
            continue
        size = np.log(spread)
        for run in range(recording.runs):
            others = np.delete(size, run)
            off = float(size[run] - np.mean(others))
            scatter = float(np.hypot(np.std(others, ddof=1), USUAL))
            if abs(off) > max(np.log(SIZE), SCATTERS * scatter):
                return Remark(
                    "unlike-runs",
                    f"{name} of run {run + 1} is {np.exp(off):.2g} times as large as in the other "
                    "runs, which differ far less among themselves: it is not of their condition, "
                    "or was not flown through; leave it out",
                )
    return None


def repeated(recording: Recording) -> Remark | None:
    """Noise does not come twice: a stretch that does was copied."""
    length = round(REPEATED / recording.dt)
    window = np.ascontiguousarray(recording.window(recording.u) + 0.0)  # no negative zero
    if window.shape[1] <= length:
        return None
    places = window.shape[1] - length + 1
    changes = np.cumsum(np.diff(window, axis=1, prepend=window[:, :1]) != 0.0, axis=1)
    is_lively = changes[:, length - 1 :] - changes[:, :places] >= VALUES - 1
    # Equal stretches have equal sums of products with any numbers, modulo 2^64.
    weights = np.random.default_rng(0).integers(2**63, size=length, dtype=np.uint64)
    prints = np.array([np.correlate(row, weights, "valid") for row in window.view(np.uint64)])
    candidates = np.flatnonzero(is_lively)
    candidates = candidates[np.argsort(prints.ravel()[candidates], kind="stable")]
    same = np.flatnonzero(np.diff(prints.ravel()[candidates]) == 0)
    for first, second in sorted(zip(candidates[same], candidates[same + 1], strict=True)):
        (run, a), (again, b) = divmod(first, places), divmod(second, places)
        stretch = window[run, a : a + length]
        if np.unique(stretch).size >= VALUES and np.array_equal(
            stretch, window[again, b : b + length]
        ):
            return Remark(
                "repeated-samples",
                f"u from t = {a * recording.dt:.4g} s on in run {run + 1} comes again, to "
                f"the last digit, from t = {b * recording.dt:.4g} s on in run {again + 1}: "
                "a part was recorded or copied twice; leave it out",
            )
    return None
