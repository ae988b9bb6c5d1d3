"""The store of a study: one SQLite file that survives whatever stops the process.

Every fit is one transaction in write-ahead mode: what was committed is there after a
crash, and what was not is simply fitted again.  The store also keeps all that a report
needs (truth, bounds, settings, versions), so that it is made from the store alone.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import astuple
from pathlib import Path
from typing import Any

from pilotid.study.entries import MethodEntry, ParameterTruth, Result, ScenarioEntry, Unit
from pilotid.types import InputError

STORE = "study.sqlite"
#: Raised when the tables change, so that an older store is refused and not misread.
FORMAT = 2

SCHEMA = """
CREATE TABLE about (key TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE scenarios (
    name TEXT PRIMARY KEY, position INTEGER, description TEXT, model TEXT, family TEXT,
    settings TEXT, code TEXT, typed TEXT);
CREATE TABLE parameters (
    scenario TEXT, position INTEGER, parameter TEXT, unit TEXT, truth REAL, bound REAL,
    PRIMARY KEY (scenario, parameter));
CREATE TABLE methods (
    label TEXT PRIMARY KEY, position INTEGER, settings TEXT, code TEXT, typed TEXT);
CREATE TABLE fits (
    scenario TEXT, method TEXT, replication INTEGER, outcome TEXT, message TEXT,
    usable INTEGER, vaf REAL, iterations INTEGER, posterior INTEGER, seconds REAL,
    PRIMARY KEY (scenario, method, replication)) WITHOUT ROWID;
CREATE TABLE estimates (
    scenario TEXT, method TEXT, replication INTEGER, parameter TEXT,
    value REAL, std_error REAL, lower REAL, upper REAL,
    PRIMARY KEY (scenario, method, replication, parameter)) WITHOUT ROWID;
"""


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
        e = entry
        with self._transaction():
            self._base.execute(
                "INSERT OR IGNORE INTO scenarios VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
                (e.name, e.position, e.description, e.model, e.family, _json(e.settings))
                + (e.code, e.typed),
            )
            self._base.executemany(
                "INSERT OR IGNORE INTO parameters VALUES (?, ?, ?, ?, ?, ?)",
                [(e.name, i, *astuple(p)) for i, p in enumerate(e.parameters)],
            )

    def add_method(self, entry: MethodEntry) -> None:
        """Keep what a method is; one that is known already stays as it is."""
        e = entry
        self._base.execute(
            "INSERT OR IGNORE INTO methods VALUES (?, ?, ?, ?, ?)",
            (e.label, e.position, _json(e.settings), e.code, e.typed),
        )

    def forget(self, units: Iterable[Unit]) -> None:
        """Drop fits, which are then fitted again."""
        keys = [astuple(unit) for unit in units]
        with self._transaction():
            for table in ("estimates", "fits"):
                self._base.executemany(
                    f"DELETE FROM {table} WHERE scenario = ? AND method = ? AND replication = ?",
                    keys,
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

    def done(self) -> dict[Unit, str]:
        """The fits that are in the store, and how they ended."""
        rows = self._base.execute("SELECT scenario, method, replication, outcome FROM fits")
        return {Unit(*key): outcome for *key, outcome in rows}

    def scenarios(self) -> list[ScenarioEntry]:
        """The scenarios, in the order of the catalogue."""
        rows = self._base.execute(
            "SELECT name, position, description, model, settings, family, code, typed "
            "FROM scenarios ORDER BY position, name"
        ).fetchall()
        return [
            ScenarioEntry(
                name, position, words, model, json.loads(settings), self._parameters(name), *others
            )
            for name, position, words, model, settings, *others in rows
        ]

    def _parameters(self, scenario: str) -> tuple[ParameterTruth, ...]:
        rows = self._base.execute(
            "SELECT parameter, unit, truth, bound FROM parameters WHERE scenario = ? "
            "ORDER BY position",
            (scenario,),
        )
        return tuple(ParameterTruth(*row) for row in rows)

    def methods(self) -> dict[str, MethodEntry]:
        """The methods by their labels, in the order of the catalogue."""
        rows = self._base.execute("SELECT * FROM methods ORDER BY position, label")
        return {
            label: MethodEntry(label, position, json.loads(settings), *others)
            for label, position, settings, *others in rows
        }

    def results(self) -> Iterator[Result]:
        """All fits, by scenario, method and replication in the order of the catalogues."""
        order = (
            "SELECT {} FROM {} JOIN scenarios s ON s.name = t.scenario JOIN methods m "
            "ON m.label = t.method {} "
            "ORDER BY s.position, s.name, m.position, m.label, t.replication"
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


def _json(settings: Mapping[str, Any]) -> str:
    return json.dumps(settings, allow_nan=False)
