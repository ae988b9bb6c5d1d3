"""Recordings as named arrays: MATLAB, HDF5 and numpy files.

MATLAB's versions 4 and 5 are read by scipy in a process of their own, which a damaged file can end;
7.3 and other HDF5 files are read by h5py.
"""

from __future__ import annotations

import atexit
import math
import os
import pickle
import re
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache, partial
from pathlib import Path
from subprocess import PIPE
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pilotid.recordings import roles
from pilotid.recordings.roles import shown
from pilotid.recordings.windows import sidecar_path
from pilotid.support.disk import require_file
from pilotid.support.types import InputError

if TYPE_CHECKING:
    from pilotid.recordings.sidecar import Sidecar

LARGEST_FILE = 2**32  # bytes
#: It lives for a minute after it was asked last.
READER = """
import pickle, signal, sys, warnings
from scipy.io import loadmat
signal.signal(signal.SIGINT, signal.SIG_IGN)
warnings.simplefilter("ignore")
for path in map(eval, sys.stdin):
    getattr(signal, "alarm", int)(60)
    try:
        found = loadmat(path)
    except Exception as error:
        found = error
    pickle.dump(found, sys.stdout.buffer, protocol=5)
    sys.stdout.buffer.flush()
"""
LOCK = threading.Lock()
HDF5 = b"\x89HDF\r\n\x1a\n"  # how v7.3 files begin, behind a header of 512 bytes
NOTES = "pilotid"  # the struct variable that holds what a CSV's sidecar holds


class MatlabObject(NamedTuple):
    """An object of a MATLAB class, whose content only MATLAB reads."""

    kind: str


#: Variables by name, ``data(2).u`` and ``u{3}`` inside arrays of structs and cells: arrays, texts,
#: functions that read one from the file, and None for what is none of these.
Variables = dict[str, Any]


def read_arrays(path: Path, source: str, ask: roles.Request) -> roles.Found:
    """What a file holds, or a part of it.

    Parameters
    ----------
    path, source
        The file, and its name in messages.
    ask
        What is wanted of it.

    Raises
    ------
    InputError
        If the file cannot be used; the message names the variable.
    """
    from pilotid.recordings.sidecar import read_sidecar

    with _opened(path, source) as variables:
        beside = path.suffix.lower() != ".mat" and sidecar_path(path).exists()
        notes = read_sidecar(path) if beside else _notes(variables, source)
        places = roles.signal_places(ask.mapping, notes.extra)
        timed = ask.timed or notes.dt is not None
        names = _members(variables, source, places, ask.part, timed=timed)
        pieces = {
            signal: {f"variable {n}": _array(variables[n], n, source) for n in own}
            for signal, own in names.items()
        }
        levels = {name: _levels(variables, name, source) for name in ask.levels}
    families = {signal: dict.fromkeys(map(_family, own)) for signal, own in names.items()}
    return roles.Found(
        pieces, families, {}, places, notes, lambda n: f"sample {n + 1} of t", levels
    )


@contextmanager
def _opened(path: Path, source: str) -> Iterator[Variables]:
    """The variables of a file.

    Raises
    ------
    InputError
        If it cannot be read, within the context as well.
    """
    require_file(path, LARGEST_FILE)
    try:
        with path.open("rb") as stream:
            head = stream.read(520)
        if path.suffix.lower() == ".npz":
            with path.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
                yield dict(pair for name in archive.files for pair in _in_npz(archive, name))
        elif HDF5 in (head[:8], head[512:]):
            import h5py

            with h5py.File(path, "r") as file:
                yield dict(_in_hdf5(file, ""))
        else:
            loaded = _loaded(path).items()
            yield dict(pair for name, value in loaded for pair in _in_array(value, name))
    except InputError:
        raise
    except Exception as error:  # what is damaged, or too large, fails in any way whatsoever
        suffix = path.suffix.lower()
        kind, command = ("MATLAB", "save -v7") if suffix == ".mat" else (suffix, "numpy.savez")
        name = "out of memory" if isinstance(error, MemoryError) else type(error).__name__
        what = shown(f"{name}: {error}")[1:-1]
        raise InputError(
            f"{source}: is no {kind} file, damaged, cut short or too large ({what}); save t, e, u, "
            f"x again with {command}"
        ) from None


@cache
def _reader(owner: int) -> subprocess.Popen[bytes]:
    """The process that reads for the one with this id; one that was forked has another."""
    command = [sys.executable, "-P", "-c", READER]
    reader = subprocess.Popen(command, stdin=PIPE, stdout=PIPE, stderr=subprocess.DEVNULL)
    atexit.register(_end, reader)
    return reader


