"""Recordings as CSV with an optional sidecar F.json."""

from __future__ import annotations

import json
import os
import re
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import replace
from itertools import chain
from pathlib import Path

import numpy as np

from pilotid.recordings.contents import Contents, Notes, common_run
from pilotid.recordings.csv_table import RUN, Table, number_or_nan
from pilotid.recordings.csv_text import encoding_of
from pilotid.recordings.names import (
    UNEVENNESS,
    Place,
    bare,
    lacking,
    listed,
    matching,
    required,
    seconds_in,
    shown,
    time_base,
)
from pilotid.recordings.paths import file_size, path_shown
from pilotid.recordings.recording import Recording
from pilotid.types import FloatArray, InputError

LARGEST_FILE = 2**30  # bytes
LARGEST_SIDECAR = 2**22


def sidecar_path(path: Path) -> Path:
    """The notes beside a CSV file: F.json for F.csv."""
    return path.with_suffix(".json")


def read_csv(path: Path, source: str, places: Mapping[str, Place], *, timed: bool) -> Contents:
    """Read a CSV file and its sidecar.

    Parameters
    ----------
    path, source
        The file, and its name in messages.
    places
        Where it keeps each signal.
    timed
        Whether the sampling interval is known, so that no column of times is needed.

    Raises
    ------
    InputError
        With the line and column of the first thing that is wrong.
    OSError
        If the file cannot be read.
    """
    file_size(path, LARGEST_FILE)
    encoding = encoding_of(path, source)
    sidecar = sidecar_path(path)
    notes = _read_sidecar(sidecar) if os.path.exists(sidecar) else Notes()
    with path.open(encoding=encoding, newline="") as stream:
        table = Table(stream, source)
        columns = {signal: _columns(table, signal, place) for signal, place in places.items()}
        found = {signal: names for signal, names in columns.items() if names}
        _require(table, places, found, timed=timed or notes.dt is not None)
        for signal, names in found.items():
            if RUN in table.header and len(names) > 1:
                raise InputError(
                    f"{source}: line {table.line} has a {RUN} column and also columns {names[0]}, "
                    f"{names[1]} for {signal}; number the runs in one way only"
                )
        needed = list(dict.fromkeys(chain.from_iterable(found.values())))
        values = table.read(needed)
    place_of = {name: i for i, name in enumerate(needed)}
    signals = {
        signal: places[signal].signed(values[:, [place_of[name] for name in names]].T)
        for signal, names in found.items()
    }
    time = None
    if "t" in found:
        time = signals.pop("t")[0] * seconds_in(table.unit(found["t"][0]), source)
    units = {s: unit for s, names in found.items() if (unit := table.unit(names[0]))}
    units.pop("t", None)
    notes = replace(notes, units={**units, **(notes.units or {})} or None)
    origin = {signal: places[signal].shown(names) for signal, names in found.items()}
    if RUN in table.header:
        return _split_runs(table, time, signals, notes, origin)
    return Contents(time, signals, table.where(range(len(values))), notes, origin)


def _columns(table: Table, signal: str, place: Place) -> list[str]:
    """The columns of a signal: one, or one a run; none for one that is absent."""
    own = matching(place.name, table.header)
    numbered = dict[int, list[str]]()
    pattern = re.compile(re.escape(place.name) + r"_([0-9]{1,6})", re.IGNORECASE)
    for column in table.header if signal != "t" else ():
        if match := pattern.fullmatch(bare(column)[0]):
            numbered.setdefault(int(match[1]), []).append(column)
    several = [column for _, columns in sorted(numbered.items()) for column in columns]
    if own and several:
        raise InputError(
            f"{table.source}: line {table.line} has the column {shown(own[0])} and also "
            f"{listed(several)} for {signal}; rename what is not meant"
        )
    if len(set(own)) > 1 or len(several) > len(numbered):
        raise InputError(
            f"{table.source}: line {table.line} has the columns {listed(own or several)}, any of "
            f"which may be {signal}; pick one, as in --map {signal}={listed((own or several)[:1])}"
        )
    if own:
        return own[:1]
    if sorted(numbered) != list(range(1, len(numbered) + 1)):
        raise InputError(
            f"{table.source}: line {table.line} has the columns {listed(several)} for {signal}; "
            "number the runs from 1 without a gap"
        )
    return several


def _require(
    table: Table, places: Mapping[str, Place], found: Collection[str], *, timed: bool
) -> None:
    """Refuse a file that lacks what it must have."""
    absent = required(places, found, timed=timed)
    if not absent:
        return
    if all(np.isfinite(number_or_nan(cell.replace(",", "."))) for cell in table.header):
        raise InputError(
            f"{table.source}: line {table.line} holds numbers but must be a header row that names "
            "the columns t, e, u, x"
        )
    raise InputError(
        f"{table.source}: line {table.line} has " + lacking(absent, places, table.header, "column")
    )


def _split_runs(
    table: Table,
    t: FloatArray | None,
    signals: Mapping[str, FloatArray],
    notes: Notes,
    origin: Mapping[str, str],
) -> Contents:
    """The contents of a file in long format: rows with the same run number are one run."""
    rows = table.labels
    labels = list(rows)
    if not labels:
        return Contents(t, signals, table.where([]), notes, origin)
    first = rows[labels[0]]
    for label, own in rows.items():
        if len(own) != len(first):
            raise InputError(
                f"{table.source}: run {shown(label)}, which starts on line {table.lines[own[0]]}, "
                f"has {len(own)} rows but run {shown(labels[0])} has {len(first)}; cut all runs to "
                "the same length"
            )
        if t is None:
            continue
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
    return Contents(None if t is None else t[first], split, table.where(first), notes, origin)


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
    for signal in recording.signals:
        values: FloatArray = getattr(recording, signal)
        runs = common_run(values) if signal in ("ft", "fd") else values
        for run, samples in enumerate(runs.tolist(), start=1):
            name = f"{signal}_{run}" if len(runs) > 1 else signal
            columns.append((name, *map(repr, samples)))
    text = "".join(",".join(row) + "\n" for row in zip(*columns, strict=True))
    sidecar = json.dumps(notes.plain(), indent=2, ensure_ascii=False) + "\n"
    return text.encode(), sidecar.encode()
