"""A study's estimates and scores as CSV files."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path

from pilotid.disk import write_file
from pilotid.study.comparison import ESTIMATE_COLUMNS, SUMMARY_COLUMNS, Comparison
from pilotid.study.population import POPULATION_COLUMNS

ESTIMATES = "estimates.csv"
SUMMARY = "summary.csv"
POPULATION = "population.csv"


def write_tables(folder: Path, study: Comparison) -> None:
    """Write estimates and summary as CSV, numbers with as many digits as restore them.

    What methods did on populations has a table of its own, if there are any.
    """
    head = ["scenario", "method", *SUMMARY_COLUMNS]
    write_file(folder / SUMMARY, csv_table(head, study.summary_rows()))
    if study.populations:
        head = ["scenario", "method", *POPULATION_COLUMNS]
        write_file(folder / POPULATION, csv_table(head, study.population_rows()))
    write_file(folder / ESTIMATES, csv_table(ESTIMATE_COLUMNS, study.estimate_rows()))


def csv_table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> bytes:
    """A table as CSV; NaN is an empty cell."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(head)
    writer.writerows([["" if cell != cell else cell for cell in row] for row in rows])
    return text.getvalue().encode()
