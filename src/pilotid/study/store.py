"""The store of a study: one SQLite file, to which every fit is added as soon as it is done.

It also keeps all that a report needs (truth, bounds, settings, versions), so that it is made
from the store alone.  A row and its parts (a fit and its estimates, a scenario and its
parameters) have one checksum, and the number of rows is kept, so that none is lost unnoticed.
"""

from __future__ import annotations

import json
import shutil
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from dataclasses import astuple
from pathlib import Path
from typing import Any

from pilotid import database
from pilotid.database import DamagedError, beside, checksum, damaged, in_words
from pilotid.disk import write_file
from pilotid.study.archive import KEPT, from_archive, not_an_archive, to_archive
from pilotid.study.entries import (
    Draw,
    MethodEntry,
    ParameterTruth,
    Result,
    ScenarioEntry,
    Track,
    Unit,
)
from pilotid.types import InputError

__all__ = ["FORMAT", "KEPT", "STORE", "Store", "salvage"]

STORE = "study.sqlite"
#: Raised when the tables change, so that a store of another version is refused and not misread.
FORMAT = 6
#: The same but for what they know of the number of rows.
READABLE = ("5", "6")

SCHEMA = """
CREATE TABLE about (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE scenarios (
    name TEXT PRIMARY KEY, position INTEGER, description TEXT, model TEXT, settings TEXT,
    family TEXT, code TEXT, typed TEXT, checksum INTEGER) WITHOUT ROWID;
CREATE TABLE parameters (
    scenario TEXT, parameter TEXT, position INTEGER, unit TEXT, truth REAL, bound REAL,
    PRIMARY KEY (scenario, parameter)) WITHOUT ROWID;
CREATE TABLE methods (
    label TEXT PRIMARY KEY, position INTEGER, settings TEXT, code TEXT, typed TEXT,
    checksum INTEGER) WITHOUT ROWID;
CREATE TABLE fits (
    scenario TEXT, method TEXT, replication INTEGER, outcome TEXT, message TEXT,
    usable INTEGER, vaf REAL, iterations INTEGER, posterior INTEGER, seconds REAL,
    excess REAL, remarks TEXT, tracks TEXT, checksum INTEGER,
    PRIMARY KEY (scenario, method, replication)) WITHOUT ROWID;
CREATE TABLE estimates (
    scenario TEXT, method TEXT, replication INTEGER, parameter TEXT,
    value REAL, std_error REAL, lower REAL, upper REAL,
    PRIMARY KEY (scenario, method, replication, parameter)) WITHOUT ROWID;
CREATE TABLE draws (
    scenario TEXT, replication INTEGER, model TEXT, parameters TEXT, facts TEXT,
    checksum INTEGER, PRIMARY KEY (scenario, replication)) WITHOUT ROWID;
CREATE TABLE seals (name TEXT PRIMARY KEY, rows INTEGER) WITHOUT ROWID;
"""
FIT_KEY = ("scenario", "method", "replication")
#: Tables whose rows have checksums, in the order of their keys, and the tables of their parts.
KEYS = {
    "scenarios": ("name",),
    "methods": ("label",),
    "draws": ("scenario", "replication"),
    "fits": FIT_KEY,
}
PARTS = {"scenarios": "parameters", "fits": "estimates"}
PART_KEYS = {"parameters": ("scenario", "parameter"), "estimates": (*FIT_KEY, "parameter")}
#: The row of `about` that holds the checksum of the others.
CHECKSUM = "checksum"

Row = tuple[Any, ...]
#: A row with its parts, and whether their checksum holds.
Entry = tuple[Row, list[Row], bool]
Reader = Callable[[sqlite3.Connection, str], Iterable[Row]]


