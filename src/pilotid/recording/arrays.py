"""Recordings as named arrays: MATLAB, HDF5 and numpy files.

MATLAB's versions 4 and 5 are read by scipy in a process of their own, which a damaged file can end;
7.3 and other HDF5 files are read by h5py.
"""

from __future__ import annotations

import atexit
import os
import pickle
import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from subprocess import PIPE
from typing import Any

import numpy as np

from pilotid.recording.roles import Content, MatlabObject, listed, shown
from pilotid.recording.windows import sidecar_path
from pilotid.support.types import FloatArray, InputError

READER = """
import pickle, signal, sys, warnings
from scipy.io import loadmat
signal.signal(signal.SIGINT, signal.SIG_IGN)
warnings.simplefilter("ignore")
for path in map(eval, sys.stdin):
    try:
        content = loadmat(path)
    except Exception as error:
        content = error
    pickle.dump(content, sys.stdout.buffer, protocol=5)
    sys.stdout.buffer.flush()
"""
LOCK = threading.Lock()
HDF5 = b"\x89HDF\r\n\x1a\n"  # how v7.3 files begin, behind a header of 512 bytes
NOTES = "pilotid"  # the struct variable that holds what a CSV's sidecar holds
#: Variables by name, ``data(2).u`` and ``u{3}`` inside arrays of structs and cells: arrays, texts,
#: and None for what is none of these.
Variables = dict[str, Any]


def read_arrays(path: Path, source: str, part: str) -> Content:
    """What a file holds, or a part of it.

    Parameters
    ----------
    path, source
        The file, and its name in messages.
    part
        The struct or group that holds the recording, or the runs that are meant, as in
        ``sigma=17``; empty for all.

    Raises
    ------
    InputError
        If the file cannot be used.
    """
    from pilotid.recording.sidecar import parsed, read_sidecar

    variables = _read(path, source)
    facts: dict[str, Any] = {}
    for name in [n for n in variables if n.partition(".")[0] == NOTES]:
        value, place = variables.pop(name), facts
        *keys, last = name.split(".")[1:] or ["it is no struct"]
        for key in keys:
            place = place.setdefault(key, {})
        place[last] = value.tolist() if isinstance(value, np.ndarray) else value
    beside = path.suffix.lower() != ".mat" and sidecar_path(path).exists()
    families = {name: re.sub(r"\([0-9]+\)|\{[0-9]+\}", "", name) for name in variables}
    parts = dict.fromkeys(n.partition(".")[0] for n in families.values() if "." in n)
    if part and "=" not in part and part not in parts:
        what = f"has no part {shown(part)}, only {listed(parts)}"
        raise InputError(f"{source}: {what}; name one of them behind ::")

    def numbers(name: str) -> FloatArray:
        value = variables[name]
        if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiub":
            raise InputError(
                f"{source}: variable {name} does not hold real numbers; save it as a full numeric "
                "matrix"
            )
        return np.atleast_1d(value if value.dtype.kind == "f" else value.astype(np.float64))

    notes = read_sidecar(path) if beside else parsed(facts, f"{source}, variable {NOTES}")
    return Content("variable", source, variables, families, notes, numbers, part)


def _read(path: Path, source: str) -> Variables:
    """The variables of a file.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    suffix = path.suffix.lower()
    try:
        with path.open("rb") as stream:
            if suffix == ".npz":
                archive = np.load(stream, allow_pickle=False)
                return {name: _in_npz(archive, name) for name in archive.files}
            head = stream.read(520)
        if HDF5 in (head[:8], head[512:]):
            import h5py

            with h5py.File(path, "r") as file:
                return dict(_in_hdf5(file, ""))
        loaded = _loaded(path).items()
        return dict(pair for name, value in loaded for pair in _in_array(value, name))
    except Exception as error:  # what is damaged, or too large, fails in any way whatsoever
        kind, command = ("MATLAB", "save -v7") if suffix == ".mat" else (suffix, "numpy.savez")
        what = shown(f"{type(error).__name__}: {error}")[1:-1]
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
    with LOCK:
        reader = _reader(os.getpid())
        assert reader.stdin is not None
        assert reader.stdout is not None
        try:
            reader.stdin.write(f"{str(path.absolute())!a}\n".encode())
            reader.stdin.flush()
            content = pickle.load(reader.stdout)
        except BaseException:  # the next answer must not be this one
            _end(reader)
            raise
    if isinstance(content, Exception):
        raise content
    return {name: value for name, value in content.items() if not name.startswith("__")}


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
            place = name if value.size == 1 else f"{name}({number})"
            for field in value.dtype.names:
                yield from _in_array(struct[field], f"{place}.{field}")
    elif value.dtype.kind == "O":
        for number, cell in enumerate(value.ravel(order="F"), start=1):
            yield from _in_array(cell, f"{name}{{{number}}}")
    elif value.dtype.kind == "U" and value.size < 2:
        yield name, "".join(value.ravel())
    else:
        yield name, value.squeeze()


def _in_npz(archive: Any, name: str) -> Any:
    """An array of numpy; None for objects of Python, which could run a program when read."""
    try:
        return archive[name].squeeze()
    except ValueError:
        return None


def _decoded(word: Any) -> str:
    return word.decode("utf-8", "backslashreplace") if isinstance(word, bytes) else str(word)


def _in_hdf5(entry: Any, name: str) -> Iterator[tuple[str, Any]]:
    """The variables in an entry of a file."""
    import h5py

    kind = _decoded(entry.attrs.get("MATLAB_class", b""))
    if "MATLAB_object_decode" in entry.attrs:
        yield name, MatlabObject(kind)
    elif isinstance(entry, h5py.Group):
        for key in map(_decoded, entry):
            if not key.startswith("#"):  # there lies what cells and objects refer to
                yield from _in_hdf5(entry[key], f"{name}.{key}".removeprefix("."))
    elif not isinstance(entry, h5py.Dataset):
        yield name, None
    elif h5py.check_ref_dtype(entry.dtype) is h5py.Reference and kind in ("cell", ""):
        struct, _, field = name.rpartition(".")
        for number, place in enumerate(entry[()].T.ravel(order="F"), start=1):
            inside = f"{name}{{{number}}}" if kind else f"{struct}({number}).{field}"
            yield from _in_hdf5(entry.file[place], inside)
    elif kind == "char":
        text = b"" if "MATLAB_empty" in entry.attrs else entry[()].T.astype("<u2").tobytes()
        yield name, text.decode("utf-16-le")
    else:
        yield name, np.zeros(0) if "MATLAB_empty" in entry.attrs else entry[()].T.squeeze()
