"""Recordings as text: a table under a header row."""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pilotid.recording.recording import is_unit
from pilotid.recording.roles import Content, bare, shown
from pilotid.support.disk import require_file
from pilotid.support.types import FloatArray, InputError

LARGEST_FILE = 2**30  # bytes
RUN = "run"  # the column that numbers the runs of a file in long format
COMMENT = ("#", "%")
NUMBER = r"\s*[-+]?[.,]?[0-9]"  # how a row of numbers begins
MORE = "..."  # behind the last name, where more columns follow than there are names
#: Lines with their numbers.
Lines = list[tuple[int, str]]


def read_table(path: Path, source: str) -> Content:
    """What a text file and its sidecar hold.

    Parameters
    ----------
    path, source
        The file, and its name in messages.

    Raises
    ------
    InputError
        With the line and column of the first thing that is wrong.
    """
    from pilotid.recording.sidecar import read_sidecar

    require_file(path, LARGEST_FILE)
    text, rows, number = _text(path, source), list[list[str]](), 1
    try:
        body, separator = _layout(text)
        while len(body) > 1 and not body[-1][1].strip(f"{separator} \t"):
            del body[-1]
        for number, line in body:  # noqa: B007  (the message names it)
            rows.append(_cells(line, separator))
    except csv.Error as error:
        what = f"line {number} cannot be read as comma-separated values ({error})"
        raise InputError(f"{source}: {what}; correct it") from None
    header: list[str] = []  # names are told apart as pandas does it: state, state.1
    families: dict[str, dict[str, int]] = {}  # columns that one name may mean
    for place, name in enumerate(map(str.strip, rows[0] or [""])):
        header.append(f"{name}.{len(families[name])}" if name in families else name)
        families.setdefault(name, {})[header[-1]] = place
    families |= {name: {name: n} for n, name in enumerate(header) if name not in families}
    for place, name in enumerate(header if RUN not in header else ()):
        if match := re.fullmatch(r"(.+)_([0-9]{1,6})", bare(name)[0], re.DOTALL):
            families.setdefault(match[1], {})[name] = place
    units = [_unit(cell) for cell in rows[1]] if len(rows) > 1 else []
    begin = 2 if any(units) and None not in units else 1
    where = f"{source}: line {body[0][0]}, the header"
    numbers, rows = [number for number, _ in body[begin:]], rows[begin:]
    for number, row in zip(numbers, rows, strict=True):
        if len(row) != len(header):
            raise InputError(
                f"{source}: line {number} has {len(row)} cells but the header has {len(header)}; "
                "complete or remove that line, or separate cells by semicolons if decimals have "
                "commas"
            )
    runs: dict[str, list[int]] = {}
    for n, row in enumerate(rows if RUN in header else ()):
        runs.setdefault(row[header.index(RUN)].strip(), []).append(n)
    lines = next(iter(runs.values()), range(len(rows)))
    return Content(
        families,
        {},
        read_sidecar(path),
        lambda name, place: _column(name, [row[place] for row in rows], numbers, source),
        where,
        "column",
        dict(zip(header, map(str, units), strict=False)) if begin == 2 else {},
        lambda sample: f"line {numbers[lines[sample]]}",
        {f"run {shown(run)} from line {numbers[own[0]]} on": own for run, own in runs.items()},
    )


def _column(name: str, cells: Sequence[str], numbers: Sequence[int], source: str) -> FloatArray:
    """A column as finite numbers."""
    commas = any("," in cell for cell in cells) and not any("." in cell for cell in cells)
    values = np.array([_number(cell.replace(",", ".") if commas else cell) for cell in cells])
    if (bad := np.flatnonzero(~np.isfinite(values))).size:
        cell = cells[bad[0]]
        what = f"{shown(cell)} is not a finite number" if cell else "the cell is empty"
        raise InputError(
            f"{source}: line {numbers[bad[0]]}, column {shown(name)[1:-1]}: {what}; repair or cut "
            f"the recording there, and write a decimal {'comma' if commas else 'point'}"
        )
    return values


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return np.nan


def _text(path: Path, source: str) -> str:
    """The characters of a file: UTF-8, UTF-16 with a mark, or Latin-1."""
    data = path.read_bytes()
    marked = data[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
    try:
        return data.decode("utf-16" if marked else "utf-8-sig")
    except UnicodeDecodeError as error:
        if not marked and b"\0" not in data:
            return data.decode("latin-1")
        line = data.count(b"\n", 0, error.start) + 1
        raise InputError(
            f"{source}: line {line} is no text in UTF-8 or UTF-16; save the file as CSV in UTF-8"
        ) from None


def _layout(text: str) -> tuple[Lines, str]:
    """The header and the rows, and the separator.

    Before the header there may be a line ``sep=;`` and lines that begin with # or %.  One of these
    is the header itself if numbers follow at once: the last with a name for each, or the one above
    it if that holds units.  Names that end in ``...`` stand for as many as there are columns.
    """
    lines = list(enumerate(re.split(r"\r\n|\r|\n", text), start=1))
    marked = re.fullmatch(r'"?sep=([,;\t ])"?\s*', lines[0][1], re.IGNORECASE)
    separator, lines = (marked[1], lines[1:]) if marked else ("", lines)
    begin = next((k for k, (_, line) in enumerate(lines) if _is_row(line)), 0)
    comments = [(number, line.strip("#% \t")) for number, line in lines[:begin]]
    body = [(n, line) for n, line in lines[begin:] if not line.lstrip().startswith(COMMENT)]
    first = body[0][1] if body else ""

    def cells(line: str) -> list[str]:
        return _cells(line, separator or _separator(line))

    width = len(cells(first))
    fits = [k for k, (_, c) in enumerate(comments) if c.endswith(MORE) or len(cells(c)) == width]
    if re.match(NUMBER, first) and fits:
        start = end = fits[-1]
        if end - 1 in fits and None not in map(_unit, cells(comments[end][1])):
            start -= 1
        number, header = comments[start]
        separator = separator or _separator(header)
        if header.endswith(MORE):
            names = cells(header.removesuffix(MORE))
            header = separator.join([*names, *names[-1:] * (width - len(names))])
        body = [(number, header), *comments[start + 1 : end + 1], *body]
    return body or [(1, "")], separator or _separator(body[0][1])


def _is_row(line: str) -> bool:
    return bool(line.strip()) and not line.lstrip().startswith(COMMENT)


def _cells(line: str, separator: str) -> list[str]:
    """The cells of a line."""
    line = line.strip() if separator == " " else line
    return next(csv.reader([line], delimiter=separator, skipinitialspace=True, strict=True), [])


def _separator(line: str) -> str:
    """What separates the cells of a header."""
    # Spreadsheets in countries with a decimal comma separate the cells by semicolons.
    separator = max((",", ";", "\t"), key=line.count)
    return " " if separator not in line and " " in line.strip() else separator


def _unit(cell: str) -> str | None:
    """The unit in a cell of a row of units, without its brackets; None if it is none."""
    text = re.sub(r"^\[(.*)\]$|^\((.*)\)$", r"\1\2", cell.strip()).strip()
    return text if is_unit(text) and re.match(r"$|1$|-$|[^\W\d_]|[°%]", text) else None