class Store:
    """A study's results in a folder.

    Parameters
    ----------
    folder
        The study's folder.  Where it holds rows in their small form alone (see
        `pilotid.study.archive`), these are read, and a store that is made begins with them.
    create
        Whether to write: the store is made if there is none.  A store that is only read may be
        on a medium that cannot be written.
    small
        Whether to read the small form though there is a store.

    Attributes
    ----------
    path
        The file.
    """

    def __init__(self, folder: Path, *, create: bool = False, small: bool = False) -> None:
        self.path = folder / STORE
        self._close = database.close if create else sqlite3.Connection.close
        try:
            missing = not create and not self.path.exists()
            kept = (folder / KEPT).exists()
        except OSError:  # a folder that may not be looked into, which opening tells
            missing = kept = False
        if missing and not kept:
            raise InputError(
                f"{self.path}: there is no such file; name a folder that `pilotid compare` wrote"
            )
        if missing or small:
            self.path = folder / KEPT
            self._base = sqlite3.connect(":memory:", isolation_level=None)
            _create(self._base)
            self._restore(self.path)
            return
        opened = database.open_to_write if create else database.open_to_read
        self._base = opened(self.path)
        try:
            if create:
                with self._transaction():
                    if not self._base.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]:
                        _create(self._base)
            self._require_readable()
            if create and kept and "seed" not in self.about():
                self._restore(folder / KEPT)
            if create and self.about()["format"] != str(FORMAT):
                self.describe({"format": str(FORMAT)})  # earlier versions know other seals
        except BaseException:
            self._base.close()
            raise

    def _require_readable(self) -> None:
        """Refuse a store of another version."""
        with in_words(self.path):
            about, _ = _facts(self._base)
        if about.get("format", READABLE[0]) not in READABLE:
            raise InputError(
                f"{self.path}: was written by another version of pilotid, whose tables differ; "
                "name another folder with --out"
            )
        self.about()

    def close(self) -> None:
        """Close the file, which then holds everything."""
        self._close(self._base)

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        with in_words(self.path):
            self._base.execute("BEGIN IMMEDIATE")
            with self._base:  # commits, or rolls back if something fails
                yield

    # ----------------------------------------------------------------------------- writing

    def describe(self, about: Mapping[str, str]) -> None:
        """Keep facts on the study."""
        with self._transaction():
            _describe(self._base, about)

    def add_scenario(self, entry: ScenarioEntry) -> None:
        """Keep what a scenario is; one that is known already stays as it is."""
        e = entry
        row = (e.name, e.position, e.description, e.model, _json(e.settings))
        parts = [
            (e.name, p.parameter, place, p.unit, _real(p.truth), _real(p.bound))
            for place, p in enumerate(e.parameters)
        ]
        with self._transaction():
            _put(self._base, "scenarios", (*row, e.family, e.code, e.typed), parts)

    def add_method(self, entry: MethodEntry) -> None:
        """Keep what a method is; one that is known already stays as it is."""
        e = entry
        with self._transaction():
            row = (e.label, e.position, _json(e.settings), e.code, e.typed)
            _put(self._base, "methods", row)

    def forget(self, units: Iterable[Unit]) -> None:
        """Drop fits, which are then fitted again."""
        with self._transaction():
            _drop(self._base, map(astuple, units))

    def add(self, result: Result) -> None:
        """Keep a fit and what was drawn for it; one that is known already stays as it is.

        Raises
        ------
        InputError
            If another pilot was drawn for other fits of the replication.
        """
        r, unit = result, astuple(result.unit)
        row = (*unit, r.outcome, r.message, int(r.usable), _real(r.vaf), int(r.iterations))
        row = (*row, int(r.posterior), _real(r.seconds), _real(r.excess), r.remarks)
        row = (*row, json.dumps([astuple(track) for track in r.tracks]) if r.tracks else "")
        estimates = [(*unit, name, *map(_real, numbers)) for name, *numbers in r.estimates]
        with self._transaction():
            if r.draw is not None:
                self._add_draw(r.unit, r.draw)
            _put(self._base, "fits", row, estimates)

    def _add_draw(self, unit: Unit, draw: Draw) -> None:
        """Keep what was drawn for a replication; the caller has a transaction."""
        key = (unit.scenario, unit.replication)
        held = self._base.execute(
            "SELECT * FROM draws WHERE scenario = ? AND replication = ?", key
        ).fetchone()
        if held and not draw.same(_draw(held[:-1])):
            raise InputError(
                f"{self.path}: holds fits of another pilot for replication {unit.replication} of "
                f"{unit.scenario}, drawn by other code; name another folder with --out"
            )
        parameters = [
            [p.parameter, p.unit, _real(p.truth), _real(p.bound)] for p in draw.parameters
        ]
        row = (*key, draw.model, json.dumps(parameters), _json(draw.facts))
        _put(self._base, "draws", row)

    def keep(self, folder: Path) -> Path:
        """Write all rows in their small form into a folder; returns the file."""
        rows = {table: self._rows(table) for table in KEYS}
        path = folder / KEPT
        write_file(path, to_archive(self.about(), rows))
        return path

    def _restore(self, path: Path) -> None:
        """Fill a new store with the rows of its small form."""
        about, rows = from_archive(path)
        try:
            with self._transaction():
                _describe(self._base, {**about, "format": str(FORMAT)})
                for table, row, parts in rows:
                    _put(self._base, table, row, parts)
        except (InputError, ValueError, TypeError, KeyError) as error:
            raise not_an_archive(path) from error

    # ----------------------------------------------------------------------------- reading

    def about(self) -> dict[str, str]:
        """Facts on the study."""
        with in_words(self.path):
            held, whole = _facts(self._base)
        if not whole:
            raise damaged(self.path, "the checksum of the table about does not hold")
        return held

    def done(self) -> dict[Unit, str]:
        """The fits that are in the store, and how they ended."""
        return {Unit(*row[:3]): row[3] for row, _ in self._rows("fits")}

    def scenarios(self) -> list[ScenarioEntry]:
        """The scenarios, in the order of the catalogue."""
        entries = []
        for (name, position, words, model, settings, *others), parts in self._rows("scenarios"):
            parts = sorted(parts, key=lambda part: part[2])
            known = tuple(ParameterTruth(key, *numbers) for _, key, _, *numbers in parts)
            entries.append(
                ScenarioEntry(name, position, words, model, json.loads(settings), known, *others)
            )
        return sorted(entries, key=lambda entry: (entry.position, entry.name))

    def methods(self) -> dict[str, MethodEntry]:
        """The methods by their labels, in the order of the catalogue."""
        entries = [
            MethodEntry(label, position, json.loads(settings), *others)
            for (label, position, settings, *others), _ in self._rows("methods")
        ]
        entries.sort(key=lambda entry: (entry.position, entry.label))
        return {entry.label: entry for entry in entries}

    def results(self) -> Iterator[Result]:
        """All fits, by scenario, method and replication in the order of the catalogues."""
        scenarios, methods = self.scenarios(), list(self.methods())
        draws = self.draws()
        by_cell: dict[tuple[str, str], list[tuple[Row, list[Row]]]] = {}
        for row, parts in self._rows("fits"):
            by_cell.setdefault(row[:2], []).append((row, parts))
        for scenario in scenarios:
            for method in methods:
                for row, parts in by_cell.get((scenario.name, method), ()):
                    draw = draws.get((scenario.name, row[2]))
                    known = scenario.parameters if draw is None else draw.parameters
                    yield _result(row, parts, draw, [p.parameter for p in known])

    def draws(self) -> dict[tuple[str, int], Draw]:
        """What populations drew, by their names and the replications."""
        return {row[:2]: _draw(row) for row, _ in self._rows("draws")}

    def _rows(self, table: str) -> list[tuple[Row, list[Row]]]:
        """Rows with their parts, in the order of their keys, all of which are whole."""
        with in_words(self.path):
            self._base.execute("BEGIN")  # what another process writes meanwhile is not seen
            try:
                found = list(_entries(self._base, table))
                known = _counts(self._base).get(table)
            finally:
                self._base.execute("ROLLBACK")
        if not all(whole for *_, whole in found):
            raise damaged(self.path, f"a checksum in the table {table} does not hold")
        if known != len(found):
            raise damaged(self.path, f"rows of the table {table} are missing")
        return [(row, parts) for row, parts, _ in found]


