"""Recordings as text: a table under a header row."""

from __future__ import annotations

import codecs
import csv
import re
from collections import Counter
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

    number, rows = 1, list[list[str]]()
    try:
        lines, separator = _layout(_text(path))
        while len(lines) > 1 and not lines[-1][1].strip(f"{separator} \t"):
            del lines[-1]
        for number, line in lines:
            rows.append(_cells(line, separator))
            if len(rows[-1]) != len(rows[0]):
                raise InputError(
                    f"{source}: line {number} has {len(rows[-1])} cells but the header has "
                    f"{len(rows[0])}; complete or remove that line, or separate cells by "
                    "semicolons if decimals have commas"
                )
    except csv.Error as error:
        what = f"line {number} cannot be read as comma-separated values ({error})"
        raise InputError(f"{source}: {what}; correct it") from None
    header = [name.strip() for name in rows[0]]
    names, times_named = list[str](), Counter[str]()
    for name in header:  # told apart as pandas does it: state, state.1
        names.append(f"{name}.{times_named[name]}" if name in times_named else name)
        times_named[name] += 1
    units = [_unit(cell) for cell in rows[1]] if len(rows) > 1 else []
    begin = 2 if any(units) and None not in units else 1
    numbers, columns = [n for n, _ in lines[begin:]], [*zip(*rows[begin:], strict=True)]
    cells = dict(zip(names, columns or [()] * len(names), strict=True))
    runs: dict[str, list[int]] = {}
    for place, run in enumerate(cells.get(RUN, ())):
        runs.setdefault(run.strip(), []).append(place)
    first = next(iter(runs.values()), range(len(numbers)))
    return Content(
        "column",
        f"{source}: line {lines[0][0]}, the header",
        cells,
        {name: _family(as_read, header) for name, as_read in zip(names, header, strict=True)},
        read_sidecar(path),
        lambda name: _column(name, cells[name], numbers, source),
        units=dict(zip(names, map(str, units), strict=True)) if begin == 2 else {},
        place=lambda sample: f"line {numbers[first[sample]]}",
        runs={f"run {shown(run)} from line {numbers[at[0]]} on": at for run, at in runs.items()},
    )


def _family(name: str, header: Sequence[str]) -> str:
    """The name that columns of runs have in common: ``u`` of ``u_1``, if none numbers the runs."""
    match = re.fullmatch(r"(.+)_[0-9]{1,6}", bare(name)[0], re.DOTALL)
    return match[1] if match and RUN not in header else name


def _column(name: str, cells: Sequence[str], numbers: Sequence[int], source: str) -> FloatArray:
    """A column as finite numbers."""
    commas = any("," in cell for cell in cells) and not any("." in cell for cell in cells)
    values = np.array([number_of(cell.replace(",", ".") if commas else cell) for cell in cells])
    if (bad := np.flatnonzero(~np.isfinite(values))).size:
        cell = cells[bad[0]]
        what = f"{shown(cell)} is not a finite number" if cell else "the cell is empty"
        raise InputError(
            f"{source}: line {numbers[bad[0]]}, column {shown(name)[1:-1]}: {what}; repair or cut "
            f"the recording there, and write a decimal {'comma' if commas else 'point'}"
        )
    return values


def _text(path: Path) -> str:
    """The characters of a file: UTF-8, UTF-16 with a mark, or Latin-1."""
    data = path.read_bytes()
    if data[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        return data.decode("utf-16", "replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def _layout(text: str) -> tuple[Lines, str]:
    """The header and the rows, and the separator.

    Before the header there may be lines that begin with # or %, and a line ``sep=;``.  One of these
    is the header itself if numbers follow at once: the last with a name for each, or the one above
    it if that holds units.  Names that end in ``...`` stand for as many as there are columns.
    """
    lines = list(enumerate(re.split(r"\r\n|\r|\n", text), start=1))
    begin = next((k for k, (_, line) in enumerate(lines) if _is_row(line)), 0)
    comments = [(number, line.strip("#% \t")) for number, line in lines[:begin]]
    body = [(n, line) for n, line in lines[begin:] if not line.lstrip().startswith(COMMENT)]
    first = body[0][1] if body else ""

    def cells(line: str) -> list[str]:
        return _cells(line, _separator(line))

    width = len(cells(first))
    fits = [k for k, (_, c) in enumerate(comments) if c.endswith(MORE) or len(cells(c)) == width]
    if re.match(NUMBER, first) and fits:
        start = end = fits[-1]
        if end - 1 in fits and None not in map(_unit, cells(comments[end][1])):
            start -= 1
        number, header = comments[start]
        if header.endswith(MORE):
            names = cells(header.removesuffix(MORE))
            header = _separator(header).join([*names, *names[-1:] * (width - len(names))])
        body = [(number, header), *comments[start + 1 : end + 1], *body]
    body = body or [(1, "")]
    return body, _separator(body[0][1])


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
