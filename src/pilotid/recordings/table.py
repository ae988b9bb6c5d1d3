"""Recordings as text: a table under a header row."""

from __future__ import annotations

import codecs
import csv
import io
import math
import re
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pilotid.recordings import roles
from pilotid.recordings.recording import is_unit
from pilotid.recordings.roles import bare, shown
from pilotid.support.disk import require_file
from pilotid.support.types import FloatArray, InputError

LARGEST_FILE = 2**30  # bytes
RUN = "run"  # the column that numbers the runs of a file in long format
COMMENT = ("#", "%")
NUMBER = r"\s*[-+]?[.,]?[0-9]"  # how a row of numbers begins
MORE = "..."  # behind the last name, where more columns follow than there are names
SWAPPED = str.maketrans(",.", ".,")  # where decimals have commas
#: What is no UTF-8 and free of these bytes is taken for Latin-1.
CONTROLS = bytes(b for b in range(32) if b not in b"\t\n\v\f\r") + b"\x7f"


def read_table(path: Path, source: str, ask: roles.Request) -> roles.Found:
    """What a text file and its sidecar hold.

    Parameters
    ----------
    path, source
        The file, and its name in messages.
    ask
        What is wanted of it.

    Raises
    ------
    InputError
        With the line and column of the first thing that is wrong.
    OSError
        If the file cannot be read.
    """
    from pilotid.recordings.sidecar import read_sidecar

    require_file(path, LARGEST_FILE)
    if ask.part:
        raise InputError(
            f"{source}: a table has no part {shown(ask.part)}; choose rows by the value in a "
            "column, as in FILE::subject=3"
        )
    separator, start, lines, comments = _layout(iter(io.StringIO(_text(path, source), newline="")))
    rows = _rows(lines, separator, start, source)
    groups: dict[str, list[str]] = {}  # columns that one name may mean
    header: list[str] = []  # names are told apart as pandas does it: state, state.1
    for name in map(str.strip, next(rows, (start, [""]))[1]):
        header.append(f"{name}.{len(groups[name])}" if name in groups else name)
        groups.setdefault(name, []).append(header[-1])
    time = roles.matching(roles.signal_places(ask.mapping)["t"].name, header)
    notes = read_sidecar(path, comments, timed=bool(time))
    places = roles.signal_places(ask.mapping, notes.extra)
    groups |= {name: [name] for name in header if name not in groups}
    for name in header if RUN not in header else ():
        if match := re.fullmatch(r"(.+)_([0-9]{1,6})", bare(name)[0], re.DOTALL):
            groups.setdefault(match[1], []).append(name)
    where = f"{source}: line {start}, the header"
    found = roles.resolved(
        places, [*groups], where, "column", timed=ask.timed or notes.dt is not None
    )
    members = {}
    for signal, group in found.items():
        own = sorted(groups[group], key=lambda name: (len(bare(name)[0]), bare(name)[0]))
        own = [group] if places[signal].chosen and group in header else own
        runs = [bare(name)[0].rpartition("_")[2] for name in own]
        if own != [group] and runs != [str(n + 1) for n in range(len(own))]:
            raise InputError(
                f"{where}: has the columns {roles.listed(own)}, any of which may be {signal}; pick "
                f"one, as in --map {signal}={own[0]}, or number runs from 1 without a gap"
            )
        members[signal] = own
    columns = list(dict.fromkeys(chain.from_iterable(members.values())))
    levels = {roles.only(name, header, where, "column"): v for name, v in ask.levels.items()}
    numbers = _numbers(rows, header, columns, levels, source)
    rows_of: dict[str, list[int]] = {}
    for row, label in enumerate(numbers.labels):
        rows_of.setdefault(label, []).append(row)
    first = next(iter(rows_of.values()), [])
    pieces: dict[str, roles.Pieces] = {
        signal: {
            f"run {shown(label)} from line {numbers.lines[run[0]]} on"
            if label
            else f"column {n}": (numbers.values[run, columns.index(n)])
            for label, run in (rows_of or {"": []}).items()
            for n in own
        }
        for signal, own in members.items()
    }
    units = {s: bare(own[0])[1] or numbers.units.get(own[0], "") for s, own in members.items()}
    return roles.Found(
        pieces, members, units, places, notes, lambda n: f"line {numbers.lines[first[n]]}"
    )


class _Numbers(NamedTuple):
    """Columns as finite numbers, shape (rows, columns), and of each row its line and its run."""

    values: FloatArray
    lines: list[int]
    labels: list[str]
    units: dict[str, str]  # by column, in a row under the header


