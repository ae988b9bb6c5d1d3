"""Draws of a posterior, and what they say of a quantity: mean, spread, intervals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pilotid.support.types import BoolArray, FloatArray

if TYPE_CHECKING:
    from arviz_base import DataTree

SHARE = 0.95  # of the intervals
TAILS = (0.5 * (1.0 - SHARE), 0.5 * (1.0 + SHARE))


@dataclass(frozen=True, eq=False)
class Draws:
    """Draws of a posterior by ensembles of walkers.

    Attributes
    ----------
    keys
        Names of the parameters, the pilot's first.
    positive
        Which of them were sampled by their logarithm, shape (parameters,).
    values
        Parameter values, shape (draws, parameters); ensemble by ensemble, in each step by step,
        in each walker by walker.
    log_density
        Of the posterior on the scale it was sampled on, up to a constant, shape (draws,).
    chains
        Ensembles, steps of each that were kept, and walkers.
    effective
        Effective number of draws of each parameter, shape (parameters,).
    r_hat
        Rank-normalised split R-hat across ensembles, shape (parameters,).
    autocorrelation
        Integrated autocorrelation time [steps], shape (parameters,).
    acceptance
        Share of the proposals that were accepted.
    converged
        Whether there are as many effective draws as asked, and the ensembles agree.
    """

    keys: tuple[str, ...]
    positive: BoolArray
    values: FloatArray
    log_density: FloatArray
    chains: tuple[int, int, int]
    effective: FloatArray
    r_hat: FloatArray
    autocorrelation: FloatArray
    acceptance: float
    converged: bool

    @property
    def centre(self) -> FloatArray:
        """Means on the scale of sampling: geometric ones of positive parameters, (parameters,).

        They keep the product of gain and lead time, which is well known, as the product of
        means does not.
        """
        positive = self.positive
        logs = np.log(np.where(positive, self.values, 1.0))
        return np.asarray(np.where(positive, np.exp(logs.mean(axis=0)), self.values.mean(axis=0)))

    @property
    def covariance(self) -> FloatArray:
        """Posterior covariance, shape (parameters, parameters)."""
        return np.atleast_2d(np.cov(self.values.T, ddof=0))

    @property
    def equal_tailed(self) -> FloatArray:
        """95 % intervals with as much outside on either side, shape (parameters, 2)."""
        return np.quantile(self.values, TAILS, axis=0).T

    @property
    def highest_density(self) -> FloatArray:
        """The shortest 95 % intervals, shape (parameters, 2)."""
        return np.array([shortest_interval(own) for own in self.values.T])

    def thinned(self, count: int) -> FloatArray:
        """So many draws, evenly from all of them, shape (count, parameters)."""
        every = (np.arange(count) + 0.5) * (len(self.values) / count)
        return np.asarray(self.values[every.astype(int)])

    def to_arviz(self) -> DataTree:
        """The draws for ArviZ: walkers are its chains.

        Raises
        ------
        ImportError
            Without the package arviz-base, which ``pip install 'pilotid[posterior]'`` brings.
        """
        from arviz_base import from_dict

        ensembles, steps, walkers = self.chains
        shaped = self.values.reshape(ensembles, steps, walkers, -1).transpose(0, 2, 1, 3)
        chains = shaped.reshape(ensembles * walkers, steps, -1)
        return from_dict({"posterior": {key: chains[..., i] for i, key in enumerate(self.keys)}})


def shortest_interval(values: FloatArray) -> FloatArray:
    """The shortest interval that holds 95 % of values, shape (2,).

    For a density with one mode that is the interval of highest density.
    """
    low = np.linspace(0.0, 1.0 - SHARE, 401)
    ends = np.quantile(values, [low, low + SHARE])
    return np.asarray(ends[:, int(np.argmin(ends[1] - ends[0]))])
