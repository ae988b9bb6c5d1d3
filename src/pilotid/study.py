"""Scenarios x methods x replications: where truth meets estimate."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, fields
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from pilotid.datasets import scenario_named, simulate
from pilotid.datasets.scenarios import SCENARIOS
from pilotid.datasets.spectra import spectra
from pilotid.estimate import identify
from pilotid.files import write_file
from pilotid.fits import parameters
from pilotid.methods import method_named
from pilotid.randomness import fit_rng, recording_rng
from pilotid.theory import bounds
from pilotid.types import InputError

#: Scenarios and replications of each, by name of the profile.
PROFILES: dict[str, tuple[tuple[str, ...], int]] = {
    "quick": (("nominal",), 20),
    "full": (tuple(SCENARIOS), 100),
}
ESTIMATES = "estimates.csv"


@dataclass(frozen=True)
class Unit:
    """One fit: a method on one replication of a scenario."""

    scenario: str
    method: str
    replication: int
    seed: int


@dataclass(frozen=True)
class Row:
    """One parameter of one fit beside its truth; the fields are the columns of the CSV file."""

    scenario: str
    method: str
    replication: int
    outcome: str
    parameter: str
    truth: float
    value: float
    std_error: float
    lower_95: float
    upper_95: float
    seconds: float


def units_of(
    scenarios: Sequence[str], methods: Sequence[str], replications: int, seed: int
) -> list[Unit]:
    """All fits of a comparison, in the order of their rows."""
    return [
        Unit(scenario, method, replication, seed)
        for scenario in scenarios
        for method in methods
        for replication in range(replications)
    ]


def run_unit(unit: Unit) -> list[Row]:
    """Simulate, identify, and set the estimate beside the truth."""
    scenario = scenario_named(unit.scenario)
    recording = simulate(scenario, recording_rng(unit.seed, unit.scenario, unit.replication))
    rng = fit_rng(unit.seed, unit.method, unit.scenario, unit.replication)
    estimate = identify(method_named(unit.method), recording, scenario.model, rng)
    return [
        Row(
            unit.scenario,
            unit.method,
            unit.replication,
            estimate.outcome.slug,
            q.key,
            float(truth),
            q.value,
            q.std_error,
            q.lower,
            q.upper,
            estimate.seconds,
        )
        for q, truth in zip(parameters(estimate), scenario.values, strict=True)
    ]


def run_units(units: Sequence[Unit], workers: int | None = None) -> Iterator[list[Row]]:
    """The rows of each unit, in the order of the units.

    Parameters
    ----------
    units
        What to run.
    workers
        Number of processes; None for one for each processor.  All work is done in them,
        even by a single one, so that the numbers are the same for any number.
    """
    with (
        _one_thread_each(),
        ProcessPoolExecutor(workers or os.cpu_count(), mp_context=get_context("spawn")) as pool,
    ):
        yield from pool.map(run_unit, units)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Processes started meanwhile use one thread each in linear algebra.

    They read these variables when they import numpy, before any code of ours runs.
    """
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value


def bound(scenario: str, parameter: str) -> float:
    """Cramer-Rao bound on a parameter's standard deviation, NaN where nothing is known of it.

    It is that of the whole record with the remnant's spectrum known: the floor under every
    unbiased method.  Rows read from a file may name scenarios that this version lacks.
    """
    return _bounds(scenario).get(parameter, float("nan"))


@lru_cache(maxsize=64)
def _bounds(scenario: str) -> dict[str, float]:
    if scenario not in SCENARIOS:
        return {}
    known = SCENARIOS[scenario]
    deviations = np.sqrt(np.diag(bounds(spectra(known)).full))
    return dict(zip(known.model.keys, deviations.tolist(), strict=True))


def make_folder(folder: Path) -> None:
    """Make the folder of the results."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{folder}: cannot be made ({error.strerror}); name another folder with --out"
        ) from error


def write_estimates(folder: Path, rows: Sequence[Row]) -> None:
    """Write the rows as CSV, numbers with as many digits as restore them."""
    names = [f.name for f in fields(Row)]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    for row in rows:
        writer.writerow([cell(getattr(row, name)) for name in names])
    write_file(folder / ESTIMATES, text.getvalue().encode())


def cell(value: str | float) -> str:
    """A cell of a CSV file; empty for NaN."""
    return "" if value != value else str(value)


def read_estimates(folder: Path) -> list[Row]:
    """The rows that `write_estimates` wrote."""
    path = folder / ESTIMATES
    try:
        lines = list(csv.reader(path.read_text(encoding="utf-8").splitlines()))
    except (OSError, UnicodeDecodeError):
        raise InputError(
            f"{path}: cannot be read; name a folder that `pilotid compare` wrote"
        ) from None
    names = [f.name for f in fields(Row)]
    if not lines or lines[0] != names:
        raise InputError(f"{path}: line 1 must be {','.join(names)}; run `pilotid compare` again")
    rows = []
    for number, line in enumerate(lines[1:], start=2):
        try:
            scenario, method, replication, outcome, parameter, *numbers = line
            values = [float(text) if text else float("nan") for text in numbers]
            rows.append(Row(scenario, method, int(replication), outcome, parameter, *values))
        except (ValueError, TypeError):
            raise InputError(
                f"{path}: line {number} is not a row of {len(names)} cells as `pilotid compare` "
                "writes it; run that again"
            ) from None
    return rows
