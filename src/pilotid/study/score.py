"""Scores of one parameter by one method in one scenario."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from pilotid.study import scores
from pilotid.study.entries import ParameterTruth
from pilotid.types import BoolArray, FloatArray


@dataclass(frozen=True)
class Score:
    """One parameter by one method in one scenario; fits that failed are counted and left out.

    Attributes
    ----------
    parameter, truth
        The parameter.
    n, failures, tried
        Fits that count as results, those that do not, and all fits of recordings that the
        method can treat.
    bias, bias_se, std, std_se, rmse, rmse_se, claimed, bound, posterior
        Over the fits that count, in the parameter's unit; ``_se`` is the Monte Carlo standard
        error, `claimed` the mean standard error, `posterior` that of a posterior.
    skew
        Skewness of the estimates, see `pilotid.study.scores.skewness`.
    coverage, coverage_interval
        Share of the 95 % intervals that hold the truth, and its own 95 % interval.
    coverage_all, coverage_all_interval
        The same over all fits tried, with a failure as a miss.
    n_all, bias_all, bias_all_se, std_all
        Over all fits that gave a value, those that failed included.
    """

    parameter: str
    truth: float
    n: int
    failures: int
    tried: int
    bias: float
    bias_se: float
    std: float
    std_se: float
    rmse: float
    rmse_se: float
    claimed: float
    bound: float
    posterior: float
    coverage: float
    coverage_interval: tuple[float, float]
    coverage_all: float
    coverage_all_interval: tuple[float, float]
    n_all: int
    bias_all: float
    bias_all_se: float
    std_all: float
    skew: float

    @property
    def bias_percent(self) -> float:
        """Bias in % of the truth."""
        return 100.0 * self.bias / self.truth if self.truth else math.nan

    @property
    def ratio(self) -> float:
        """Root mean square error over the bound."""
        return self.rmse / self.bound

    @property
    def ratio_se(self) -> float:
        """Monte Carlo standard error of the ratio."""
        return self.rmse_se / self.bound

    @property
    def percent(self) -> Score:
        """The same scores with all that has the parameter's unit in % of its true value."""
        scale = 100.0 / abs(self.truth) if self.truth else math.nan
        return replace(
            self,
            truth=math.copysign(100.0, self.truth),
            bias=self.bias_percent,
            bias_se=scale * self.bias_se,
            std=scale * self.std,
            std_se=scale * self.std_se,
            rmse=scale * self.rmse,
            rmse_se=scale * self.rmse_se,
            claimed=scale * self.claimed,
            bound=scale * self.bound,
            posterior=scale * self.posterior,
            bias_all=math.copysign(scale, self.truth) * self.bias_all,
            bias_all_se=scale * self.bias_all_se,
            std_all=scale * self.std_all,
            skew=math.copysign(1.0, self.truth) * self.skew,
        )


def scored(
    known: ParameterTruth,
    numbers: FloatArray,
    counted: BoolArray,
    tried: int,
    *,
    posterior: bool = False,
) -> Score:
    """Scores of a parameter from plain arrays.

    Parameters
    ----------
    known
        The parameter, its true value and bound.
    numbers
        Value, standard error and the interval's ends by fit, NaN where there are none, shape
        (fits, 4).
    counted
        Which fits count as results, shape (fits,).
    tried
        Fits of recordings that the method can treat.
    posterior
        Whether standard errors are those of a posterior distribution.
    """
    truth, own = known.truth, numbers[counted]
    values, claimed, intervals = own[:, 0], scores.mean(own[:, 1]), own[:, 2:]
    every = numbers[np.isfinite(numbers[:, 0]), 0]
    coverage = scores.coverage(intervals, truth)
    claims = bool(np.isfinite(intervals).any())
    share = scores.held(intervals, truth) / tried if claims else math.nan
    given = int(np.sum(np.isfinite(intervals).all(axis=1)))
    return Score(
        known.parameter,
        truth,
        n=values.size,
        failures=counted.size - values.size,
        tried=tried,
        bias=scores.bias(values, truth),
        bias_se=scores.bias_std_error(values),
        std=scores.spread(values),
        std_se=scores.spread_std_error(values),
        rmse=scores.rmse(values, truth),
        rmse_se=scores.rmse_std_error(values, truth),
        claimed=claimed,
        bound=known.bound if known.bound else math.nan,
        posterior=claimed if posterior else math.nan,
        coverage=coverage,
        coverage_interval=scores.coverage_interval(coverage, given),
        coverage_all=share,
        coverage_all_interval=scores.coverage_interval(share, tried if claims else 0),
        n_all=every.size,
        bias_all=scores.bias(every, truth),
        bias_all_se=scores.bias_std_error(every),
        std_all=scores.spread(every),
        skew=scores.skewness(values),
    )