def _end(reader: subprocess.Popen[bytes]) -> None:
    reader.kill()
    reader.communicate()
    _reader.cache_clear()


def _loaded(path: Path) -> dict[str, Any]:
    """The variables that scipy reads of a file."""
    found: Any = ValueError("reading it failed")
    for _ in range(2):  # a file read before may have harmed the first reader
        with LOCK:
            reader = _reader(os.getpid())
            assert reader.stdin is not None
            assert reader.stdout is not None
            try:
                reader.stdin.write(f"{str(path.absolute())!a}\n".encode())
                reader.stdin.flush()
                found = pickle.load(reader.stdout)
                break
            except BaseException as error:  # the next answer must not be this one
                _end(reader)
                if not isinstance(error, OSError | EOFError | pickle.UnpicklingError):
                    raise
    if isinstance(found, Exception):
        raise found
    return {name: value for name, value in found.items() if not name.startswith("__")}


def _in_array(value: Any, name: str) -> Iterator[tuple[str, Any]]:
    """The variables in what scipy makes of one."""
    from scipy.io.matlab import MatlabOpaque

    if isinstance(value, MatlabOpaque):
        about = value.ravel()[0]
        yield _decoded(about["s0"]), MatlabObject(_decoded(about["s2"]))
    elif not isinstance(value, np.ndarray):
        yield name, None
    elif value.dtype.names is not None:
        for number, struct in enumerate(value.ravel(order="F"), start=1):
            own = name if value.size == 1 else f"{name}({number})"
            for field in value.dtype.names:
                yield from _in_array(struct[field], f"{own}.{field}")
    elif value.dtype.kind == "O":
        for number, cell in enumerate(value.ravel(order="F"), start=1):
            yield from _in_array(cell, f"{name}{{{number}}}")
    elif value.dtype.kind == "U" and value.size < 2:
        yield name, "".join(value.ravel())
    else:
        yield name, value.squeeze()


def _in_npz(archive: Any, name: str) -> Iterator[tuple[str, Any]]:
    """The variables in an array of numpy: itself, or its fields; objects are none."""
    try:
        array = archive[name]
    except ValueError:  # objects of Python could run a program when they are read
        array = np.array(None)
    for field in array.dtype.names or ("",):
        yield f"{name}.{field}".rstrip("."), (array[field] if field else array).squeeze()


def _decoded(word: Any) -> str:
    return word.decode("utf-8", "backslashreplace") if isinstance(word, bytes) else str(word)


def _in_hdf5(entry: Any, name: str) -> Iterator[tuple[str, Any]]:
    """The variables in an entry of a file; links and what lies elsewhere are none."""
    import h5py

    kind = _decoded(entry.attrs.get("MATLAB_class", b""))
    if "MATLAB_object_decode" in entry.attrs:
        yield name, MatlabObject(kind)
    elif isinstance(entry, h5py.Group):
        for key in map(_decoded, entry):
            # Below # lies what cells and objects refer to.
            if not key.startswith("#") and isinstance(entry.get(key, getlink=True), h5py.HardLink):
                yield from _in_hdf5(entry[key], f"{name}.{key}".removeprefix("."))
    elif not isinstance(entry, h5py.Dataset) or entry.is_virtual or entry.external:
        yield name, None
    elif h5py.check_ref_dtype(entry.dtype) is h5py.Reference and kind in ("cell", ""):
        struct, _, field = name.rpartition(".")
        for number, place in enumerate(entry[()].T.ravel(order="F"), start=1):
            own = f"{name}{{{number}}}" if kind else f"{struct}({number}).{field}"
            yield from _in_hdf5(entry.file[place], own)
    else:
        for field in entry.dtype.names or ("",):
            yield f"{name}.{field}".rstrip("."), partial(_value, entry, kind, field)


