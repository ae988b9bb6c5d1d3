"""Recordings on disk: how files are read, whatever their format, and written."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pilotid.recording import windows
from pilotid.recording.contents import read_arrays, read_table
from pilotid.recording.recording import SIGNALS, Recording, factor_of, joined, require_extra_name
from pilotid.support.disk import path_shown, require_file, require_suffix, table_bytes, write_file
from pilotid.support.types import InputError

READ = {
    **dict.fromkeys((".csv", ".txt", ".tsv", ".dat"), read_table),
    **dict.fromkeys((".mat", ".h5", ".hdf5", ".hdf", ".npz"), read_arrays),
}


def load_recording(
    path: str | os.PathLike[str],
    mapping: Mapping[str, str] | str | None = None,
    dt: float | None = None,
    *,
    periods: bool = True,
) -> Recording:
    """Read a recording from a file: text, MATLAB, HDF5 or numpy.

    Parameters
    ----------
    path
        The file; its suffix tells the format.  A part of one is named behind it, as in
        ``F.mat::identification``, and runs by the value of a variable, as in ``F.mat::sigma=17``.
    mapping
        The file's names for our signals t, e, u, x, ft, fd where they differ,
        with a leading minus to flip the sign; by other names, extra signals.  A mapping, or a
        text such as ``u=-stick,e=err``.
    dt
        Sampling interval [s], for a file without times.
    periods
        Whether the window is cut to whole periods of the forcing functions where these repeat
        themselves, and the file does not say how long its run-in is; `Recording.treatment` tells.

    Raises
    ------
    InputError
        If the file cannot be used; the message says where it goes wrong.
    """
    from pilotid.recording.roles import Content, read_sidecar, recording_of  # heavy: pydantic

    source = path_shown(path)
    file, part = windows.file_and_part(path)
    require_file(file)
    places, notes = _places_of(mapping or {}), read_sidecar(file)
    places = {name: (1.0, name) for name in notes.extra} | places
    stated = [interval for interval in (notes.dt, dt) if interval is not None]
    suffix = require_suffix(file, source, READ, "convert it to a .csv or a .mat file")
    variables = [*READ[suffix](file, source)]
    with np.errstate(all="ignore"):  # files may hold anything
        recording = recording_of(Content(source, variables, part, notes, places, stated))
    cut = periods and notes.run_in is None
    return windows.whole_periods(recording) if cut else recording


def _places_of(mapping: Mapping[str, str] | str) -> dict[str, tuple[float, str]]:
    """A factor and a name in the file by signal; what is none of ours is an extra signal."""
    pairs = mapping.split(",") if isinstance(mapping, str) else map("=".join, mapping.items())
    places: dict[str, tuple[float, str]] = {}
    for pair in pairs:
        signal, _, choice = (text.strip() for text in pair.partition("="))
        if signal not in ("t", *SIGNALS):
            require_extra_name(signal)
        factor, name = factor_of(choice)
        if signal in places or not (name and np.isfinite(factor) and factor):
            raise InputError(
                f"the mapping {pair!r:.50} names nothing, or {signal} a second time; write each "
                "once, SIGNAL=NAME or SIGNAL=-3.5*NAME"
            )
        places[signal] = factor, name
    return places


def save_recording(recording: Recording, path: str | os.PathLike[str]) -> None:
    """Write a recording such that `load_recording` restores it to the bit.

    Parameters
    ----------
    recording
        What to write.
    path
        The file, .csv, .mat or .npz; a sidecar .json is written beside it.  Each is complete or
        not there: it is written under another name and then renamed.

    Raises
    ------
    InputError
        If the format is unknown or the file cannot be written.
    """
    from pilotid.recording.roles import Sidecar, parsed

    source, file = path_shown(path), Path(path)
    suffix = require_suffix(file, source, (".csv", ".mat", ".npz"), "name a file that does")
    known = {**recording.to_dict(), "extra": [*recording.extra]}
    notes = parsed(json.dumps({name: known[name] for name in Sidecar.model_fields}), source)
    signals = {name: recording.input(name).T for name in recording.signals}
    columns: dict[str, Any] = {"t": recording.time, **signals}
    stream = io.BytesIO()
    if suffix == ".mat":
        from scipy.io import savemat  # heavy, and the others do not need it

        savemat(stream, columns, oned_as="column")  # type: ignore[arg-type]
    elif suffix == ".npz":
        np.savez_compressed(stream, **columns)
    else:
        cells = {"t": [f"{t:.12g}" for t in recording.time.tolist()]}
        for name, samples in signals.items():
            for run, column in enumerate(samples.T.tolist(), start=1):
                cells[f"{name}_{run}" if recording.runs > 1 else name] = column
        stream.write(table_bytes([*cells], zip(*cells.values(), strict=True)))
    write_file(file, stream.getvalue())
    text = notes.model_dump_json(indent=2, exclude_defaults=True)
    write_file(windows.sidecar_path(file), f"{text}\n".encode())


def read_with(files: Sequence[Path]) -> list[Path]:
    """Recordings, and the files beside them that belong to them."""
    real = [file for file in map(windows.file_of, files) if file.name]
    return [f for r in real for f in (r, windows.sidecar_path(r), r.with_suffix(".truth.json"))]


@dataclass(frozen=True)
class Reading:
    """How files are read.

    Attributes
    ----------
    mapping
        Texts such as ``u=stick,e=err``.
    dt
        Sampling interval of files without times [s].
    detrend
        Whether a straight line is taken out of the control.
    lead_in
        See `Recording.lead_in`.
    runs, span
        Texts such as ``2-5`` and ``0:41``, empty for all of a recording.
    """

    mapping: Sequence[str] = ()
    dt: float | None = None
    detrend: bool = False
    lead_in: float = Recording.lead_in
    runs: str = ""
    span: str = ""

    def one(self, file: Path) -> Recording:
        """The recording in a file."""
        recording = load_recording(file, ",".join(self.mapping), self.dt, periods=not self.span)
        recording = replace(recording, lead_in=self.lead_in)
        if self.span:
            recording = recording.cut(*windows.span_of(self.span))
        recording = detrended(recording) if self.detrend else recording
        return windows.chosen_runs(recording, self.runs) if self.runs else recording

    def all(self, files: Sequence[Path], *, joint: bool) -> tuple[dict[Path, Recording], list[str]]:
        """The recordings in files, as one if they are runs of one, and why others are refused.

        One bad file of several does not cost the others; where none is good, or all are runs of
        one recording, there is nothing to go on with.
        """
        if joint and len(files) > 1:
            whole = joined(replace(self, runs="").one(file) for file in files)
            return {files[0]: windows.chosen_runs(whole, self.runs) if self.runs else whole}, []
        recordings, refused = dict[Path, Recording](), list[str]()
        for file in files:
            try:
                recordings[file] = self.one(file)
            except InputError as error:
                refused.append(str(error))
        if not recordings:
            raise InputError("; ".join(refused))
        return recordings, refused


def detrended(recording: Recording) -> Recording:
    """The recording with a straight line taken out of the control of each run.

    The line is that of least squares over the measurement window.  It takes with it what the
    pilot himself did so slowly; `Recording.treatment` tells of it.
    """
    time, window = recording.time, recording.window(recording.u)
    slope, level = np.polyfit(time[recording.run_in :], window.T, 1)
    line = np.outer(slope, time) + level[:, np.newaxis]
    words = "a straight line was taken out of u in each run"
    return replace(recording, u=recording.u - line, treatment=(*recording.treatment, words))