def salvage(folder: Path) -> str:
    """Put a new store with all that is whole in the place of a damaged one; says what was lost.

    Raises
    ------
    InputError
        If nothing is whole, or the folder cannot be written.
    """
    path = folder / STORE
    try:
        with Store(folder) as store:
            list(store.results())
        return f"{store.path}: is whole, and was left as it is"
    except DamagedError:
        pass
    numbers = ("", *range(2, 10**6))
    aside = next(p for n in numbers if not (p := beside(path, f".damaged{n}")).exists())
    new = beside(path, ".new")
    with in_words(path):
        new.unlink(missing_ok=True)
        shutil.copyfile(path, aside)
        with suppress(FileNotFoundError):
            shutil.copyfile(beside(path, "-wal"), beside(aside, "-wal"))
        copy, base = database.connect(new, "rwc"), database.connect(aside, "rw")
        with closing(copy), closing(base):
            base.execute("PRAGMA writable_schema=ON")  # by which a file cut short is read too
            copy.execute("BEGIN IMMEDIATE")
            with copy:
                _create(copy)
                kept, lost = _copy_whole(base, copy)
        if not kept:
            new.unlink()
            raise InputError(
                f"{path}: holds no fit that is whole; name another folder, or compare again"
            )
        for ending in ("-wal", "-shm"):
            beside(path, ending).unlink(missing_ok=True)
        new.replace(path)
    return (
        f"{path} was damaged: {kept} fits are whole and kept, {lost} were lost; the damaged file "
        f"is {aside.name}"
    )


