"""The rows of a study in a form small enough to be kept in git: compressed text.

One line of JSON for the facts, one for each scenario, method and draw, and one for all fits of
a scenario by a method, column by column, since numbers of a kind compress best side by side.
Numbers of fits are rounded to `DIGITS`, far below any Monte Carlo error; truth and bounds are
kept as they are.  Equal stores give equal bytes.
"""

from __future__ import annotations

import json
import lzma
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from pilotid.disk import require_file
from pilotid.types import InputError

#: The file, beside or in place of a store.
KEPT = "study.rows.xz"
#: Significant digits of a fit's numbers.
DIGITS = 6
#: Bytes of the file, of its rows unpacked, and of a line of these; a fit takes 100 of them.
LARGEST, UNPACKED, LONGEST_LINE = 2**27, 2**28, 2**24
#: Of the rows; that of a store may be higher.
FORMAT = 5

HEAD = {"pilotid": "rows of a study", "format": FORMAT, "digits": DIGITS}
UNREADABLE = (
    *(ValueError, TypeError, LookupError, ArithmeticError, AttributeError),
    *(EOFError, RecursionError, lzma.LZMAError),
)
CELL = 2  # columns in front of a fit's row that a line says once

Row = tuple[Any, ...]
Rows = Sequence[tuple[Row, list[Row]]]


def to_archive(about: Mapping[str, str], rows: Mapping[str, Rows]) -> bytes:
    """Facts on a study and the rows of its tables, each with its parts, as bytes."""
    lines = _lines({**about, "format": str(FORMAT)}, rows)
    text = "\n".join(json.dumps(line, separators=(",", ":")) for line in lines)
    return lzma.compress(text.encode("utf-8", "surrogateescape"), preset=6)


def from_archive(path: Path) -> tuple[dict[str, str], Iterator[tuple[str, Row, list[Row]]]]:
    """Facts on a study, and rows with the names of their tables and their parts.

    Raises
    ------
    InputError
        If the file cannot be read, is damaged, or is of another version of pilotid.
    """
    try:
        lines = _lines_in(path)
        head, about = next(lines), next(lines)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    except StopIteration:
        raise not_an_archive(path) from None
    except UNREADABLE as error:
        raise not_an_archive(path) from error
    if isinstance(head, dict) and head.get("format") not in (None, FORMAT):
        raise InputError(
            f"{path}: was written by another version of pilotid, whose tables differ; "
            "make the study again with this one"
        )
    if head != HEAD or not isinstance(about, dict):
        raise not_an_archive(path)
    return about, _rows(lines)


def not_an_archive(path: Path) -> InputError:
    """What to raise where a file is no such archive."""
    return InputError(
        f"{path}: is damaged, or holds no rows of a study; take it again from where it came"
    )


def _lines_in(path: Path) -> Iterator[Any]:
    """The lines of a file, one at a time: a small file can say that it is a large one."""
    require_file(path, LARGEST)
    left = UNPACKED
    with lzma.open(path) as stream:
        while line := stream.readline(LONGEST_LINE):
            left -= len(line)
            if left < 0 or len(line) == LONGEST_LINE:
                raise EOFError
            yield json.loads(line.decode("utf-8", "surrogateescape"))


def _lines(about: Mapping[str, str], rows: Mapping[str, Rows]) -> Iterator[object]:
    yield HEAD
    yield about
    for table in ("scenarios", "methods", "draws"):
        for row, parts in rows[table]:
            yield [table, row, parts]
    cells: dict[tuple[Row, tuple[str, ...]], list[tuple[Row, list[Row]]]] = {}
    for row, parts in rows["fits"]:
        keys = tuple(part[0] for part in parts)
        cells.setdefault((row[:CELL], keys), []).append((row, parts))
    for (cell, keys), fits in cells.items():
        columns = _columns([row[CELL:] for row, _ in fits])
        numbers = [_columns([parts[place][1:] for _, parts in fits]) for place in range(len(keys))]
        yield ["fits", cell, keys, columns, numbers]


def _columns(rows: Sequence[Row]) -> list[list[Any]]:
    return [[_rounded(value) for value in column] for column in zip(*rows, strict=True)]


def _rounded(value: Any) -> Any:
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value


def _rows(lines: Iterable[Any]) -> Iterator[tuple[str, Row, list[Row]]]:
    for table, *content in lines:
        if table != "fits":
            row, parts = content
            yield table, tuple(row), [tuple(part) for part in parts]
            continue
        cell, keys, columns, numbers = content
        estimates = [list(zip(*own, strict=True)) for own in numbers]
        for place, own in enumerate(zip(*columns, strict=True)):
            parts = [(key, *values[place]) for key, values in zip(keys, estimates, strict=True)]
            yield "fits", (*cell, *own), parts
