"""The store of a study: one SQLite file, to which every fit is added as soon as it is done.

It also keeps all that a report needs (truth, bounds, settings, versions), so that it is made
from the store alone.  Its rows are JSON: a row and its parts (a fit and its estimates, a scenario
and its parameters), with a checksum.  The number of rows of each kind is kept, so that none is
lost unnoticed.
"""

from __future__ import annotations

import json
import os
import shutil
import sqlite3
from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from dataclasses import astuple
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from pilotid import database
from pilotid.database import DamagedError, beside, checksum, damaged, in_words
from pilotid.disk import write_file
from pilotid.study.archive import KEPT, UNREADABLE, Row, from_archive, not_an_archive, to_archive
from pilotid.study.entries import (
    Draw,
    MethodEntry,
    ParameterTruth,
    Result,
    ScenarioEntry,
    Unit,
)
from pilotid.types import InputError

__all__ = ["FORMAT", "KEPT", "STORE", "Store", "salvage"]

STORE = "study.sqlite"
#: Raised when the rows change, so that a store of another version is refused and not misread.
FORMAT = 7
SCHEMA = (
    """CREATE TABLE rows (kind TEXT, key TEXT, content TEXT, checksum INTEGER,
        PRIMARY KEY (kind, key)) WITHOUT ROWID""",
    "CREATE TABLE counts (kind TEXT PRIMARY KEY, rows INTEGER) WITHOUT ROWID",
    *database.TRIGGERS,
    f"PRAGMA user_version = {FORMAT}",
)
#: How many columns of a row are its key, by kind.
#: Tables of earlier formats, 5 and 6; those of parts, and the columns that say whose they are.
EARLIER = {"about", "scenarios", "parameters", "methods", "draws", "fits", "estimates"}
PARTS = {"scenarios": ("parameters", 0), "fits": ("estimates", 3)}
KINDS = {"about": 0, "scenarios": 1, "methods": 1, "draws": 2, "fits": 3}


Num = float | None
Parameter = tuple[str, str, float, Num]