#: Fits without what tells their scenario, their method, or the pilot that was drawn for them.
ORPHANS = """FROM fits WHERE scenario NOT IN (SELECT name FROM scenarios)
    OR method NOT IN (SELECT label FROM methods)
    OR scenario NOT IN (SELECT scenario FROM parameters)
    AND (scenario, replication) NOT IN (SELECT scenario, replication FROM draws)"""


def _copy_whole(base: sqlite3.Connection, copy: sqlite3.Connection) -> tuple[int, int]:
    """Copy what is whole in a damaged store; returns the numbers of fits kept and lost."""
    try:
        about, whole = _facts(base)
        known = _counts(base).get("fits", 0)
    except (sqlite3.Error, TypeError, UnicodeError):
        return 0, 0
    if not whole:  # nobody knows of which seed and code the fits are
        return 0, known
    _describe(copy, {**about, "format": str(FORMAT)})
    seen = 0
    for table in KEYS:
        for row, parts, whole in _entries(base, table, _readable_rows):
            seen += table == "fits"
            if whole:
                _put(copy, table, row, parts)
    _drop(copy, copy.execute(f"SELECT scenario, method, replication {ORPHANS}").fetchall())
    kept = _counts(copy)["fits"]
    return kept, max(known, seen) - kept


# ----------------------------------------------------------------------------------- rows


def _create(base: sqlite3.Connection) -> None:
    """Make the tables; the caller has a transaction."""
    for statement in SCHEMA.split(";"):
        base.execute(statement)
    base.executemany("INSERT INTO seals VALUES (?, 0)", [(name,) for name in KEYS])
    _describe(base, {"format": str(FORMAT)})


def _describe(base: sqlite3.Connection, about: Mapping[str, str]) -> None:
    """Keep facts on the study; the caller has a transaction."""
    base.executemany("INSERT OR REPLACE INTO about VALUES (?, ?)", about.items())
    own = _checksum_of_facts(dict(base.execute("SELECT key, value FROM about")))
    base.execute("INSERT OR REPLACE INTO about VALUES (?, ?)", (CHECKSUM, own))


def _facts(base: sqlite3.Connection) -> tuple[dict[str, str], bool]:
    """Facts on the study, and whether their checksum holds."""
    held = dict(base.execute("SELECT key, value FROM about ORDER BY key"))
    return {k: v for k, v in held.items() if k != CHECKSUM}, (
        held.get(CHECKSUM) == _checksum_of_facts(held)
    )


def _checksum_of_facts(held: Mapping[str, str]) -> str:
    return str(checksum(sorted((str(k), v) for k, v in held.items() if k != CHECKSUM)))


