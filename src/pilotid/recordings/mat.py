"""Recordings as MATLAB files."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pilotid.recordings.contents import Contents, Notes, common_run
from pilotid.recordings.mat_v5 import MatV5
from pilotid.recordings.mat_v73 import MatV73
from pilotid.recordings.mat_variables import Value, Variables
from pilotid.recordings.names import NAMES, REQUIRED, Place, listed, shown
from pilotid.recordings.paths import file_size
from pilotid.recordings.recording import SIGNALS, Recording
from pilotid.types import FloatArray, InputError

LARGEST_FILE = 2**32  # bytes; what is not needed is skipped
NOTES = "pilotid"  # the struct variable that holds what a CSV's sidecar holds


def read_mat(path: Path, source: str, places: Mapping[str, Place]) -> Contents:
    """Read a MATLAB v5 file, or a v7.3 one where h5py is installed.

    Raises
    ------
    InputError
        With the variable that is wrong.
    OSError
        If the file cannot be read.
    """
    file_size(path, LARGEST_FILE)
    variables = _opened(path, source)
    names = _resolved(variables, places, source)
    values = variables.read(tuple(names.values()), NOTES)
    notes = Notes()
    if any(name.partition(".")[0] == NOTES for name in values):
        notes = Notes.parsed(_plain_notes(values), f"{source}, variable {NOTES}")
    t = _real(values[names["t"]], names["t"], source)
    if t.ndim != 1:
        raise InputError(
            f"{source}: variable {names['t']} (time) is {_size(t)}; give one row or one column"
        )
    signals = {
        signal: places[signal].signed(_runs(values[name], name, t.size, source))
        for signal, name in names.items()
        if signal != "t"
    }
    return Contents(
        places["t"].signed(t), signals, lambda i: f"sample {i + 1} of {names['t']}", notes
    )


def _opened(path: Path, source: str) -> Variables:
    """The variables of a file of either version."""
    with path.open("rb") as stream:
        head = stream.read(520)
    hdf = b"\x89HDF\r\n\x1a\n"
    if head.startswith(hdf) or head[512:520] == hdf:
        return MatV73(path, source)
    # The last two of the 128 bytes of a header tell the byte order, the two before the version.
    order = {b"IM": "little", b"MI": "big"}.get(head[126:128])
    version = head[125:126] if order == "little" else head[124:125]
    if order is None or version != b"\x01":
        raise InputError(
            f"{source}: is not a MATLAB v5 file (v4 and text files are not read); save it "
            "again with save -v7"
        )
    return MatV5(path, source)


def _resolved(variables: Variables, places: Mapping[str, Place], source: str) -> dict[str, str]:
    """The variable of each signal: at the top level, or else in the one struct with the rest."""
    wanted = {signal: place.name for signal, place in places.items()}
    needed = [s for s, place in places.items() if s in REQUIRED or place.chosen]
    present = variables.names(deep=False)
    if any(wanted[signal] not in present for signal in needed):
        present = variables.names(deep=True)
    top = [name for name in present if name.partition(".")[0] != NOTES]
    known = set(top)
    absent = {s: wanted[s] for s in REQUIRED if wanted[s] not in known}
    structs: dict[str, list[str]] = {}
    for name in top:
        if "." in name:
            structs.setdefault(name.partition(".")[0], []).append(name)
    holding = [
        struct
        for struct, inside in structs.items()
        if absent and all(_ending(inside, name) for name in absent.values())
    ]
    if len(holding) > 1:
        first = structs[holding[0]]
        picks = ",".join(f"{s}={_ending(first, n)[0]}" for s, n in absent.items())
        raise InputError(
            f"{source}: the structs {listed(holding)} all hold {listed(absent.values())}; pick "
            f"one, as in --map {picks}"
        )
    names: dict[str, str] = {}
    for signal, name in wanted.items():
        found = [name] if name in known else []
        if not found and holding:
            found = _ending(structs[holding[0]], name)
        if len(found) > 1:
            raise InputError(
                f"{source}: {signal} may be any of {listed(found)}; pick one, as in --map "
                f"{signal}={found[0]}"
            )
        if found:
            names[signal] = found[0]
        elif signal in needed:
            raise InputError(
                f"{source}: has no variable {shown(name)} for {signal} ({NAMES[signal]}), only "
                f"{listed(top)}; name the right one with --map {signal}=VARIABLE"
            )
    return names


def _ending(names: list[str], name: str) -> list[str]:
    return [v for v in names if v.endswith(f".{name}")]


def _real(value: object, name: str, source: str) -> FloatArray:
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


def _runs(value: object, name: str, samples: int, source: str) -> FloatArray:
    """A signal with one row a run.  Nothing is transposed by guess."""
    array = _real(value, name, source)
    if array.ndim == 1 and array.size == samples:
        return array[np.newaxis]
    if array.ndim == 2 and array.shape[0] == samples:
        return array.T
    size = f"{array.size} samples long" if array.ndim == 1 else _size(array)
    raise InputError(
        f"{source}: variable {name} is {size} but the time has {samples} samples; store one column "
        "a run, one row a sample"
    )


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
    for signal in SIGNALS:
        values: FloatArray | None = getattr(recording, signal)
        if values is not None:
            variables[signal] = (common_run(values) if signal in ("ft", "fd") else values).T
    stream = io.BytesIO()
    savemat(stream, variables)  # type: ignore[arg-type]  # the stub forgets streams
    return stream.getvalue()
