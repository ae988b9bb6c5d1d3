"""Scores of an estimator over replications, as free functions of plain arrays.

Each takes one parameter's estimates, shape (replications,); those of failed fits are left
out beforehand and counted elsewhere.  Too few estimates for a score give NaN.
"""

from __future__ import annotations

import math

import numpy as np

from pilotid.chance import Z95
from pilotid.types import FloatArray


def bias(values: FloatArray, truth: float) -> float:
    """Mean error, with its sign.

    Parameters
    ----------
    values
        Estimates, shape (replications,).
    truth
        True value, in the same unit.
    """
    return float(np.mean(values) - truth) if values.size else math.nan


def bias_std_error(values: FloatArray) -> float:
    """Monte Carlo standard error of the bias.

    Parameters
    ----------
    values
        Estimates, shape (replications,).
    """
    return spread(values) / math.sqrt(values.size) if values.size else math.nan


def skewness(values: FloatArray) -> float:
    """Third moment of the deviations over the cube of their RMS; 0 for equal values.

    Parameters
    ----------
    values
        Estimates, shape (replications,).
    """
    if not values.size:
        return math.nan
    deviations = values - np.mean(values)
    size = float(np.sqrt(np.mean(deviations**2)))
    return float(np.mean((deviations / size) ** 3)) if size > 0.0 else 0.0


def skewed_t(error: float, deviation: float, skew: float, count: int) -> float:
    """Student's t of a mean, by Hall's transformation, which skewed values need.

    Mean and spread of skewed values, as estimates of a gain are, vary together, which makes the
    plain ratio too large on one side and too small on the other.

    Parameters
    ----------
    error
        Mean less the value that is tested.
    deviation, skew, count
        Standard deviation, skewness and number of the values.

    References
    ----------
    P. Hall, *On the removal of skewness by transformation*, J. R. Statist. Soc. B 54(1) 1992.
    """
    if not deviation > 0.0:
        return math.copysign(math.inf, error) if error else 0.0
    share = error / deviation
    corrected = share + skew * share**2 / 3.0 + skew**2 * share**3 / 27.0 + skew / (6.0 * count)
    return math.sqrt(count) * corrected


def spread(values: FloatArray) -> float:
    """Sample standard deviation, with n - 1 in the denominator.

    Parameters
    ----------
    values
        Estimates, shape (replications,).
    """
    return float(np.std(values, ddof=1)) if values.size > 1 else math.nan


def rmse(values: FloatArray, truth: float) -> float:
    """Root mean square error.

    Parameters
    ----------
    values
        Estimates, shape (replications,).
    truth
        True value, in the same unit.
    """
    return float(np.sqrt(np.mean((values - truth) ** 2))) if values.size else math.nan


def mean(values: FloatArray) -> float:
    """Mean of the finite entries."""
    finite = values[np.isfinite(values)]
    return float(np.mean(finite)) if finite.size else math.nan


def coverage(intervals: FloatArray, truth: float) -> float:
    """Share of intervals that hold the truth, ends included.

    Parameters
    ----------
    intervals
        Lower and upper ends, shape (replications, 2); those with a NaN do not count.
    truth
        The true value.
    """
    given = intervals[np.all(np.isfinite(intervals), axis=1)]
    if not len(given):
        return math.nan
    return float(np.mean((given[:, 0] <= truth) & (truth <= given[:, 1])))


def coverage_limits(share: float, count: int) -> tuple[float, float]:
    """Range in which the observed coverage of `count` honest intervals lies 95 % of the time.

    Parameters
    ----------
    share
        Nominal coverage, for example 0.95.
    count
        Number of independent intervals.
    """
    from scipy.special import bdtr

    k = np.arange(count + 1)
    below = bdtr(k, count, share)  # P(at most k)
    low, high = int(np.argmax(below >= 0.025)), int(np.argmax(below >= 0.975))
    return low / count, high / count


def coverage_interval(share: float, count: int) -> tuple[float, float]:
    """95 % interval of the coverage that an observed share of `count` intervals tells (Wilson).

    Parameters
    ----------
    share
        Share of the intervals that held the truth.
    count
        Number of intervals.
    """
    if count == 0:
        return math.nan, math.nan
    z = Z95
    centre = (share + z**2 / (2 * count)) / (1.0 + z**2 / count)
    reach = z * math.sqrt(share * (1.0 - share) / count + z**2 / (4 * count**2))
    return centre - reach / (1.0 + z**2 / count), centre + reach / (1.0 + z**2 / count)


def rmse_std_error(values: FloatArray, truth: float) -> float:
    """Monte Carlo standard error of the root mean square error (delta method).

    Parameters
    ----------
    values
        Estimates, shape (replications,).
    truth
        True value, in the same unit.
    """
    squares = (values - truth) ** 2
    if values.size < 2 or not squares.any():
        return math.nan
    return float(np.std(squares, ddof=1) / math.sqrt(values.size) / (2.0 * rmse(values, truth)))


def spread_std_error(values: FloatArray) -> float:
    """Monte Carlo standard error of the sample standard deviation (delta method).

    It uses the fourth moment of the values, so that it holds for heavy tails too.

    Parameters
    ----------
    values
        Estimates, shape (replications,).
    """
    deviation = spread(values)
    if not deviation > 0.0:
        return math.nan
    fourth = float(np.mean((values - np.mean(values)) ** 4))
    # The variance of a variance estimate, without its terms of order 1/n^2.
    return math.sqrt(max(fourth - deviation**4, 0.0) / values.size) / (2.0 * deviation)


def held(intervals: FloatArray, truth: float) -> int:
    """Number of intervals that hold the truth, ends included; one with a NaN does not."""
    return int(np.sum((intervals[:, 0] <= truth) & (truth <= intervals[:, 1])))
