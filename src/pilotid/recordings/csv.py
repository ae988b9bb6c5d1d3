"""Recordings as CSV with an optional sidecar F.json."""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pilotid.recordings.contents import Contents, Notes, common_run
from pilotid.recordings.names import NAMES, REQUIRED, UNEVENNESS, Place, listed, shown, time_base
from pilotid.recordings.recording import SIGNALS, Recording
from pilotid.types import FloatArray, InputError

RUN = "run"  # the column that numbers the runs of a file in long format


def sidecar_path(path: Path) -> Path:
    """The notes beside a CSV file: F.json for F.csv."""
    return path.with_suffix(".json")


def read_csv(path: Path, source: str, places: Mapping[str, Place]) -> Contents:
    """Read a CSV file and its sidecar.

    Raises
    ------
    InputError
        With the line and column of the first thing that is wrong.
    OSError
        If the file cannot be read.
    """
    table = _read_table(path, source)
    sidecar = sidecar_path(path)
    notes = _read_sidecar(sidecar) if sidecar.exists() else Notes()
    columns = {signal: _columns(table, signal, place) for signal, place in places.items()}
    time = table.numbers(columns["t"][0])
    signals = {
        signal: places[signal].signed(np.array([table.numbers(name) for name in names]))
        for signal, names in columns.items()
        if names and signal != "t"
    }
    if RUN not in table.header:
        where = table.where(range(len(time)))
        return Contents(places["t"].signed(time), signals, where, notes)
    for signal, names in columns.items():
        if len(names) > 1:
            raise InputError(
                f"{source}: line 1 has a {RUN} column and also columns {names[0]}, {names[1]} for "
                f"{signal}; number the runs in one way only"
            )
    return _split_runs(table, places["t"].signed(time), signals, notes)


@dataclass(frozen=True)
class _Table:
    """The cells of a file by column, and the line of each row."""

    source: str
    header: list[str]
    columns: list[tuple[str, ...]]
    lines: list[int]

    def cells(self, name: str) -> tuple[str, ...]:
        if self.header.count(name) > 1:
            raise InputError(
                f"{self.source}: line 1 has more than one column {shown(name)}; rename all but one"
            )
        return self.columns[self.header.index(name)]

    def where(self, rows: Sequence[int]) -> Callable[[int], str]:
        """A function that puts the place of the i-th of some rows into words."""
        return lambda i: f"line {self.lines[rows[i]]}"

    def numbers(self, name: str) -> FloatArray:
        """A column as finite numbers, shape (rows,)."""
        cells = self.cells(name)
        try:
            values = np.array([float(cell) for cell in cells])
        except ValueError:
            values = np.array([_number_or_nan(cell) for cell in cells])
        bad = ~np.isfinite(values)
        if bad.any():
            row = int(np.argmax(bad))
            text = cells[row].strip()
            what = f"{shown(text)} is not a finite number" if text else "the cell is empty"
            remedy = "write a decimal point" if "," in text else "repair or cut the recording there"
            raise InputError(
                f"{self.source}: line {self.lines[row]}, column {listed([name])}: {what}; {remedy}"
            )
        return values


