"""What files hold, by names: the columns of a text, the arrays of MATLAB, HDF5 and numpy.

MATLAB's versions 4 and 5 are read by scipy in a process of their own, which a damaged file can end;
7.3 and other HDF5 files are read by h5py.
"""

from __future__ import annotations

import atexit
import csv
import os
import pickle
import re
import sys
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from subprocess import DEVNULL, PIPE, Popen
from threading import Lock
from typing import Any, NamedTuple

import numpy as np

from pilotid.support.types import FloatArray, InputError

UNIT = re.compile(r"(.*\S)\s*(?:\[([^\[\]]*)\]|\(([^()]*[^()0-9][^()]*|1)\))", re.DOTALL)
RUN = "run"  # the column that numbers the runs of a text in long format
MORE = "..."  # behind the last name, where more columns follow than there are names
READER = """
import pickle, sys
from scipy.io import loadmat
for path in map(eval, sys.stdin):
    try:
        content = loadmat(path, simplify_cells=True)
    except Exception as error:
        content = error
    pickle.dump(content, sys.stdout.buffer)
    sys.stdout.flush()
"""
LOCK = Lock()


class Variable(NamedTuple):
    """A column of a text file, or an array.

    Attributes
    ----------
    name
        As in the file; that of a struct or group comes before, and a dot.
    family
        The name without its unit and the number of the run, which all runs of a signal share.
    unit
        Empty where none stands with it.
    run
        The number of the run, 0 where it has none.
    numbers
        Makes arrays of it: one, or one a run; what is no number is refused then.
    """

    name: str
    family: str
    unit: str
    run: int
    numbers: Callable[[], list[FloatArray]]


def listed(names: Iterable[object]) -> str:
    """Names in a file, for a message."""
    texts = [f"{name!s:.40}" for name in names]
    return ", ".join(texts[:20] + ["..."] * (len(texts) > 20)) or "none"


def is_unit(text: str) -> bool:
    """Whether a text can label an axis; a dollar sign would start a formula there."""
    return len(text) <= 40 and text.isprintable() and "$" not in text


def bare(name: str) -> tuple[str, str]:
    """A name without its unit, and the unit: ``t [s]`` and ``u (deg)`` have one."""
    match = UNIT.fullmatch(name)
    unit = (match[2] or match[3] or "").strip() if match else ""
    return (match[1], unit) if match and is_unit(unit) else (name, "")


def number_of(text: str) -> float:
    """The number in a text, NaN if it holds none."""
    try:
        return float(text)
    except ValueError:
        return np.nan


def read_table(path: Path, source: str) -> Iterator[Variable]:
    """The columns of a text file.

    Parameters
    ----------
    path, source
        The file, and its name in messages.

    Raises
    ------
    InputError
        With the line of the first thing that is wrong; columns say it when they are asked.
    """
    places, rows = zip(*_rows(_text(path)), strict=True)
    for place, row in zip(places, rows, strict=True):
        if len(row) != len(rows[0]):
            raise InputError(
                f"{source}: line {place} has {len(row)} cells, the header {len(rows[0])}; "
                "complete or remove it, or separate cells by semicolons if decimals have commas"
            )
    header = [name.strip() for name in rows[0]]
    if np.isfinite([number_of(name.replace(",", ".")) for name in header]).all():
        raise InputError(
            f"{source}: has no header row, line {places[0]} holds numbers; write the names of the "
            "columns above it, as in t,e,u,x"
        )
    units = _units(rows[1]) if len(rows) > 1 else []
    begin = 2 if units else 1
    columns = [column[begin:] for column in zip(*rows, strict=True)]
    labels = columns[header.index(RUN)] if RUN in header else [""] * len(rows[begin:])
    of_row = np.array([label.strip() for label in labels])
    runs = [of_row == label for label in dict.fromkeys(of_row.tolist())]

    def numbers(name: str, cells: Sequence[str]) -> list[FloatArray]:
        commas = any("," in cell for cell in cells) and not any("." in cell for cell in cells)
        column = np.array([number_of(cell.replace(",", ".") if commas else cell) for cell in cells])
        for bad in np.flatnonzero(~np.isfinite(column)).tolist():
            raise InputError(
                f"{source}: line {places[begin + bad]}, column {name:.40}: {cells[bad]!r:.50} is "
                f"no finite number with a decimal {'comma' if commas else 'point'}; repair or cut "
                "it there"
            )
        return [column[run] for run in runs] or [column]

    for place, (name, cells) in enumerate(zip(header, columns, strict=True)):
        family, unit = bare(name)
        numbered = None if RUN in header else re.fullmatch(r"(.+)_([0-9]{1,6})", family, re.DOTALL)
        family, run = (numbered[1], int(numbered[2])) if numbered else (family, 0)
        # Columns of one name are told apart as pandas does it: state, state.1.
        same = header[:place].count(name)
        unique = f"{name}.{same}" if same else name
        unit = unit or (units[place] if units else "")
        yield Variable(unique, family, unit, run, partial(numbers, unique, cells))


def _text(path: Path) -> str:
    """The characters of a file: UTF-8, UTF-16 or Latin-1."""
    with suppress(UnicodeDecodeError):
        return path.read_text("utf-8-sig")
    is_wide = path.read_bytes().startswith((BOM_UTF16_LE, BOM_UTF16_BE))
    return path.read_text("utf-16" if is_wide else "latin-1", errors="replace")


