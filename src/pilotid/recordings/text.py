"""Recordings as text: a table with a header row, and a sidecar F.json with notes."""

from __future__ import annotations

import codecs
import csv
import json
import os
import re
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import chain, compress, islice
from pathlib import Path
from typing import Any

import numpy as np

from pilotid.recordings.contents import (
    MOST_VALUES,
    READERS,
    Contents,
    Notes,
    Parts,
    Place,
    bare,
    common_run,
    common_time,
    is_level,
    lacking,
    listed,
    matching,
    no_level,
    required,
    seconds_in,
    shown,
)
from pilotid.recordings.recording import Recording, is_unit
from pilotid.support.disk import path_shown, require_file
from pilotid.support.types import FloatArray, InputError

LARGEST_FILE = 2**30  # bytes
LARGEST_SIDECAR = 2**22
RUN = "run"  # the column that numbers the runs of a file in long format
BLOCK = 2**16  # cells that are turned into numbers at once
COMMENT = ("#", "%")
NUMBER = r"\s*[-+]?[.,]?[0-9]"  # how a row of numbers begins
MORE = "..."  # behind the last name, where more columns follow than there are names
SWAPPED = str.maketrans(",.", ".,")  # where decimals have commas
#: What is no UTF-8 and free of these bytes is taken for Latin-1.
CONTROLS = bytes(b for b in range(32) if b not in b"\t\n\v\f\r") + b"\x7f"


def sidecar_path(path: Path) -> Path:
    """The notes beside a text file: F.json for F.csv."""
    return path.with_suffix(".json")


def read_text(
    path: Path, source: str, places: Mapping[str, Place], parts: Parts, *, timed: bool
) -> Contents:
    """Read a text file and its sidecar.

    Parameters
    ----------
    path, source
        The file, and its name in messages.
    places
        Where it keeps each signal.
    parts
        Which rows of it are meant.
    timed
        Whether the sampling interval is known, so that no column of times is needed.

    Raises
    ------
    InputError
        With the line and column of the first thing that is wrong.
    OSError
        If the file cannot be read.
    """
    require_file(path, LARGEST_FILE)
    notes = read_sidecar(path)
    with path.open(encoding=_encoding(path, source), newline="") as stream:
        return read_table(stream, source, places, parts, notes, timed=timed)


def read_table(
    lines: Iterable[str],
    source: str,
    places: Mapping[str, Place],
    parts: Parts,
    notes: Notes | None = None,
    *,
    timed: bool,
) -> Contents:
    """What a table holds; see `read_text`."""
    if parts.path:
        raise InputError(
            f"{source}: a table has no part {shown(parts.path)}; choose rows by the value in a "
            "column, as in FILE::subject=3"
        )
    table = _Table(lines, source)
    levels = {table.column(name): wanted for name, wanted in parts.levels.items()}
    notes = notes or Notes()
    places = notes.with_extra(places)
    columns = {signal: _columns(table, signal, place) for signal, place in places.items()}
    found = {signal: names for signal, names in columns.items() if names}
    notes = _with_comments(notes, table.comments, timed="t" in found)
    _require(table, places, found, timed=timed or notes.dt is not None)
    needed = list(dict.fromkeys(chain.from_iterable(found.values())))
    values = dict(zip(needed, table.read(needed, levels).T, strict=True))
    signals = {
        signal: places[signal].signed(np.array([values[name] for name in names]))
        for signal, names in found.items()
    }
    time = None
    if "t" in found:
        time = signals.pop("t")[0] * seconds_in(table.unit(found["t"][0]), source)
    units = {s: unit for s, names in found.items() if s != "t" and (unit := table.unit(names[0]))}
    notes = replace(notes, units={**units, **(notes.units or {})} or None)
    origin = {signal: places[signal].shown(names) for signal, names in found.items()}
    if RUN in table.header:
        return _split_runs(table, time, signals, notes, origin)
    return Contents(time, signals, partial(_line, table.lines), notes, origin)


def _line(lines: Sequence[int], row: int) -> str:
    """The place of a row in words."""
    return f"line {lines[row]}"


