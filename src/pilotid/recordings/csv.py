"""Recordings as CSV with an optional sidecar F.json."""

from __future__ import annotations

import json
import os
import re
from collections import Counter
from collections.abc import Mapping
from itertools import chain
from pathlib import Path

import numpy as np

from pilotid.recordings.contents import Contents, Notes, common_run
from pilotid.recordings.csv_table import RUN, Table, check_lines, number_or_nan
from pilotid.recordings.names import (
    NAMES,
    REQUIRED,
    UNEVENNESS,
    Place,
    listed,
    shown,
    time_base,
)
from pilotid.recordings.paths import file_size, path_shown
from pilotid.recordings.recording import SIGNALS, Recording
from pilotid.types import FloatArray, InputError

LARGEST_FILE = 2**30  # bytes
LARGEST_SIDECAR = 2**22


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
    file_size(path, LARGEST_FILE)
    check_lines(path, source)
    sidecar = sidecar_path(path)
    notes = _read_sidecar(sidecar) if os.path.exists(sidecar) else Notes()
    with path.open(encoding="utf-8-sig", newline="") as stream:
        table = Table(stream, source)
        columns = {signal: _columns(table, signal, place) for signal, place in places.items()}
        for signal, names in columns.items():
            if RUN in table.header and len(names) > 1:
                raise InputError(
                    f"{source}: line 1 has a {RUN} column and also columns {names[0]}, {names[1]} "
                    f"for {signal}; number the runs in one way only"
                )
        needed = list(dict.fromkeys(chain.from_iterable(columns.values())))
        values = table.read(needed)
    place_of = {name: i for i, name in enumerate(needed)}
    time = places["t"].signed(values[:, place_of[columns["t"][0]]])
    signals = {
        signal: places[signal].signed(values[:, [place_of[name] for name in names]].T)
        for signal, names in columns.items()
        if names and signal != "t"
    }
    if RUN in table.header:
        return _split_runs(table, time, signals, notes)
    return Contents(time, signals, table.where(range(len(time))), notes)


def _columns(table: Table, signal: str, place: Place) -> list[str]:
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


def _missing(table: Table, signal: str, name: str) -> InputError:
    if all(np.isfinite(number_or_nan(cell)) for cell in table.header):
        return InputError(
            f"{table.source}: line 1 holds numbers but must be a header row that names the "
            "columns t, e, u, x"
        )
    return InputError(
        f"{table.source}: line 1 has no column {shown(name)} for {signal} ({NAMES[signal]}), only "
        f"{listed(table.header)}; name the right one with --map {signal}=COLUMN"
    )


def _split_runs(
    table: Table, t: FloatArray, signals: Mapping[str, FloatArray], notes: Notes
) -> Contents:
    """The contents of a file in long format: rows with the same run number are one run."""
    rows = table.labels
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
    source = path_shown(path)
    file_size(path, LARGEST_SIDECAR)
    try:
        raw = json.loads(path.read_bytes().decode("utf-8-sig"), object_pairs_hook=_single)
    except UnicodeDecodeError as error:
        line = error.object.count(b"\n", 0, error.start) + 1
        raise InputError(f"{source}: line {line} is not UTF-8 text; save it in UTF-8") from None
    except json.JSONDecodeError as error:
        raise InputError(
            f"{source}: line {error.lineno} is not valid JSON ({error.msg}); correct it or remove "
            "the file"
        ) from None
    except _RepeatedError as error:
        raise InputError(f"{source}: gives {error} twice; give it once") from None
    except (ValueError, RecursionError):  # a number of thousands of digits; brackets without end
        raise InputError(
            f"{source}: cannot be read as JSON; correct it or remove the file"
        ) from None
    return Notes.parsed(raw, source)


class _RepeatedError(Exception):
    """A key stands twice in one object."""


def _single(pairs: list[tuple[str, object]]) -> dict[str, object]:
    """An object of JSON whose keys differ."""
    for key, count in Counter(key for key, _ in pairs).items():
        if count > 1:
            raise _RepeatedError(shown(key))
    return dict(pairs)


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
