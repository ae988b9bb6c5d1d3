"""Recordings on disk: CSV with an optional sidecar, and MATLAB files."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping
from pathlib import Path

from pilotid.disk import write_file
from pilotid.recordings.contents import assembled
from pilotid.recordings.csv import csv_bytes, read_csv, sidecar_path
from pilotid.recordings.mat import mat_bytes, read_mat
from pilotid.recordings.names import shown, signal_places
from pilotid.recordings.paths import path_shown
from pilotid.recordings.recording import Recording
from pilotid.types import InputError

READERS = {
    **dict.fromkeys((".csv", ".txt", ".tsv", ".dat"), read_csv),
    ".mat": read_mat,
}
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
) -> Recording:
    """Read a recording from a CSV or MATLAB file.

    Parameters
    ----------
    path
        The file; its suffix tells the format.
    mapping
        The file's names for our signals t, e, u, x, ft, fd where they differ,
        with a leading minus to flip the sign.
    dt
        Sampling interval [s], for a file without times.

    Raises
    ------
    InputError
        If the file cannot be used; the message says where it goes wrong.
    """
    source = path_shown(path)
    file = Path(path)
    reader = READERS[_suffix(file, source, READERS)]
    places = signal_places(mapping)
    try:
        contents = reader(file, source, places, timed=dt is not None)
    except OSError as error:
        raise InputError(
            f"{path_shown(error.filename or source)}: cannot be read ({error.strerror or error}); "
            "check the file and its rights"
        ) from error
    return assembled(contents, source, dt)


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
        files[file] = mat_bytes(recording, source)
    for target, content in files.items():
        write_file(target, content)


def _suffix(file: Path, source: str, known: Collection[str]) -> str:
    suffix = file.suffix.lower()
    if suffix not in known:
        raise InputError(f"{source}: a recording must be a .csv or a .mat file; convert it to one")
    return suffix
