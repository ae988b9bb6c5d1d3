"""Recordings in files: simulated ones that no change of the simulation moves, and those of people.

Five recordings of each of four scenarios lie in ``tasks/`` in single precision, as
``SCENARIO-REPLICATION.npz``; ``truth.json`` has the true parameters and their Cramer-Rao bounds.
They are those of `pilotid compare` with the seed 1.  ``nox -s check -- tasks`` wrote them.

Published recordings of people do not come with pilotid: `people.csv` says what they are, and
`people_files.csv` has the SHA-256 of every file, so that results say which recordings they are of.
"""

from __future__ import annotations

import csv
import json
import os
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

HERE = Path(__file__).parent
TASKS = HERE / "tasks"
#: The variable that names the folder of the recordings of people.
DATA = "PILOTID_DATA"


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
    entry = _known()[name]
    truth, bound = (np.array([*entry[part].values()]) for part in ("truth", "bound"))
    return FixedTask(load_recording(TASKS / f"{name}.npz"), MODELS[entry["model"]], truth, bound)


def reference_posterior(name: str) -> dict[str, FloatArray]:
    """Draws of the posterior of a fixed task, by parameter, the remnant's last, shape (1000,).

    They are evenly from long runs of `bayes` with its own priors and choice of the remnant's
    model.  ``nox -s check -- posteriors`` wrote them.

    Parameters
    ----------
    name
        One of `fixed_tasks`.
    """
    with np.load(TASKS / "posteriors.npz") as posteriors:
        return {
            key.removeprefix(f"{name}."): posteriors[key].astype(float)
            for key in posteriors.files
            if key.startswith(f"{name}.")
        }


@cache
def _known() -> dict[str, Any]:
    known: dict[str, Any] = json.loads((TASKS / "truth.json").read_text(encoding="utf-8"))
    return known


def _table(name: str) -> list[dict[str, str]]:
    with (HERE / name).open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


#: The data card of each experiment by its name: ``who``, ``task`` and ``rate`` of recording;
#: ``faults``, to know before believing an estimate; ``licence``, ``source``, and ``address`` of the
#: folder with the files, empty where none is known that gives a single file; ``files`` behind the
#: folder, with the ``pattern`` of their names, a ``model`` that suits, and ``map`` and ``dt`` as
#: `pilotid.recording.files.Reading` takes them.
PEOPLE = {row["name"]: row for row in _table("people.csv")}


def published(name: str) -> dict[str, str]:
    """The files of an experiment, with the SHA-256 of each."""
    rows = _table("people_files.csv")
    return {row["file"]: row["sha256"] for row in rows if row["name"] == name}


def recordings_in(folder: Path, name: str) -> list[Path]:
    """The recordings of an experiment in a folder, as commands take them."""
    files = PEOPLE[name]["files"]
    start, _, levels = files.partition("{")
    if levels:
        return [folder / f"{start}{level}" for level in levels.rstrip("}").split(",")]
    return sorted(folder.glob(files))


def folder_of(name: str) -> Path:
    """Where the files of an experiment are, or would be."""
    import pooch

    return Path(os.environ.get(DATA) or pooch.os_cache("pilotid")) / name


def fetch(name: str) -> Path:
    """The folder with the files of an experiment, which are fetched where they are not there yet.

    Parameters
    ----------
    name
        One of `PEOPLE`.

    Raises
    ------
    InputError
        If there is no such experiment, or a file cannot be had or is another than the published.
    """
    import pooch

    if name not in PEOPLE:
        raise InputError(f"unknown data {name!r:.50}: choose from {', '.join(PEOPLE)}")
    people = PEOPLE[name]
    pooch.get_logger().setLevel("WARNING")
    folder = folder_of(name)
    files = pooch.create(folder, people["address"], registry=published(name))
    for file in files.registry:
        try:
            files.fetch(file)
        except (OSError, ValueError) as error:  # those of the network are of the first kind
            raise InputError(
                f"{name}: {file} cannot be had ({error}); get the files from "
                f"{people['source']} and put them into {folder}"
            ) from error
    return folder