class Entry(NamedTuple):
    """A row and its parts."""

    row: Row
    parts: list[Row]


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
        missing = not create and not os.path.exists(self.path)
        kept = os.path.exists(folder / KEPT)
        if missing and not kept:
            raise InputError(
                f"{self.path}: there is no such file; name a folder that `pilotid compare` wrote"
            )
        if missing or small:
            self.path = folder / KEPT
            self._base = _temporary()
            self._restore(self.path)
            return
        opened = database.open_to_write if create else database.open_to_read
        self._base = opened(self.path)
        try:
            if create:
                with self._transaction():
                    if not self._base.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]:
                        _create(self._base)
            with in_words(self.path):
                (version,) = self._base.execute("PRAGMA user_version").fetchone()
            if version != FORMAT:
                self._base = self._of_other_format(version, create)
            if "seed" not in self.about() and create and kept:
                self._restore(folder / KEPT)
        except BaseException:
            self._base.close()
            raise

    def _of_other_format(self, version: int, create: bool) -> sqlite3.Connection:
        """The rows of a store that an earlier version wrote, in this version's form."""
        old = self._base
        with in_words(self.path):
            names = {name for (name,) in old.execute("SELECT name FROM sqlite_master")}
            if version > FORMAT:
                raise InputError(
                    f"{self.path}: was written by a later version of pilotid (format {version}; "
                    f"this one reads up to {FORMAT}); install that version"
                )
            if create or not names >= EARLIER:
                raise InputError(
                    f"{self.path}: was written by an earlier version of pilotid, or holds nothing; "
                    "`pilotid report` reads it: name another folder with --out to compare again"
                )
            new = _temporary()
            facts = dict(old.execute("SELECT key, value FROM about").fetchall())
            _describe(new, {k: v for k, v in facts.items() if k not in ("format", "checksum")})
            for kind in ("scenarios", "methods", "draws", "fits"):
                parts: dict[Row, list[Row]] = {}
                length, table, start = KINDS[kind], *PARTS.get(kind, ("", 0))
                for part in old.execute(f"SELECT * FROM {table}") if table else ():
                    parts.setdefault(part[:length], []).append(part[start:])
                for *row, _ in old.execute(f"SELECT * FROM {kind}"):
                    _put(new, kind, tuple(row), parts.get(tuple(row[:length]), ()))
        old.close()
        return new

    def close(self) -> None:
        """Close the file, which then holds everything."""
        self._base.close()

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
            _describe(self._base, {**dict(self._rows("about")[0].row), **about})

    def add_scenario(self, entry: ScenarioEntry) -> None:
        """Keep what a scenario is; one that is known already stays as it is."""
        e = entry
        row = (e.name, e.position, e.description, e.model, _json(e.settings))
        parts = [
            (e.name, p.parameter, place, p.unit, p.truth, p.bound)
            for place, p in enumerate(e.parameters)
        ]
        with self._transaction():
            _put(self._base, "scenarios", (*row, e.family, e.code, e.typed), parts)

    def add_method(self, entry: MethodEntry) -> None:
        """Keep what a method is; one that is known already stays as it is."""
        e = entry
        with self._transaction():
            _put(self._base, "methods", (e.label, e.position, _json(e.settings), e.code, e.typed))

    def forget(self, units: Iterable[Unit]) -> None:
        """Drop fits, which are then fitted again."""
        with self._transaction():
            keys = [(_key(astuple(unit)),) for unit in units]
            self._base.executemany("DELETE FROM rows WHERE kind = 'fits' AND key = ?", keys)

    def add(self, result: Result) -> None:
        """Keep a fit and what was drawn for it; one that is known already stays as it is.

        Raises
        ------
        InputError
            If another pilot was drawn for other fits of the replication.
        """
        r = result
        row = (*astuple(r.unit), r.outcome, r.message, int(r.usable), r.vaf, int(r.iterations))
        row = (*row, int(r.posterior), r.seconds, r.excess, r.remarks, "")
        with self._transaction():
            if r.draw is not None:
                self._add_draw(r.unit, r.draw)
            _put(self._base, "fits", row, r.estimates)

    def _add_draw(self, unit: Unit, draw: Draw) -> None:
        """Keep what was drawn for a replication; the caller has a transaction."""
        key = (unit.scenario, unit.replication)
        held = self._base.execute(
            "SELECT content FROM rows WHERE kind = 'draws' AND key = ?", (_key(key),)
        ).fetchone()
        if held and not draw.same(_draw(_loaded(held[0])[0])):
            raise InputError(
                f"{self.path}: holds fits of another pilot for replication {unit.replication} of "
                f"{unit.scenario}, drawn by other code; name another folder with --out"
            )
        parameters = json.dumps([astuple(p) for p in draw.parameters])
        _put(self._base, "draws", (*key, draw.model, parameters, _json(draw.facts)))

    def keep(self, folder: Path) -> Path:
        """Write all rows in their small form into a folder; returns the file."""
        rows = {kind: self._rows(kind) for kind in KINDS if kind != "about"}
        path = folder / KEPT
        write_file(path, to_archive(self.about(), rows))
        return path

    def _restore(self, path: Path) -> None:
        """Fill a new store with the rows of its small form."""
        about, rows = from_archive(path)
        try:
            with self._transaction():
                _describe(self._base, about)
                for kind, row, parts in rows:
                    _put(self._base, kind, row, parts)
        except (InputError, *UNREADABLE) as error:
            raise not_an_archive(path) from error

    # ----------------------------------------------------------------------------- reading

    def about(self) -> dict[str, str]:
        """Facts on the study."""
        return dict(sorted({**dict(self._rows("about")[0].row), "format": str(FORMAT)}.items()))

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
                ScenarioEntry(name, position, words, model, _loaded(settings), known, *others)
            )
        return sorted(entries, key=lambda entry: (entry.position, entry.name))

    def methods(self) -> dict[str, MethodEntry]:
        """The methods by their labels, in the order of the catalogue."""
        entries = [
            MethodEntry(label, position, _loaded(settings), *others)
            for (label, position, settings, *others), _ in self._rows("methods")
        ]
        entries.sort(key=lambda entry: (entry.position, entry.label))
        return {entry.label: entry for entry in entries}

    def results(self) -> Iterator[Result]:
        """All fits, by scenario, method and replication in the order of the catalogues."""
        scenarios, methods = {e.name: e for e in self.scenarios()}, list(self.methods())
        draws, places = self.draws(), {name: place for place, name in enumerate(scenarios)}
        held = [e for e in self._rows("fits") if e.row[0] in places and e.row[1] in methods]
        held.sort(key=lambda e: (places[e.row[0]], methods.index(e.row[1]), e.row[2]))
        for row, parts in held:
            draw = draws.get((row[0], row[2]))
            known = (draw or scenarios[row[0]]).parameters
            yield _result(row, parts, draw, [p.parameter for p in known])

    def draws(self) -> dict[tuple[str, int], Draw]:
        """What populations drew, by their names and the replications."""
        return {row[:2]: _draw(row) for row, _ in self._rows("draws")}

    def _rows(self, kind: str) -> list[Entry]:
        """Rows of a kind with their parts, in the order of their keys, all of which are whole."""
        with in_words(self.path):  # one statement, which sees nothing of what others write
            found = self._base.execute(
                "SELECT key, content, checksum, counts.rows FROM counts LEFT JOIN rows USING (kind)"
                " WHERE kind = ?",
                (kind,),
            ).fetchall()
        if not found:
            raise damaged(self.path, f"it lacks the number of rows of {kind}")
        count = found[0][3]
        found = [row[:3] for row in found if row[0] is not None]
        if any(own != checksum(kind, *content) for *content, own in found):
            raise damaged(self.path, f"a checksum of {kind} does not hold")
        if count != len(found):
            raise damaged(self.path, f"rows of {kind} are missing")
        try:
            return sorted(_checked(kind, content) for _, content, _ in found)
        except (ValueError, TypeError, RecursionError) as error:
            raise damaged(self.path, f"rows of {kind} are none") from error


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


