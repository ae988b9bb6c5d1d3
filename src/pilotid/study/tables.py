"""The tables of a store, and the checksums without which nothing in them is believed.

A row and its parts (a fit and its estimates, a scenario and its parameters) have one
checksum, and so has what a population drew for a replication; seals tell how many rows
there are and hold the sum of their checksums, so that no row can vanish unnoticed either.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing
from hashlib import blake2b
from typing import Any, NamedTuple

#: Raised when the tables change, so that an older store is refused and not misread.
FORMAT = 5

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
CREATE TABLE seals (name TEXT PRIMARY KEY, rows INTEGER, checksum INTEGER) WITHOUT ROWID;
"""
#: Of a new store: one that finds the tables, and one for each of them.
PAGES_AT_FIRST = 1 + SCHEMA.count(";")
STATEMENTS = [statement.strip() for statement in SCHEMA.split(";") if statement.strip()]
NAMES = [statement.split()[2] for statement in STATEMENTS]

Row = tuple[Any, ...]
#: Reads a table's rows in the order of its key, where a condition with its values holds.
Reader = Callable[[sqlite3.Connection, str, str, Row], list[Row]]

FIT_KEY = ("scenario", "method", "replication")
#: Tables whose rows have checksums: their keys, and the tables of their parts.
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


# Primary result codes, which are the low byte of what SQLite says.
BUSY, LOCKED = 5, 6
READ_ONLY = (3, 8, 14)  # no permission, read-only, cannot be opened
DAMAGED = (11, 26)  # malformed, no database
FULL = 13
#: What says nothing on the file's content; also no memory, interrupted, input and output.
PASSING = (BUSY, LOCKED, *READ_ONLY, FULL, 7, 9, 10)


def code_of(error: sqlite3.Error) -> int:
    """SQLite's primary result code, 0 if the error is not SQLite's own."""
    return int(getattr(error, "sqlite_errorcode", 0)) & 0xFF


class Held(NamedTuple):
    """A row with its parts, its checksum, and whether that holds."""

    row: Row
    parts: list[Row]
    checksum: Any
    whole: bool


def checksum(*content: object) -> int:
    """64 bits, with a sign as SQLite has it."""
    text = json.dumps(content, default=repr, separators=(",", ":"))
    return int.from_bytes(blake2b(text.encode(), digest_size=8).digest(), "big", signed=True)


def real(value: float | None) -> float | None:
    """A number as SQLite gives it back."""
    return None if value is None or value != value else float(value)


# ------------------------------------------------------------------------------- writing


def create(base: sqlite3.Connection) -> None:
    """Make the tables; the caller has a transaction."""
    for statement in STATEMENTS:
        base.execute(statement)
    base.executemany("INSERT INTO seals VALUES (?, 0, 0)", [(name,) for name in KEYS])
    describe(base, {"format": str(FORMAT)})


def describe(base: sqlite3.Connection, about: Mapping[str, str]) -> None:
    """Keep facts on the study; the caller has a transaction."""
    base.executemany("INSERT OR REPLACE INTO about VALUES (?, ?)", about.items())
    held = dict(base.execute("SELECT key, value FROM about"))
    base.execute("INSERT OR REPLACE INTO about VALUES (?, ?)", (CHECKSUM, _of_facts(held)))


def put(base: sqlite3.Connection, table: str, row: Row, parts: Iterable[Row] = ()) -> None:
    """Add a row with its parts unless it is known; the caller has a transaction."""
    length = len(KEYS[table]) + 1
    ordered = sorted(parts, key=lambda part: part[:length])
    own = checksum(table, row, ordered)
    new = base.execute(f"INSERT OR IGNORE INTO {table} VALUES ({_marks(row)}, ?)", (*row, own))
    if not new.rowcount:
        return
    for part in ordered:
        base.execute(f"INSERT INTO {PARTS[table]} VALUES ({_marks(part)})", part)
    _reseal(base, table, 1, own)


def drop(base: sqlite3.Connection, table: str, key: Row) -> None:
    """Remove a row with its parts if it is there; the caller has a transaction."""
    condition = " AND ".join(f"{name} = ?" for name in KEYS[table])
    found = base.execute(f"SELECT checksum FROM {table} WHERE {condition}", key).fetchone()
    if found is None:
        return
    for name in (table, *([PARTS[table]] if table in PARTS else [])):
        base.execute(f"DELETE FROM {name} WHERE {condition}", key)
    _reseal(base, table, -1, found[0])


