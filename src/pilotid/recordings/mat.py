"""Recordings as MATLAB files."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pilotid.recordings.contents import Contents, Notes, common_run
from pilotid.recordings.mat_signals import NOTES, as_runs, one_time, real, resolved
from pilotid.recordings.mat_v4 import MatV4, looks_like_v4
from pilotid.recordings.mat_v5 import MatV5
from pilotid.recordings.mat_v73 import MatV73
from pilotid.recordings.mat_variables import Value, Variables, family
from pilotid.recordings.names import Place
from pilotid.recordings.paths import file_size
from pilotid.recordings.recording import Recording
from pilotid.types import FloatArray, InputError

LARGEST_FILE = 2**32  # bytes; what is not needed is skipped


def read_mat(path: Path, source: str, places: Mapping[str, Place], *, timed: bool) -> Contents:
    """Read a MATLAB v4 or v5 file, or a v7.3 one where h5py is installed.

    Parameters
    ----------
    path, source
        The file, and its name in messages.
    places
        Where it keeps each signal.
    timed
        Whether the sampling interval is known, so that no variable of times is needed.

    Raises
    ------
    InputError
        With the variable that is wrong.
    OSError
        If the file cannot be read.
    """
    file_size(path, LARGEST_FILE)
    variables = _opened(path, source)
    notes = _notes(variables.read((), NOTES), source)
    members = resolved(variables, places, source, timed=timed or notes.dt is not None)
    values = variables.read([name for names in members.values() for name in names], "")
    arrays = {
        signal: [real(values[name], name, source) for name in names]
        for signal, names in members.items()
    }
    t, samples = None, _longest(arrays["u"][0])
    if "t" in arrays:
        t = one_time(arrays.pop("t"), members["t"], source)
        samples = t.size
    signals = {
        signal: places[signal].signed(as_runs(pieces, members[signal], samples, source))
        for signal, pieces in arrays.items()
    }
    origin = {
        signal: places[signal].shown(dict.fromkeys(map(family, names)))
        for signal, names in members.items()
    }
    first = members["t"][0] if "t" in members else ""
    where = f"sample {{}} of {first}".format
    return Contents(t, signals, lambda i: where(i + 1), notes, origin)


def _opened(path: Path, source: str) -> Variables:
    """The variables of a file of any version."""
    with path.open("rb") as stream:
        head = stream.read(520)
    hdf = b"\x89HDF\r\n\x1a\n"
    if head.startswith(hdf) or head[512:520] == hdf:
        return MatV73(path, source)
    # The last two of the 128 bytes of a header tell the byte order, the two before the version.
    order = {b"IM": "little", b"MI": "big"}.get(head[126:128])
    version = head[125:126] if order == "little" else head[124:125]
    if order is not None and version == b"\x01":
        return MatV5(path, source)
    if looks_like_v4(head):
        return MatV4(path, source)
    raise InputError(
        f"{source}: is not a MATLAB v5 file, nor a v4 or v7.3 one; save it again with save -v7"
    )


def _notes(values: Mapping[str, Value], source: str) -> Notes:
    """The notes in the struct of that name, if there is one."""
    if not values:
        return Notes()
    return Notes.parsed(_plain_notes(values), f"{source}, variable {NOTES}")


def _longest(array: FloatArray) -> int:
    """The number of samples where there is no time: recordings have more of them than runs."""
    return int(max(array.shape))


def _plain_notes(values: Mapping[str, Value]) -> object:
    """The notes struct in the form of a sidecar, lines always lists; None if it is in disorder."""
    plain: dict[str, Any] = {}
    for name, value in values.items():
        root, *path = name.split(".")
        if root != NOTES:
            continue
        entry = value.tolist() if isinstance(value, np.ndarray) else value
        if not path:
            return entry
        if path[0] == "lines" and len(path) > 1 and not isinstance(entry, list):
            entry = [entry]
        place = plain
        for key in path[:-1]:
            place = place.setdefault(key, {})
            if not isinstance(place, dict):
                return None
        if place.setdefault(path[-1], entry) is not entry:
            return None
    return plain


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