def _copy_whole(base: sqlite3.Connection, copy: sqlite3.Connection) -> tuple[int, int]:
    """Copy what is whole in a damaged store; returns the numbers of fits kept and lost.

    Fits without what tells their scenario, their method, or the pilot that was drawn for them
    are lost too, and all are where nobody knows of which seed and code they are.
    """
    found: dict[str, dict[Row, Entry]] = {kind: {} for kind in KINDS}
    known, seen = 0, set()
    for direction in ("ASC", "DESC"):  # rows before the damage, and rows behind it
        with suppress(sqlite3.Error, UnicodeError):
            query = f"SELECT * FROM rows ORDER BY kind {direction}, key {direction}"
            for kind, key, content, own in base.execute(query):
                seen |= {key} if kind == "fits" else set()
                if kind in found and own == checksum(kind, key, content):
                    entry = _entry(content)
                    found[kind][entry.row[: KINDS[kind]]] = entry
    with suppress(sqlite3.Error, UnicodeError):
        known = sum(n for _, n in base.execute("SELECT * FROM counts WHERE kind = 'fits'"))
    fits = {
        key: entry
        for key, entry in found["fits"].items()
        if found["about"]
        and key[1:2] in found["methods"]
        and (scenario := found["scenarios"].get(key[:1]))
        and (scenario.parts or (key[0], key[2]) in found["draws"])
    }
    if found["about"]:
        _describe(copy, dict(found["about"][()].row))
    for kind in ("scenarios", "methods", "draws"):
        for entry in found[kind].values():
            _put(copy, kind, *entry)
    for entry in fits.values():
        _put(copy, "fits", *entry)
    return len(fits), max(known, len(seen)) - len(fits)


