"""What came out of a study: its fits by scenario and method, and their scores."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pilotid.estimates.estimate import Outcome
from pilotid.study import scores
from pilotid.study.store import ParameterTruth, Result, ScenarioEntry, Store
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
    )


@dataclass(frozen=True, eq=False)
class Cell:
    """All fits of one scenario by one method.

    Attributes
    ----------
    scenario
        The scenario.
    method
        The method's name.
    results
        The fits by replication.
    """

    scenario: ScenarioEntry
    method: str
    results: tuple[Result, ...]

    @cached_property
    def numbers(self) -> FloatArray:
        """Value, standard error and the interval's ends, shape (parameters, fits, 4).

        A fit that gave none has NaN; one that did not converge has its last values.
        """
        none = [(None,) * 4] * len(self.scenario.parameters)
        rows = [[e[1:] for e in r.estimates] if r.estimates else none for r in self.results]
        return np.array(rows, dtype=float).swapaxes(0, 1)

    @cached_property
    def counted(self) -> BoolArray:
        """Which fits count as results, shape (fits,)."""
        return np.array([r.usable for r in self.results], dtype=bool)

    @property
    def usable(self) -> int:
        """Fits that count as results."""
        return int(np.sum(self.counted))

    @property
    def tried(self) -> int:
        """Fits of recordings that the method can treat."""
        return sum(r.outcome != Outcome.NOT_APPLICABLE.slug for r in self.results)

    @property
    def milliseconds(self) -> float:
        """Median time of a fit."""
        known = [r.seconds for r in self.results if r.seconds is not None]
        return 1e3 * float(np.median(known)) if known else math.nan

    @cached_property
    def scores(self) -> tuple[Score, ...]:
        """Scores of each parameter, in its unit."""
        posterior = any(r.posterior for r in self.results)
        return tuple(
            scored(known, own, self.counted, self.tried, posterior=posterior)
            for known, own in zip(self.scenario.parameters, self.numbers, strict=True)
        )

    @cached_property
    def percent(self) -> tuple[Score, ...]:
        """Scores of each parameter, in % of its true value."""
        return tuple(score.percent for score in self.scores)

    @property
    def errors(self) -> FloatArray:
        """Errors of the fits that count, in % of the true values, shape (fits, parameters)."""
        truth = np.array([p.truth for p in self.scenario.parameters])
        return np.asarray(100.0 * (self.numbers[:, self.counted, 0].T / truth - 1.0))

    @property
    def agreeing(self) -> int:
        """Fits that end in the common optimum: within a tenth of the bound of the median end.

        Where a bound is missing, within 0.1 % of the truth.
        """
        ends = self.errors
        if not len(ends):
            return 0
        bounds = np.array([s.bound for s in self.percent])
        reach = np.where(np.isfinite(bounds), bounds, 1.0) / 10.0
        return int(np.sum(np.all(np.abs(ends - np.median(ends, axis=0)) <= reach, axis=1)))


@dataclass(frozen=True, eq=False)
class Comparison:
    """All fits of a study, by scenario and method.

    Attributes
    ----------
    cells
        What each method did in each scenario, in the order of the catalogues.
    """

    cells: tuple[Cell, ...]
    methods: tuple[str, ...]

    @cached_property
    def _by_name(self) -> dict[tuple[str, str], Cell]:
        return {(c.scenario.name, c.method): c for c in self.cells}

    @cached_property
    def scenarios(self) -> tuple[ScenarioEntry, ...]:
        """The scenarios that have fits, in the order of the catalogue."""
        return tuple({c.scenario.name: c.scenario for c in self.cells}.values())

    @property
    def names(self) -> list[str]:
        """The scenarios' names, in the order of the catalogue."""
        return [entry.name for entry in self.scenarios]

    def at(self, scenario: str, method: str) -> Cell | None:
        """What a method did in a scenario, None if it was not tried there."""
        return self._by_name.get((scenario, method))

    def of(self, scenario: str) -> list[Cell]:
        """The cells of a scenario, in the order of the methods."""
        found = [self.at(scenario, method) for method in self.methods]
        return [cell for cell in found if cell is not None]

    def entry(self, scenario: str) -> ScenarioEntry:
        """A scenario by its name."""
        return next(entry for entry in self.scenarios if entry.name == scenario)

    def replications(self, scenarios: Sequence[str]) -> int:
        """Recordings of each scenario, the largest number if they differ."""
        results = [r for name in scenarios for c in self.of(name) for r in c.results]
        return max((r.unit.replication + 1 for r in results), default=0)


def comparison_of(store: Store) -> Comparison:
    """What a store holds."""
    scenarios = {entry.name: entry for entry in store.scenarios()}
    found: dict[tuple[str, str], list[Result]] = {}
    for result in store.results():
        found.setdefault((result.unit.scenario, result.unit.method), []).append(result)
    present = {method for _, method in found}
    return Comparison(
        tuple(Cell(scenarios[name], method, tuple(own)) for (name, method), own in found.items()),
        tuple(method for method in store.methods() if method in present),
    )