def _value(entry: Any, kind: str, field: str) -> Any:
    """A data set as an array, or a text."""
    if "MATLAB_empty" in entry.attrs:
        return "" if kind == "char" else np.zeros(0)
    if entry.chunks:
        chunks = math.prod(-(-n // c) for n, c in zip(entry.shape, entry.chunks, strict=True))
        missing = entry.id.get_num_chunks() < chunks
    else:
        missing = entry.id.get_storage_size() < entry.nbytes
    if missing:  # HDF5 would make zeros of them
        raise ValueError(f"parts of {entry.name} are missing")
    values = entry[()].T
    if kind == "char":
        return values.astype("<u2").tobytes().decode("utf-16-le")
    return (values[field] if field else values).squeeze()


def _notes(variables: Variables, source: str) -> Sidecar:
    """The notes in the struct of that name; none if there is none."""
    from pilotid.recordings.sidecar import parsed

    plain: dict[str, Any] = {}
    for name, value in variables.items():
        root, *path = name.split(".")
        if root == NOTES:
            value = value() if callable(value) else value
            entry = value.tolist() if isinstance(value, np.ndarray) else value
            place = plain
            for key in path[:-1]:
                place = place.setdefault(key, {})
            place[path[-1] if path else "it is no struct"] = entry
    return parsed(plain, f"{source}, variable {NOTES}")


def _family(name: str) -> str:
    """The name that the members of an array have in common: ``data(2).u`` is of ``data.u``.

    Arrays of structs and cells hold runs; each is a variable of its own here.
    """
    return re.sub(r"\([0-9]+\)|\{[0-9]+\}", "", name)


def _members(
    variables: Variables, source: str, places: Mapping[str, roles.Place], part: str, *, timed: bool
) -> dict[str, list[str]]:
    """The variables of each signal, a member a run where they are many.

    Left of the variables are those of the part, and columns of matrices are added.
    """
    for name in [n for n in variables if n.partition(".")[0] == NOTES]:
        del variables[name]
    if part:
        _keep_part(variables, part, source)
    for place in places.values():  # columns of matrices, as in ``data:3``
        name, _, number = place.name.rpartition(":")
        if name in variables and number.isascii() and number.isdigit():
            variables[place.name] = partial(_column, variables[name], int(number))
    families: dict[str, list[str]] = {}
    for name in variables:
        families.setdefault(_family(name), []).append(name)
    try:
        found = roles.resolved(places, [*families], source, "variable", timed=timed)
    except InputError:
        for name, value in variables.items():
            if isinstance(value, MatlabObject):
                raise InputError(
                    f"{source}: variable {name} is a MATLAB {value.kind}, which only MATLAB reads: "
                    f"make matrices of it there, as in S = table2struct({name},'ToScalar',true); "
                    "save('F.mat','-struct','S'), a timetable by timetable2table first, a "
                    "timeseries by its Time and Data"
                ) from None
        raise
    return {signal: families[own] for signal, own in found.items()}


def _keep_part(variables: Variables, part: str, source: str) -> None:
    """Leave the variables in a struct, cell or group by their names there, and those beside it."""
    inside = {
        name.removeprefix(part).removeprefix("."): value
        for name, value in variables.items()
        if name.startswith((f"{part}.", f"{part}(", f"{part}{{"))
    }
    if not inside:
        there = dict.fromkeys(n.rpartition(".")[0] for n in variables if "." in n)
        raise InputError(
            f"{source}: has no part {shown(part)}, only {roles.listed(there)}; name one of them "
            "behind ::"
        )
    for name in sorted(variables, key=lambda name: -name.count(".")):
        above, _, last = name.rpartition(".")
        if f"{part}.".startswith(f"{above}." * bool(above)) and not re.search(r"[({]", last):
            inside.setdefault(last, variables[name])
    variables.clear()
    variables |= inside


def _column(value: Any, number: int) -> Any:
    """A column of a matrix, counted from 1."""
    matrix = np.atleast_2d(value() if callable(value) else value)
    table = matrix if len(matrix) >= matrix.shape[-1] else matrix.T  # more samples than columns
    return table[:, number - 1] if table.ndim == 2 and 0 < number <= table.shape[1] else None


def _array(value: Any, name: str, source: str) -> Any:
    """A variable as numbers, its shape as it is."""
    array = value() if callable(value) else value
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiub":
        raise InputError(
            f"{source}: variable {name} does not hold real numbers; save it as a full numeric "
            "matrix"
        )
    return np.atleast_1d(array if array.dtype.kind == "f" else array.astype(np.float64))


def _levels(variables: Variables, name: str, source: str) -> list[object]:
    """The values of a variable that has one for each run."""
    own = roles.only(name, [*dict.fromkeys(map(_family, variables))], source, "variable")
    values: list[object] = []
    for variable, value in variables.items():
        if _family(variable) == own:
            held = value() if callable(value) else value
            values += held.ravel().tolist() if isinstance(held, np.ndarray) else [held]
    return values
