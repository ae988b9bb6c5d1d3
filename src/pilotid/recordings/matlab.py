"""MATLAB and HDF5 files: the variables in them, and recordings written as such files.

Versions 4 and 5 are read by scipy in a process of their own, which a damaged file can end; 7.3 and
other HDF5 files are read by h5py.
"""

from __future__ import annotations

import atexit
import io
import os
import pickle
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache, partial
from itertools import product, repeat
from pathlib import Path
from typing import Any

import numpy as np

from pilotid.recordings.contents import Notes, common_run
from pilotid.recordings.recording import Recording
from pilotid.recordings.variables import NOTES, MatlabObject, Variables

#: A damaged file can end the process in which scipy reads it, so that it is one of its own,
#: which lives for a minute after it was asked last.
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


@contextmanager
def opened(path: Path) -> Iterator[Variables]:
    """The variables of a MATLAB or HDF5 file."""
    with path.open("rb") as stream:
        head = stream.read(520)
    if HDF5 in (head[:8], head[512:]):
        import h5py

        with h5py.File(path, "r") as file:
            yield dict(_in_group(file, ""))
    else:
        content = {n: v for n, v in _loaded(path).items() if not n.startswith("__")}
        yield dict(pair for name, value in content.items() for pair in _in_array(value, name))


@cache
def _reader(owner: int) -> subprocess.Popen[bytes]:
    """The process that reads for the one with this id; one that was forked has another."""
    pipe, command = subprocess.PIPE, [sys.executable, "-P", "-c", READER]
    reader = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL)
    atexit.register(_end, reader)
    return reader


def _end(reader: subprocess.Popen[bytes]) -> None:
    reader.kill()
    reader.communicate()


def _answer(path: Path) -> object:
    """What scipy reads of a file, or what it raises; None if that ended its process."""
    reader = _reader(os.getpid())
    assert reader.stdin is not None
    assert reader.stdout is not None
    try:
        reader.stdin.write(f"{str(path.absolute())!a}\n".encode())
        reader.stdin.flush()
        return pickle.load(reader.stdout)
    except BaseException as error:  # when interrupted, the next answer must not be this one
        _end(reader)
        _reader.cache_clear()
        if isinstance(error, OSError | EOFError | pickle.UnpicklingError):
            return None
        raise


def _loaded(path: Path) -> dict[str, Any]:
    """The variables that scipy reads of a file."""
    with LOCK:
        found = _answer(path) or _answer(path)  # a file read before may have harmed the first
    if isinstance(found, Exception):
        raise found
    if not isinstance(found, dict):
        raise ValueError("reading it failed")
    return found


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
    elif entry.dtype.names and set(entry.dtype.names) != {"real", "imag"}:  # complex numbers
        for field in entry.dtype.names:
            yield f"{name}.{field}", partial(_field, entry, field)
    else:
        is_usual = h5py.h5t.py_create(entry.dtype).equal(entry.id.get_type())
        yield (
            name,
            partial(_value, entry, kind) if entry.dtype.kind in "fiub" and is_usual else None,
        )


def _field(entry: Any, field: str) -> Any:
    """A column of a table."""
    values = _value(entry, "")
    return values[field] if values[field].dtype.kind in "fiub" else None


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
        values = recording.input(signal)
        variables[signal] = (values if signal in ("e", "u", "x") else common_run(values)).T
    stream = io.BytesIO()
    savemat(stream, variables)  # type: ignore[arg-type]  # the stub forgets streams
    return stream.getvalue()
