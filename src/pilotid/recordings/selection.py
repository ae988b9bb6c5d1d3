"""Parts of a recording: some of its runs, or a span of its time."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

from pilotid.recordings.recording import SIGNALS, Recording
from pilotid.types import InputError


def of_runs(recording: Recording, runs: Sequence[int], words: str) -> Recording:
    """Some runs of a recording, counted from 1."""
    rows = [run - 1 for run in runs]
    signals = {name: getattr(recording, name) for name in SIGNALS}
    some = {name: signal[rows] for name, signal in signals.items() if signal is not None}
    return replace(recording, **some, source=f"{recording.source}, {words}")


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
