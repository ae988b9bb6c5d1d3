"""What came out of a study: its fits by scenario and method, and their scores.

A scenario is a population of one pilot: both have the same table of numbers, a row for each fit
and a column for each parameter, and the same scores.  What has a meaning for one true value alone,
such as the bias in the parameter's unit, is NaN where every recording has its own.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pilotid.estimates.estimate import Outcome
from pilotid.study import scores
from pilotid.study.scores import Interval, Mean
from pilotid.study.store import (
    Draw,
    MethodEntry,
    ParameterTruth,
    Result,
    ScenarioEntry,
    Store,
    Stratum,
    strata_of,
)
from pilotid.support.disk import table_bytes, write_file
from pilotid.support.numbers import Z95
from pilotid.support.types import BoolArray, FloatArray, InputError

if TYPE_CHECKING:
    from pandas import DataFrame

ESTIMATES, SUMMARY = "estimates.csv", "summary.csv"
POPULATION, SCORES = "population.csv", "scores.csv"
ALL = "all"  # stands for all parameters, and for all recordings
NO_TRY = Outcome.NOT_APPLICABLE.slug
#: A fit ends in a wrong optimum if its criterion exceeds that of a search from the truth by more.
WRONG = 4.0

LOSS_COLUMNS = ("loss", "loss_lower", "loss_upper")
#: Columns of the summary behind scenario and method.
SUMMARY_COLUMNS = (
    *("parameter", "n", "failures", "truth", "bias", "bias_se", "bias_percent", "std", "rmse"),
    *("crlb", "mean_std_error", "coverage_95", "posterior_std", *LOSS_COLUMNS),
)
ESTIMATE_COLUMNS = (
    *("scenario", "method", "replication", "outcome", "parameter", "truth"),
    *("value", "std_error", "lower_95", "upper_95", "seconds", "crlb"),
)
#: Columns of population.csv and scores.csv behind scenario and method.
POPULATION_COLUMNS = (
    *("stratum", "value", "parameter", "recordings", "n"),
    *("coverage_95", "coverage_se", "mean_z", "mean_z_se", "rms_z", "rms_z_se"),
    *("rms_z_trimmed", "rms_z_trimmed_se", "beyond_3", "beyond_3_se"),
    *("rmse_over_bound", "rmse_over_bound_se", "median_over_bound"),
    *("failures", "not_applicable", "wrong_optima", "optima", *LOSS_COLUMNS),
)


@dataclass(frozen=True)
class Score:
    """Scores of one parameter, or of all, by one method in one scenario or a part of it.

    Attributes
    ----------
    parameter, truth, bound
        The parameter; true value and Cramer-Rao bound are NaN unless all recordings share them.
    n, tried, failures, objections
        Values that count, fits of recordings that the method can treat, those of them that
        failed, and recordings that the method objects to.
    bias, std, rmse
        Of the values that count, in the parameter's unit, where the truth is one.
    claimed, posterior
        Mean standard error that the fits claim, and that of posteriors.
    coverage, coverage_interval, worth
        Share of the 95 % intervals that hold the truth, its own 95 % interval, and how many
        independent intervals they are worth.
    z, z_skew, rms, trimmed, beyond
        Of error over claimed error: mean, skewness, root mean square, the same with 1 % left
        out, and share beyond 3.
    ratio, typical
        Root mean square of error over bound, and its counterpart of the median.
    wrong, optima
        Fits that end in a wrong optimum, of those for which that is known.
    loss, loss_ended_well
        See `pilotid.study.scores`; with each failure charged with the interval from zero to
        twice the true value, and of the fits that ended well alone.
    """

    parameter: str
    truth: float
    bound: float
    n: int
    tried: int
    failures: int
    objections: int
    bias: Mean
    std: Mean
    rmse: Mean
    claimed: float
    posterior: float
    coverage: Mean
    coverage_interval: tuple[float, float]
    worth: int
    z: Mean
    z_skew: float
    rms: Mean
    trimmed: Mean
    beyond: Mean
    ratio: Mean
    typical: float
    wrong: int
    optima: int
    loss: Interval
    loss_ended_well: float

    @property
    def percent(self) -> Score:
        """The same with all that has the parameter's unit in % of its true value."""
        scale = 100.0 / abs(self.truth) if self.truth else math.nan
        turned = math.copysign(scale, self.truth)
        return replace(
            self,
            truth=math.copysign(100.0, self.truth),
            bound=scale * self.bound,
            bias=Mean(turned * self.bias.value, scale * self.bias.error),
            std=Mean(scale * self.std.value, scale * self.std.error),
            rmse=Mean(scale * self.rmse.value, scale * self.rmse.error),
            claimed=scale * self.claimed,
            posterior=scale * self.posterior,
        )


