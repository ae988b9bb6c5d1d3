"""Scores of a study, and the files that hold them."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from pilotid.disk import write_file
from pilotid.estimates.estimate import Outcome
from pilotid.study import scores
from pilotid.study.entries import ParameterTruth, Result, ScenarioEntry
from pilotid.study.store import Store
from pilotid.types import BoolArray, FloatArray

ESTIMATES = "estimates.csv"
SUMMARY = "summary.csv"


@dataclass(frozen=True, eq=False)
class Group:
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

    @property
    def usable(self) -> BoolArray:
        """Which fits count as results, shape (fits,)."""
        return np.array([r.usable for r in self.results], dtype=bool)

    @property
    def failures(self) -> int:
        """Number of fits that do not count."""
        return int(np.sum(~self.usable))

    @property
    def tried(self) -> int:
        """Number of fits of recordings that the method can treat."""
        return sum(r.outcome != Outcome.NOT_APPLICABLE.slug for r in self.results)

    @property
    def seconds(self) -> FloatArray:
        """Wall-clock times of the fits, shape (fits,)."""
        return np.array([math.nan if r.seconds is None else r.seconds for r in self.results])

    def numbers(self, index: int) -> FloatArray:
        """Value, standard error and the interval's ends of one parameter, (fits, 4).

        A fit that gave none has NaN; one that did not converge has its last values.
        """
        rows = [r.estimates[index][1:] if r.estimates else (None,) * 4 for r in self.results]
        return np.array(rows, dtype=float)


@dataclass(frozen=True)
class Summary:
    """Scores of one parameter by one method; the fields are the columns of the CSV file.

    Fits that failed are counted and left out, as the literature does.
    """

    scenario: str
    method: str
    parameter: str
    n: int
    failures: int
    truth: float
    bias: float
    bias_se: float
    bias_percent: float
    std: float
    rmse: float
    crlb: float
    mean_std_error: float
    coverage_95: float
    posterior_std: float


def groups_of(store: Store) -> list[Group]:
    """The study's fits by scenario and method, in the order of the catalogues."""
    scenarios = {entry.name: entry for entry in store.scenarios()}
    found: dict[tuple[str, str], list[Result]] = {}
    for result in store.results():
        found.setdefault((result.unit.scenario, result.unit.method), []).append(result)
    return [Group(scenarios[name], method, tuple(own)) for (name, method), own in found.items()]


def summaries_of(groups: Iterable[Group]) -> list[Summary]:
    """Scores for each scenario, method and parameter."""
    return [
        _scored(group, index, parameter)
        for group in groups
        for index, parameter in enumerate(group.scenario.parameters)
    ]


def _scored(group: Group, index: int, known: ParameterTruth) -> Summary:
    values, errors, *ends = group.numbers(index)[group.usable].T
    bias = scores.bias(values, known.truth)
    claimed = scores.mean(errors)
    return Summary(
        group.scenario.name,
        group.method,
        known.parameter,
        n=values.size,
        failures=group.failures,
        truth=known.truth,
        bias=bias,
        bias_se=scores.bias_std_error(values),
        bias_percent=100.0 * bias / known.truth if known.truth else math.nan,
        std=scores.spread(values),
        rmse=scores.rmse(values, known.truth),
        crlb=math.nan if known.bound is None else known.bound,
        mean_std_error=claimed,
        coverage_95=scores.coverage(np.stack(ends, axis=1), known.truth),
        posterior_std=claimed if any(r.posterior for r in group.results) else math.nan,
    )


def write_tables(folder: Path, groups: Sequence[Group], summaries: Sequence[Summary]) -> None:
    """Write estimates and summary as CSV, numbers with as many digits as restore them."""
    names = [f.name for f in fields(Summary)]
    rows = [[getattr(s, name) for name in names] for s in summaries]
    write_file(folder / SUMMARY, _csv(names, rows))
    columns = ["scenario", "method", "replication", "outcome", "parameter", "truth", "value"]
    columns += ["std_error", "lower_95", "upper_95", "seconds"]
    write_file(folder / ESTIMATES, _csv(columns, _estimates(groups)))


def _estimates(groups: Sequence[Group]) -> Iterator[list[object]]:
    for group in groups:
        numbers = [group.numbers(index) for index in range(len(group.scenario.parameters))]
        for row, result in enumerate(group.results):
            for known, own in zip(group.scenario.parameters, numbers, strict=True):
                yield [
                    group.scenario.name,
                    group.method,
                    result.unit.replication,
                    result.outcome,
                    known.parameter,
                    known.truth,
                    *own[row].tolist(),
                    math.nan if result.seconds is None else result.seconds,
                ]


def _csv(head: Sequence[str], rows: Iterable[Sequence[object]]) -> bytes:
    """A table as CSV; NaN is an empty cell."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(head)
    writer.writerows([["" if cell != cell else cell for cell in row] for row in rows])
    return text.getvalue().encode()
