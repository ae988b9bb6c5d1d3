"""Recordings as named arrays: MATLAB, HDF5 and numpy files.

MATLAB's versions 4 and 5 are read by scipy in a process of their own, which a damaged file can end;
7.3 and other HDF5 files are read by h5py.
"""

from __future__ import annotations

import atexit
import json
import os
import pickle
import re
import sys
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from subprocess import DEVNULL, PIPE, Popen
from threading import Lock
from typing import Any

import numpy as np

from pilotid.recording.roles import Content, shown
from pilotid.recording.windows import sidecar_path
from pilotid.support.types import FloatArray, InputError

READER = """
import pickle, signal, sys
from scipy.io import loadmat
signal.signal(signal.SIGINT, signal.SIG_IGN)
for path in map(eval, sys.stdin):
    try:
        content = loadmat(path, squeeze_me=True, struct_as_record=False)
    except Exception as error:
        content = error
    pickle.dump(content, sys.stdout.buffer)
    sys.stdout.flush()
"""
LOCK = Lock()
NOTES = "pilotid"  # the struct variable that holds what a CSV's sidecar holds
OBJECT = {"<object: save it as matrices>": None}  # tables, time series


def read_arrays(path: Path, source: str, part: str) -> Content:
    """What a file holds.

    Parameters
    ----------
    path, source
        The file, and its name in messages.
    part
        See `Content`.

    Raises
    ------
    InputError
        If the file cannot be used.
    """
    from pilotid.recording.sidecar import parsed, read_sidecar

    try:
        variables = dict(_named(_content(path), ""))
        facts = _facts(variables)
    except Exception as error:  # what is damaged, or too large, fails in any way whatsoever
        what = shown(f"{type(error).__name__}: {error}")[1:-1]
        raise InputError(
            f"{source}: is damaged, too large or no {path.suffix} file ({what}); save t, e, u, x "
            "again, in MATLAB with save -v7"
        ) from None

    def arrays(name: str) -> list[FloatArray]:
        values = np.atleast_1d(variables[name])
        if values.dtype.kind not in "fiub":
            raise InputError(
                f"{source}: variable {name} does not hold real numbers; save a full numeric matrix"
            )
        return [values]

    notes = parsed(facts, f"{source}, variable {NOTES}")
    if path.suffix.lower() != ".mat" and sidecar_path(path).exists():
        notes = read_sidecar(path)
    families = {name: re.sub(r"\{[0-9]+\}", "", name) for name in variables}
    return Content("variable", source, families, notes, arrays, part)


def _facts(variables: dict[str, Any]) -> str:
    """The notes as JSON; they are taken out of the variables."""
    facts: dict[str, Any] = {}
    for name in [name for name in variables if name.partition(".")[0] == NOTES]:
        *keys, last = name.split(".")[1:] or ["it is no struct"]
        place = facts
        for key in keys:
            place = place.setdefault(key, {})
        place[last] = variables.pop(name)
    # An array is all that JSON does not know; an empty text is one.
    return json.dumps(facts, default=lambda a: a.tolist() if a.size or a.dtype.kind != "U" else "")


def _content(path: Path) -> dict[str, Any]:
    """What libraries make of a file; structs and groups are dictionaries, cells lists."""
    with path.open("rb") as stream:
        if path.suffix.lower() == ".npz":
            archive = np.load(stream)
            content = dict.fromkeys(archive.files)
            for name in content:
                with suppress(ValueError):  # an object of Python could run a program
                    content[name] = archive[name].squeeze()
            return content
    import h5py  # when it is needed

    if h5py.is_hdf5(path):
        with h5py.File(path, "r") as file:
            return dict(_in_hdf5(file))
    return {name: value for name, value in _loaded(path).items() if not name.startswith("__")}


def _named(value: Any, name: str) -> Iterator[tuple[str, Any]]:
    """The variables in one; in arrays of structs and cells by names such as ``data{2}.u``."""
    if hasattr(value, "_fieldnames"):  # of scipy
        value = {field: getattr(value, field) for field in value._fieldnames}
    elif type(value).__name__ == "MatlabOpaque":
        name, value = value.ravel()[0]["s0"].decode(errors="replace"), OBJECT
    elif isinstance(value, np.ndarray) and value.dtype.kind == "O":
        value = value.ravel(order="F").tolist()
    if isinstance(value, dict):
        for key, inside in value.items():
            yield from _named(inside, f"{name}.{key}".removeprefix("."))
    elif isinstance(value, list):
        for number, inside in enumerate(value, start=1):
            yield from _named(inside, f"{name}{{{number}}}")
    else:
        yield name, value


def _in_hdf5(entry: Any) -> Any:
    """What is in an entry of a file."""
    import h5py

    kind = entry.attrs.get("MATLAB_class", b"")
    if "MATLAB_object_decode" in entry.attrs:
        return OBJECT
    if isinstance(entry, h5py.Group):  # in one with # lies what cells and objects refer to
        return {str(key): _in_hdf5(entry[key]) for key in entry if str(key)[0] != "#"}
    if not isinstance(entry, h5py.Dataset):
        return None
    if h5py.check_ref_dtype(entry.dtype) is h5py.Reference and kind in (b"cell", b""):
        return [_in_hdf5(entry.file[place]) for place in entry[()].T.ravel(order="F")]
    if "MATLAB_empty" in entry.attrs:
        return "" if kind == b"char" else np.zeros(0)
    values = entry[()].T.squeeze()
    is_text = kind == b"char"
    return values.astype("<u2").tobytes().decode("utf-16-le") if is_text else values


@cache
def _reader(owner: int) -> Any:
    """The process that reads for the one with this id; one that was forked has another."""
    command = [sys.executable, "-PWignore", "-c", READER]
    reader = Popen(command, stdin=PIPE, stdout=PIPE, stderr=DEVNULL)
    atexit.register(reader.communicate)  # it ends when its input does
    return reader


def _loaded(path: Path) -> dict[str, Any]:
    """The variables that scipy reads of a file."""
    with LOCK:
        reader = _reader(os.getpid())
        try:
            reader.stdin.write(f"{str(path.absolute())!a}\n".encode())
            reader.stdin.flush()
            content: dict[str, Any] | Exception = pickle.load(reader.stdout)
        except BaseException:  # the next answer must not be this one
            _reader.cache_clear()
            reader.kill()
            reader.communicate()
            raise
    if isinstance(content, Exception):
        raise content
    return content
