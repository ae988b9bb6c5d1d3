"""Recordings as MATLAB v5 files."""

from __future__ import annotations

import importlib
import io
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import ModuleType

import numpy as np

from pilotid.recordings.contents import Contents, Notes, common_run
from pilotid.recordings.names import NAMES, REQUIRED, Place, listed, shown
from pilotid.recordings.recording import SIGNALS, Recording
from pilotid.types import FloatArray, InputError

NOTES = "pilotid"  # the struct variable that holds what a CSV's sidecar holds


def read_mat(path: Path, source: str, places: Mapping[str, Place]) -> Contents:
    """Read a MATLAB v5 file, or a v7.3 one where mat73 is installed.

    Raises
    ------
    InputError
        With the variable that is wrong.
    OSError
        If the file cannot be read.
    """
    content = _loaded(path, source)
    notes = Notes()
    if NOTES in content:
        notes = Notes.parsed(_plain_notes(content.pop(NOTES)), f"{source}, variable {NOTES}")
    variables = dict(_flattened(content))
    names = _resolved(variables, places, source)
    t = _real(variables[names["t"]], names["t"], source)
    if t.ndim != 1:
        raise InputError(
            f"{source}: variable {names['t']} (time) is {_size(t)}; give one row or one column"
        )
    signals = {
        signal: places[signal].signed(_runs(variables[name], name, t.size, source))
        for signal, name in names.items()
        if signal != "t"
    }
    return Contents(
        places["t"].signed(t), signals, lambda i: f"sample {i + 1} of {names['t']}", notes
    )


def _loaded(path: Path, source: str) -> dict[str, object]:
    """The variables of a file: arrays with unit dimensions removed, structs as dictionaries."""
    with path.open("rb") as stream:
        head = stream.read(520)
    # The last two of the 128 bytes of a header tell the byte order, the two before the version.
    order = {b"IM": "little", b"MI": "big"}.get(head[126:128])
    version = head[125:126] if order == "little" else head[124:125]
    hdf = b"\x89HDF\r\n\x1a\n"
    try:
        if head.startswith(hdf) or head[512:520] == hdf:
            content = dict(_mat73(source).loadmat(str(path)))
        elif order is None or version != b"\x01":
            raise InputError(
                f"{source}: is not a MATLAB v5 file (v4 and text files are not read); save it "
                "again with save -v7"
            )
        else:
            from scipy.io import loadmat  # heavy, and CSV does not need it

            with warnings.catch_warnings():
                # A variable that we do not need may be unreadable; one that we need is checked.
                warnings.simplefilter("ignore")
                content = dict(loadmat(str(path), simplify_cells=True))
    except InputError:
        raise
    except Exception as error:  # a damaged file makes the readers fail in any way whatsoever
        raise InputError(
            f"{source}: the MATLAB file is damaged or cut short ({type(error).__name__} while "
            "reading it); save it again with save -v7"
        ) from error
    return {name: value for name, value in content.items() if not name.startswith("__")}


def _mat73(source: str) -> ModuleType:
    try:
        return importlib.import_module("mat73")
    except ImportError:
        raise InputError(
            f"{source}: is a MATLAB v7.3 file; save it with save -v7, or install pilotid[matlab]"
        ) from None


def _flattened(content: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, object]]:
    """All variables, those inside structs by their dotted names."""
    for name, value in content.items():
        if isinstance(value, dict):
            yield from _flattened(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def _resolved(
    variables: Mapping[str, object], places: Mapping[str, Place], source: str
) -> dict[str, str]:
    """The variable of each signal: at the top level, or else in the one struct with the rest."""
    wanted = {signal: place.name for signal, place in places.items()}
    absent = {s: wanted[s] for s in REQUIRED if wanted[s] not in variables}
    structs = dict.fromkeys(name.partition(".")[0] for name in variables if "." in name)
    holding = [
        struct
        for struct in structs
        if absent and all(_inside(variables, struct, name) for name in absent.values())
    ]
    if len(holding) > 1:
        picks = ",".join(f"{s}={_inside(variables, holding[0], n)[0]}" for s, n in absent.items())
        raise InputError(
            f"{source}: the structs {listed(holding)} all hold {listed(absent.values())}; pick "
            f"one, as in --map {picks}"
        )
    names: dict[str, str] = {}
    for signal, name in wanted.items():
        found = [name] if name in variables else []
        if not found and holding:
            found = _inside(variables, holding[0], name)
        if len(found) > 1:
            raise InputError(
                f"{source}: {signal} may be any of {listed(found)}; pick one, as in --map "
                f"{signal}={found[0]}"
            )
        if found:
            names[signal] = found[0]
        elif signal in REQUIRED or places[signal].chosen:
            raise InputError(
                f"{source}: has no variable {shown(name)} for {signal} ({NAMES[signal]}), only "
                f"{listed(variables)}; name the right one with --map {signal}=VARIABLE"
            )
    return names


def _inside(variables: Mapping[str, object], struct: str, name: str) -> list[str]:
    return [v for v in variables if v.startswith(f"{struct}.") and v.endswith(f".{name}")]


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


def _plain_notes(value: object) -> object:
    """The notes struct in the form of a sidecar: no arrays, lines always lists."""
    plain = _plain(value)
    if isinstance(plain, dict) and isinstance(plain.get("lines"), dict):
        plain["lines"] = {k: v if isinstance(v, list) else [v] for k, v in plain["lines"].items()}
    return plain


def _plain(value: object) -> object:
    if isinstance(value, dict):
        return {name: _plain(entry) for name, entry in value.items()}
    if isinstance(value, np.ndarray) and value.dtype.kind == "U" and value.size == 0:
        return ""  # how an empty text comes back
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


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
