"""Parts of files and of recordings: some of its runs, or a span of its time."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path

from pilotid.recordings.recording import Recording
from pilotid.support.types import InputError

#: What stands between a file and the part of it that is meant.
INSIDE = "::"


def file_and_parts(path: str | os.PathLike[str]) -> tuple[Path, list[str]]:
    """The file of a path such as ``F.mat::identification``, and the names of the part."""
    whole = Path(path)
    file, *parts = str(path).split(INSIDE)
    named = file and parts and not os.path.exists(whole)
    return (Path(file), parts) if named else (whole, [])


def file_of(path: str | os.PathLike[str]) -> Path:
    """The file of a path such as ``F.mat::identification``."""
    return file_and_parts(path)[0]


def stem_of(path: str | os.PathLike[str]) -> str:
    """The name of a recording: that of its file without the suffix, and of the part."""
    file, parts = file_and_parts(path)
    return INSIDE.join([file.stem, *parts])


def of_runs(recording: Recording, runs: Sequence[int], words: str) -> Recording:
    """Some runs of a recording, counted from 1."""
    rows = [run - 1 for run in runs]
    some = {name: signal[rows] for name, signal in recording.arrays.items()}
    return recording.with_arrays(some, source=f"{recording.source}, {words}")


def chosen_runs(recording: Recording, text: str) -> Recording:
    """The runs of a text such as ``2-5`` or ``1,3``.

    Raises
    ------
    InputError
        If the text is none, or names runs that there are not.
    """
    runs: list[int] = []
    for part in text.split(","):
        found = re.fullmatch(r"\s*(\d+)\s*(?:-\s*(\d+)\s*)?", part, re.ASCII)
        first, last = (int(found[1]), int(found[2] or found[1])) if found else (1, 0)
        if not 1 <= first <= last:
            raise InputError(f"--runs {text}: '{part}' names no runs; write for example 2-5 or 1,3")
        if last > recording.runs:
            raise InputError(
                f"--runs {text}: {recording.source} has no run {last}; it has {recording.runs}"
            )
        runs += range(first, last + 1)
    return of_runs(recording, list(dict.fromkeys(runs)), f"runs {text}")


def span_of(text: str) -> tuple[float, float]:
    """Start and end [s] in a text such as ``0:41``.

    Raises
    ------
    InputError
        If it is no span, or an empty one.
    """
    try:
        start, end = (float(part) for part in text.split(":"))
    except ValueError:
        start = end = 0.0
    if not 0.0 <= start < end < float("inf"):
        raise InputError(f"--span {text}: must be START:END in seconds of the window, as in 0:41")
    return start, end
