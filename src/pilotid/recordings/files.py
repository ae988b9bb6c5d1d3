"""Recordings on disk: how files are read, whatever their format, and written."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from pilotid.recordings.contents import (
    Notes,
    Parts,
    assembled,
    shown,
    signal_places,
)
from pilotid.recordings.recording import LEAD_IN, Recording, joined
from pilotid.recordings.text import csv_bytes, read_sidecar, read_text, sidecar_path
from pilotid.recordings.windows import (
    chosen_runs,
    file_and_parts,
    file_of,
    span_of,
    spanned,
    whole_periods,
)
from pilotid.support.disk import path_shown, write_file
from pilotid.support.types import InputError

TEXTS = (".csv", ".txt", ".tsv", ".dat")
READ = (*TEXTS, ".mat", ".h5", ".hdf5", ".hdf", ".npz")
WRITTEN = (".csv", ".mat")


def parse_mapping(text: str) -> dict[str, str]:
    """The mapping in a text such as ``u=-stick,e=err``.

    Parameters
    ----------
    text
        Pairs of our signal name and the file's name for it; a minus before
        the file's name flips the sign.

    Raises
    ------
    InputError
        For anything but such pairs, an unknown signal, or one given twice.
    """
    mapping: dict[str, str] = {}
    for pair in text.split(","):
        signal, equals, name = (part.strip() for part in pair.partition("="))
        if not equals:
            raise InputError(
                f"the mapping {shown(text)} has {shown(pair)} where SIGNAL=NAME is wanted; write "
                "for example u=stick,e=err"
            )
        if signal in mapping:
            raise InputError(f"the mapping {shown(text)} gives {signal} twice; give it once")
        mapping[signal] = name
    signal_places(mapping)
    return mapping


def load_recording(
    path: str | os.PathLike[str],
    mapping: Mapping[str, str] | None = None,
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
        with a leading minus to flip the sign; by other names, extra signals.
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
    source = path_shown(path)
    file, names = file_and_parts(path)
    suffix, places, parts = _suffix(file, source, READ), signal_places(mapping), Parts.of(names)
    try:
        if suffix in TEXTS:
            contents = read_text(file, source, places, parts, timed=dt is not None)
        else:
            from pilotid.recordings.containers import read_container

            notes = Notes() if suffix == ".mat" else read_sidecar(file)
            timed = dt is not None or notes.dt is not None
            contents = read_container(file, source, places, parts, timed=timed)
            if notes.where:
                contents = replace(contents, notes=notes)
    except OSError as error:
        raise InputError(
            f"{path_shown(error.filename or source)}: cannot be read ({error.strerror or error}); "
            "check the file and its rights"
        ) from error
    recording = assembled(contents, source, dt)
    return whole_periods(recording) if periods and contents.notes.run_in is None else recording


def save_recording(recording: Recording, path: str | os.PathLike[str]) -> None:
    """Write a recording such that `load_recording` restores it to the bit.

    Parameters
    ----------
    recording
        What to write.
    path
        The file, .csv (a sidecar .json is written beside it) or .mat.  Each is
        complete or not there: it is written under another name and then renamed.

    Raises
    ------
    InputError
        If the format is unknown or the file cannot be written.
    """
    source = path_shown(path)
    file = Path(path)
    files = {}
    if _suffix(file, source, WRITTEN) == ".csv":
        files[file], files[sidecar_path(file)] = csv_bytes(recording, source)
    else:
        from pilotid.recordings.matlab import mat_bytes

        files[file] = mat_bytes(recording, source)
    for target, content in files.items():
        write_file(target, content)


def _suffix(file: Path, source: str, known: Collection[str]) -> str:
    suffix = file.suffix.lower()
    others = "" if known == WRITTEN else f", or one of {' '.join(READ[1:])}"
    if suffix not in known:
        raise InputError(
            f"{source}: a recording must be a .csv or a .mat file{others}; convert it to one"
        )
    return suffix


def read_with(files: Sequence[Path]) -> list[Path]:
    """Recordings, and the files beside them that belong to them."""
    real = [file for file in map(file_of, files) if file.name]
    beside = ((file, sidecar_path(file), file.with_suffix(".truth.json")) for file in real)
    return [path for own in beside for path in own]


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

    mapping: tuple[str, ...] = ()
    dt: float | None = None
    detrend: bool = False
    lead_in: float = LEAD_IN
    runs: str = ""
    span: str = ""

    @property
    def names(self) -> dict[str, str] | None:
        """The file's names by our signals; None for our own."""
        return parse_mapping(",".join(self.mapping)) if self.mapping else None

    def one(self, file: Path) -> Recording:
        """The recording in a file."""
        if self.dt is not None and not 0.0 < self.dt < 1.0:
            raise InputError(f"--dt {self.dt:g}: give seconds between samples, as in --dt 0.01")
        recording = load_recording(file, self.names, self.dt, periods=not self.span)
        recording = replace(recording, lead_in=self.lead_in)
        if self.span:
            recording = spanned(recording, *span_of(self.span))
        return detrended(recording) if self.detrend else recording

    def all(self, files: Sequence[Path], *, joint: bool) -> tuple[list[Recording], list[str]]:
        """The recordings in files, as one if they are runs of one, and why others are refused.

        One bad file of several does not cost the others; where none is good, or all are runs of
        one recording, there is nothing to go on with.
        """
        recordings, refused = [], []
        together = joint and len(files) > 1
        for file in files:
            try:
                recording = self.one(file)
                if self.runs and not together:
                    recording = chosen_runs(recording, self.runs)
                recordings.append(recording)
            except InputError as error:
                if joint or len(files) == 1:
                    raise
                refused.append(str(error))
        if not recordings:
            raise InputError("; ".join(refused))
        if together:
            whole = joined(recordings)
            recordings = [chosen_runs(whole, self.runs) if self.runs else whole]
        return recordings, refused


def detrended(recording: Recording) -> Recording:
    """The recording with a straight line taken out of the control of each run.

    The line is that of least squares over the measurement window.  It takes with it what the
    pilot himself did so slowly; `Recording.treatment` tells what was taken.
    """
    time = recording.time
    inside = time[recording.run_in :]
    window = recording.window(recording.u)
    centred = inside - inside.mean()
    slope = (window @ centred) / float(centred @ centred)
    mean = window.mean(axis=1)
    line = mean[:, None] + slope[:, None] * (time - inside.mean())
    gained = ", ".join(f"{s * recording.duration:.3g}" for s in slope)
    where = "run" if recording.runs == 1 else "runs"
    words = (
        f"a straight line was taken out of u, which gained {gained} over the {where} and was "
        f"{', '.join(f'{m:.3g}' for m in mean)} in the mean"
    )
    return replace(recording, u=recording.u - line, treatment=(*recording.treatment, words))
