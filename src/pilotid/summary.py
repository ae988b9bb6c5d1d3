"""Scores of a comparison: as CSV, as tables and as a report in Markdown."""

from __future__ import annotations

import csv
import io
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pilotid import scores
from pilotid.estimate import Outcome
from pilotid.files import write_file
from pilotid.study import Row, bound, cell, write_estimates

if TYPE_CHECKING:
    from rich.table import Table

REPORT = "report.md"
USABLE = {outcome.slug for outcome in Outcome if outcome.usable}


@dataclass(frozen=True)
class Summary:
    """Scores of one parameter by one method; the fields are the columns of the CSV file."""

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


def summarise(rows: Sequence[Row]) -> list[Summary]:
    """Scores for each scenario, method and parameter, in order of appearance."""
    groups: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.scenario, row.method, row.parameter), []).append(row)
    return [_scored(*key, group) for key, group in groups.items()]


def _scored(scenario: str, method: str, parameter: str, rows: list[Row]) -> Summary:
    truth = rows[0].truth
    used = [row for row in rows if row.outcome in USABLE]
    values = np.array([row.value for row in used])
    intervals = np.array([(row.lower_95, row.upper_95) for row in used]).reshape(-1, 2)
    bias = scores.bias(values, truth)
    return Summary(
        scenario,
        method,
        parameter,
        n=len(used),
        failures=len(rows) - len(used),
        truth=truth,
        bias=bias,
        bias_se=scores.bias_std_error(values),
        bias_percent=100.0 * bias / truth if truth else math.nan,
        std=scores.spread(values),
        rmse=scores.rmse(values, truth),
        crlb=bound(scenario, parameter),
        mean_std_error=scores.mean(np.array([row.std_error for row in used])),
        coverage_95=scores.coverage(intervals, truth),
        posterior_std=math.nan,
    )


COLUMNS = ("method", "parameter", "n", "failed", "truth", "bias %", "+- %", "std %")
CLAIMS = ("claimed std %", "bound %", "coverage 95 %")


def _cells(summary: Summary) -> list[str]:
    def percent(value: float) -> str:
        return f"{100.0 * value / abs(summary.truth):.1f}" if math.isfinite(value) else "-"

    return [
        summary.method,
        summary.parameter,
        str(summary.n),
        str(summary.failures),
        f"{summary.truth:.4g}",
        percent(summary.bias * math.copysign(1.0, summary.truth)),
        percent(summary.bias_se),
        percent(summary.std),
        percent(summary.mean_std_error),
        percent(summary.crlb),
        f"{summary.coverage_95:.2f}" if math.isfinite(summary.coverage_95) else "-",
    ]


def _by_scenario(summaries: Sequence[Summary]) -> Iterator[tuple[str, list[Summary]]]:
    for scenario, group in groupby(summaries, key=lambda s: s.scenario):
        yield scenario, list(group)


def summary_tables(summaries: Sequence[Summary]) -> Iterator[Table]:
    """A table for the terminal for each scenario."""
    from pilotid.output import make_table

    for scenario, group in _by_scenario(summaries):
        table = make_table()
        table.title = f"scenario {scenario}"
        table.title_justify = "left"
        for i, name in enumerate(COLUMNS + CLAIMS):
            table.add_column(name, justify="left" if i < 2 else "right", no_wrap=True)
        for i, summary in enumerate(group):
            last = i + 1 == len(group) or group[i + 1].method != summary.method
            table.add_row(*_cells(summary), end_section=last)
        yield table


def report_text(rows: Sequence[Row], summaries: Sequence[Summary]) -> str:
    """The report in Markdown."""
    parts = [
        "# Comparison of methods on simulated recordings\n",
        "Percentages are of the true value. bias: mean error, with its Monte Carlo standard "
        "error beside it; std: scatter of the estimates; claimed std: mean of the standard "
        "errors that the method itself reports; bound: the least standard deviation of any "
        "unbiased method (Cramer-Rao); coverage: share of its 95 % intervals that hold "
        "the truth. Failed fits are counted and left out.\n",
    ]
    for scenario, group in _by_scenario(summaries):
        count = len({row.replication for row in rows if row.scenario == scenario})
        parts.append(f"## {scenario}: {count} recordings\n")
        parts.append(_markdown([COLUMNS + CLAIMS, *map(_cells, group)]))
        parts += _failures([row for row in rows if row.scenario == scenario])
    return "\n".join(parts)


def _markdown(lines: Sequence[Sequence[str]]) -> str:
    head, *body = [f"| {' | '.join(line)} |" for line in lines]
    rule = f"| --- | --- |{' ---: |' * (len(lines[0]) - 2)}"
    return "\n".join([head, rule, *body]) + "\n"


def _failures(rows: Sequence[Row]) -> list[str]:
    sentences = {outcome.slug: outcome.value for outcome in Outcome}
    fits = {(row.method, row.replication): row.outcome for row in rows}
    counts = Counter((method, outcome) for (method, _), outcome in fits.items())
    return [
        f"- {method}, {count} of {sum(m == method for m, _ in fits)} fits: "
        f"{sentences.get(outcome, outcome)}\n"
        for (method, outcome), count in counts.items()
        if outcome != Outcome.CONVERGED.slug
    ]


def write_results(folder: Path, rows: Sequence[Row], summaries: Sequence[Summary]) -> Path:
    """Write the files of a comparison; returns the path of the report."""
    names = [f.name for f in fields(Summary)]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    writer.writerows([cell(getattr(s, name)) for name in names] for s in summaries)
    write_estimates(folder, rows)
    write_file(folder / "summary.csv", text.getvalue().encode())
    write_file(folder / REPORT, report_text(rows, summaries).encode())
    return folder / REPORT