class Numbers(NamedTuple):
    """What is known of each parameter of each fit, shape (fits, parameters); NaN for nothing."""

    value: FloatArray
    std_error: FloatArray
    lower: FloatArray
    upper: FloatArray
    truth: FloatArray
    bound: FloatArray


@dataclass(frozen=True, eq=False)
class MethodResults:
    """All fits of one scenario, or of one population, by one method.

    Attributes
    ----------
    scenario
        The scenario.
    method
        The method's label.
    results
        The fits by replication.
    strata
        Of a population: replications by the values of each fact that was drawn, by its name.
    """

    scenario: ScenarioEntry
    method: str
    results: tuple[Result, ...]
    strata: Mapping[str, Stratum] = field(default_factory=dict)

    @cached_property
    def counted(self) -> BoolArray:
        """Which fits count as results, shape (fits,)."""
        return np.array([r.usable for r in self.results], dtype=bool)

    @cached_property
    def applicable(self) -> BoolArray:
        """Which fits are of recordings that the method can treat, shape (fits,)."""
        return np.array([r.outcome != NO_TRY for r in self.results], dtype=bool)

    @property
    def attempts(self) -> list[Result]:
        """Fits of recordings that the method can treat."""
        return [r for r in self.results if r.outcome != NO_TRY]

    @property
    def usable(self) -> int:
        """Fits that count as results."""
        return int(np.sum(self.counted))

    @property
    def tried(self) -> int:
        """Fits of recordings that the method can treat."""
        return int(np.sum(self.applicable))

    @property
    def seconds(self) -> float:
        """Median time of a fit."""
        known = [r.seconds for r in self.results if r.seconds is not None]
        return float(np.median(known)) if known else math.nan

    def parameters_of(self, result: Result) -> tuple[ParameterTruth, ...]:
        """True values and bounds of a fit's recording; none if it is not known what was drawn."""
        return self.scenario.parameters if result.draw is None else result.draw.parameters

    @cached_property
    def keys(self) -> tuple[str, ...]:
        """The parameters; of a population those of any model, of large models in their order."""
        if not self.scenario.population:
            return tuple(p.parameter for p in self.scenario.parameters)
        models = {r.draw.model: r.draw for r in self.results if r.draw is not None}
        ordered = sorted(models.values(), key=lambda draw: (-len(draw.parameters), draw.model))
        return tuple(dict.fromkeys(p.parameter for draw in ordered for p in draw.parameters))

    @cached_property
    def numbers(self) -> Numbers:
        """What is known of each parameter; a fit that did not converge has its last values."""
        table = np.full((len(self.results), len(self.keys), 6), math.nan)
        place = {key: index for index, key in enumerate(self.keys)}
        for row, result in zip(table, self.results, strict=True):
            for p in self.parameters_of(result):
                if p.parameter in place:
                    row[place[p.parameter], 4:] = p.truth, p.bound or math.nan
            for key, *numbers in result.estimates:
                if key in place:
                    row[place[key], :4] = [math.nan if x is None else x for x in numbers]
        return Numbers(*np.moveaxis(table, 2, 0))

    @cached_property
    def intervals(self) -> tuple[FloatArray, FloatArray]:
        """Ends of the 95 % intervals, or what the standard errors make; (fits, parameters)."""
        known = self.numbers
        reach = np.where(known.std_error > 0.0, Z95 * known.std_error, math.nan)
        own = np.isfinite(known.lower) & np.isfinite(known.upper)
        return (
            np.where(own, known.lower, known.value - reach),
            np.where(own, known.upper, known.value + reach),
        )

    @cached_property
    def losses(self) -> FloatArray:
        """The loss, shape (fits, parameters), NaN of recordings that are no try.

        What failed, and an interval that is missing though others are not, is charged with the
        interval from zero to twice the true value.  Without any interval there is no loss.
        """
        known, (lower, upper) = self.numbers, self.intervals
        counted, tried = self.counted[:, None], self.applicable[:, None]
        score = scores.interval_score(lower, upper, known.truth)
        if self.usable and not np.isfinite(score[self.counted]).any():
            return np.full_like(score, math.nan)
        charged = np.where(counted & np.isfinite(score), score, 2.0 * np.abs(known.truth))
        return np.where(tried, charged / (scores.EFFICIENT * known.bound), math.nan)

    @cached_property
    def scores(self) -> tuple[Score, ...]:
        """Scores of all parameters together and of each."""
        return self.scores_in(None)

    @cached_property
    def parts(self) -> dict[tuple[str, str], tuple[Score, ...]]:
        """The same in each part of a population, by the name and the value of a fact."""
        return {
            (name, value): self.scores_in(members)
            for name, stratum in self.strata.items()
            for value, members in stratum.items()
        }

    @property
    def percent(self) -> list[Score]:
        """Scores of each parameter, in % of its true value."""
        return [score.percent for score in self.scores[1:]]

    @property
    def overall(self) -> Score:
        """Scores of all parameters together."""
        return self.scores[0]

    def scores_in(self, members: frozenset[int] | None) -> tuple[Score, ...]:
        """Scores of all parameters together and of each, in some of the recordings.

        Parameters
        ----------
        members
            Replications; None for all.
        """
        rows = np.ones(len(self.results), dtype=bool)
        if members is not None:
            rows = np.array([r.unit.replication in members for r in self.results], dtype=bool)
        losses, ended_well = self.losses[rows], self.losses[rows & self.counted]
        found = scores.mean_losses(losses, self.scenario.name)
        means = [scores.mean(own) for own in ended_well.T]
        logs = np.array([math.log(m) for m in means if m > 0.0])
        means = [math.exp(float(np.mean(logs))) if logs.size else math.nan, *means]
        return tuple(
            self._score(key, rows, loss, good)
            for key, loss, good in zip((ALL, *self.keys), found, means, strict=True)
        )

    def _score(self, key: str, rows: BoolArray, loss: Interval, ended_well: float) -> Score:
        columns = list(range(len(self.keys))) if key == ALL else [self.keys.index(key)]
        own = Numbers(*(table[:, columns] for table in self.numbers))
        has = np.isfinite(own.truth)
        concerned = rows & (has.any(axis=1) | (key == ALL))
        tried = concerned & self.applicable
        counted = concerned & self.counted
        mine = has & counted[:, None] & np.isfinite(own.value)
        clusters = np.broadcast_to(np.arange(len(self.results))[:, None], mine.shape)
        error = own.value - own.truth
        claims = mine & (own.std_error > 0.0)
        z, of = error[claims] / own.std_error[claims], clusters[claims]
        bounded = mine & np.isfinite(own.bound)
        ratio = error[bounded] / own.bound[bounded]
        given = mine & np.isfinite(own.lower) & np.isfinite(own.upper)
        hits = (own.lower <= own.truth) & (own.truth <= own.upper)
        share, interval, worth = scores.coverage(hits[given], clusters[given])
        excess = [r.excess for r, yes in zip(self.results, tried, strict=True)
                  if yes and r.excess is not None]  # fmt: skip
        one = key != ALL and not self.scenario.population
        known = self.scenario.parameters[columns[0]] if one else None
        truth = known.truth if known else math.nan
        values = own.value[mine] if one else np.zeros(0)
        claimed = scores.mean(own.std_error[mine]) if one else math.nan
        posterior = any(r.posterior for r in self.results)
        return Score(
            key,
            truth,
            (known.bound if known else None) or math.nan,
            n=int(np.sum(mine)),
            tried=int(np.sum(tried)),
            failures=int(np.sum(tried & ~self.counted)),
            objections=int(np.sum(concerned & ~self.applicable)),
            bias=scores.bias(values, truth),
            std=scores.spread(values),
            rmse=scores.rmse(values, truth),
            claimed=claimed,
            posterior=claimed if posterior else math.nan,
            coverage=share,
            coverage_interval=interval,
            worth=worth,
            z=scores.clustered_mean(z, of),
            z_skew=scores.skewness(z),
            rms=scores.root_mean_square(z, of),
            trimmed=scores.trimmed(z, of),
            beyond=scores.beyond(z, of),
            ratio=scores.root_mean_square(ratio, clusters[bounded]),
            typical=scores.typical(ratio),
            wrong=sum(e > WRONG for e in excess),
            optima=len(excess),
            loss=loss,
            loss_ended_well=ended_well,
        )

    def errors_over_claim(self, key: str) -> FloatArray:
        """Errors of a parameter over claimed errors, in ascending order, shape (n,)."""
        known, column = self.numbers, self.keys.index(key)
        claimed = known.std_error[self.counted, column]
        error = (known.value - known.truth)[self.counted, column]
        return np.sort((error / np.where(claimed > 0.0, claimed, math.nan))[claimed > 0.0])

    @property
    def agreeing(self) -> int:
        """Fits that end in the common optimum: within a tenth of the bound of the median end.

        Where a bound is missing, within 0.1 % of the truth.
        """
        ends = 100.0 * (self.numbers.value / self.numbers.truth)[self.counted]
        if not len(ends):
            return 0
        bounds = np.array([s.percent.bound for s in self.scores[1:]])
        reach = np.where(np.isfinite(bounds), bounds, 1.0) / 10.0
        return int(np.sum(np.all(np.abs(ends - np.median(ends, axis=0)) <= reach, axis=1)))


