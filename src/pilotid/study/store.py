"""The store of a study: one SQLite file that survives whatever stops the process.

Every fit is one transaction in write-ahead mode: what was committed is there after a
crash, and what was not is simply fitted again.  The store also keeps all that a report
needs (truth, bounds, settings, versions), so that it is made from the store alone.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import astuple, dataclass
from pathlib import Path

from pilotid.types import InputError

STORE = "study.sqlite"
#: Raised when the tables change, so that an older store is refused and not misread.
FORMAT = 1

SCHEMA = """
CREATE TABLE about (key TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE scenarios (
    name TEXT PRIMARY KEY, position INTEGER, description TEXT, model TEXT, details TEXT);
CREATE TABLE parameters (
    scenario TEXT, position INTEGER, parameter TEXT, unit TEXT, truth REAL, bound REAL,
    PRIMARY KEY (scenario, parameter));
CREATE TABLE methods (name TEXT PRIMARY KEY, position INTEGER, label TEXT);
CREATE TABLE fits (
    scenario TEXT, method TEXT, replication INTEGER, outcome TEXT, message TEXT,
    usable INTEGER, vaf REAL, iterations INTEGER, posterior INTEGER, seconds REAL,
    PRIMARY KEY (scenario, method, replication)) WITHOUT ROWID;
CREATE TABLE estimates (
    scenario TEXT, method TEXT, replication INTEGER, parameter TEXT,
    value REAL, std_error REAL, lower REAL, upper REAL,
    PRIMARY KEY (scenario, method, replication, parameter)) WITHOUT ROWID;
"""


@dataclass(frozen=True)
class Unit:
    """One fit: a method on one replication of a scenario."""

    scenario: str
    method: str
    replication: int


@dataclass(frozen=True)
class Result:
    """What a fit gave; numbers are None where there are none.

    Attributes
    ----------
    unit
        What was fitted.
    outcome, message, usable
        How it ended, and whether the estimate counts.
    vaf, iterations, seconds
        See `pilotid.estimates.estimate.Estimate`.
    posterior
        Whether the standard errors are those of a posterior distribution.
    estimates
        Parameter, value, standard error and the interval's ends.
    """

    unit: Unit
    outcome: str
    message: str = ""
    usable: bool = False
    vaf: float | None = None
    iterations: int = 0
    posterior: bool = False
    seconds: float | None = None
    estimates: tuple[tuple[str, float | None, float | None, float | None, float | None], ...] = ()


@dataclass(frozen=True)
class ParameterTruth:
    """True value of a scenario's parameter and the Cramer-Rao bound on its deviation."""

    parameter: str
    unit: str
    truth: float
    bound: float | None


@dataclass(frozen=True)
class ScenarioEntry:
    """A scenario as the store knows it."""

    name: str
    position: int
    description: str
    model: str
    details: str
    parameters: tuple[ParameterTruth, ...]


class Store:
    """A study's results in a folder.

    Parameters
    ----------
    folder
        The study's folder.
    create
        Whether to make the store if there is none.
    """

    def __init__(self, folder: Path, *, create: bool = False) -> None:
        self.path = folder / STORE
        if not create and not self.path.exists():
            raise InputError(
                f"{self.path}: there is no such file; name a folder that `pilotid compare` wrote"
            )
        try:
            # Autocommit: every transaction below is opened and closed by name.
            self._base = sqlite3.connect(self.path, isolation_level=None, timeout=60.0)
            self._base.execute("PRAGMA journal_mode=WAL")
            self._base.execute("PRAGMA synchronous=NORMAL")
            self._prepare()
        except sqlite3.Error as error:
            raise InputError(
                f"{self.path}: is no store of results or cannot be written ({error}); "
                "name another folder with --out"
            ) from error

    def _prepare(self) -> None:
        with self._transaction():
            known = self._base.execute("SELECT name FROM sqlite_master WHERE type='table'")
            if not known.fetchall():
                for statement in SCHEMA.split(";"):
                    self._base.execute(statement)
                self.describe({"format": str(FORMAT)})
        if self.about().get("format") != str(FORMAT):
            raise InputError(
                f"{self.path}: was written by another version of pilotid, whose tables differ; "
                "name another folder with --out"
            )

    def close(self) -> None:
        """Close the file; the write-ahead log is merged into it."""
        self._base.close()

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        self._base.execute("BEGIN IMMEDIATE")
        with self._base:  # commits, or rolls back if something fails
            yield

    # ----------------------------------------------------------------------------- writing

    def describe(self, about: Mapping[str, str]) -> None:
        """Keep facts on the study."""
        self._base.executemany("INSERT OR REPLACE INTO about VALUES (?, ?)", about.items())

    def add_scenario(self, entry: ScenarioEntry) -> None:
        """Keep what a scenario is; one that is known already stays as it is."""
        with self._transaction():
            self._base.execute(
                "INSERT OR IGNORE INTO scenarios VALUES (?, ?, ?, ?, ?)", astuple(entry)[:5]
            )
            self._base.executemany(
                "INSERT OR IGNORE INTO parameters VALUES (?, ?, ?, ?, ?, ?)",
                [(entry.name, i, *astuple(p)) for i, p in enumerate(entry.parameters)],
            )

    def add_method(self, name: str, position: int, label: str) -> None:
        """Keep a method's settings."""
        self._base.execute(
            "INSERT OR IGNORE INTO methods VALUES (?, ?, ?)", (name, position, label)
        )

    def add(self, result: Result) -> None:
        """Keep a fit; one that is known already stays as it is."""
        unit = astuple(result.unit)
        with self._transaction():
            new = self._base.execute(
                "INSERT OR IGNORE INTO fits VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
                (
                    *unit,
                    result.outcome,
                    result.message,
                    result.usable,
                    result.vaf,
                    result.iterations,
                    result.posterior,
                    result.seconds,
                ),
            )
            if new.rowcount:
                self._base.executemany(
                    "INSERT INTO estimates VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
                    [(*unit, *numbers) for numbers in result.estimates],
                )

    # ----------------------------------------------------------------------------- reading

    def about(self) -> dict[str, str]:
        """Facts on the study."""
        return dict(self._base.execute("SELECT key, value FROM about ORDER BY key"))

    def done(self) -> set[Unit]:
        """The fits that are in the store."""
        return {
            Unit(*row)
            for row in self._base.execute("SELECT scenario, method, replication FROM fits")
        }

    def scenarios(self) -> list[ScenarioEntry]:
        """The scenarios, in the order of the catalogue."""
        entries = self._base.execute("SELECT * FROM scenarios ORDER BY position, name").fetchall()
        return [
            ScenarioEntry(name, position, description, model, details, self._parameters(name))
            for name, position, description, model, details in entries
        ]

    def _parameters(self, scenario: str) -> tuple[ParameterTruth, ...]:
        rows = self._base.execute(
            "SELECT parameter, unit, truth, bound FROM parameters WHERE scenario = ? "
            "ORDER BY position",
            (scenario,),
        )
        return tuple(ParameterTruth(*row) for row in rows)

    def methods(self) -> dict[str, str]:
        """The methods' settings by name, in the order of the catalogue."""
        return dict(self._base.execute("SELECT name, label FROM methods ORDER BY position, name"))

    def results(self) -> Iterator[Result]:
        """All fits, by scenario, method and replication in the order of the catalogues."""
        order = (
            "SELECT {} FROM {} JOIN scenarios s ON s.name = t.scenario JOIN methods m "
            "ON m.name = t.method {} ORDER BY s.position, s.name, m.position, m.name, t.replication"
        )
        columns = "t.scenario, t.method, t.replication, "
        numbers = self._base.execute(
            order.format(
                columns + "t.parameter, t.value, t.std_error, t.lower, t.upper",
                "estimates t",
                "JOIN parameters p ON p.scenario = t.scenario AND p.parameter = t.parameter",
            )
            + ", p.position"
        )
        by_unit: dict[tuple[str, str, int], list[tuple[object, ...]]] = {}
        for scenario, method, replication, *rest in numbers:
            by_unit.setdefault((scenario, method, replication), []).append(tuple(rest))
        fits = self._base.execute(
            order.format(
                columns
                + "t.outcome, t.message, t.usable, t.vaf, t.iterations, t.posterior, t.seconds",
                "fits t",
                "",
            )
        )
        for (
            scenario,
            method,
            replication,
            outcome,
            message,
            usable,
            vaf,
            count,
            posterior,
            s,
        ) in fits:
            key = (scenario, method, replication)
            yield Result(
                Unit(*key),
                outcome,
                message,
                bool(usable),
                vaf,
                count,
                bool(posterior),
                s,
                tuple(by_unit.get(key, ())),  # type: ignore[arg-type]
            )
