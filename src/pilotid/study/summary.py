"""A study's estimates and scores as CSV files."""

from __future__ import annotations

from pathlib import Path

from pilotid.disk import table_bytes, write_file
from pilotid.study.comparison import ESTIMATE_COLUMNS, SUMMARY_COLUMNS, TRACK_COLUMNS, Comparison
from pilotid.study.population import POPULATION_COLUMNS

ESTIMATES = "estimates.csv"
SUMMARY = "summary.csv"
POPULATION = "population.csv"
TRAJECTORIES = "trajectories.csv"


def write_tables(folder: Path, study: Comparison) -> None:
    """Write estimates and summary as CSV, numbers with as many digits as restore them.

    What methods did on populations has a table of its own, and so have trajectories, if there
    are any.
    """
    head = ["scenario", "method", *SUMMARY_COLUMNS]
    write_file(folder / SUMMARY, table_bytes(head, study.summary_rows()))
    if study.populations:
        head = ["scenario", "method", *POPULATION_COLUMNS]
        write_file(folder / POPULATION, table_bytes(head, study.population_rows()))
    tracks = list(study.track_rows())
    if tracks:
        head = ["scenario", "method", *TRACK_COLUMNS]
        write_file(folder / TRAJECTORIES, table_bytes(head, tracks))
    write_file(folder / ESTIMATES, table_bytes(ESTIMATE_COLUMNS, study.estimate_rows()))