def _rows(text: str) -> list[tuple[int, list[str]]]:
    """The header and the rows, as cells, with the number of the line of each.

    Before the header there may be lines that begin with # or %, and a line ``sep=;``.  The last of
    these with a name for each column is the header itself if numbers follow at once.  Names that
    end in ``...`` stand for as many as there are columns.
    """
    lines = dict(enumerate(text.split("\n"), start=1))
    marks = ("#", "%", "sep=", '"sep=')
    rows = {n: line for n, line in lines.items() if not line.lstrip().startswith(marks)}
    filled = [n for n, line in rows.items() if line.strip(",; \t")]
    if not filled:
        return [(1, [""])]
    first, header = filled[0], lines[filled[0]]
    # Spreadsheets in countries with a decimal comma separate the cells by semicolons.
    separator = max(",;\t", key=header.count)
    separator = " " if separator not in header and " " in header.strip() else separator
    table = [(n, _cells(rows[n], separator)) for n in rows if first <= n <= filled[-1]]
    has_numbers = re.match(r"\s*[-+]?[.,]?[0-9]", header)
    for n in range(first - 1, 0, -1) if has_numbers else ():
        comment = lines[n].strip("#% \t")
        names = _cells(comment.removesuffix(MORE), separator)
        further = len(table[0][1]) - len(names)
        if further == 0 or comment.endswith(MORE):
            return [(0, names + names[-1:] * further), *table]
    return table


def _cells(line: str, separator: str) -> list[str]:
    """The cells of a line; none where quotes are not closed."""
    line = line.strip() if separator == " " else line
    try:
        return next(csv.reader([line], delimiter=separator, skipinitialspace=True, strict=True), [])
    except csv.Error:
        return []


def _units(row: Sequence[str]) -> list[str]:
    """The units in a row of them, without their brackets; none if it is another row."""
    units = [re.sub(r"^\[(.*)\]$|^\((.*)\)$", r"\1\2", cell.strip()).strip() for cell in row]
    are_units = all(is_unit(u) and re.match(r"$|1$|-$|[^\W\d_]|[°%]", u) for u in units)
    return units if any(units) and are_units else []


def read_arrays(path: Path, source: str) -> Iterator[Variable]:
    """The arrays in a file.

    Parameters
    ----------
    path, source
        The file, and its name in messages.

    Raises
    ------
    InputError
        If the file cannot be used.
    """
    try:
        arrays = _arrays_in(path)
    except Exception:  # what is damaged, or too large, fails in any way whatsoever
        raise InputError(
            f"{source}: is damaged, too large or no {path.suffix} file; save t, e, u, x again, in "
            "MATLAB with save -v7"
        ) from None

    runs = Counter[str]()
    for name, values in arrays.items():
        family, numbered = re.subn(r"\{[0-9]+\}", "", name)
        runs[family] += 1
        run = runs[family] if numbered else 0
        yield Variable(name, *bare(family), run, partial(list, [values]))


def _arrays_in(path: Path) -> dict[str, FloatArray]:
    """The arrays that libraries read of a file, by names."""
    if path.suffix.lower() == ".npz":
        with path.open("rb") as stream, np.load(stream) as archive:
            content = dict.fromkeys(archive.files)
            for name in content:
                with suppress(ValueError):  # an object of Python could run a program
                    content[name] = archive[name]
            return dict(_named(content, ""))
    import h5py  # when it is needed

    if h5py.is_hdf5(path):
        with h5py.File(path, "r") as file:
            return dict(_named(file, ""))
    return dict(_named(_loaded(path), ""))


def _named(value: Any, name: str) -> Iterator[tuple[str, FloatArray]]:
    """The arrays in a value; in arrays of structs and cells by names such as ``data{2}.u``."""
    if hasattr(value, "chunks"):  # a data set of h5py
        is_places = "ref" in (value.dtype.metadata or ())  # cells, fields of arrays of structs
        value = [value.file[place] for place in value[()].flat] if is_places else value[()].T
    if isinstance(value, np.ndarray) and value.dtype.kind == "O":
        value = value.ravel(order="F").tolist()
    if isinstance(value, Mapping):  # in a group with # lies what cells and objects refer to
        for key in [key for key in value if not key.startswith(("#", "__"))]:
            yield from _named(value[key], f"{name}.{key}".removeprefix("."))
    elif isinstance(value, list):
        for number, inside in enumerate(value, start=1):
            yield from _named(inside, f"{name}{{{number}}}")
    else:
        array = np.atleast_1d(value)
        is_real = array.dtype.kind in "fiub"
        yield name if is_real else f"{name}<no matrix of real numbers>", array


@cache
def _reader(owner: int) -> Any:
    """The process that reads for the one with this id; one that was forked has another."""
    command = [sys.executable, "-PWignore", "-c", READER]
    # Ctrl-C is for this process alone.
    reader = Popen(command, stdin=PIPE, stdout=PIPE, stderr=DEVNULL, process_group=0)
    atexit.register(reader.communicate)  # it ends when its input does
    return reader


def _loaded(path: Path) -> dict[str, Any]:
    """The variables that scipy reads of a file."""
    with LOCK:
        reader = _reader(os.getpid())
        try:
            reader.stdin.write(f"{str(path.absolute())!a}\n".encode())
            reader.stdin.flush()
            content: dict[str, Any] | Exception = pickle.load(reader.stdout)
        except BaseException:  # it ended on a damaged file, or its answer would be the next
            _reader.cache_clear()
            reader.kill()
            reader.communicate()
            raise
    if isinstance(content, Exception):
        raise content
    return content
