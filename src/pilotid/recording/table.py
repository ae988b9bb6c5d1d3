"""Recordings as text: a table under a header row."""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pilotid.recording.roles import Content, bare, is_unit, number_of, shown
from pilotid.support.types import FloatArray, InputError

RUN = "run"  # the column that numbers the runs of a file in long format
COMMENT = ("#", "%", "sep=", '"sep=')  # what no row begins with
NUMBER = r"\s*[-+]?[.,]?[0-9]"  # how a row of numbers begins
MORE = "..."  # behind the last name, where more columns follow than there are names
#: Lines with their numbers.
Lines = list[tuple[int, str]]


def read_table(path: Path, source: str, part: str) -> Content:
    """What a text file and its sidecar hold.

    Parameters
    ----------
    path, source
        The file, and its name in messages.
    part
        See `Content`.

    Raises
    ------
    InputError
        With the line and column of the first thing that is wrong.
    """
    from pilotid.recording.sidecar import read_sidecar

    lines, separator = _layout(_text(path))
    while len(lines) > 1 and not lines[-1][1].strip(f"{separator} \t"):
        del lines[-1]
    rows = [_cells(line, separator) for _, line in lines]
    for (number, _), row in zip(lines, rows, strict=True):
        if len(row) != len(rows[0]):
            raise InputError(
                f"{source}: line {number} has {len(row)} cells, the header {len(rows[0])}; "
                "complete or remove it, or separate cells by semicolons if decimals have commas"
            )
    header = [name.strip() for name in rows[0]]
    # Columns of one name are told apart as pandas does it: state, state.1.
    names = [f"{n}.{header[:k].count(n)}" if n in header[:k] else n for k, n in enumerate(header)]
    units = [_unit(cell) for row in rows[1:2] for cell in row]
    begin = 2 if any(units) and None not in units else 1
    numbers = [number for number, _ in lines[begin:]]
    columns = zip(names, zip(*rows, strict=True), strict=True)
    cells = {name: column[begin:] for name, column in columns}
    runs: dict[str, list[int]] = {}
    for place, run in enumerate(cells.get(RUN, [""] * len(numbers))):
        runs.setdefault(run.strip(), []).append(place)

    def arrays(name: str) -> list[FloatArray]:
        column = _column(name, cells[name], numbers, source)
        return [column[places] for places in [*runs.values()] or [[]]]

    families = {n: _family(as_read, header) for n, as_read in zip(names, header, strict=True)}
    stated = dict(zip(names, map(str, units), strict=True)) if begin == 2 else {}
    return Content("column", source, families, read_sidecar(path), arrays, part, stated)


def _family(name: str, header: Sequence[str]) -> str:
    """The name that columns of runs have in common: ``u`` of ``u_1``, if none numbers the runs."""
    match = re.fullmatch(r"(.+)_[0-9]{1,6}", bare(name)[0], re.DOTALL)
    return match[1] if match and RUN not in header else name


def _column(name: str, cells: Sequence[str], numbers: Sequence[int], source: str) -> FloatArray:
    """A column as finite numbers."""
    commas = any("," in cell for cell in cells) and not any("." in cell for cell in cells)
    values = np.array([number_of(cell.replace(",", ".") if commas else cell) for cell in cells])
    for bad in np.flatnonzero(~np.isfinite(values)).tolist():
        raise InputError(
            f"{source}: line {numbers[bad]}, column {shown(name)[1:-1]}: {shown(cells[bad])} is no "
            f"finite number with a decimal {'comma' if commas else 'point'}; repair or cut it there"
        )
    return values


def _text(path: Path) -> str:
    """The characters of a file: UTF-8, UTF-16 with a mark, or Latin-1."""
    data = path.read_bytes()
    is_wide = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        return data.decode("utf-16" if is_wide else "utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def _layout(text: str) -> tuple[Lines, str]:
    """The header and the rows, and the separator.

    Before the header there may be lines that begin with # or %, and a line ``sep=;``.  One of these
    is the header itself if numbers follow at once: the last with a name for each, or the one above
    it if that holds units.  Names that end in ``...`` stand for as many as there are columns.
    """
    lines = list(enumerate(re.split(r"\r\n|\r|\n", text), start=1))
    rows = [n for n, line in lines if line.strip() and not line.lstrip().startswith(COMMENT)]
    begin = rows[0] if rows else 1
    comments = [(n, line.strip("#% \t")) for n, line in lines[: begin - 1]]
    body = [(n, line) for n, line in lines[begin - 1 :] if not line.lstrip().startswith(COMMENT)]
    body = body or [(1, "")]
    width = len(_cells(body[0][1]))
    fits = [k for k, (_, c) in enumerate(comments) if c.endswith(MORE) or len(_cells(c)) == width]
    if re.match(NUMBER, body[0][1]) and fits:
        end = fits[-1]
        has_units = end - 1 in fits and None not in map(_unit, _cells(comments[end][1]))
        body = [*comments[end - has_units : end + 1], *body]
        number, header = body[0]
        if header.endswith(MORE):
            names = _cells(header.removesuffix(MORE))
            names += names[-1:] * (width - len(names))
            body[0] = number, _separator(header).join(names)
    return body, _separator(body[0][1])


def _cells(line: str, separator: str = "") -> list[str]:
    """The cells of a line; none where quotes are not closed."""
    separator = separator or _separator(line)
    line = line.strip() if separator == " " else line
    try:
        return next(csv.reader([line], delimiter=separator, skipinitialspace=True, strict=True), [])
    except csv.Error:
        return []


def _separator(line: str) -> str:
    """What separates the cells of a header."""
    # Spreadsheets in countries with a decimal comma separate the cells by semicolons.
    separator = max((",", ";", "\t"), key=line.count)
    return " " if separator not in line and " " in line.strip() else separator


def _unit(cell: str) -> str | None:
    """The unit in a cell of a row of units, without its brackets; None if it is none."""
    text = re.sub(r"^\[(.*)\]$|^\((.*)\)$", r"\1\2", cell.strip()).strip()
    return text if is_unit(text) and re.match(r"$|1$|-$|[^\W\d_]|[°%]", text) else None
