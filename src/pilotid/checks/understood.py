"""What was understood of a recording, as plain data."""

from __future__ import annotations

from typing import Any

import numpy as np

from pilotid.checks.plant import plant_of
from pilotid.recording.recording import SIGNALS, Recording
from pilotid.recording.spectra import NotMultisineError, answers, lines_of

LACKING = {
    "e": "no model can be fitted",
    "x": "models with a channel on x cannot be fitted",
    "ft": "lines of a target are unknown",
    "fd": "lines of a disturbance are unknown",
}


def understood(recording: Recording) -> dict[str, Any]:
    """What was understood of a recording, as JSON has it.

    The keys are ``runs``, ``rate`` [Hz], ``duration`` and ``run_in`` [s] of the measurement window
    and before it; ``unscored``, the seconds at its beginning that methods in the time domain do
    not score; ``signals``, and ``missing`` with what that means; ``forcing``;
    ``element_coherence``, the mean squared coherence of x with u + fd, None if unknown; and
    ``controlled_element``, what the file says of it.

    A signal has ``name``, ``meaning``, ``origin`` (its name in the file, or what it follows from),
    ``unit``, and ``rms``, ``smallest`` and ``largest`` over the window of all runs.

    A forcing function has ``name``, ``lines`` (multiples of ``base``, 2 pi / T of the window in
    rad/s) with ``lowest`` and ``highest`` [rad/s]; ``given``, whether the file names the lines;
    ``answered``, at how many of them the control stands out of its noise, and the median
    ``coherence`` there, None where unknown; ``why`` there are no lines, empty if there are.
    """
    plant = plant_of(recording)
    run_in = recording.run_in * recording.dt
    return {
        "runs": recording.runs,
        "rate": 1.0 / recording.dt,
        "duration": recording.duration,
        "run_in": run_in,
        "unscored": max(0.0, recording.lead_in - run_in),
        "signals": [_signal(recording, name) for name in recording.signals],
        "missing": {n: why for n, why in LACKING.items() if n not in recording.signals},
        "forcing": [
            _forcing(recording, name)
            for name in ("ft", "fd")
            if getattr(recording, name) is not None or name in recording.lines
        ],
        "element_coherence": None if plant is None else plant.mean_coherence,
        "controlled_element": recording.controlled_element,
    }


def _signal(recording: Recording, name: str) -> dict[str, Any]:
    window = recording.window(recording.input(name))
    return {
        "name": name,
        "meaning": SIGNALS.get(name, "extra signal"),
        "origin": recording.origin.get(name, name),
        "unit": recording.units.get(name, ""),
        "rms": float(np.sqrt(np.mean(window**2))),
        "smallest": float(window.min()),
        "largest": float(window.max()),
    }


def _forcing(recording: Recording, name: str) -> dict[str, Any]:
    base = 2.0 * np.pi / recording.duration
    answered, coherence = answers(recording).get(name, (None, None))
    lines, why = [], "it does not move"
    try:
        lines = lines_of(recording, name).tolist()
    except NotMultisineError as error:
        why = str(error)
    return {
        "name": name,
        "lines": lines,
        "base": base,
        "lowest": lines[0] * base if lines else None,
        "highest": lines[-1] * base if lines else None,
        "given": name in recording.lines,
        "answered": answered,
        "coherence": coherence,
        "why": "" if lines else why,
    }
