"""Differences of scores between two versions of a method, as free functions of plain arrays.

Errors are those of estimates in any one unit, shape (fits,).  Where both versions had the same
recordings (``paired``), place i of both arrays is the same recording, and what it did to both
cancels; otherwise the arrays may differ in length.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pilotid.study.scores import bias_std_error, rmse_std_error
from pilotid.types import BoolArray, FloatArray


class Difference(NamedTuple):
    """A score of two versions, and the difference of the second from the first.

    Attributes
    ----------
    first, second
        The scores.
    change
        Second less first; of times the factor between them.
    error
        Its Monte Carlo standard error.
    p
        How often chance alone makes a difference as large, two-sided; NaN if that is not known.
    """

    first: float
    second: float
    change: float
    error: float
    p: float


def bias(first: FloatArray, second: FloatArray, *, paired: bool) -> Difference:
    """Difference of the mean errors."""
    before, after = float(np.mean(first)), float(np.mean(second))
    error, p = _of_means(first, second, paired=paired)
    return Difference(before, after, after - before, error, p)


def rmse(first: FloatArray, second: FloatArray, *, paired: bool) -> Difference:
    """Difference of the root mean square errors, tested as that of the mean squares."""
    sizes = tuple(float(np.sqrt(np.mean(errors**2))) for errors in (first, second))
    _, p = _of_means(first**2, second**2, paired=paired)
    if paired:
        # What each recording adds to both roots, to first order.
        parts = [
            errors**2 / (2.0 * size) if size > 0.0 else np.zeros(errors.size)
            for errors, size in zip((first, second), sizes, strict=True)
        ]
        error = bias_std_error(parts[1] - parts[0])
    else:
        error = math.hypot(*(rmse_std_error(errors, 0.0) for errors in (first, second)))
    return Difference(sizes[0], sizes[1], sizes[1] - sizes[0], error, p)


def share(first: BoolArray, second: BoolArray, *, paired: bool) -> Difference:
    """Difference of the shares of what is true.

    Pairs by McNemar's test in its exact form, others by Fisher's.
    """
    before, after = float(np.mean(first)), float(np.mean(second))
    if paired:
        gained, lost = int(np.sum(second & ~first)), int(np.sum(first & ~second))
        error = math.sqrt(gained + lost - (gained - lost) ** 2 / first.size) / first.size
        p = _sign_test(gained, lost)
    else:
        error = math.sqrt(
            before * (1.0 - before) / first.size + after * (1.0 - after) / second.size
        )
        p = _fisher(int(np.sum(first)), first.size, int(np.sum(second)), second.size)
    return Difference(before, after, after - before, error, p)


def times(first: FloatArray, second: FloatArray, least: float, *, paired: bool) -> Difference:
    """Factor between the times of fits, from the mean of their logarithms.

    Parameters
    ----------
    first, second
        Times, above zero.
    least
        Factor, or one over it, that counts as no difference: it is tested whether the factor
        is beyond.
    paired
        Whether the fits are of the same recordings.
    """
    logs = [np.log(own) for own in (first, second)]
    change = float(np.mean(logs[1]) - np.mean(logs[0]))
    beyond = max(abs(change) - math.log(least), 0.0)
    error, p = _of_means(logs[0], logs[1], paired=paired, beyond=math.copysign(beyond, change))
    factor = math.exp(change)
    return Difference(float(np.median(first)), float(np.median(second)), factor, factor * error, p)


def _of_means(
    first: FloatArray, second: FloatArray, *, paired: bool, beyond: float | None = None
) -> tuple[float, float]:
    """Standard error of a difference of means, and how often chance makes it as large.

    By Student's t.  The difference of two versions that are alike is symmetric, however skewed
    the errors of each are, so that the correction which a single mean needs would do harm here.

    Parameters
    ----------
    first, second
        The values.
    paired
        Whether they belong together one by one.
    beyond
        What of the difference is tested; None for all of it.
    """
    from scipy.special import stdtr

    difference = float(np.mean(second) - np.mean(first))
    tested = difference if beyond is None else beyond
    if paired:
        if first.size < 2:
            return math.nan, math.nan
        error, freedom = bias_std_error(second - first), first.size - 1.0
    else:
        if min(first.size, second.size) < 2:
            return math.nan, math.nan
        squares = [bias_std_error(values) ** 2 for values in (first, second)]
        error = math.sqrt(sum(squares))
        terms = [s**2 / (v.size - 1) for s, v in zip(squares, (first, second), strict=True)]
        freedom = error**4 / sum(terms) if error > 0.0 else 1.0
    if not error > 0.0 or tested == 0.0:
        return error, 0.0 if tested else 1.0
    return error, float(min(2.0 * stdtr(freedom, -abs(tested) / error), 1.0))


def _sign_test(gained: int, lost: int) -> float:
    from scipy.special import bdtr

    count = gained + lost
    return min(2.0 * float(bdtr(min(gained, lost), count, 0.5)), 1.0) if count else 1.0


def _fisher(first: int, of_first: int, second: int, of_second: int) -> float:
    from scipy.stats import fisher_exact

    table = np.array([[first, of_first - first], [second, of_second - second]])
    return float(fisher_exact(table).pvalue)