# ----------------------------------------------------------------------------------- rows


def _temporary() -> sqlite3.Connection:
    """A store of its own for rows from elsewhere, which leaves the memory where they are many."""
    base = sqlite3.connect("", isolation_level=None)
    _create(base)
    return base


def _create(base: sqlite3.Connection) -> None:
    """Make the tables; the caller has a transaction."""
    for statement in SCHEMA:
        base.execute(statement)
    base.executemany("INSERT INTO counts VALUES (?, 0)", [(kind,) for kind in KINDS])
    _describe(base, {})


def _describe(base: sqlite3.Connection, about: Mapping[str, str]) -> None:
    """Keep facts on the study in place of those before; the caller has a transaction."""
    base.execute("DELETE FROM rows WHERE kind = 'about'")
    _put(base, "about", tuple(about.items()))


def _put(base: sqlite3.Connection, kind: str, row: Row, parts: Iterable[Row] = ()) -> None:
    """Add a row with its parts unless it is known; the caller has a transaction."""
    key, content = _key(row[: KINDS[kind]]), json.dumps([row, sorted(parts, key=lambda p: p[:2])])
    values = (kind, key, content, checksum(kind, key, content))
    base.execute("INSERT OR IGNORE INTO rows VALUES (?, ?, ?, ?)", values)


def _key(columns: Row) -> str:
    return json.dumps(columns)


@cache
def _adapter(kind: str) -> Any:
    """Checks a row and its parts, in the types that they are written in."""
    from pydantic import Json, TypeAdapter

    row: Any = tuple  # of which types are made here, as pydantic is imported here
    several: Any = list
    settings, drawn, none = Json[dict[str, Any]], Json[list[Parameter]], row[()]
    words = (str, str, str)
    entry, parts = {
        "about": (row[row[str, str], ...], none),
        "scenarios": (
            row[str, int, str, str, settings, *words],
            row[str, str, int, str, float, Num],
        ),
        "methods": (row[str, int, settings, str, str], none),
        "draws": (row[str, int, str, drawn, settings], none),
        "fits": (
            row[str, str, int, str, str, int, Num, int, int, Num, Num, str, str],
            row[str, Num, Num, Num, Num],
        ),
    }[kind]
    return TypeAdapter[Any](row[entry, several[parts]])


def _checked(kind: str, content: str) -> Entry:
    """A row and its parts of the types that they should have."""
    _adapter(kind).validate_json(content)
    entry = _entry(content)
    if kind == "about":
        _require_facts(dict(entry.row))
    return entry


def _require_facts(facts: Mapping[str, str]) -> None:
    """Refuse facts that a report could not read, with a ValueError."""
    for key, value in facts.items():
        if key.startswith("remnant ratio "):
            float(value)


def _entry(content: str) -> Entry:
    row, parts = _loaded(content)
    return Entry(tuple(row), [tuple(part) for part in parts])


def _result(row: Row, parts: list[Row], draw: Draw | None, order: list[str]) -> Result:
    *unit, outcome, message, usable, vaf, count, posterior, seconds, excess, remarks, _ = row
    known = [part for part in parts if part[0] in order]
    estimates = tuple(sorted(known, key=lambda part: order.index(part[0])))
    head = Unit(*unit), outcome, message, bool(usable), vaf, count, bool(posterior), seconds
    return Result(*head, estimates, excess, draw, remarks)


def _draw(row: Row) -> Draw:
    _, _, model, parameters, facts = row
    known = tuple(ParameterTruth(*parameter) for parameter in _loaded(parameters))
    return Draw(model, known, _loaded(facts))


def _loaded(text: str) -> Any:
    """Plain objects; a whole number that no float holds becomes one that is about as large."""
    return json.loads(text, parse_int=lambda d: int(d) if len(d) < 17 else float(d))


def _json(settings: Mapping[str, Any]) -> str:
    return json.dumps(settings, allow_nan=False)
