"""Which variables of a MATLAB file are the signals, and their runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from pilotid.recordings.mat_variables import Value, Variables, family
from pilotid.recordings.names import (
    UNEVENNESS,
    Place,
    lacking,
    listed,
    matching,
    required,
)
from pilotid.types import FloatArray, InputError

NOTES = "pilotid"  # the struct variable that holds what a CSV's sidecar holds
#: How to make variables that are read of objects that are not.
REMEDIES = {
    "table": "S = table2struct({0},'ToScalar',true); save('F.mat','-struct','S')",
    "timetable": (
        "S = table2struct(timetable2table({0}),'ToScalar',true); S.t = seconds(S.Time); "
        "S = rmfield(S,'Time'); save('F.mat','-struct','S')"
    ),
    "timeseries": "t = {0}.Time; u = {0}.Data; save('F.mat','t','u')",
}


def resolved(
    variables: Variables, places: Mapping[str, Place], source: str, *, timed: bool
) -> dict[str, list[str]]:
    """The variables of each signal, a member a run where they are many.

    They are at the top level, or else in the one struct (array, cell) with all the rest.

    Parameters
    ----------
    variables, places
        Those of the file, and where it keeps each signal.
    source
        Its name in messages.
    timed
        Whether no time is needed.

    Raises
    ------
    InputError
        If signals are missing or may be found in several places.
    """
    names = _chosen(variables.names(deep=False), places, source)
    present = [name for name in variables.names(deep=False) if _outside_notes(name)]
    if required(places, names, timed=timed) or "x" not in names:
        present = [name for name in variables.names(deep=True) if _outside_notes(name)]
        families = list(dict.fromkeys(map(family, present)))
        names = _chosen(families, places, source)
        absent = required(places, names, timed=timed)
        if absent or "x" not in names:
            names |= _inside(families, names, places, source, timed=timed)
        absent = required(places, names, timed=timed)
        if absent:
            raise _missing(variables, absent, places, families, source)
    return {
        signal: [v for v in present if v == name or family(v) == name] or [name]
        for signal, name in names.items()
    }


def _outside_notes(name: str) -> bool:
    return name.partition(".")[0] != NOTES


def _chosen(names: Sequence[str], places: Mapping[str, Place], source: str) -> dict[str, str]:
    """The variables of those signals that have one by their full name."""
    found = {s: matching(p.name, filter(_outside_notes, names)) for s, p in places.items()}
    return {s: _single(s, own, source) for s, own in found.items() if own}


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
        picks = ",".join(f"{s}={first[s][0]}" for s in needed)
        raise InputError(
            f"{source}: the structs {listed(holding)} all hold "
            f"{listed(wanted[s] for s in needed)}; pick one, as in --map {picks}"
        )
    if not holding:
        return {}
    return {s: _single(s, own, source) for s, own in inside[holding[0]].items()}


def _ending(names: Sequence[str], name: str) -> list[str]:
    """The variables whose last part, or last parts, are the name."""
    exact = [v for v in names if v.endswith(f".{name}")]
    return exact or [v for v in names if v.casefold().endswith(f".{name.casefold()}")]


def _missing(
    variables: Variables,
    absent: Sequence[str],
    places: Mapping[str, Place],
    families: Sequence[str],
    source: str,
) -> InputError:
    for name, kind in variables.objects.items():
        if _outside_notes(name):
            remedy = REMEDIES.get(kind, "save('F.mat','t','e','u','x') with plain matrices")
            return InputError(
                f"{source}: variable {name} is a MATLAB {kind}, which only MATLAB reads; write "
                f"there: {remedy.format(name)}"
            )
    return InputError(f"{source}: has {lacking(absent, places, families, 'variable')}")


def real(value: Value, name: str, source: str) -> FloatArray:
    """A variable as finite numbers, its shape as it is."""
    array = np.asarray(value)
    if array.dtype.kind not in "fiub":
        raise InputError(
            f"{source}: variable {name} does not hold real numbers; save it as a full numeric "
            "matrix"
        )
    numbers = np.atleast_1d(array.astype(np.float64))
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


def one_time(times: Sequence[FloatArray], names: Sequence[str], source: str) -> FloatArray:
    """The times of the samples, shape (samples,), which all runs must have in common.

    Parameters
    ----------
    times
        Arrays of times: one, or one for each run; one with many columns is one for each run too.
    names
        Their names.
    source
        The file, for messages.
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
    for other, name in zip(times[1:], names[1:], strict=True):
        step = abs(float(first[-1] - first[0])) / max(1, first.size - 1)
        if other.size != first.size:
            raise InputError(
                f"{source}: variable {name} (time) has {other.size} samples but {names[0]} has "
                f"{first.size}; cut all runs to the same length"
            )
        if np.abs(other.ravel() - first).max() > UNEVENNESS * step:
            raise InputError(
                f"{source}: variable {name} (time) differs from {names[0]}; give every run the "
                "same times"
            )
    return first


def as_runs(
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
                f"{source}: variable {name} is {size} but the time has {samples} samples; store "
                "one column a run, one row a sample"
            )
    return np.concatenate(rows)