def loss_ratios(first: MethodResults, second: MethodResults) -> dict[str, Interval]:
    """Ratios of the first method's losses to the second's on the recordings that both have.

    Parameters
    ----------
    first, second
        What both did in one scenario; the bounds of the second count.

    Returns
    -------
    Those of all parameters together and of each, by key.
    """
    keys = [key for key in first.keys if key in second.keys]
    rows = [{r.unit.replication: i for i, r in enumerate(c.results)} for c in (first, second)]
    both = [number for number in rows[0] if number in rows[1]]
    if not both or not keys:
        return {ALL: scores.NOTHING}
    one, other = (
        np.ix_([place[n] for n in both], [cell.keys.index(key) for key in keys])
        for cell, place in zip((first, second), rows, strict=True)
    )
    scale = first.numbers.bound[one] / second.numbers.bound[other]
    found = scores.mean_losses(first.losses[one] * scale, first.scenario.name, second.losses[other])
    return dict(zip((ALL, *keys), found, strict=True))


@dataclass(frozen=True, eq=False)
class Comparison:
    """All fits of a study, by scenario and method.

    Attributes
    ----------
    cells
        What each method did in each scenario and on each population, in the order of the
        catalogues.
    entries
        The methods by their labels, in the order of tables and figures.
    about
        Facts on the study, see `pilotid.study.study`.
    folder
        Where its store is.
    """

    cells: tuple[MethodResults, ...]
    entries: Mapping[str, MethodEntry]
    about: Mapping[str, str]
    folder: Path

    @property
    def methods(self) -> tuple[str, ...]:
        """The methods' labels, in the order of tables and figures."""
        return tuple(self.entries)

    @cached_property
    def _by_name(self) -> dict[tuple[str, str], MethodResults]:
        return {(c.scenario.name, c.method): c for c in self.cells}

    @cached_property
    def scenarios(self) -> tuple[ScenarioEntry, ...]:
        """The scenarios and populations that have fits."""
        return tuple({c.scenario.name: c.scenario for c in self.cells}.values())

    @property
    def names(self) -> list[str]:
        """Names of scenarios and populations."""
        return [entry.name for entry in self.scenarios]

    @property
    def fits(self) -> int:
        """Number of fits."""
        return sum(len(cell.results) for cell in self.cells)

    @property
    def populations(self) -> list[MethodResults]:
        """What each method did on each population."""
        return [cell for cell in self.cells if cell.scenario.population]

    def at(self, scenario: str, method: str) -> MethodResults | None:
        """What a method did in a scenario, None if it was not tried there.

        Parameters
        ----------
        scenario, method
            Name of the scenario, label of the method.
        """
        return self._by_name.get((scenario, method))

    def of(self, scenario: str) -> list[MethodResults]:
        """The cells of a scenario, in the order of the methods."""
        found = [self.at(scenario, method) for method in self.methods]
        return [cell for cell in found if cell is not None]

    def entry(self, scenario: str) -> ScenarioEntry:
        """A scenario or population by its name."""
        return next(entry for entry in self.scenarios if entry.name == scenario)

    def remnant_ratio(self, scenario: str) -> float:
        """The remnant's share of the control's power; NaN where it is not known."""
        return float(self.about.get(f"remnant ratio {scenario}", "nan"))

    def replications(self, scenarios: Sequence[str]) -> int:
        """Recordings of each scenario, the largest number if they differ."""
        results = [r for name in scenarios for c in self.of(name) for r in c.results]
        return max((r.unit.replication + 1 for r in results), default=0)

    def summary_rows(self) -> Iterator[list[object]]:
        """Scenario, method and `SUMMARY_COLUMNS` of every parameter and of all in every cell."""
        for cell in self.cells:
            for s in (*cell.scores[1:], cell.overall):
                count = cell.usable if s.parameter == ALL else s.n
                head = cell.scenario.name, cell.method, s.parameter, count
                errors = s.truth, *s.bias, s.percent.bias.value, s.std.value, s.rmse.value
                claims = s.bound, s.claimed, s.coverage.value, s.posterior
                yield [*head, s.failures + s.objections, *errors, *claims, *s.loss]

    def score_rows(self, cells: Iterable[MethodResults]) -> Iterator[list[object]]:
        """Scenario, method and `POPULATION_COLUMNS` of every stratum and parameter."""
        for cell in cells:
            for (name, value), own in {(ALL, ALL): cell.scores, **cell.parts}.items():
                for s in own:
                    wrong = [s.wrong, s.optima] if s.optima else [math.nan, 0]
                    yield [
                        *(cell.scenario.name, cell.method, name, value, s.parameter, s.tried, s.n),
                        *(*s.coverage, *s.z, *s.rms, *s.trimmed, *s.beyond, *s.ratio, s.typical),
                        *(s.failures, s.objections, *wrong, *s.loss),
                    ]

    def estimate_rows(self) -> Iterator[list[object]]:
        """`ESTIMATE_COLUMNS` of every parameter in every fit.

        A fit of a population of which it is not known what was drawn has one row without a
        parameter.
        """
        for cell in self.cells:
            for result in cell.results:
                unit, own = result.unit, {key: numbers for key, *numbers in result.estimates}
                head = [unit.scenario, unit.method, unit.replication, result.outcome]
                known = cell.parameters_of(result) or [ParameterTruth("", "", math.nan, None)]
                for p in known:
                    numbers = map(_float, own.get(p.parameter, (None,) * 4))
                    tail = [_float(result.seconds), _float(p.bound)]
                    yield [*head, p.parameter, p.truth, *numbers, *tail]

    def to_dataframe(self, *, summary: bool = False) -> DataFrame:
        """All estimates, or the scores, as the CSV files have them.

        Parameters
        ----------
        summary
            A row for each scenario, method and parameter in place of one for each fit.
        """
        from pandas import DataFrame

        if summary:
            columns = ["scenario", "method", *SUMMARY_COLUMNS]
            return DataFrame(self.summary_rows(), columns=columns)
        return DataFrame(self.estimate_rows(), columns=list(ESTIMATE_COLUMNS))

    def write_tables(self, folder: Path) -> None:
        """Write estimates and scores as CSV, numbers with as many digits as restore them.

        What methods did on populations has a table of its own, if there are any, and all scores
        of scenarios and populations have one.
        """
        head = ("scenario", "method")
        for name, columns, rows in (
            (SUMMARY, (*head, *SUMMARY_COLUMNS), self.summary_rows()),
            (POPULATION, (*head, *POPULATION_COLUMNS), self.score_rows(self.populations)),
            (SCORES, (*head, *POPULATION_COLUMNS), self.score_rows(self.cells)),
            (ESTIMATES, ESTIMATE_COLUMNS, self.estimate_rows()),
        ):
            held = list(rows)
            if held or name != POPULATION:
                write_file(folder / name, table_bytes(columns, held))


