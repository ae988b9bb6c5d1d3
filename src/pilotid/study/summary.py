"""A study's estimates and scores as CSV files."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from pilotid.disk import write_file
from pilotid.study.comparison import Comparison

ESTIMATES = "estimates.csv"
SUMMARY = "summary.csv"
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


def write_tables(folder: Path, study: Comparison) -> None:
    """Write estimates and summary as CSV, numbers with as many digits as restore them."""
    head = ["scenario", "method", *SUMMARY_COLUMNS]
    write_file(folder / SUMMARY, _csv(head, summary_rows(study)))
    write_file(folder / ESTIMATES, _csv(ESTIMATE_COLUMNS, estimate_rows(study)))


def summary_rows(study: Comparison) -> Iterator[list[object]]:
    """Scenario, method and `SUMMARY_COLUMNS` of every parameter in every cell."""
    for cell in study.cells:
        for score in cell.scores:
            numbers = [getattr(score, name) for name in SUMMARY_COLUMNS.values()]
            yield [cell.scenario.name, cell.method, *numbers]


def estimate_rows(study: Comparison) -> Iterator[list[object]]:
    """`ESTIMATE_COLUMNS` of every parameter in every fit."""
    for cell in study.cells:
        for row, result in enumerate(cell.results):
            for known, own in zip(cell.scenario.parameters, cell.numbers, strict=True):
                yield [
                    cell.scenario.name,
                    cell.method,
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
