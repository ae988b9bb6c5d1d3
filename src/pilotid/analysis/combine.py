"""Numbers with errors put together: paired tests and corrections; plain arrays."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pilotid.support.types import FloatArray

NAN = math.nan
#: Differences are equal if they scatter by no more than the rounding of what they are made of.
ROUNDING = 1e-12


@dataclass(frozen=True)
class Mean:
    """A mean with its test against zero; NaN where there is none.

    Attributes
    ----------
    value, std_error
        The mean and its standard error.
    freedom
        Degrees of freedom of Student's t.
    t, p
        Mean over standard error, and its two-sided p.
    lower, upper
        The 95 % interval.
    """

    value: float
    std_error: float
    freedom: float
    t: float
    p: float
    lower: float
    upper: float


def mean_of(value: float, std_error: float, freedom: float) -> Mean:
    """A mean with Student's t; without test and interval where the error is 0 or unknown."""
    from scipy.special import stdtr, stdtrit

    if not (std_error > 0.0 and freedom > 0.0):
        return Mean(value, std_error, float(freedom), NAN, NAN, NAN, NAN)
    t = value / std_error
    reach = float(stdtrit(freedom, 0.975)) * std_error
    p = 2.0 * float(stdtr(freedom, -abs(t)))
    return Mean(value, std_error, float(freedom), t, p, value - reach, value + reach)


def plain_mean(values: FloatArray, scale: float = 0.0) -> Mean:
    """The mean of numbers, shape (n,), by Student's t.

    Parameters
    ----------
    values
        The numbers; of fewer than two the error is NaN.
    scale
        Size of what they are differences of: with a scatter that is rounding of it, the
        standard error is 0, and there is no test.
    """
    count = len(values)
    if count < 2:
        return mean_of(float(values[0]) if count else NAN, NAN, count - 1)
    deviation = float(np.std(values, ddof=1))
    if deviation <= ROUNDING * max(scale, float(np.abs(values).max())):
        deviation = 0.0
    return mean_of(float(np.mean(values)), deviation / math.sqrt(count), count - 1)


def holm(chances: Sequence[float]) -> list[float]:
    """Holm's (1979) correction of p-values for their number; NaN are no tests and do not count."""
    p = np.array(chances, dtype=float)
    order = np.argsort(p)[: np.count_nonzero(np.isfinite(p))]  # NaN come last
    times = np.arange(len(order), 0, -1)
    p[order] = np.minimum(np.maximum.accumulate(times * p[order]), 1.0)
    return [float(value) for value in p]


def signed_ranks(values: FloatArray) -> tuple[float, float]:
    """The Hodges-Lehmann mean, which one value in four cannot move far, and Wilcoxon's p.

    NaN of fewer than two values, and p where all are zero.
    """
    if len(values) < 2:
        return NAN, NAN
    from scipy.stats import wilcoxon

    first, second = np.triu_indices(len(values))
    robust = float(np.median(0.5 * (values[first] + values[second])))
    return robust, float(wilcoxon(values).pvalue) if np.any(values) else NAN


def effect_size(mean: float, deviation: float, count: int) -> float:
    """Cohen's d_z with Hedges' (1981) correction for small numbers; NaN of fewer than three.

    Parameters
    ----------
    mean, deviation
        Mean and standard deviation of paired differences.
    count
        Number of pairs.
    """
    if count < 3 or not deviation > 0.0:
        return NAN
    half = 0.5 * (count - 1)
    log_correction = math.lgamma(half) - math.lgamma(half - 0.5) - 0.5 * math.log(half)
    return mean / deviation * math.exp(log_correction)