def _reseal(base: sqlite3.Connection, table: str, rows: int, own: int) -> None:
    # SQLite has no exclusive or: it is what one of two has, less what both have.
    base.execute(
        "UPDATE seals SET rows = rows + ?1, checksum = (checksum | ?2) - (checksum & ?2) "
        "WHERE name = ?3",
        (rows, own, table),
    )


def _marks(row: Row) -> str:
    return ", ".join("?" * len(row))


# ------------------------------------------------------------------------------- reading


def all_rows(
    base: sqlite3.Connection, table: str, condition: str = "", values: Row = ()
) -> list[Row]:
    """The rows of a table in the order of its key."""
    keys = ", ".join(KEYS.get(table) or PART_KEYS[table])
    return base.execute(f"SELECT * FROM {table} {condition} ORDER BY {keys}", values).fetchall()


def readable_rows(
    base: sqlite3.Connection, table: str, condition: str = "", values: Row = ()
) -> list[Row]:
    """What can be read of a damaged table: rows before the damage, and rows behind it."""
    keys = KEYS.get(table) or PART_KEYS[table]
    found: dict[Row, Row] = {}
    for direction in ("ASC", "DESC"):
        order = ", ".join(f"{key} {direction}" for key in keys)
        try:
            for row in base.execute(f"SELECT * FROM {table} {condition} ORDER BY {order}", values):
                found[row[: len(keys)]] = row
        except (sqlite3.Error, UnicodeError):
            continue
    return sorted(found.values(), key=lambda row: [str(value) for value in row[: len(keys)]])


def with_page_one(content: bytes) -> bytes:
    """A damaged file with a new first page, which is the same in every store but for sizes.

    It holds the file's header and the tables' definitions, without which nothing is found.
    """
    with closing(sqlite3.connect(":memory:", isolation_level=None)) as base:
        create(base)
        new = bytearray(base.serialize())
    size = len(new) // PAGES_AT_FIRST
    head, rest = new[:size], content[size:]
    rest = rest[: len(rest) // size * size]
    head[28:32] = (1 + len(rest) // size).to_bytes(4, "big")
    return bytes(head) + rest


def facts(base: sqlite3.Connection) -> tuple[dict[str, str], bool]:
    """Facts on the study, and whether their checksum holds."""
    held = dict(base.execute("SELECT key, value FROM about ORDER BY key"))
    own = held.pop(CHECKSUM, None)
    return held, own == _of_facts(held)


def _of_facts(held: Mapping[str, str]) -> str:
    return str(checksum(sorted((str(k), v) for k, v in held.items() if k != CHECKSUM)))


def held(
    base: sqlite3.Connection,
    table: str,
    condition: str = "",
    values: Row = (),
    reader: Reader = all_rows,
) -> Iterator[Held]:
    """The rows of a table with their parts."""
    length = len(KEYS[table])
    heads = reader(base, table, condition, values)
    parts: dict[Row, list[Row]] = {}
    if table in PARTS:
        for part in reader(base, PARTS[table], condition, values):
            parts.setdefault(part[:length], []).append(part)
    for *columns, own in heads:
        row = tuple(columns)
        mine = parts.get(row[:length], [])
        yield Held(row, mine, own, own == checksum(table, row, mine))


def fault(base: sqlite3.Connection) -> str:
    """What is wrong with a store's file, in words; empty if nothing is."""
    try:
        base.execute("BEGIN")  # what another process writes meanwhile is not seen
        try:
            return _fault(base)
        finally:
            base.execute("ROLLBACK")
    except sqlite3.Error as error:
        if code_of(error) in PASSING:
            raise
        return str(error)
    except UnicodeError as error:  # in what SQLite says of it
        return str(error)


def _fault(base: sqlite3.Connection) -> str:
    (answer,) = base.execute("PRAGMA quick_check(1)").fetchone()
    if answer != "ok":
        return "SQLite's check fails"
    made = base.execute("SELECT name, sql FROM sqlite_master ORDER BY rootpage").fetchall()
    if made != list(zip(NAMES, STATEMENTS, strict=True)):
        return "its tables are not as they were made"
    if not facts(base)[1]:
        return "the checksum of the table about does not hold"
    seals = {name: seal for name, *seal in base.execute("SELECT * FROM seals")}
    for table in KEYS:
        rows = total = 0
        for each in held(base, table):
            if not each.whole:
                return f"a checksum in the table {table} does not hold"
            rows += 1
            total ^= each.checksum
        if seals.get(table) != [rows, total]:
            return f"rows of the table {table} are missing"
    return ""
