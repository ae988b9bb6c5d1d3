"""Scores of a study in the units of its report: % of the truth, and times the bound."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pilotid.study import scores
from pilotid.study.entries import MethodEntry, ScenarioEntry
from pilotid.study.summary import Group, Summary
from pilotid.types import FloatArray


@dataclass(frozen=True)
class Score:
    """One parameter by one method in one scenario.

    Attributes
    ----------
    parameter, unit, truth
        The parameter.
    n, tried
        Fits that count as results, and fits of recordings that the method can treat.
    bias, bias_se, std, std_se, rmse, claimed, bound, posterior
        Over the fits that count, in % of the truth; ``_se`` is the Monte Carlo standard
        error, `claimed` the mean standard error, `posterior` that of a posterior.
    ratio, ratio_se
        Root mean square error over the bound.
    coverage, coverage_interval
        Share of the 95 % intervals that hold the truth, and its own 95 % interval.
    coverage_all, coverage_all_interval
        The same over all fits tried, with a failure as a miss.
    n_all, bias_all, bias_all_se, std_all
        Over all fits that gave a value, those that failed included.
    """

    parameter: str
    unit: str
    truth: float
    n: int
    tried: int
    bias: float
    bias_se: float
    std: float
    std_se: float
    rmse: float
    claimed: float
    bound: float
    posterior: float
    ratio: float
    ratio_se: float
    coverage: float
    coverage_interval: tuple[float, float]
    coverage_all: float
    coverage_all_interval: tuple[float, float]
    n_all: int
    bias_all: float
    bias_all_se: float
    std_all: float


@dataclass(frozen=True, eq=False)
class Cell:
    """One method in one scenario.

    Attributes
    ----------
    group
        The fits.
    scores
        One for each parameter of the scenario.
    """

    group: Group
    scores: tuple[Score, ...]

    @property
    def method(self) -> str:
        """The method's name."""
        return self.group.method

    @property
    def scenario(self) -> ScenarioEntry:
        """The scenario."""
        return self.group.scenario

    @property
    def tried(self) -> int:
        """Fits of recordings that the method can treat."""
        return self.group.tried

    @property
    def usable(self) -> int:
        """Fits that count as results."""
        return int(np.sum(self.group.usable))

    @property
    def milliseconds(self) -> float:
        """Median time of a fit."""
        seconds = self.group.seconds[np.isfinite(self.group.seconds)]
        return 1e3 * float(np.median(seconds)) if seconds.size else math.nan


class Cells:
    """All cells of a study, by scenario and method.

    Parameters
    ----------
    groups, summaries
        The fits and their scores.
    methods
        The methods in the order of tables and figures.
    """

    def __init__(
        self,
        groups: Sequence[Group],
        summaries: Sequence[Summary],
        methods: Mapping[str, MethodEntry],
    ) -> None:
        known = {(s.scenario, s.method, s.parameter): s for s in summaries}
        self._cells = {(g.scenario.name, g.method): _cell(g, known) for g in groups}
        self.scenarios = list({g.scenario.name: g.scenario for g in groups}.values())
        present = {g.method for g in groups}
        self.methods = [m for m in methods if m in present]
        self.typed = {label: entry.typed or label for label, entry in methods.items()}

    @property
    def names(self) -> list[str]:
        """The scenarios' names, in the order of the catalogue."""
        return [entry.name for entry in self.scenarios]

    def at(self, scenario: str, method: str) -> Cell | None:
        """What a method did in a scenario, None if it was not tried there."""
        return self._cells.get((scenario, method))

    def of(self, scenario: str) -> list[Cell]:
        """The cells of a scenario, in the order of the methods."""
        found = [self.at(scenario, method) for method in self.methods]
        return [cell for cell in found if cell is not None]

    def entry(self, scenario: str) -> ScenarioEntry:
        """A scenario by its name."""
        return next(entry for entry in self.scenarios if entry.name == scenario)

    def replications(self, scenarios: Sequence[str]) -> int:
        """Recordings of each scenario, the largest number if they differ."""
        results = [r for name in scenarios for c in self.of(name) for r in c.group.results]
        return max((r.unit.replication + 1 for r in results), default=0)


def _cell(group: Group, known: dict[tuple[str, str, str], Summary]) -> Cell:
    entry = group.scenario
    return Cell(
        group,
        tuple(
            _score(group, index, known[entry.name, group.method, p.parameter])
            for index, p in enumerate(entry.parameters)
        ),
    )


def _score(group: Group, index: int, summary: Summary) -> Score:
    numbers, truth = group.numbers(index), summary.truth
    own = numbers[group.usable]
    every = numbers[np.isfinite(numbers[:, 0]), 0]
    tried = group.tried
    claims = bool(np.isfinite(own[:, 2:]).any())
    given = int(np.sum(np.isfinite(own[:, 2:]).all(axis=1)))
    share = scores.held(own[:, 2:], truth) / tried if claims else math.nan
    percent = 100.0 / abs(truth) if truth else math.nan
    bound = summary.crlb if summary.crlb > 0.0 else math.nan
    return Score(
        summary.parameter,
        group.scenario.parameters[index].unit,
        truth,
        n=summary.n,
        tried=tried,
        bias=summary.bias_percent,
        bias_se=percent * summary.bias_se,
        std=percent * summary.std,
        std_se=percent * scores.spread_std_error(own[:, 0]),
        rmse=percent * summary.rmse,
        claimed=percent * summary.mean_std_error,
        bound=percent * bound,
        posterior=percent * summary.posterior_std,
        ratio=summary.rmse / bound,
        ratio_se=scores.rmse_std_error(own[:, 0], truth) / bound,
        coverage=summary.coverage_95,
        coverage_interval=scores.coverage_interval(summary.coverage_95, given),
        coverage_all=share,
        coverage_all_interval=scores.coverage_interval(share, tried if claims else 0),
        n_all=every.size,
        bias_all=percent * scores.bias(every, truth),
        bias_all_se=percent * scores.bias_std_error(every),
        std_all=percent * scores.spread(every),
    )


def ends(cell: Cell) -> FloatArray:
    """Errors of all fits that count, in % of the truth, shape (fits, parameters)."""
    usable = cell.group.usable
    columns = [
        100.0 * (cell.group.numbers(i)[usable, 0] / p.truth - 1.0)
        for i, p in enumerate(cell.scenario.parameters)
    ]
    return np.stack(columns, axis=1)


def agreeing(cell: Cell) -> int:
    """Fits that end in the common optimum: within a tenth of the bound of the median end.

    Where a bound is missing, within 0.1 % of the truth.
    """
    found = ends(cell)
    if not len(found):
        return 0
    reach = np.array([s.bound if math.isfinite(s.bound) else 1.0 for s in cell.scores]) / 10.0
    return int(np.sum(np.all(np.abs(found - np.median(found, axis=0)) <= reach, axis=1)))
