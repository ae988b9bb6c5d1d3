"""Scores of an estimator over recordings, as free functions of plain arrays.

Each takes what is known of one parameter, shape (fits,), or of several; what failed is left out
beforehand.  Too few values for a score give NaN.  Values of one recording depend on one another,
so that scores over several parameters take the recording of each value (``clusters``) and have
the Monte Carlo error of clusters.

The loss
--------
A fit says between which values a parameter lies with 95 % confidence.  `interval_score` (Gneiting
and Raftery, *Strictly proper scoring rules, prediction, and estimation*, JASA 102(477) 2007, eq.
43; R. L. Winkler, JASA 67(337) 1972) charges the interval's width and, where it misses the truth,
2/.05 = 40 times the distance by which it does.  Of an exact, efficient normal estimator, whose
standard error is the Cramer-Rao bound b, the interval is the value ± 1.96 b, and the score is on
average

    2 * 1.96 b + 40 * 2 E[(z - 1.96)+] b = (3.920 + 40 * 0.01889) b = 4.676 b,

since E[(z - c)+] = phi(c) - c (1 - Phi(c)) = 0.009445 for c = 1.96 and z a standard normal
variable, on either side.  The **loss** is the score over 4.676 times the recording's own bound:
an exact, efficient estimator has 1, and bias, scatter, intervals too short and intervals too long
all cost.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple
from zlib import crc32

import numpy as np

from pilotid.support.format import number
from pilotid.support.numbers import Z95
from pilotid.support.types import BoolArray, FloatArray, IntArray

MISSED = 40.0  # what a missed distance costs: 2 over the chance that a 95 % interval misses
#: E[(|z| - 1.96)+] of a standard normal variable: twice phi(c) - c (1 - Phi(c)).
SHORTFALL = 2.0 * (math.exp(-0.5 * Z95**2) / math.sqrt(2.0 * math.pi) - 0.025 * Z95)
#: Expected interval score of an exact, efficient normal estimator with the standard error 1.
EFFICIENT = 2.0 * Z95 + MISSED * SHORTFALL
#: The variance of its loss: (E[(|z| - c)+^2] - SHORTFALL^2) (40/4.676)^2.
EFFICIENT_VARIANCE = (0.05 - Z95 * SHORTFALL - SHORTFALL**2) * (MISSED / EFFICIENT) ** 2
RESAMPLES = 1000
ROUNDING = 1e-12  # what is smaller, of logarithms and of their variances, is zero
FAR = 3.0  # an honest standardised error is beyond this in 0.27 % of all cases
TRIMMED = 0.01  # share of the largest errors that the trimmed score leaves out
MEDIAN_SIZE = 0.674490  # median of the absolute value of a standard normal variable


class Mean(NamedTuple):
    """A mean or a share, and its Monte Carlo standard error; NaN where there is none."""

    value: float
    error: float


class Interval(NamedTuple):
    """A value and its 95 % interval."""

    value: float
    lower: float
    upper: float

    def __str__(self) -> str:
        value, lower, upper = map(loss_text, self)
        return f"{value} ({lower}-{upper})" if math.isfinite(self.upper) else value


def loss_text(loss: float) -> str:
    """A loss with the digits that it deserves."""
    return f"{loss:.2f}" if loss < 9.995 else number(loss)


NOTHING = Interval(math.nan, math.nan, math.nan)


# ---------------------------------------------------------------------------------- the loss


def interval_score(lower: FloatArray, upper: FloatArray, truth: FloatArray) -> FloatArray:
    """Width of each 95 % interval, and 40 times the distance by which it misses the truth.

    Parameters
    ----------
    lower, upper, truth
        Ends of the intervals and true values, all of one shape.
    """
    missed = np.maximum(lower - truth, 0.0) + np.maximum(truth - upper, 0.0)
    return np.asarray(upper - lower + MISSED * missed)


@lru_cache(maxsize=8)
def _resamples(name: str, count: int) -> FloatArray:
    """Weights of recordings: each once, then drawn with replacement; shape (1 + resamples, count).

    The scenario's name and the number of recordings decide them, whatever else a study holds.
    """
    rng = np.random.default_rng(crc32(name.encode()))
    drawn = rng.multinomial(count, np.full(count, 1.0 / count), size=RESAMPLES)
    return np.vstack([np.ones(count), drawn]) / count


def mean_losses(losses: FloatArray, name: str, others: FloatArray | None = None) -> list[Interval]:
    """Mean of each parameter's losses and, first, the geometric mean over the parameters.

    The intervals are bootstrap-t on logarithms, with recordings as what is resampled.  Misses
    are rare and dear: where few or none came, the recordings do not show how much the loss
    scatters.  It therefore scatters at least as that of an efficient estimator does, one more
    recording like that is added to every resample, and no upper end is nearer than a normal
    distribution has it.

    Parameters
    ----------
    losses
        Shape (recordings, parameters), NaN where a pilot lacks a parameter.
    name
        Of the scenario, which seeds the resampling.
    others
        Those of another method on the same recordings: ratios to its means are given then.
    """
    known = np.isfinite(losses)
    if others is not None:
        known &= np.isfinite(others)
    rows = known.any(axis=1)
    count = int(rows.sum())
    present: BoolArray = np.asarray(known.any(axis=0))
    if not count:
        return [NOTHING] * (1 + present.size)
    known = known[rows][:, present]
    x = np.where(known, losses[rows][:, present], 0.0)
    # Of one method alone the other one's loss is 1 everywhere.
    y = known * 1.0 if others is None else np.where(known, others[rows][:, present], 0.0)
    weights = _resamples(name, count)
    share = weights @ known
    share[share == 0.0] = math.nan  # a resample without any pilot who has the parameter
    means = [weights @ side / share for side in (x, y)]
    with np.errstate(divide="ignore"):  # intervals may have no width
        logs = np.log(means[0] / means[1])
    # What a recording adds to a logarithm is, to first order, (x/mean(x) - y/mean(y))/share.
    squares = weights @ x**2 / means[0] ** 2 + weights @ y**2 / means[1] ** 2
    squares -= 2.0 * (weights @ (x * y)) / (means[0] * means[1])
    together = (x @ (1.0 / (share * means[0])).T - y @ (1.0 / (share * means[1])).T).T
    variance = np.column_stack(
        [np.sum(weights * together**2, axis=1) / present.sum() ** 2, squares / share**2]
    )
    variance *= count / max(count - 1, 1)
    variance[variance < ROUNDING] = 0.0
    if others is None:
        least = np.full(1 + logs.shape[1], EFFICIENT_VARIANCE)
        least[0] /= logs.shape[1]
        variance[0] = np.maximum(variance[0], least)
    logs = np.column_stack([logs.mean(axis=1), logs])
    logs[np.abs(logs) < ROUNDING] = 0.0
    found = [
        _bootstrap_t(logs[:, k], variance[:, k], count, one_sided=others is None)
        for k in range(logs.shape[1])
    ]
    rest = iter(found[1:])
    return [found[0], *(next(rest) if there else NOTHING for there in present)]


def _bootstrap_t(
    logs: FloatArray, variance: FloatArray, count: int, *, one_sided: bool
) -> Interval:
    """An interval from the logarithms of the sample (first) and of its resamples."""
    value = float(np.exp(logs[0]))
    error = math.sqrt(variance[0] / count) if count > 1 and variance[0] >= 0.0 else math.nan
    if not math.isfinite(value) or not math.isfinite(error):
        return Interval(value, math.nan, math.nan)
    if error == 0.0:
        return Interval(value, value, value)
    spread = np.sqrt((count * variance[1:] + variance[0]) / (count + 1.0) / count)
    t = (logs[1:] - logs[0]) / spread
    low, high = np.nanquantile(t, [0.025, 0.975]) if np.isfinite(t).any() else (-Z95, Z95)
    if one_sided:
        low = min(low, -Z95)
    return Interval(value, value * math.exp(-high * error), value * math.exp(-low * error))


# ---------------------------------------------------------------- one parameter, one true value


def bias(values: FloatArray, truth: float) -> Mean:
    """Mean error, with its sign.

    Parameters
    ----------
    values
        Estimates, shape (fits,).
    truth
        True value, in the same unit.
    """
    if not values.size:
        return Mean(math.nan, math.nan)
    return Mean(float(np.mean(values) - truth), spread(values).value / math.sqrt(values.size))


def spread(values: FloatArray) -> Mean:
    """Sample standard deviation, with n - 1 in the denominator.

    Its Monte Carlo error is by the delta method from the fourth moment, which holds for heavy
    tails too.

    Parameters
    ----------
    values
        Estimates, shape (fits,).
    """
    if values.size < 2:
        return Mean(math.nan, math.nan)
    deviation = float(np.std(values, ddof=1))
    if not deviation > 0.0:
        return Mean(deviation, math.nan)
    fourth = float(np.mean((values - np.mean(values)) ** 4))
    # The variance of a variance estimate, without its terms of order 1/n^2.
    error = math.sqrt(max(fourth - deviation**4, 0.0) / values.size) / (2.0 * deviation)
    return Mean(deviation, error)


def rmse(values: FloatArray, truth: float) -> Mean:
    """Root mean square error (its Monte Carlo error by the delta method).

    Parameters
    ----------
    values
        Estimates, shape (fits,).
    truth
        True value, in the same unit.
    """
    return root_mean_square(values - truth, np.arange(values.size))


def mean(values: FloatArray) -> float:
    """Mean of the finite entries."""
    finite = values[np.isfinite(values)]
    return float(np.mean(finite)) if finite.size else math.nan


def skewness(values: FloatArray) -> float:
    """Third moment of the deviations over the cube of their RMS; 0 for equal values."""
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


# ---------------------------------------------------------------------- values of several truths


def clustered_mean(values: FloatArray, clusters: IntArray) -> Mean:
    """Mean of all values, with the standard error of a ratio of sums over clusters.

    Parameters
    ----------
    values
        Shape (values,).
    clusters
        The recording of each, shape (values,).
    """
    if not values.size:
        return Mean(math.nan, math.nan)
    middle = float(np.mean(values))
    # Recordings are numbered from zero; one that has no value here is no cluster.
    sums = np.bincount(clusters, weights=values - middle)[np.bincount(clusters) > 0]
    count = sums.size
    if count < 2:
        return Mean(middle, math.nan)
    return Mean(middle, math.sqrt(float(np.sum(sums**2)) * count / (count - 1)) / values.size)


def root_mean_square(values: FloatArray, clusters: IntArray) -> Mean:
    """Root of the mean square (its error by the delta method)."""
    return _root(clustered_mean(values**2, clusters))


def trimmed(values: FloatArray, clusters: IntArray, share: float = TRIMMED) -> Mean:
    """Root mean square of all but the share of values that are farthest from zero.

    With 1 % left out it is 0.96 for standard normal values.  Of fewer than 1/share values none
    is left out.
    """
    squares = values**2
    if not squares.size:
        return Mean(math.nan, math.nan)
    left_out = math.floor(share * squares.size + 1e-9)
    kept = np.sort(squares)[: squares.size - left_out]
    # The influence of a value that is left out is that of the largest one that is not.
    error = clustered_mean(np.minimum(squares, kept[-1]), clusters).error
    return _root(Mean(float(np.mean(kept)), error * squares.size / kept.size))


def beyond(values: FloatArray, clusters: IntArray, limit: float = FAR) -> Mean:
    """Share of values farther from zero than a limit."""
    return clustered_mean((np.abs(values) > limit).astype(float), clusters)


def typical(values: FloatArray) -> float:
    """Median of the absolute values, over that of a standard normal variable."""
    return float(np.median(np.abs(values))) / MEDIAN_SIZE if values.size else math.nan


def coverage(hits: BoolArray, clusters: IntArray) -> tuple[Mean, tuple[float, float], int]:
    """Share of intervals that hold the truth, its 95 % interval, and what the values are worth.

    The interval is Wilson's for as many independent intervals as the clusters are worth: as
    many as there are clusters if all or none hold the truth, where they tell no error.

    Parameters
    ----------
    hits
        Whether each interval holds the truth, shape (values,).
    clusters
        The recording of each, shape (values,).
    """
    share = clustered_mean(hits.astype(float), clusters)
    if not hits.size:
        return share, (math.nan, math.nan), 0
    worth = int(np.count_nonzero(np.bincount(clusters)))
    if worth < hits.size and share.error > 0.0:
        # Parameters that make up for one another are worth no more than independent ones.
        worth = min(hits.size, max(1, round(share.value * (1.0 - share.value) / share.error**2)))
    return share, coverage_interval(share.value, worth), worth


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


def _root(square: Mean) -> Mean:
    root = math.sqrt(square.value) if square.value >= 0.0 else math.nan
    return Mean(root, square.error / (2.0 * root) if root > 0.0 else math.nan)
