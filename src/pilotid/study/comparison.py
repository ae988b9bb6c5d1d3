"""What came out of a study: its fits by scenario and method, and their scores."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from pilotid.study.attempts import Attempts
from pilotid.study.entries import Draw, Result, ScenarioEntry
from pilotid.study.population import PopulationCell
from pilotid.study.score import Score, scored
from pilotid.study.store import Store
from pilotid.study.strata import strata_of
from pilotid.study.tracks import PERIODS, TrackScore, track_scores
from pilotid.types import FloatArray

if TYPE_CHECKING:
    from pandas import DataFrame


#: Columns of the summary behind scenario and method, and the score that each holds.
SUMMARY_COLUMNS = {
    "parameter": "parameter",
    "n": "n",
    "failures": "failures",
    "truth": "truth",
    "bias": "bias",
    "bias_se": "bias_se",
    "bias_percent": "bias_percent",
    "std": "std",
    "rmse": "rmse",
    "crlb": "bound",
    "mean_std_error": "claimed",
    "coverage_95": "coverage",
    "posterior_std": "posterior",
}
ESTIMATE_COLUMNS = (
    *("scenario", "method", "replication", "outcome", "parameter", "truth"),
    *("value", "std_error", "lower_95", "upper_95", "seconds"),
)
#: Columns of the table of trajectories behind scenario and method.
TRACK_COLUMNS = (
    *("parameter", "n"),
    *(f"rmse_{period}{end}" for period in PERIODS for end in ("", "_se")),
    *("rmse_median", "lag", "lag_se", "coverage_95", "coverage_se"),
)


@dataclass(frozen=True, eq=False)
class Cell(Attempts):
    """All fits of one scenario by one method; see `Attempts`.

    Attributes
    ----------
    scenario, method, results
        See `Attempts`.
    """

    @cached_property
    def numbers(self) -> FloatArray:
        """Value, standard error and the interval's ends, shape (parameters, fits, 4).

        A fit that gave none has NaN; one that did not converge has its last values.
        """
        none = [(None,) * 4] * len(self.scenario.parameters)
        rows = [[e[1:] for e in r.estimates] if r.estimates else none for r in self.results]
        return np.array(rows, dtype=float).swapaxes(0, 1)

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

    @cached_property
    def tracks(self) -> tuple[TrackScore, ...]:
        """Scores of the trajectories of the fits that count, by parameter; none if none changes."""
        return track_scores([r.tracks for r in self.results if r.usable and r.tracks])

    def paths(self, parameter: str) -> FloatArray:
        """A parameter's trajectories in the fits that count, shape (fits, times)."""
        rows = [t.values for r in self.results if r.usable for t in r.tracks
                if t.parameter == parameter]  # fmt: skip
        return np.array(rows, dtype=float)

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
    typed
        What to type for each method on the command line, by its label and in the order of
        tables and figures.
    populations
        What each method did on each population; they have no one truth, and are in none of
        the lists of scenarios here but `every` and `all_names`.
    """

    cells: tuple[Cell, ...]
    typed: Mapping[str, str]
    populations: tuple[PopulationCell, ...] = ()

    @property
    def methods(self) -> tuple[str, ...]:
        """The methods' labels, in the order of tables and figures."""
        return tuple(self.typed)

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
        """What a method did in a scenario, None if it was not tried there.

        Parameters
        ----------
        scenario, method
            Name of the scenario, label of the method.
        """
        return self._by_name.get((scenario, method))

    def of(self, scenario: str) -> list[Cell]:
        """The cells of a scenario, in the order of the methods."""
        found = [self.at(scenario, method) for method in self.methods]
        return [cell for cell in found if cell is not None]

    @property
    def every(self) -> tuple[Attempts, ...]:
        """What each method did in each scenario and on each population."""
        return (*self.cells, *self.populations)

    @property
    def all_names(self) -> list[str]:
        """Names of scenarios and populations."""
        return list(dict.fromkeys(each.scenario.name for each in self.every))

    def tried_on(self, scenario: str) -> list[Attempts]:
        """What methods did in a scenario or on a population, in the order of the methods."""
        found = {each.method: each for each in self.every if each.scenario.name == scenario}
        return [found[method] for method in self.methods if method in found]

    def entry(self, scenario: str) -> ScenarioEntry:
        """A scenario or population by its name."""
        return next(e.scenario for e in self.every if e.scenario.name == scenario)

    def replications(self, scenarios: Sequence[str]) -> int:
        """Recordings of each scenario, the largest number if they differ."""
        results = [r for name in scenarios for c in self.tried_on(name) for r in c.results]
        return max((r.unit.replication + 1 for r in results), default=0)

    def summary_rows(self) -> Iterator[list[object]]:
        """Scenario, method and `SUMMARY_COLUMNS` of every parameter in every cell.

        Of a population's parameters only what has a meaning without one truth.
        """
        for cell in self.cells:
            for score in cell.scores:
                numbers = [getattr(score, name) for name in SUMMARY_COLUMNS.values()]
                yield [cell.scenario.name, cell.method, *numbers]
        for own in self.populations:
            for key in own.keys:
                standing = own.standing(key)
                known = {
                    "parameter": key,
                    "n": standing.n,
                    "failures": standing.failures + standing.objections,
                    "coverage": standing.coverage.value,
                }
                numbers = [known.get(name, math.nan) for name in SUMMARY_COLUMNS.values()]
                yield [own.scenario.name, own.method, *numbers]

    def population_rows(self) -> Iterator[list[object]]:
        """Population, method and `POPULATION_COLUMNS` of every stratum and parameter."""
        for cell in self.populations:
            for row in cell.rows():
                yield [cell.scenario.name, cell.method, *row]

    def track_rows(self) -> Iterator[list[object]]:
        """Scenario, method and `TRACK_COLUMNS` of every trajectory's parameter."""
        for cell in self.cells:
            for t in cell.tracks:
                pairs = zip(t.rmse, t.rmse_se, strict=True)
                errors = [value for pair in pairs for value in pair]
                rest = [t.median, t.lag, t.lag_se, t.coverage, t.coverage_se]
                yield [cell.scenario.name, cell.method, t.parameter, t.n, *errors, *rest]

    def estimate_rows(self) -> Iterator[list[object]]:
        """`ESTIMATE_COLUMNS` of every parameter in every fit.

        A fit of a population of which it is not known what was drawn has one row without a
        parameter.
        """
        none = (math.nan,) * 4
        for each in self.every:
            for result in each.results:
                unit, own = result.unit, {key: numbers for key, *numbers in result.estimates}
                head = [unit.scenario, unit.method, unit.replication, result.outcome]
                known = each.scenario.parameters if result.draw is None else result.draw.parameters
                for parameter, truth in [(p.parameter, p.truth) for p in known] or [("", math.nan)]:
                    numbers = own.get(parameter, none)
                    yield [*head, parameter, truth, *map(_float, numbers), _float(result.seconds)]

    def to_dataframe(self, *, summary: bool = False) -> DataFrame:
        """All estimates, or the scores, as the CSV files have them.

        Parameters
        ----------
        summary
            A row for each scenario, method and parameter in place of one for each fit.

        Raises
        ------
        ImportError
            Without pandas, which ``pip install 'pilotid[tables]'`` brings.
        """
        from pandas import DataFrame

        if summary:
            columns = ["scenario", "method", *SUMMARY_COLUMNS]
            return DataFrame(self.summary_rows(), columns=columns)
        return DataFrame(self.estimate_rows(), columns=list(ESTIMATE_COLUMNS))


def _float(value: float | None) -> float:
    return math.nan if value is None else value


def comparison_of(store: Store) -> Comparison:
    """What a store holds."""
    entries = {entry.name: entry for entry in store.scenarios()}
    found: dict[tuple[str, str], list[Result]] = {}
    for result in store.results():
        found.setdefault((result.unit.scenario, result.unit.method), []).append(result)
    present = {method for _, method in found}
    drawn: dict[str, dict[int, Draw]] = {}
    for (name, replication), draw in store.draws().items():
        drawn.setdefault(name, {})[replication] = draw
    strata = {name: strata_of(draws) for name, draws in drawn.items()}
    return Comparison(
        tuple(
            Cell(entries[name], method, tuple(own))
            for (name, method), own in found.items()
            if not entries[name].population
        ),
        {label: m.typed or label for label, m in store.methods().items() if label in present},
        tuple(
            PopulationCell(entries[name], method, tuple(own), strata.get(name, {}))
            for (name, method), own in found.items()
            if entries[name].population
        ),
    )
