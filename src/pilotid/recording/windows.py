"""Parts of recordings: whole periods of the forcing functions, spans and runs that users choose.

A laboratory fades its forcing functions in, waits, or stops a little late.  Where a forcing
function repeats itself exactly, the window that holds whole periods of it is known.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from pilotid.recording.recording import SHORTEST, Recording
from pilotid.recording.spectra import FEWEST_LINES, NotMultisineError, forcing_lines
from pilotid.support.remarks import Remark
from pilotid.support.types import BoolArray, FloatArray, InputError

SHORTEST_PERIOD = 4.0  # seconds
REPEATED = 2.0  # seconds that must come again
EXACT = 0.01  # root mean squares by which a repetition may differ
ALIKE = 0.6  # of the squares of two stretches is their difference, where a period is looked for
CANDIDATES = 12
NEAR = 3  # samples about each


def whole_periods(recording: Recording) -> Recording:
    """A recording whose window is cut to whole periods of its forcing functions.

    It stays as it is where the window holds whole periods already, and where no forcing function
    is known, or none repeats itself exactly and is a sum of sines then.
    """
    try:
        forcing_lines(recording)
        return recording
    except NotMultisineError:
        window = _periods(recording)
    if window is None:
        return recording
    first, period, count = window
    start, end = first * recording.dt, (first + count * period) * recording.dt
    try:
        cut = recording.cut(start, end)
        if sum(lines.size for lines in forcing_lines(cut).values()) < FEWEST_LINES:
            return recording
    except (NotMultisineError, InputError):
        return recording
    note = Remark(
        "preprocessed",
        f"the window is {start:.4g} to {end:.4g} s of {recording.duration:.4g} s: {count} x "
        f"{period * recording.dt:.4g} s, whole periods of the forcing functions; what lies before "
        "is run-in (--span chooses another)",
    )
    return replace(cut, source=recording.source, treatment=(*recording.treatment, note))


def _periods(recording: Recording) -> tuple[int, int, int] | None:
    """First sample, samples of a period and number of periods; None if nothing repeats itself."""
    signals = _moving(recording)
    samples = recording.samples
    shortest, repeated = (round(t / recording.dt) for t in (SHORTEST_PERIOD, REPEATED))
    windows = []
    for place in _candidates(signals, shortest, samples - repeated):
        # A ramp moves the delay of the best likeness by a sample.
        near = range(max(shortest, place - NEAR), min(samples - repeated, place + NEAR) + 1)
        repetitions = [longest_run(_differences(signals, delay) <= EXACT) for delay in near]
        (first, length), period = max(zip(repetitions, near, strict=True), key=lambda r: r[0][1])
        count = (length + period) // period
        if length >= repeated and count * period * recording.dt >= SHORTEST:
            # The excess goes before the window, down to a whole second.
            latest = first + length + period - count * period
            second = round(math.floor(latest * recording.dt) / recording.dt)
            windows.append((second if second >= first else latest, period, count))
    return max(windows, key=lambda window: (window[1] * window[2], -window[1]), default=None)


def _differences(signals: FloatArray, delay: int) -> FloatArray:
    """The largest difference of signals and themselves after a delay, shape (samples - delay,)."""
    return np.asarray(np.abs(signals[:, delay:] - signals[:, :-delay]).max(axis=0))


def _moving(recording: Recording) -> FloatArray:
    """The different forcing functions that move, of unit size, shape (functions, samples)."""
    forcing = [s for s in (recording.ft, recording.fd) if s is not None]
    rows = np.unique(recording.window(np.concatenate([recording.u[:0], *forcing])), axis=0)
    sizes = rows.std(axis=1, keepdims=True)
    moving = sizes[:, 0] > 1e-9 * sizes.max(initial=0.0)
    return np.asarray(rows[moving] / sizes[moving])


def _candidates(signals: FloatArray, shortest: int, longest: int) -> list[int]:
    """Delays after which signals are most like themselves, the most alike first."""
    samples = signals.shape[1]
    spectra = np.fft.rfft(signals, 2 * samples)
    products = np.fft.irfft(np.abs(spectra) ** 2, 2 * samples)[:, :samples].sum(axis=0)
    squares = np.concatenate([[0.0], np.cumsum((signals**2).sum(axis=0))])
    delays = np.arange(samples)
    total = squares[samples - delays] + squares[-1] - squares[delays]
    unlike = 1.0 - 2.0 * products / np.maximum(total, 1e-300)
    inner = unlike[1:-1]
    lowest = (inner <= unlike[:-2]) & (inner <= unlike[2:]) & (inner < ALIKE)
    places = 1 + np.flatnonzero(lowest)
    places = places[(places >= shortest) & (places <= longest)]
    return [int(p) for p in places[np.argsort(unlike[places], kind="stable")][:CANDIDATES]]


def longest_run(mask: BoolArray) -> tuple[int, int]:
    """Where the longest run of true entries begins, and its length."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    if not edges.size:
        return 0, 0
    lengths = edges[1::2] - edges[::2]
    longest = int(np.argmax(lengths))
    return int(edges[2 * longest]), int(lengths[longest])


#: What stands between a file and the part of it that is meant.
INSIDE = "::"


def file_and_part(path: str | os.PathLike[str]) -> tuple[Path, str]:
    """The file of a path such as ``F.mat::identification``, and the name of the part."""
    file, _, part = str(path).partition(INSIDE)
    return (Path(file), part) if file and part and not os.path.exists(path) else (Path(path), "")


def file_of(path: str | os.PathLike[str]) -> Path:
    """The file of a path such as ``F.mat::identification``."""
    return file_and_part(path)[0]


def sidecar_path(path: Path) -> Path:
    """The notes beside a file: F.json for F.csv."""
    return path.with_suffix(".json")


def stem_of(path: str | os.PathLike[str]) -> str:
    """The name of a recording: that of its file without the suffix, and of the part."""
    file, part = file_and_part(path)
    return f"{file.stem}{INSIDE}{part}" if part else file.stem


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
        match = re.fullmatch(r"\s*(\d+)\s*(?:-\s*(\d+)\s*)?", part, re.ASCII)
        first, last = (int(match[1]), int(match[2] or match[1])) if match else (1, 0)
        if not 1 <= first <= last <= recording.runs:
            raise InputError(
                f"--runs {text}: '{part}' names no runs of {recording.source}, which has "
                f"{recording.runs}; write for example 2-5 or 1,3"
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