def _encoding(path: Path, source: str) -> str:
    """How the characters of a file are written: UTF-8, UTF-16 or Latin-1."""
    data = path.read_bytes()
    encoding = "utf-8-sig"
    if data[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        encoding = "utf-16"
    try:
        data.decode(encoding)
    except UnicodeDecodeError as error:
        if encoding == "utf-8-sig" and len(data.translate(None, CONTROLS)) == len(data):
            return "latin-1"
        kind = "UTF-8" if encoding == "utf-8-sig" else "UTF-16"
        line = data.count(b"\n", 0, error.start) + 1
        raise InputError(
            f"{source}: line {line} is not {kind} text; save the file as CSV in UTF-8"
        ) from None
    return encoding


class _Table:
    """A table: what is needed of it becomes numbers, a block of rows at a time."""

    def __init__(self, stream: Iterable[str], source: str) -> None:
        self.source = source
        separator, self.line, lines, self.comments = _layout(iter(stream))
        if separator == " ":  # any number of them, but none at the ends
            lines = (f"{line.strip()}\n" for line in lines)
        self._rows = csv.reader(lines, delimiter=separator, skipinitialspace=True, strict=True)
        self._is_comma_separated = separator == ","
        (row,), _ = next(self._blocks(1), ([[]], []))
        self.repeated: set[str] = set()  # names of several columns, of which the first keeps it
        self.named = [name.strip() for name in row]
        self.header = self._told_apart()
        if not any(self.header):
            raise InputError(
                f"{source}: line {self.line} must be a header row with the columns t, e, u, x"
            )
        self._units: dict[str, str] = {}  # those in a row under the header
        self._has_commas: bool | None = None  # in decimals; unknown until a cell has a sign
        self.lines: list[int] = []  # on which rows start: a quoted cell may hold line breaks
        self.labels: list[str] = []  # of the runs, by rows

    def _told_apart(self) -> list[str]:
        """Names with a number where they were there before: state, state.1, as pandas has them."""
        found: list[str] = []
        for name in self.named:
            own, number = name, 0
            while own and own in found:
                number += 1
                own = f"{name}.{number}"
                self.repeated.add(name)
            found.append(own)
        return found

    def unit(self, column: str) -> str | None:
        """The unit of a column, in its name or in the row below the header; None if unsaid."""
        return bare(column)[1] or self._units.get(column)

    def _blocks(self, size: int) -> Iterator[tuple[list[list[str]], list[int]]]:
        """Some rows at once, and the lines on which they start."""
        start = self._rows.line_num + self.line
        while True:
            rows, starts = [], []
            try:
                for row in islice(self._rows, size):
                    rows.append(row)
                    starts.append(start)
                    start = self._rows.line_num + self.line
            except csv.Error as error:
                raise InputError(
                    f"{self.source}: line {start} cannot be read as comma-separated values "
                    f"({error}); correct it"
                ) from None
            if not rows:
                return
            yield rows, starts

    def column(self, name: str) -> str:
        """The column of a name, for choosing rows by it."""
        if len(found := matching(name, self.header)) != 1:
            raise InputError(
                f"{self.source}: line {self.line} has no column {shown(name)}, only "
                f"{listed(self.header)}; choose rows by one of them"
            )
        return found[0]

    def read(self, names: Sequence[str], levels: Mapping[str, str]) -> FloatArray:
        """Some columns as finite numbers, shape (rows, columns).

        Parameters
        ----------
        names
            The columns.
        levels
            Cells by column that a row must have.
        """
        index = {name: i for i, name in enumerate(self.header)}
        places = [index[name] for name in names]
        pieces = [np.zeros((0, len(names)))]
        there: dict[str, None] = {}  # cells in the columns that choose rows
        blank = 0  # the line of the first row without content: such are allowed at the end only
        for number, (rows, starts) in enumerate(self._blocks(max(1, BLOCK // len(self.header)))):
            while (
                not number
                and rows
                and (self._is_comment(rows[0]) or self._holds_units(rows[0], names, places))
            ):
                del rows[0], starts[0]
            while rows and not any(map(str.strip, rows[-1])):
                blank, _ = starts.pop(), rows.pop()
            if not rows:
                continue
            if blank and blank < starts[-1]:
                raise self._not_a_number("", blank, names[0])
            self._require_width(rows, starts)
            for name, wanted in levels.items():
                there |= dict.fromkeys(row[index[name]] for row in rows)
                kept = [is_level(row[index[name]], wanted) for row in rows]
                rows, starts = list(compress(rows, kept)), list(compress(starts, kept))
            self.lines += starts
            if len(self.lines) * len(names) > MOST_VALUES:
                raise InputError(
                    f"{self.source}: holds more than {MOST_VALUES} values, too many for a "
                    "recording; thin it out in time or leave runs out"
                )
            pieces.append(self._numbers(rows, starts, names, places))
            if RUN in index:
                self.labels += [row[index[RUN]].strip() for row in rows]
        if levels and not self.lines:
            raise no_level(self.source, *next(iter(levels.items())), there)
        return np.concatenate(pieces)

    def _is_comment(self, row: list[str]) -> bool:
        """Whether a row under the header is for people; numbers behind its sign are none."""
        if not row or row[0].lstrip()[:1] not in COMMENT:
            return False
        numbers = len(row) == len(self.header) and np.isfinite([*map(_number_or_nan, row[1:])])
        return not np.any(numbers)

    def _holds_units(self, row: list[str], names: Sequence[str], places: Sequence[int]) -> bool:
        """Whether a row under the header holds the units, which are noted then."""
        if len(row) != len(self.header):
            return False
        units = [_unit_in(row[i]) for i in places]
        if None in units or not any(units):
            return False
        self._units = {name: unit for name, unit in zip(names, units, strict=True) if unit}
        return True

    def _require_width(self, rows: list[list[str]], starts: list[int]) -> None:
        width = len(self.header)
        if {*map(len, rows)} == {width}:
            return
        cells, line = next(
            (len(r), s) for r, s in zip(rows, starts, strict=True) if len(r) != width
        )
        remedy = "complete or remove that line"
        if self._is_comma_separated and cells > width + 1:
            remedy += ", or separate cells by semicolons if decimals have commas"
        raise InputError(
            f"{self.source}: line {line} has {cells} cells but the header has {width}; {remedy}"
        )

    def _numbers(
        self, rows: list[list[str]], starts: list[int], names: Sequence[str], places: Sequence[int]
    ) -> FloatArray:
        """Some cells of rows as finite numbers."""
        cells = [row[i] for row in rows for i in places]
        signs = "".join(cells)
        if self._has_commas is None and ("," in signs or "." in signs):
            self._has_commas = signs.count(",") > signs.count(".")
        given = cells
        if self._has_commas:
            cells = [cell.translate(SWAPPED) for cell in cells]
        try:
            values = np.array(list(map(float, cells)))
            are_numbers = "_" not in signs  # Python's 1_000 is none
        except ValueError:
            are_numbers = False
        if not are_numbers:
            values = np.array([_number_or_nan(cell) for cell in cells])
        bad = ~np.isfinite(values)
        if bad.any():
            first = int(np.argmax(bad))
            row, column = divmod(first, len(names))
            raise self._not_a_number(given[first].strip(), starts[row], names[column])
        return values.reshape(len(rows), len(names))

    def _not_a_number(self, text: str, line: int, name: str) -> InputError:
        what = f"{shown(text)} is not a finite number" if text else "the cell is empty"
        remedy = "repair or cut the recording there"
        if ("." if self._has_commas else ",") in text:
            remedy = f"write a decimal {'comma' if self._has_commas else 'point'}"
        return InputError(f"{self.source}: line {line}, column {listed([name])}: {what}; {remedy}")


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
    begin = [first]
    headers = _headers(comments, first, separator) if re.match(NUMBER, first) else []
    if headers:
        header = comments[headers[0]]
        separator = separator or _separator(header)
        if header.endswith(MORE):
            name = _cells(header, separator)[-1]
            missing = len(_cells(first, separator)) - len(_cells(header, separator))
            header = header.removesuffix(MORE) + (separator + name.removesuffix(MORE)) * missing
        begin = [f"{line}\n" for line in (header, *(comments[n] for n in headers[1:]))] + [first]
        number -= len(begin) - 1
        comments = [comment for n, comment in enumerate(comments) if n not in headers]
    return separator or _separator(begin[0]), number, chain(begin, lines), comments


def _separator(line: str) -> str:
    """What separates the cells of a header."""
    # Spreadsheets in countries with a decimal comma separate the cells by semicolons.
    separator = max((",", ";", "\t"), key=line.count)
    return " " if separator not in line and " " in line.strip() else separator


def _cells(line: str, separator: str) -> list[str]:
    """The cells of a line without quotes."""
    return line.split() if separator == " " else line.strip("\r\n").split(separator)


def _headers(comments: Sequence[str], first: str, separator: str) -> list[int]:
    """Which comments above a row of numbers name its columns, and hold the units below."""

    def fits(comment: str) -> bool:
        own = separator or _separator(comment)
        return comment.endswith(MORE) or len(_cells(first, own)) == len(_cells(comment, own))

    found = [n for n, comment in enumerate(comments) if comment and fits(comment)][-2:]
    if len(found) == 2 and found[1] == found[0] + 1:
        cells = _cells(comments[found[1]], separator or _separator(comments[found[1]]))
        if None not in map(_unit_in, cells):
            return found
    return found[-1:]


def _with_comments(notes: Notes, comments: Iterable[str], *, timed: bool) -> Notes:
    """Notes with what comments such as ``dt: 0.01`` say and the sidecar does not.

    Comments are for people: what is not understood is left aside, and times count for more.
    """
    for comment in comments:
        match = re.fullmatch(r"\W*(\w+)\s*[:=]\s*(.*\S)\s*", comment)
        key = match[1].casefold() if match else ""
        if match is None or key not in READERS or key in ("runs", "extra"):
            continue
        if (key == "dt" and timed) or getattr(notes, key) is not None:
            continue
        text: object = match[2]
        with suppress(ValueError, RecursionError):
            text = json.loads(re.sub(r"(?<=[0-9])\s*(s|sec|seconds)$", "", match[2]))
        found: dict[str, Any] = {key: READERS[key][0](text)}
        notes = replace(notes, where=notes.where or "its comments", **found)
    return notes


def _unit_in(cell: str) -> str | None:
    """The unit in a cell of a row of units, without its brackets; None if it is none."""
    text = cell.strip()
    if text[:1] + text[-1:] in ("[]", "()"):
        text = text[1:-1].strip()
    if not is_unit(text) or not re.match(r"$|1$|-$|[^\W\d_]|[°%]", text):
        return None
    return None if text != "1" and np.isfinite(_number_or_nan(text)) else text


def _number_or_nan(cell: str) -> float:
    """A cell as a number, NaN if it is none."""
    try:
        return np.nan if "_" in cell else float(cell)
    except ValueError:
        return np.nan


def _columns(table: _Table, signal: str, place: Place) -> list[str]:
    """The columns of a signal: one, or one a run; none for one that is absent."""
    own = matching(place.name, table.header)
    numbered = dict[int, list[str]]()
    pattern = re.compile(re.escape(place.name) + r"_([0-9]{1,6})", re.IGNORECASE)
    for column in table.header if signal != "t" else ():
        if match := pattern.fullmatch(bare(column)[0]):
            numbered.setdefault(int(match[1]), []).append(column)
    several = [column for _, columns in sorted(numbered.items()) for column in columns]
    place_of_header = f"{table.source}: line {table.line}"
    for name in several or own:
        if name in table.repeated and (several or not place.chosen):
            pick = "" if several else f", or pick one, as in --map {signal}={name}.1"
            raise InputError(
                f"{place_of_header} has more than one column {shown(name)}; rename all but one"
                f"{pick}"
            )
    if RUN in table.repeated:
        raise InputError(f"{place_of_header} has more than one column {RUN}; rename all but one")
    if (own and several) or len(set(own)) > 1 or len(several) > len(numbered):
        raise InputError(
            f"{place_of_header} has the columns {listed(own + several)}, any of which may be "
            f"{signal}; pick one, as in --map {signal}={listed((own or several)[:1])}"
        )
    wanted = [1] if RUN in table.header else range(1, len(numbered) + 1)
    if several and sorted(numbered) != [*wanted]:
        raise InputError(
            f"{place_of_header} has the columns {listed(several)} for {signal}; number the runs "
            f"from 1 without a gap, or by a column {RUN} alone"
        )
    return own[:1] or several


def _require(
    table: _Table, places: Mapping[str, Place], found: Collection[str], *, timed: bool
) -> None:
    """Refuse a file that lacks what it must have."""
    absent = required(places, found, timed=timed)
    if not absent:
        return
    if all(np.isfinite(_number_or_nan(cell.replace(",", "."))) for cell in table.named):
        raise InputError(
            f"{table.source}: line {table.line} holds numbers but must be a header row that names "
            "the columns t, e, u, x"
        )
    raise InputError(
        f"{table.source}: line {table.line} has " + lacking(absent, places, table.header, "column")
    )


def _split_runs(
    table: _Table,
    t: FloatArray | None,
    signals: Mapping[str, FloatArray],
    notes: Notes,
    origin: Mapping[str, str],
) -> Contents:
    """The contents of a file in long format: rows with the same run number are one run."""
    runs: dict[str, list[int]] = {}
    for row, label in enumerate(table.labels):
        runs.setdefault(label, []).append(row)
    if not runs:
        return Contents(t, signals, partial(_line, table.lines), notes, origin)
    if "" in runs:
        line = table.lines[runs[""][0]]
        raise InputError(
            f"{table.source}: line {line}, column {RUN}: the cell is empty; write the number of "
            "the run"
        )
    first = next(iter(runs.values()))
    times = {
        f"run {shown(label)} from line {table.lines[own[0]]} on": (
            np.arange(float(len(own))) if t is None else t[own]
        )
        for label, own in runs.items()
    }
    time = common_time(times, table.source)
    index = np.array(list(runs.values()))
    split = {signal: values[0][index] for signal, values in signals.items()}
    where = partial(_line, [table.lines[row] for row in first])
    return Contents(None if t is None else time, split, where, notes, origin)


def read_sidecar(file: Path) -> Notes:
    """The notes beside a file; none if there are none.

    Raises
    ------
    InputError
        With the line of what is wrong in them.
    """
    path = sidecar_path(file)
    if not os.path.exists(path):
        return Notes()
    source = path_shown(path)
    require_file(path, LARGEST_SIDECAR)
    try:
        raw = json.loads(path.read_bytes().decode("utf-8-sig"), object_pairs_hook=_object)
    except UnicodeDecodeError as error:
        line = error.object.count(b"\n", 0, error.start) + 1
        raise InputError(f"{source}: line {line} is not UTF-8 text; save it in UTF-8") from None
    except json.JSONDecodeError as error:
        raise InputError(
            f"{source}: line {error.lineno} is not valid JSON ({error.msg}); correct it or remove "
            "the file"
        ) from None
    except KeyError as error:
        raise InputError(f"{source}: gives {shown(error.args[0])} twice; give it once") from None
    except (ValueError, RecursionError):  # a number of thousands of digits; brackets without end
        raise InputError(
            f"{source}: cannot be read as JSON; correct it or remove the file"
        ) from None
    return Notes.parsed(raw, source)


def _object(pairs: list[tuple[str, object]]) -> dict[str, object]:
    """An object of JSON; a `KeyError` for a key that is there twice."""
    if len(found := dict(pairs)) < len(pairs):
        raise KeyError(Counter(key for key, _ in pairs).most_common(1)[0][0])
    return found


def csv_bytes(recording: Recording, source: str) -> tuple[bytes, bytes]:
    """The CSV file of a recording, and its sidecar.

    Signals are written with as many digits as restore them to the bit.

    Raises
    ------
    InputError
        If the recording's lines or units cannot be written.
    """
    times = [f"{t:.12g}" for t in recording.time.tolist()]
    notes = Notes.of(recording, np.array([float(t) for t in times]), source)
    columns: list[tuple[str, ...]] = [("t", *times)]
    for signal in recording.signals:
        values = recording.input(signal)
        runs = values if signal in ("e", "u", "x") else common_run(values)
        for run, samples in enumerate(runs.tolist(), start=1):
            name = f"{signal}_{run}" if len(runs) > 1 else signal
            columns.append((name, *map(repr, samples)))
    text = "".join(",".join(row) + "\n" for row in zip(*columns, strict=True))
    sidecar = json.dumps(notes.plain(), indent=2, ensure_ascii=False) + "\n"
    return text.encode(), sidecar.encode()
