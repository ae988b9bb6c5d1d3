"""Recordings as MATLAB files: which variables are the signals, and their runs.

Versions 4 and 5 are read by scipy, 7.3 by h5py.  Both trust what a file says, and a damaged one can
end the process: `pilotid.recordings.matlab_process` does so in a process of its own.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import product, repeat
from pathlib import Path
from typing import Any

import numpy as np

from pilotid.recordings.contents import (
    MOST_VALUES,
    UNEVENNESS,
    Contents,
    Notes,
    Place,
    common_run,
    common_time,
    lacking,
    listed,
    matching,
    required,
    shown,
)
from pilotid.recordings.recording import Recording
from pilotid.types import FloatArray, InputError

NOTES = "pilotid"  # the struct variable that holds what a CSV's sidecar holds
HDF5 = b"\x89HDF\r\n\x1a\n"  # how v7.3 files begin, behind a header of 512 bytes
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


def read_contents(path: Path, source: str, places: Mapping[str, Place], *, timed: bool) -> Contents:
    """What a MATLAB file holds; a damaged one may end the process."""
    with path.open("rb") as stream:
        head = stream.read(520)
    try:
        with _open(path, is_hdf5=HDF5 in (head[:8], head[512:])) as variables:
            return _contents(variables, source, places, timed=timed)
    except InputError:
        raise
    except MemoryError:
        raise InputError(
            f"{source}: takes too much memory; save t, e, u, x in a file of their own"
        ) from None
    except Exception as error:  # what is damaged fails in any way whatsoever
        raise damage_error(source, f"{type(error).__name__}: {error}") from None


def damage_error(source: str, what: str) -> InputError:
    """The refusal of a file that is not what its format wants."""
    return InputError(
        f"{source}: is no MATLAB file, damaged or cut short ({shown(what)[1:-1]}); save it again "
        "with save -v7"
    )


@contextmanager
def _open(path: Path, *, is_hdf5: bool) -> Iterator[Variables]:
    """The variables of a file."""
    if is_hdf5:
        import h5py

        with h5py.File(path, "r") as file:
            yield dict(_in_group(file, ""))
    else:
        from scipy.io import loadmat

        content = {n: v for n, v in loadmat(path).items() if not n.startswith("__")}
        yield dict(pair for name, value in content.items() for pair in _in_array(value, name))


def _in_array(value: Any, name: str) -> Iterator[tuple[str, Any]]:
    """The variables in what scipy makes of one."""
    from scipy.io.matlab import MatlabFunction, MatlabOpaque

    if isinstance(value, MatlabOpaque):
        about = value.ravel()[0]
        yield _decoded(about["s0"]), MatlabObject(_decoded(about["s2"]))
    elif not isinstance(value, np.ndarray) or isinstance(value, MatlabFunction):
        yield name, None
    elif value.dtype.names is not None:
        for number, struct in enumerate(value.ravel(order="F"), start=1):
            own = name if value.size == 1 else f"{name}({number})"
            for field in value.dtype.names:
                yield from _in_array(struct[field], f"{own}.{field}")
    elif value.dtype.kind == "O":
        for number, cell in enumerate(value.ravel(order="F"), start=1):
            yield from _in_array(cell, f"{name}{{{number}}}")
    elif value.dtype.kind == "U":
        yield name, "".join(value.ravel()) if value.size < 2 else None
    else:
        yield name, value.squeeze() if value.dtype.kind in "fiub" else None


def _decoded(word: Any) -> str:
    return word.decode("utf-8", "backslashreplace") if isinstance(word, bytes) else str(word)


def _in_group(group: Any, prefix: str) -> Iterator[tuple[str, Any]]:
    """The variables in a group of a v7.3 file; links and what lies elsewhere are none."""
    import h5py

    for key in group:
        name = prefix + _decoded(key)
        if name.startswith("#"):
            continue  # what cells and objects refer to
        if isinstance(group.get(key, getlink=True), h5py.HardLink):
            yield from _in_entry(group[key], name)
        else:
            yield name, None


def _in_entry(entry: Any, name: str) -> Iterator[tuple[str, Any]]:
    import h5py

    kind = _decoded(entry.attrs.get("MATLAB_class", b""))
    if "MATLAB_object_decode" in entry.attrs:
        yield name, MatlabObject(kind)
    elif isinstance(entry, h5py.Group) and "MATLAB_sparse" not in entry.attrs:
        yield from _in_group(entry, f"{name}.")
    elif not isinstance(entry, h5py.Dataset) or entry.is_virtual or entry.external:
        yield name, None
    elif h5py.check_ref_dtype(entry.dtype) is h5py.Reference and kind in ("cell", ""):
        struct, _, field = name.rpartition(".")
        for number, place in enumerate(entry[()].T.ravel(order="F"), start=1):
            own = f"{name}{{{number}}}" if kind else f"{struct}({number}).{field}"
            yield from _in_entry(entry.file[place], own)
    else:
        is_usual = h5py.h5t.py_create(entry.dtype).equal(entry.id.get_type())
        yield (
            name,
            partial(_value, entry, kind) if entry.dtype.kind in "fiub" and is_usual else None,
        )


def _value(entry: Any, kind: str) -> Any:
    """A data set as an array, or a text."""
    if "MATLAB_empty" in entry.attrs:
        return "" if kind == "char" else np.zeros(0)
    if kind in ("cell", "function_handle"):
        return None
    if entry.chunks:
        places = product(*map(range, repeat(0), entry.shape, entry.chunks))
        found = map(entry.id.get_chunk_info_by_coord, places)
        missing = any(chunk.byte_offset is None for chunk in found)
    else:
        missing = entry.id.get_storage_size() < entry.nbytes
    if missing:  # HDF5 would make zeros of them
        raise ValueError(f"parts of {entry.name} are missing")
    values = entry[()].T
    if kind != "char":
        return values.squeeze()
    return values.astype("<u2").tobytes().decode("utf-16-le") if len(values) == 1 else None


def _contents(
    variables: Variables, source: str, places: Mapping[str, Place], *, timed: bool
) -> Contents:
    """What a file with these variables holds."""
    notes = _notes(variables, source)
    own = {n: v for n, v in variables.items() if n.partition(".")[0] != NOTES}
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
    origin = {
        signal: places[signal].shown(dict.fromkeys(map(_family, names)))
        for signal, names in members.items()
    }
    return Contents(t, signals, partial(_place, members.get("t", [""])[0]), notes, origin)


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
                f"{source}: variable {name} is {size} but the time has {samples} samples; store "
                "one column a run, one row a sample"
            )
    return np.concatenate(rows) if len(rows) > 1 else rows[0]


def mat_bytes(recording: Recording, source: str) -> bytes:
    """The MATLAB v5 file of a recording.

    Raises
    ------
    InputError
        If the recording's lines or units cannot be written.
    """
    from scipy.io import savemat  # heavy, and CSV does not need it

    notes = Notes.of(recording, recording.time, source)
    variables: dict[str, object] = {"t": recording.time[:, np.newaxis], NOTES: notes.plain()}
    for signal in recording.signals:
        values: FloatArray = getattr(recording, signal)
        variables[signal] = (common_run(values) if signal in ("ft", "fd") else values).T
    stream = io.BytesIO()
    savemat(stream, variables)  # type: ignore[arg-type]  # the stub forgets streams
    return stream.getvalue()