def _number_or_nan(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return np.nan


def _decoded(path: Path, source: str) -> str:
    try:
        return path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = error.object.count(b"\n", 0, error.start) + 1
        raise InputError(
            f"{source}: line {line} is not UTF-8 text; save the file as CSV in UTF-8"
        ) from None


def _read_table(path: Path, source: str) -> _Table:
    text = _decoded(path, source)
    first = text.partition("\n")[0]
    # Spreadsheets in countries with a decimal comma separate the cells by semicolons.
    separator = ";" if ";" in first and "," not in first else ","
    reader = csv.reader(
        io.StringIO(text, newline=""), delimiter=separator, skipinitialspace=True, strict=True
    )
    rows: list[list[str]] = []
    lines = [1]  # on which each row starts: a quoted cell may hold line breaks
    try:
        for row in reader:
            rows.append(row)
            lines.append(reader.line_num + 1)
    except csv.Error as error:
        raise InputError(
            f"{source}: line {lines[-1]} cannot be read as comma-separated values ({error}); "
            "correct it"
        ) from None
    while rows and not any(cell.strip() for cell in rows[-1]):
        rows.pop()
    header = [name.strip() for name in rows[0]] if rows else []
    if not any(header):
        raise InputError(f"{source}: line 1 must be a header row with the columns t, e, u, x")
    for row, line in zip(rows, lines, strict=False):
        if len(row) != len(header):
            raise InputError(
                f"{source}: line {line} has {len(row)} cells but the header has {len(header)}; "
                "complete or remove that line"
            )
    body = rows[1:]
    columns: list[tuple[str, ...]] = list(zip(*body, strict=True)) or [()] * len(header)
    return _Table(source, header, columns, lines[1 : len(rows)])


def _columns(table: _Table, signal: str, place: Place) -> list[str]:
    """The columns of a signal: one, or one a run, or none for an absent optional signal."""
    name, numbered = place.name, dict[int, str]()
    for column in table.header if signal != "t" else ():
        if match := re.fullmatch(re.escape(name) + r"_([0-9]{1,6})", column):
            numbered[int(match[1])] = column
    if name in table.header and numbered:
        raise InputError(
            f"{table.source}: line 1 has the column {shown(name)} and also "
            f"{listed(numbered.values())} for {signal}; rename what is not meant"
        )
    if name in table.header:
        return [name]
    if numbered and sorted(numbered) != list(range(1, len(numbered) + 1)):
        raise InputError(
            f"{table.source}: line 1 has the columns {listed(numbered.values())} for {signal}; "
            "number the runs from 1 without a gap"
        )
    if not numbered and (signal in REQUIRED or place.chosen):
        raise _missing(table, signal, name)
    return [numbered[run] for run in sorted(numbered)]


def _missing(table: _Table, signal: str, name: str) -> InputError:
    if all(np.isfinite(_number_or_nan(cell)) for cell in table.header):
        return InputError(
            f"{table.source}: line 1 holds numbers but must be a header row that names the "
            "columns t, e, u, x"
        )
    return InputError(
        f"{table.source}: line 1 has no column {shown(name)} for {signal} ({NAMES[signal]}), only "
        f"{listed(table.header)}; name the right one with --map {signal}=COLUMN"
    )


def _split_runs(
    table: _Table, t: FloatArray, signals: Mapping[str, FloatArray], notes: Notes
) -> Contents:
    """The contents of a file in long format: rows with the same run number are one run."""
    rows: dict[str, list[int]] = {}
    for row, label in enumerate(table.cells(RUN)):
        if not label.strip():
            raise InputError(
                f"{table.source}: line {table.lines[row]}, column {RUN}: the cell is empty; "
                "write the number of the run"
            )
        rows.setdefault(label.strip(), []).append(row)
    labels = list(rows)
    if not labels:
        return Contents(t, signals, table.where([]), notes)
    first = rows[labels[0]]
    for label, own in rows.items():
        if len(own) != len(first):
            raise InputError(
                f"{table.source}: run {shown(label)}, which starts on line {table.lines[own[0]]}, "
                f"has {len(own)} rows but run {shown(labels[0])} has {len(first)}; cut all runs to "
                "the same length"
            )
        base = time_base(t[own], table.source, table.where(own))
        apart = np.abs(t[own] - t[first]) > UNEVENNESS * base.dt
        if apart.any():
            line = table.lines[own[int(np.argmax(apart))]]
            raise InputError(
                f"{table.source}: the time on line {line} differs from that of run "
                f"{shown(labels[0])}; give every run the same times"
            )
    index = np.array(list(rows.values()))
    split = {signal: values[0][index] for signal, values in signals.items()}
    return Contents(t[first], split, table.where(first), notes)


def _read_sidecar(path: Path) -> Notes:
    source = str(path)
    try:
        raw = json.loads(_decoded(path, source))
    except json.JSONDecodeError as error:
        raise InputError(
            f"{source}: line {error.lineno} is not valid JSON ({error.msg}); correct it or remove "
            "the file"
        ) from None
    except InputError:
        raise
    except (ValueError, RecursionError):  # a number of thousands of digits; brackets without end
        raise InputError(
            f"{source}: cannot be read as JSON; correct it or remove the file"
        ) from None
    return Notes.parsed(raw, source)


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
    for signal in SIGNALS:
        values: FloatArray | None = getattr(recording, signal)
        if values is None:
            continue
        runs = common_run(values) if signal in ("ft", "fd") else values
        for run, samples in enumerate(runs.tolist(), start=1):
            name = f"{signal}_{run}" if len(runs) > 1 else signal
            columns.append((name, *map(repr, samples)))
    text = "".join(",".join(row) + "\n" for row in zip(*columns, strict=True))
    sidecar = json.dumps(notes.plain(), indent=2, ensure_ascii=False) + "\n"
    return text.encode(), sidecar.encode()