def _put(base: sqlite3.Connection, table: str, row: Row, parts: Iterable[Row] = ()) -> None:
    """Add a row with its parts unless it is known; the caller has a transaction."""
    length = len(KEYS[table]) + 1
    ordered = sorted(parts, key=lambda part: part[:length])
    own = checksum(table, row, ordered)
    new = base.execute(f"INSERT OR IGNORE INTO {table} VALUES ({_marks(row)}, ?)", (*row, own))
    if new.rowcount:
        for part in ordered:
            base.execute(f"INSERT INTO {PARTS[table]} VALUES ({_marks(part)})", part)
        _count(base, table, 1)


def _drop(base: sqlite3.Connection, units: Iterable[Row]) -> None:
    """Remove fits that are there; the caller has a transaction."""
    for unit in units:
        which = "WHERE scenario = ? AND method = ? AND replication = ?"
        base.execute(f"DELETE FROM estimates {which}", unit)
        gone = base.execute(f"DELETE FROM fits {which}", unit)
        _count(base, "fits", -gone.rowcount)


def _marks(row: Row) -> str:
    return ", ".join("?" * len(row))


def _count(base: sqlite3.Connection, table: str, more: int) -> None:
    base.execute("UPDATE seals SET rows = rows + ? WHERE name = ?", (more, table))


def _counts(base: sqlite3.Connection) -> dict[str, int]:
    """How many rows each table should have."""
    return dict(base.execute("SELECT name, rows FROM seals"))


def _entries(base: sqlite3.Connection, table: str, reader: Reader | None = None) -> Iterator[Entry]:
    """The rows of a table with their parts."""
    read, length = reader or _all_rows, len(KEYS[table])
    parts: dict[Row, list[Row]] = {}
    if table in PARTS:
        for part in read(base, PARTS[table]):
            parts.setdefault(part[:length], []).append(part)
    for *columns, own in read(base, table):
        row = tuple(columns)
        mine = parts.get(row[:length], [])
        yield row, mine, own == checksum(table, row, mine)


def _all_rows(base: sqlite3.Connection, table: str, direction: str = "ASC") -> Iterator[Row]:
    """The rows of a table in the order of its key."""
    keys = ", ".join(f"{key} {direction}" for key in KEYS.get(table) or PART_KEYS[table])
    yield from base.execute(f"SELECT * FROM {table} ORDER BY {keys}")


def _readable_rows(base: sqlite3.Connection, table: str) -> list[Row]:
    """What can be read of a damaged table: rows before the damage, and rows behind it."""
    length = len(KEYS.get(table) or PART_KEYS[table])
    found: dict[Row, Row] = {}
    for direction in ("ASC", "DESC"):
        try:
            for row in _all_rows(base, table, direction):
                found[row[:length]] = row
        except (sqlite3.Error, UnicodeError):
            continue
    return sorted(found.values(), key=lambda row: [str(value) for value in row[:length]])


def _result(row: Row, parts: list[Row], draw: Draw | None, order: list[str]) -> Result:
    *unit, outcome, message, usable, vaf, count, posterior, seconds, excess, remarks, tracks = row
    known = [part for part in parts if part[3] in order]
    return Result(
        Unit(*unit),
        outcome,
        message,
        bool(usable),
        vaf,
        count,
        bool(posterior),
        seconds,
        tuple(part[3:] for part in sorted(known, key=lambda part: order.index(part[3]))),
        excess,
        draw,
        remarks,
        tuple(Track(*(*own, tuple(values))) for *own, values in json.loads(tracks or "[]")),
    )


def _draw(row: Row) -> Draw:
    _, _, model, parameters, facts = row
    known = tuple(ParameterTruth(*parameter) for parameter in json.loads(parameters))
    return Draw(model, known, json.loads(facts))


def _real(value: float | None) -> float | None:
    """A number as SQLite gives it back."""
    return None if value is None or value != value else float(value)


def _json(settings: Mapping[str, Any]) -> str:
    return json.dumps(settings, allow_nan=False)
