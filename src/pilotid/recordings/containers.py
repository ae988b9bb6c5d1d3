"""Files that hold named variables: MATLAB, HDF5 and numpy."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pilotid.recordings import matlab
from pilotid.recordings.contents import Contents, Parts, Place, shown
from pilotid.recordings.variables import Variables, contents_of
from pilotid.support.disk import require_file
from pilotid.support.types import InputError

LARGEST_FILE = 2**32  # bytes


def read_container(
    path: Path, source: str, places: Mapping[str, Place], parts: Parts, *, timed: bool
) -> Contents:
    """What a file holds.

    Parameters
    ----------
    path, source
        The file, and its name in messages.
    places
        Where it keeps each signal.
    parts
        Which part of it is meant.
    timed
        Whether the sampling interval is known, so that no times are needed.
    """
    require_file(path, LARGEST_FILE)
    suffix = path.suffix.lower()
    try:
        with _opened(path, suffix, source) as variables:
            return contents_of(variables, source, places, parts, timed=timed)
    except InputError:
        raise
    except MemoryError:
        raise InputError(
            f"{source}: takes too much memory; save t, e, u, x in a file of their own"
        ) from None
    except Exception as error:  # what is damaged fails in any way whatsoever
        kind, command = ("MATLAB", "save -v7") if suffix == ".mat" else (suffix, "numpy.savez")
        what = shown(f"{type(error).__name__}: {error}")[1:-1]
        raise InputError(
            f"{source}: is no {kind} file, damaged or cut short ({what}); save it again with "
            f"{command}"
        ) from None


@contextmanager
def _opened(path: Path, suffix: str, source: str) -> Iterator[Variables]:
    """The variables of a file."""
    if suffix == ".npz":
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
            yield dict(pair for name in archive.files for pair in _in_npz(archive, name, source))
    else:
        with matlab.opened(path) as variables:
            yield variables


def _in_npz(archive: Any, name: str, source: str) -> Iterator[tuple[str, Any]]:
    """The variables in an array of numpy: itself, or its fields."""
    try:
        array = archive[name]
    except ValueError:
        yield name, partial(_refuse_objects, name, source)
        return
    for field in array.dtype.names or ("",):
        own = array[field] if field else array
        text = str(own.item()) if own.dtype.kind == "U" and own.size == 1 else None
        yield f"{name}.{field}".rstrip("."), own.squeeze() if own.dtype.kind in "fiub" else text


def _refuse_objects(name: str, source: str) -> None:
    """Objects of Python could run a program when they are read."""
    raise InputError(
        f"{source}: variable {shown(name)} holds objects of Python, which are not read because "
        "they can run programs; save it as an array of numbers"
    )
