"""Scores of an estimator over recordings of different pilots, as free functions of plain arrays.

Where every recording has its own truth, errors are told in units of what the fit claims (z) or
of the Cramer-Rao bound.  Values of one recording depend on one another, so that each Monte
Carlo standard error here is that of clusters: `clusters` holds the recording of each value.
Too few values for a score give NaN.  Arrays have the shape (values,).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pilotid.study.scores import coverage_interval
from pilotid.types import BoolArray, FloatArray, IntArray

#: Share of the largest errors that the trimmed score leaves out.
TRIMMED = 0.01
#: An honest standardised error is beyond this in 0.27 % of all cases.
FAR = 3.0
#: Median of the absolute value of a standard normal variable.
MIDDLE = 0.674490


@dataclass(frozen=True)
class Share:
    """A share or another mean, with its Monte Carlo standard error.

    Attributes
    ----------
    value, error
        It, and its Monte Carlo standard error; NaN where there is none.
    """

    value: float
    error: float


def mean(values: FloatArray, clusters: IntArray) -> Share:
    """Mean of all values, with the standard error of a ratio of sums over clusters.

    Parameters
    ----------
    values
        Standardised errors, shape (values,).
    clusters
        The recording of each, shape (values,).
    """
    if not values.size:
        return Share(math.nan, math.nan)
    middle = float(np.mean(values))
    # Recordings are numbered from zero; one that has no value here is no cluster.
    sums = np.bincount(clusters, weights=values - middle)[np.bincount(clusters) > 0]
    count = sums.size
    if count < 2:
        return Share(middle, math.nan)
    spread = math.sqrt(float(np.sum(sums**2)) * count / (count - 1))
    return Share(middle, spread / values.size)


def root_mean_square(values: FloatArray, clusters: IntArray) -> Share:
    """Root of the mean square (its error by the delta method).

    Parameters
    ----------
    values
        Standardised errors, shape (values,).
    clusters
        The recording of each, shape (values,).
    """
    return _root(mean(values**2, clusters))


def trimmed(values: FloatArray, clusters: IntArray, share: float = TRIMMED) -> Share:
    """Root mean square of all but the share of values that are farthest from zero.

    With 1 % left out it is 0.96 for standard normal values.  Of fewer than 1/share values none
    is left out.

    Parameters
    ----------
    values
        Standardised errors, shape (values,).
    clusters
        The recording of each, shape (values,).
    share
        Share that is left out.
    """
    squares = values**2
    if not squares.size:
        return Share(math.nan, math.nan)
    left_out = math.floor(share * squares.size + 1e-9)
    kept = np.sort(squares)[: squares.size - left_out]
    # The influence of a value that is left out is that of the largest one that is not.
    error = mean(np.minimum(squares, kept[-1]), clusters).error
    return _root(Share(float(np.mean(kept)), error * squares.size / kept.size))


def beyond(values: FloatArray, clusters: IntArray, limit: float = FAR) -> Share:
    """Share of values farther from zero than a limit.

    Parameters
    ----------
    values
        Standardised errors, shape (values,).
    clusters
        The recording of each, shape (values,).
    limit
        The limit, in standard deviations.
    """
    return mean((np.abs(values) > limit).astype(float), clusters)


def typical(values: FloatArray) -> float:
    """Median of the absolute values, over that of a standard normal variable.

    Parameters
    ----------
    values
        Standardised errors, shape (values,).
    """
    return float(np.median(np.abs(values))) / MIDDLE if values.size else math.nan


def coverage(hits: BoolArray, clusters: IntArray) -> tuple[Share, tuple[float, float]]:
    """Share of intervals that hold the truth, and its 95 % interval.

    The interval is Wilson's for as many independent intervals as the clusters are worth: as
    many as there are clusters if all or none hold the truth, where they tell no error.

    Parameters
    ----------
    hits
        Whether each interval holds the truth, shape (values,).
    clusters
        The recording of each, shape (values,).
    """
    share = mean(hits.astype(float), clusters)
    if not hits.size:
        return share, (math.nan, math.nan)
    worth = int(np.count_nonzero(np.bincount(clusters)))
    if share.error > 0.0:
        # Parameters that make up for one another are worth no more than independent ones.
        worth = min(hits.size, max(1, round(share.value * (1.0 - share.value) / share.error**2)))
    return share, coverage_interval(share.value, worth)


def _root(square: Share) -> Share:
    root = math.sqrt(square.value) if square.value >= 0.0 else math.nan
    return Share(root, square.error / (2.0 * root) if root > 0.0 else math.nan)
