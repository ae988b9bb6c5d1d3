"""Fixed recordings with their truth, which no change of the simulation moves.

Five recordings of each of four scenarios lie in ``tasks/`` in single precision, as
``SCENARIO-REPLICATION.npz``; ``truth.json`` has the true parameters and their Cramer-Rao bounds.
They are those of `pilotid compare` with the seed 1.  ``nox -s check -- tasks`` wrote them.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from pilotid.model.catalogue import MODELS
from pilotid.model.model import PilotModel
from pilotid.recording.files import load_recording
from pilotid.recording.recording import Recording
from pilotid.support.types import FloatArray, InputError

FOLDER = Path(__file__).parent / "tasks"


@dataclass(frozen=True, eq=False)
class FixedTask:
    """A recording to identify, and what it was made of.

    Attributes
    ----------
    recording, model
        What a method is handed.
    truth, bound
        True parameters and the Cramer-Rao bounds on their standard deviations (whole record, the
        remnant's spectrum known), in model order, shape (parameters,).
    """

    recording: Recording
    model: PilotModel
    truth: FloatArray
    bound: FloatArray


@cache
def fixed_tasks() -> tuple[str, ...]:
    """The names of all fixed tasks, such as ``nominal-0``."""
    return tuple(_known())


def load_task(name: str) -> FixedTask:
    """A fixed task.

    Parameters
    ----------
    name
        One of `fixed_tasks`.

    Raises
    ------
    InputError
        If there is no such task.
    """
    if name not in fixed_tasks():
        raise InputError(f"unknown task {name!r:.50}: choose from {', '.join(fixed_tasks())}")
    held = _known()[name]
    truth, bound = (np.array([*held[part].values()]) for part in ("truth", "bound"))
    return FixedTask(load_recording(FOLDER / f"{name}.npz"), MODELS[held["model"]], truth, bound)


def reference_posterior(name: str) -> dict[str, FloatArray]:
    """Draws of the posterior of a fixed task, by parameter, the remnant's last, shape (1000,).

    They are evenly from long runs of `bayes` with its own priors and choice of the remnant's
    model.  ``nox -s check -- posteriors`` wrote them.

    Parameters
    ----------
    name
        One of `fixed_tasks`.
    """
    with np.load(FOLDER / "posteriors.npz") as held:
        return {
            key.removeprefix(f"{name}."): held[key].astype(float)
            for key in held.files
            if key.startswith(f"{name}.")
        }


@cache
def _known() -> dict[str, Any]:
    known: dict[str, Any] = json.loads((FOLDER / "truth.json").read_text(encoding="utf-8"))
    return known