def _numbers(
    rows: Iterable[tuple[int, list[str]]],
    header: Sequence[str],
    columns: Sequence[str],
    levels: Mapping[str, str],
    source: str,
) -> _Numbers:
    """Some columns as numbers, of those rows that have given cells."""
    index = {name: i for i, name in enumerate(header)}
    found = _Numbers(np.zeros(0), [], [], {})
    values = array("d")
    there: dict[str, dict[str, None]] = {name: {} for name in levels}
    commas: bool | None = None  # in decimals; unknown until a cell has a sign
    for line, row in rows:
        if not found.lines and row[0].lstrip()[:1] in COMMENT:
            continue
        if len(row) != len(header):
            raise InputError(
                f"{source}: line {line} has {len(row)} cells but the header has {len(header)}; "
                "complete or remove that line, or separate cells by semicolons if decimals have "
                "commas"
            )
        cells = [row[index[name]] for name in columns]
        units = [] if found.lines else [_unit(cell) for cell in cells]
        if None not in units and any(units):
            found.units.update(zip(columns, map(str, units), strict=True))
            continue
        for name in levels:
            there[name][row[index[name]]] = None
        if not all(roles.is_level(row[index[name]], level) for name, level in levels.items()):
            continue
        signs = "".join(cells)
        if commas is None and ("," in signs or "." in signs):
            commas = "." not in signs
        numbers = [_number(cell, commas) for cell in cells]
        if not all(map(math.isfinite, numbers)):
            bad = [math.isfinite(number) for number in numbers].index(False)
            what = (
                f"{shown(cells[bad])} is not a finite number" if cells[bad] else "the cell is empty"
            )
            raise InputError(
                f"{source}: line {line}, column {roles.listed([columns[bad]])}: {what}; repair or "
                f"cut the recording there, and write a decimal {'comma' if commas else 'point'}"
            )
        values.extend(numbers)
        found.lines.append(line)
        found.labels.append(row[index[RUN]].strip() if RUN in index else "")
    for name, level in levels.items():
        roles.require_level(source, name, level, there[name])
    return found._replace(values=np.array(values).reshape(-1, len(columns)))


def _rows(
    lines: Iterator[str], separator: str, start: int, source: str
) -> Iterator[tuple[int, list[str]]]:
    """The lines on which rows start, and their cells; without blank rows at the end."""
    if separator == " ":  # any number of them, but none at the ends
        lines = (f"{line.strip()}\n" for line in lines)
    reader = csv.reader(lines, delimiter=separator, skipinitialspace=True, strict=True)
    blank: list[tuple[int, list[str]]] = []
    line = start
    try:
        for row in reader:
            blank.append((line, row))
            if any(map(str.strip, row)):
                yield from blank
                blank = []
            line = start + reader.line_num
    except csv.Error as error:
        raise InputError(
            f"{source}: line {line} cannot be read as comma-separated values ({error}); correct it"
        ) from None


def _text(path: Path, source: str) -> str:
    """The characters of a file: UTF-8, UTF-16 with a mark, or Latin-1."""
    data = path.read_bytes()
    marked = data[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
    try:
        return data.decode("utf-16" if marked else "utf-8-sig")
    except UnicodeDecodeError as error:
        if not marked and len(data.translate(None, CONTROLS)) == len(data):
            return data.decode("latin-1")
        line = data.count(b"\n", 0, error.start) + 1
        raise InputError(
            f"{source}: line {line} is no text in UTF-8 or UTF-16; save the file as CSV in UTF-8"
        ) from None


def _layout(lines: Iterator[str]) -> tuple[str, int, Iterator[str], list[str]]:
    """The separator, the number of the header's line, the lines from there on, and comments.

    Before the header there may be a line ``sep=;`` and lines that begin with # or %.  One of these
    is the header itself if numbers follow at once: the last with a name for each, or the one above
    it if that holds units.  Names that end in ``...`` stand for as many as there are columns.
    """
    separator, number, comments = "", 1, list[str]()
    first = next(lines, "")
    if match := re.fullmatch(r'"?sep=([,;\t ])"?\s*', first, re.IGNORECASE):
        separator, first, number = match[1], next(lines, ""), 2
    while first and (first.lstrip()[:1] in COMMENT or (comments and not first.strip())):
        comments.append(first.strip("#% \t\r\n"))
        first, number = next(lines, ""), number + 1

    def cells(line: str) -> list[str]:
        own = separator or _separator(line)
        return line.split() if own == " " else line.strip("\r\n").split(own)

    width = len(cells(first))
    fits = [n for n, c in enumerate(comments) if c and (c.endswith(MORE) or len(cells(c)) == width)]
    if not (re.match(NUMBER, first) and fits):
        return separator or _separator(first), number, chain([first], lines), comments
    start = end = fits[-1]
    if end - 1 in fits and None not in map(_unit, cells(comments[end])):
        start -= 1
    header = comments[start]
    separator = separator or _separator(header)
    if header.endswith(MORE):
        missing = width - len(cells(header))
        header = (
            header.removesuffix(MORE) + (separator + cells(header)[-1].removesuffix(MORE)) * missing
        )
    begin = [f"{line}\n" for line in (header, *comments[start + 1 : end + 1])] + [first]
    return (
        separator,
        number - len(begin) + 1,
        chain(begin, lines),
        comments[:start] + comments[end + 1 :],
    )


def _separator(line: str) -> str:
    """What separates the cells of a header."""
    # Spreadsheets in countries with a decimal comma separate the cells by semicolons.
    separator = max((",", ";", "\t"), key=line.count)
    return " " if separator not in line and " " in line.strip() else separator


def _unit(cell: str) -> str | None:
    """The unit in a cell of a row of units, without its brackets; None if it is none."""
    match = re.fullmatch(r"\[(.*)\]|\((.*)\)|(.*)", cell.strip(), re.DOTALL)
    text = next((part.strip() for part in match.groups() if part), "") if match else ""
    return text if is_unit(text) and re.match(r"$|1$|-$|[^\W\d_]|[°%]", text) else None


def _number(cell: str, commas: bool | None = False) -> float:
    """A cell as a number, NaN if it is none."""
    try:
        # Python takes 1_000 for a number.
        return math.nan if "_" in cell else float(cell.translate(SWAPPED) if commas else cell)
    except ValueError:
        return math.nan
