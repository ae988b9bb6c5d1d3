"""Recordings among named variables: which of them are the signals, and their runs."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from pilotid.recordings.contents import (
    MOST_VALUES,
    UNEVENNESS,
    Contents,
    Notes,
    Parts,
    Place,
    common_time,
    is_level,
    lacking,
    listed,
    matching,
    no_level,
    required,
    shown,
)
from pilotid.support.types import FloatArray, InputError

NOTES = "pilotid"  # the struct variable that holds what a CSV's sidecar holds
#: How to make variables that are read of objects that only MATLAB reads.
REMEDIES = {
    "table": "S = table2struct({0},'ToScalar',true); save('F.mat','-struct','S')",
    "timetable": (
        "S = table2struct(timetable2table({0}),'ToScalar',true); S.t = seconds(S.Time); "
        "S = rmfield(S,'Time'); save('F.mat','-struct','S')"
    ),
    "timeseries": "t = {0}.Time; u = {0}.Data; save('F.mat','t','u')",
}


@dataclass(frozen=True)
class MatlabObject:
    """An object of a MATLAB class, whose content only MATLAB reads."""

    kind: str


#: Variables by name, ``data(2).u`` and ``u{3}`` inside arrays of structs and cells: arrays, texts,
#: functions that read one from the file, objects, and None for what is none of these.
Variables = Mapping[str, Any]


def contents_of(
    variables: Variables, source: str, places: Mapping[str, Place], parts: Parts, *, timed: bool
) -> Contents:
    """What a file with these variables holds, or a part of it."""
    notes = _notes(variables, source)
    places = notes.with_extra(places)
    own = {n: v for n, v in variables.items() if n.partition(".")[0] != NOTES}
    if parts.path:
        own = _inside_of(own, parts.path, source)
    _add_columns(own, places)
    members = _members(own, places, source, timed=timed or notes.dt is not None)
    values = {n: _array(own[n], n, source) for names in members.values() for n in names}
    if sum(array.size for array in values.values()) > MOST_VALUES:
        raise InputError(
            f"{source}: holds more than {MOST_VALUES} values, too many for a recording; thin it "
            "out in time or leave runs out"
        )
    arrays = {signal: [values[n] for n in names] for signal, names in members.items()}
    t = None
    samples = max(arrays["u"][0].shape)  # recordings have more samples than runs
    if "t" in arrays:
        times = [array.astype(np.float64) for array in arrays.pop("t")]
        t = _common_time(times, members["t"], source)
        samples = t.size
    signals = {
        signal: places[signal].signed(_as_runs(pieces, members[signal], samples, source))
        for signal, pieces in arrays.items()
    }
    for name, wanted in parts.levels.items():
        _choose(own, signals, name, wanted, source)
    origin = {
        signal: places[signal].shown(dict.fromkeys(map(_family, names)))
        for signal, names in members.items()
    }
    where = partial(_place, members.get("t", [""])[0])
    return Contents(t, signals, where, notes, origin)


def _inside_of(variables: Variables, path: str, source: str) -> dict[str, Any]:
    """The variables in a struct, cell or group by their names there, and those beside it."""
    inside = {n[len(path) + 1 :]: v for n, v in variables.items() if n.startswith(f"{path}.")}
    inside |= {n: v for n, v in variables.items() if n.startswith((f"{path}(", f"{path}{{"))}
    if not inside:
        there = dict.fromkeys(n.rpartition(".")[0] for n in variables if "." in n)
        raise InputError(
            f"{source}: has no part {shown(path)}, only {listed(there)}; name one of them behind ::"
        )
    above = path
    while above:
        above = above.rpartition(".")[0]
        start = f"{above}." if above else ""
        for name, value in variables.items():
            rest = name.removeprefix(start)
            if name.startswith(start) and not re.search(r"[.({]", rest):
                inside.setdefault(rest, value)
    return inside


def _levels(variables: Variables, name: str, source: str) -> list[object]:
    """The values of a variable that has one for each run."""
    names = matching(name, dict.fromkeys(map(_family, variables)))
    if len(names) != 1:
        raise InputError(
            f"{source}: has no variable {shown(name)}, only {listed(map(_family, variables))}"
        )
    found: list[object] = []
    for variable, value in variables.items():
        if _family(variable) == names[0] or variable == names[0]:
            held = value() if callable(value) else value
            found += held.ravel().tolist() if isinstance(held, np.ndarray) else [held]
    return found


def _choose(
    variables: Variables, signals: dict[str, FloatArray], name: str, wanted: str, source: str
) -> None:
    """Leave of all signals the runs at which a variable has a value."""
    levels, runs = _levels(variables, name, source), len(signals["u"])
    if len(levels) != runs:
        raise InputError(
            f"{source}: variable {shown(name)} has {len(levels)} values but there are {runs} runs; "
            "runs are chosen by a variable with one value a run"
        )
    chosen = [is_level(level, wanted) for level in levels]
    if not any(chosen):
        raise no_level(source, name, wanted, levels)
    for signal, values in signals.items():
        if len(values) == runs:
            signals[signal] = values[chosen]


def _add_columns(variables: dict[str, Any], places: Mapping[str, Place]) -> None:
    """Columns of matrices that users name, as in ``data:3``, as variables of their own."""
    for place in places.values():
        name, _, number = place.name.rpartition(":")
        if name in variables and number.isascii() and number.isdigit():
            variables[place.name] = partial(_column, variables[name], int(number))


def _column(value: Any, number: int) -> FloatArray | None:
    """A column of a matrix, counted from 1."""
    matrix = value() if callable(value) else value
    if not isinstance(matrix, np.ndarray) or matrix.ndim != 2:
        return None
    table = matrix if len(matrix) >= matrix.shape[1] else matrix.T  # more samples than columns
    return np.asarray(table[:, number - 1]) if 0 < number <= table.shape[1] else None


def _place(name: str, index: int) -> str:
    return f"sample {index + 1} of {name}"


def _notes(variables: Variables, source: str) -> Notes:
    """The notes in the struct of that name, if there is one; its lines are always lists."""
    plain: dict[str, Any] = {}
    for name, value in variables.items():
        root, *path = name.split(".")
        if root != NOTES:
            continue
        value = value() if callable(value) else value
        entry = value.tolist() if isinstance(value, np.ndarray) else value
        if not path:
            return Notes.parsed(entry, f"{source}, variable {NOTES}")
        if path[0] == "lines" and len(path) > 1 and not isinstance(entry, list):
            entry = [entry]
        place = plain
        for key in path[:-1]:
            place = place.setdefault(key, {})
        place[path[-1]] = entry
    return Notes.parsed(plain, f"{source}, variable {NOTES}") if plain else Notes()


def _family(name: str) -> str:
    """The name that the members of an array have in common: ``data(2).u`` is of ``data.u``.

    Arrays of structs and cells hold runs; each is a variable of its own here.
    """
    return re.sub(r"\([0-9]+\)|\{[0-9]+\}", "", name)


def _members(
    variables: Variables, places: Mapping[str, Place], source: str, *, timed: bool
) -> dict[str, list[str]]:
    """The variables of each signal, a member a run where they are many.

    They are at the top level, or else in the one struct (array, cell) with all the rest.
    """
    names = _chosen([name for name in variables if not re.search(r"[.({]", name)], places, source)
    families = list(dict.fromkeys(map(_family, variables)))
    if required(places, names, timed=timed) or "x" not in names:
        names = _chosen(families, places, source)
        if required(places, names, timed=timed) or "x" not in names:
            names |= _inside(families, names, places, source, timed=timed)
    if absent := required(places, names, timed=timed):
        for name, value in variables.items():
            if isinstance(value, MatlabObject):
                remedy = REMEDIES.get(value.kind, "save('F.mat','t','e','u','x') as matrices")
                raise InputError(
                    f"{source}: variable {name} is a MATLAB {value.kind}, which only MATLAB reads; "
                    f"write there: {remedy.format(name)}"
                )
        raise InputError(f"{source}: has {lacking(absent, places, families, 'variable')}")
    return {
        signal: [v for v in variables if v == name or _family(v) == name] or [name]
        for signal, name in names.items()
    }


def _chosen(names: Sequence[str], places: Mapping[str, Place], source: str) -> dict[str, str]:
    """The variables of those signals that have one by their full name."""
    found = {signal: matching(place.name, names) for signal, place in places.items()}
    return {signal: _single(signal, own, source) for signal, own in found.items() if own}


def _single(signal: str, names: Sequence[str], source: str) -> str:
    if len(set(names)) > 1:
        raise InputError(
            f"{source}: {signal} may be any of {listed(names)}; pick one, as in --map "
            f"{signal}={names[0]}"
        )
    return names[0]


def _inside(
    families: Sequence[str],
    known: Mapping[str, str],
    places: Mapping[str, Place],
    source: str,
    *,
    timed: bool,
) -> dict[str, str]:
    """The variables of further signals in the one struct that holds all that is needed."""
    structs: dict[str, list[str]] = {}
    for name in families:
        if "." in name:
            structs.setdefault(name.partition(".")[0], []).append(name)
    wanted = {s: place.name for s, place in places.items() if s not in known}
    inside = {
        struct: {s: own for s, name in wanted.items() if (own := _ending(content, name))}
        for struct, content in structs.items()
    }
    holding = [
        struct
        for struct, own in inside.items()
        if own and not required(places, {*known, *own}, timed=timed)
    ]
    if len(holding) > 1:
        # One that holds the output as well is the recording.
        holding = [s for s in holding if "x" in {*known, *inside[s]}] or holding
    if len(holding) > 1:
        first = inside[holding[0]]
        needed = [s for s in ("t", "e", "u", "x") if s in first]
        raise InputError(
            f"{source}: the structs {listed(holding)} all hold "
            f"{listed(wanted[s] for s in needed)}; pick one, as in {source}::{holding[0]}"
        )
    if not holding:
        return {}
    return {s: _single(s, own, source) for s, own in inside[holding[0]].items()}


def _ending(names: Sequence[str], name: str) -> list[str]:
    """The variables whose last part, or last parts, are the name."""
    exact = [v for v in names if v.endswith(f".{name}")]
    return exact or [v for v in names if v.casefold().endswith(f".{name.casefold()}")]


def _array(value: Any, name: str, source: str) -> FloatArray:
    """A variable as finite numbers, its shape as it is."""
    array = value() if callable(value) else value
    if not isinstance(array, np.ndarray):
        raise InputError(
            f"{source}: variable {name} does not hold real numbers; save it as a full numeric "
            "matrix"
        )
    numbers = np.atleast_1d(array if array.dtype.kind == "f" else array.astype(np.float64))
    bad = ~np.isfinite(numbers)
    if bad.any():
        sample, *run = (int(i) + 1 for i in np.argwhere(bad)[0])
        column = f", column {run[0]}" if run else ""
        raise InputError(
            f"{source}: variable {name} is not a finite number at row {sample}{column}; repair or "
            "cut the recording there"
        )
    return numbers


def _size(array: FloatArray) -> str:
    return " x ".join(str(n) for n in array.shape)


def _common_time(times: Sequence[FloatArray], names: Sequence[str], source: str) -> FloatArray:
    """The times of the samples, shape (samples,), which all runs must have in common.

    There is one array, or one for each run; one with many columns is one for each run too.
    """
    first, shape = times[0], times[0].shape
    if first.ndim == 2:
        columns = first.T if shape[0] >= shape[1] else first
        if np.ptp(columns, axis=0).max() > UNEVENNESS * abs(float(columns[0, 1] - columns[0, 0])):
            raise InputError(
                f"{source}: variable {names[0]} (time) is {_size(first)} and differs between runs; "
                "give one row or one column"
            )
        first = columns[0]
    if first.ndim != 1 or not first.size:
        raise InputError(
            f"{source}: variable {names[0]} (time) is {_size(first)}; give one row or one column"
        )
    every = [first, *(other.ravel() for other in times[1:])]
    return common_time(dict(zip((f"variable {n}" for n in names), every, strict=True)), source)


def _as_runs(
    pieces: Sequence[FloatArray], names: Sequence[str], samples: int, source: str
) -> FloatArray:
    """A signal with one row a run, shape (runs, samples), of one array or one for each run.

    The number of samples tells rows from columns; where both fit, a column is a run.
    """
    rows = []
    for array, name in zip(pieces, names, strict=True):
        if array.ndim == 1 and array.size == samples:
            rows.append(array[np.newaxis])
        elif array.ndim == 2 and array.shape[0] == samples:
            rows.append(array.T)
        elif array.ndim == 2 and array.shape[1] == samples:
            rows.append(array)
        else:
            size = f"{array.size} samples long" if array.ndim == 1 else _size(array)
            if len(pieces) > 1:
                raise InputError(
                    f"{source}: variable {name} is {size} but there are {samples} samples in the "
                    "time, or the first run; cut all runs to the same length"
                )
            raise InputError(
                f"{source}: variable {name} is {size} but the time has {samples} samples; give "
                "all signals at one rate, one column a run, one row a sample"
            )
    return np.concatenate(rows) if len(rows) > 1 else rows[0]
