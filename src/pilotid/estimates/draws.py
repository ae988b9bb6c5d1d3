"""Draws of a posterior, and what they say of a quantity: mean, spread, intervals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pilotid.support.types import BoolArray, FloatArray

if TYPE_CHECKING:
    from arviz_base import DataTree

SHARE = 0.95  # of the intervals


@dataclass(frozen=True, eq=False)
class Draws:
    """Draws of a posterior.

    Attributes
    ----------
    sampler
        ``emcee`` or ``importance``.
    keys
        Names of the parameters, the pilot's first.
    positive
        Which of them were sampled by their logarithm, shape (parameters,).
    values
        Parameter values, shape (draws, parameters); of an emcee run ensemble by ensemble, in
        each step by step, in each walker by walker.
    log_density
        Of the posterior on the scale it was sampled on, up to a constant, shape (draws,).
    weights
        They sum to 1, shape (draws,); all equal for emcee.
    chains
        Ensembles, steps of each that were kept, and walkers; (1, draws, 1) for importance
        sampling.
    effective
        Effective number of draws of each parameter, shape (parameters,).
    r_hat
        Rank-normalised split R-hat across ensembles, shape (parameters,), NaN without them.
    autocorrelation
        Integrated autocorrelation time [steps], shape (parameters,), 1 for independent draws.
    acceptance
        Share of the proposals that emcee accepted, NaN for importance sampling.
    """

    sampler: str
    keys: tuple[str, ...]
    positive: BoolArray
    values: FloatArray
    log_density: FloatArray
    weights: FloatArray
    chains: tuple[int, int, int]
    effective: FloatArray
    r_hat: FloatArray
    autocorrelation: FloatArray
    acceptance: float = float("nan")

    @property
    def mean(self) -> FloatArray:
        """Posterior means, shape (parameters,)."""
        return np.asarray(self.weights @ self.values)

    @property
    def centre(self) -> FloatArray:
        """Means on the scale of sampling: geometric ones of positive parameters, (parameters,).

        They keep the product of gain and lead time, which is well known, as the product of
        means does not.
        """
        positive = self.positive
        logs = np.log(np.where(positive, self.values, 1.0))
        return np.asarray(np.where(positive, np.exp(self.weights @ logs), self.mean))

    @property
    def covariance(self) -> FloatArray:
        """Posterior covariance, shape (parameters, parameters)."""
        offset = self.values - self.mean
        return np.asarray((self.weights[:, None] * offset).T @ offset)

    @property
    def equal_tailed(self) -> FloatArray:
        """95 % intervals with as much outside on either side, shape (parameters, 2)."""
        return np.array([equal_tailed_interval(v, self.weights) for v in self.values.T])

    @property
    def highest_density(self) -> FloatArray:
        """The shortest 95 % intervals, shape (parameters, 2)."""
        return np.array([shortest_interval(v, self.weights) for v in self.values.T])

    def equally_weighted(self, count: int) -> FloatArray:
        """Draws of equal weight, in the order they were made, shape (count, parameters).

        Every draw appears as often as its weight asks, to within one (systematic
        resampling, without a random offset).
        """
        edges = np.cumsum(self.weights)
        places = (np.arange(count) + 0.5) / count
        index = np.minimum(np.searchsorted(edges, places), len(edges) - 1)
        return np.asarray(self.values[index])

    def to_arviz(self) -> DataTree:
        """The draws for ArviZ: walkers are its chains; weighted draws are resampled.

        Raises
        ------
        ImportError
            Without the package arviz-base, which ``pip install 'pilotid[posterior]'`` brings.
        """
        from arviz_base import from_dict

        ensembles, steps, walkers = self.chains
        values = self.values
        if np.ptp(self.weights) > 0.0:
            values = self.equally_weighted(len(values))
        shaped = values.reshape(ensembles, steps, walkers, -1).transpose(0, 2, 1, 3)
        chains = shaped.reshape(ensembles * walkers, steps, -1)
        return from_dict({"posterior": {key: chains[..., i] for i, key in enumerate(self.keys)}})


def quantiles(values: FloatArray, weights: FloatArray, shares: tuple[float, ...]) -> FloatArray:
    """Quantiles of weighted values, shape (shares,)."""
    ordered, middles = _distribution(values, weights)
    return np.asarray(np.interp(shares, middles, ordered))


def equal_tailed_interval(values: FloatArray, weights: FloatArray) -> FloatArray:
    """The 95 % interval with as much of the weight outside on either side, shape (2,)."""
    tail = 0.5 * (1.0 - SHARE)
    return quantiles(values, weights, (tail, 1.0 - tail))


def shortest_interval(values: FloatArray, weights: FloatArray, share: float = SHARE) -> FloatArray:
    """The shortest interval that holds a share of weighted values, shape (2,).

    For a density with one summit that is the interval of highest density.
    """
    ordered, middles = _distribution(values, weights)
    grid = np.linspace(0.0, 1.0 - share, 401)
    low, high = np.interp(grid, middles, ordered), np.interp(grid + share, middles, ordered)
    best = int(np.argmin(high - low))
    return np.array([low[best], high[best]])


def _distribution(values: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Values in ascending order, and the share of the weight up to the middle of each."""
    order = np.argsort(values, kind="stable")
    own = weights[order]
    return values[order], np.cumsum(own) - 0.5 * own
