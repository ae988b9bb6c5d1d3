"""Numbers with errors put together: paired tests, random effects, corrections; plain arrays."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
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


@dataclass(frozen=True)
class RandomEffects:
    """A mean of numbers that differ by more than their errors.

    Attributes
    ----------
    mean
        The weighted mean, its error by Hartung and Knapp.
    between
        Standard deviation of the true values about the mean, apart from the errors.
    between_lower, between_upper
        Its 95 % interval, from the quantiles of Q (Viechtbauer, 2007).
    """

    mean: Mean
    between: float
    between_lower: float
    between_upper: float


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


def random_effects(values: FloatArray, errors: FloatArray) -> RandomEffects:
    """Mean and spread of numbers that have errors of their own.

    Parameters
    ----------
    values, errors
        The numbers and their standard errors, each of shape (n,) with n > 1, errors positive.

    Notes
    -----
    The spread is that of Paule and Mandel (1982): with it, the numbers scatter about their mean
    as much as errors and spread say.  It assumes no distribution and needs no iteration that
    could fail.  The mean's error is that of Hartung and Knapp (2001) with Student's t of n - 1
    degrees of freedom, without the floor that some put under it: with the floor, intervals of few
    numbers are far too long where the errors explain all.
    """
    from scipy.special import chdtri

    freedom = len(values) - 1
    variance = errors**2

    def scatter(spread: float) -> float:
        """Cochran's Q when the true values have this variance; it falls with it."""
        weights = 1.0 / (variance + spread)
        centre = np.sum(weights * values) / np.sum(weights)
        return float(np.sum(weights * (values - centre) ** 2))

    between = _falls_to(scatter, freedom, values)
    weights = 1.0 / (variance + between)
    centre = float(np.sum(weights * values) / np.sum(weights))
    error = math.sqrt(scatter(between) / freedom / float(np.sum(weights)))
    low, high = (
        _falls_to(scatter, float(chdtri(freedom, tail)), values) for tail in (0.025, 0.975)
    )
    return RandomEffects(
        mean_of(centre, error, freedom), math.sqrt(between), math.sqrt(low), math.sqrt(high)
    )


def _falls_to(scatter: Callable[[float], float], level: float, values: FloatArray) -> float:
    """The variance at which a falling function comes down to a level; 0 if it starts below."""
    from scipy.optimize import brentq

    if scatter(0.0) <= level:
        return 0.0
    high = float(np.var(values)) + float(np.finfo(float).tiny)
    while scatter(high) > level:
        high *= 4.0
    return float(brentq(lambda spread: scatter(spread) - level, 0.0, high, xtol=1e-14 * high))


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
