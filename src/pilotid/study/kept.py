"""The rows of a store in a form small enough to be kept in git: compressed text.

One line of JSON for the facts, one for each scenario, method and draw, and one for all fits of
a scenario by a method, column by column, since numbers of a kind compress best side by side.
Numbers of fits are rounded to `DIGITS`, far below any Monte Carlo error; truth and bounds are
kept as they are.  Equal stores give equal bytes.
"""

from __future__ import annotations

import json
import lzma
import sqlite3
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from pilotid.study import tables
from pilotid.study.tables import FORMAT, Row
from pilotid.types import InputError

#: The file, beside or in place of a store.
KEPT = "study.rows.xz"
#: Significant digits of a fit's numbers.
DIGITS = 6
#: Bytes that rows may take when they are unpacked; a million fits take half of it.
LARGEST = 2**30

HEAD = {"pilotid": "rows of a study", "format": FORMAT, "digits": DIGITS}
#: What comes of lines that are not as they were written.
WRONG = (ValueError, TypeError, AttributeError, KeyError, EOFError, RecursionError)
KEY = 2  # columns in front of a fit's row, and of its estimates' rows, that a line says once


def packed(base: sqlite3.Connection) -> bytes:
    """All rows of a store's tables."""
    text = "\n".join(json.dumps(line, separators=(",", ":")) for line in _lines(base))
    return lzma.compress(text.encode("utf-8", "surrogateescape"), preset=6)


def unpack(path: Path, base: sqlite3.Connection) -> None:
    """Fill the tables of a new store with rows that were kept; the caller has a transaction.

    Raises
    ------
    InputError
        If the file cannot be read, is damaged, or is of another version of pilotid.
    """
    try:
        head, about, *lines = map(json.loads, _text(path).splitlines())
        if isinstance(head, dict) and head.get("format") not in (None, FORMAT):
            raise InputError(
                f"{path}: was written by another version of pilotid, whose tables differ; "
                "make the study again with this one"
            )
        if head != HEAD:
            raise ValueError(head)
        tables.describe(base, about)
        for table, *content in lines:
            if table == "fits":
                for row, parts in _fits(*content):
                    tables.put(base, table, row, parts)
            else:
                row, parts = content
                tables.put(base, table, tuple(row), [tuple(part) for part in parts])
    except InputError:
        raise
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    except (*WRONG, lzma.LZMAError, sqlite3.Error) as error:
        raise InputError(
            f"{path}: is damaged, or holds no rows of a study; take it again from where it came"
        ) from error


def _text(path: Path) -> str:
    unpacking = lzma.LZMADecompressor()
    content = unpacking.decompress(path.read_bytes(), LARGEST)
    if not unpacking.eof:
        raise EOFError
    return content.decode("utf-8", "surrogateescape")


def _lines(base: sqlite3.Connection) -> Iterator[object]:
    yield HEAD
    yield tables.facts(base)[0]
    for table in ("scenarios", "methods", "draws"):
        for held in tables.held(base, table):
            yield [table, held.row, held.parts]
    cells: dict[tuple[Row, tuple[str, ...]], list[tuple[Row, list[Row]]]] = {}
    for held in tables.held(base, "fits"):
        keys = tuple(part[len(tables.FIT_KEY)] for part in held.parts)
        cells.setdefault((held.row[:KEY], keys), []).append((held.row, held.parts))
    for (cell, keys), fits in cells.items():
        columns = _columns([row[KEY:] for row, _ in fits])
        behind = len(tables.FIT_KEY) + 1
        numbers = [
            _columns([parts[place][behind:] for _, parts in fits]) for place in range(len(keys))
        ]
        yield ["fits", cell, keys, columns, numbers]


def _columns(rows: Sequence[Row]) -> list[list[Any]]:
    return [[_rounded(value) for value in column] for column in zip(*rows, strict=True)]


def _rounded(value: Any) -> Any:
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value


def _fits(
    cell: Sequence[str], keys: Sequence[str], columns: list[list[Any]], numbers: list[Any]
) -> Iterator[tuple[Row, list[Row]]]:
    estimates = [list(zip(*own, strict=True)) for own in numbers]
    for place, row in enumerate(zip(*columns, strict=True)):
        unit = (*cell, row[0])
        parts = [(*unit, key, *own[place]) for key, own in zip(keys, estimates, strict=True)]
        yield (*cell, *row), parts