def _float(value: float | None) -> float:
    return math.nan if value is None else value


def comparison_of(store: Store) -> Comparison:
    """What a store holds."""
    entries = {entry.name: entry for entry in store.scenarios()}
    found: dict[tuple[str, str], list[Result]] = {}
    drawn: dict[str, dict[int, Draw]] = {}
    for result in store.results():
        unit = result.unit
        found.setdefault((unit.scenario, unit.method), []).append(result)
        if result.draw is not None:
            drawn.setdefault(unit.scenario, {})[unit.replication] = result.draw
    present = {method for _, method in found}
    strata = {name: strata_of(draws) for name, draws in drawn.items()}
    cells = tuple(
        MethodResults(entries[name], method, tuple(own), strata.get(name, {}))
        for (name, method), own in found.items()
    )
    methods = {label: entry for label, entry in store.methods().items() if label in present}
    return Comparison(cells, methods, store.about(), store.path.parent)


class Change(NamedTuple):
    """The loss of one parameter, or of all, in the second study over that in the first."""

    scenario: str
    method: str
    parameter: str
    ratio: Interval


def read_study(folder: Path) -> Comparison:
    """The study that `pilotid compare` wrote to a folder."""
    with Store(folder) as store:
        return comparison_of(store)


def find_changes(first: Comparison, second: Comparison) -> tuple[list[Change], list[str]]:
    """Ratios of losses on the recordings that both studies have, and what is left out.

    Parameters
    ----------
    first, second
        The studies, in this order.

    Raises
    ------
    InputError
        If the studies have no recordings in common.
    """
    seeds = [study.about.get("seed", "?") for study in (first, second)]
    if seeds[0] != seeds[1]:
        raise InputError(
            f"{second.folder}: has the seed {seeds[1]} and other recordings than {first.folder} "
            f"(seed {seeds[0]}); set the columns `loss` of both summary.csv side by side"
        )
    found, unlike = [], {}
    for ours in first.cells:
        theirs = second.at(ours.scenario.name, ours.method)
        if theirs is None:
            continue
        if why := _difference(ours, theirs):
            unlike[ours.scenario.name] = f"{ours.scenario.name} is left out: {why}"
            continue
        ratios = loss_ratios(theirs, ours).items()
        found += [Change(ours.scenario.name, ours.method, *own) for own in ratios]
    if not found:
        told = "; ".join(["", *unlike.values()])
        raise InputError(f"{second.folder}: has no fits of the recordings of {first.folder}{told}")
    return found, list(unlike.values())


def _difference(ours: MethodResults, theirs: MethodResults) -> str:
    """Why two fits of scenarios of one name are not of the same recordings; empty if they are."""
    if ours.scenario.settings != theirs.scenario.settings:
        return "its settings differ"
    draws = {r.unit.replication: r.draw for r in theirs.results}
    pairs = [(r.draw, draws.get(r.unit.replication)) for r in ours.results]
    same = all(a.same(b) for a, b in pairs if a is not None and b is not None)
    return "" if same else "other pilots were drawn"
