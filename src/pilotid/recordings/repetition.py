"""Stretches of a recording that come twice."""

from __future__ import annotations

import numpy as np

from pilotid.recordings.recording import Recording
from pilotid.types import FloatArray

REPEATED = 0.5  # seconds of a signal that recur to the last digit
VALUES = 20  # different values that such a stretch must have: rest and saturation do recur


def repeated(recording: Recording) -> str | None:
    """Noise does not come twice: a stretch that does was copied."""
    length = round(REPEATED / recording.dt)
    window = recording.window(recording.u)
    if window.shape[1] <= length:
        return None
    prints = np.concatenate([_fingerprints(row, length) for row in window])
    ordered = np.sort(prints)
    if not (ordered[1:] == ordered[:-1]).any():
        return None
    places = window.shape[1] - length + 1
    changes = np.cumsum(np.diff(window, axis=1, prepend=window[:, :1]) != 0.0, axis=1)
    lively = (changes[:, length - 1 :] - changes[:, :places]).ravel() >= VALUES - 1
    order = np.argsort(prints, kind="stable")
    same = (prints[order][1:] == prints[order][:-1]) & lively[order][1:]
    pairs = np.stack([order[:-1][same], order[1:][same]], axis=1)
    for first, second in pairs[np.argsort(pairs[:, 0], kind="stable")].tolist():
        (run, a), (again, b) = divmod(first, places), divmod(second, places)
        stretch = window[run, a : a + length]
        if np.unique(stretch).size < VALUES:
            continue
        if np.array_equal(stretch, window[again, b : b + length]):
            return (
                f"u from t = {a * recording.dt:.4g} s on in run {run + 1} comes again, to "
                f"the last digit, from t = {b * recording.dt:.4g} s on in run {again + 1}: "
                "a part was recorded or copied twice; leave it out"
            )
    return None


def _fingerprints(row: FloatArray, length: int) -> np.ndarray[tuple[int], np.dtype[np.uint64]]:
    """A number for every stretch of that length, equal for equal stretches (Rabin and Karp)."""
    bits = np.ascontiguousarray(row + 0.0).view(np.uint64)  # + 0.0: no negative zero
    base = np.uint64(0x9E3779B97F4A7C15)
    inverse = np.uint64(pow(int(base), -1, 2**64))
    with np.errstate(over="ignore"):  # arithmetic modulo 2^64 is exact
        powers = np.cumprod(np.full(row.size + 1, base, dtype=np.uint64))
        inverses = np.cumprod(np.full(row.size, inverse, dtype=np.uint64))
        sums = np.concatenate([np.zeros(1, dtype=np.uint64), np.cumsum(bits * inverses)])
        return np.asarray((sums[length:] - sums[:-length]) * powers[: row.size - length + 1])
