"""Scenarios by name, ``file.py:NAME`` or design.json; the truth as JSON; recordings in files.

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
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pilotid.datasets.population import POPULATIONS, Population
from pilotid.datasets.recorder import Recorder
from pilotid.datasets.scenarios import DEGREES, SCENARIOS, Scenario, checked
from pilotid.datasets.signals import Multisine, Remnant, TabulatedRemnant
from pilotid.datasets.simulation import remnant_ratio
from pilotid.model.catalogue import MODELS, model_named
from pilotid.model.element import ControlledElement
from pilotid.model.loops import margins
from pilotid.model.model import PilotModel
from pilotid.recording.files import load_recording
from pilotid.recording.recording import Recording
from pilotid.support.disk import require_file
from pilotid.support.naming import named, require_name, to_jsonable
from pilotid.support.types import FloatArray, InputError

#: What a study has recordings of: both have a name, a description, and `drawn`, which gives
#: the scenario of a replication.
AnyScenario = Scenario | Population


#: Scenarios and populations by the name that the command line takes.
CATALOGUE: dict[str, AnyScenario] = {**SCENARIOS, **POPULATIONS}


def scenario_named(text: str) -> AnyScenario:
    """The scenario or population that a text names.

    Parameters
    ----------
    text
        ``nominal``, ``nominal(runs=3)``, the ``design.json`` of a design, or ``file.py:NAME`` or
        ``package.module:NAME``.

    Raises
    ------
    InputError
        If there is none; the message lists the names there are.
    """
    if text.strip().lower().endswith(".json"):
        return sound(designed_scenario(Path(text.strip())))
    thing = named(text, CATALOGUE, "scenario", "NAME")
    if not isinstance(thing, AnyScenario):
        raise InputError(f"{text}: is no Scenario and no Population; name one")
    return sound(thing)


def sound(thing: object) -> AnyScenario:
    """A scenario or population, if its name is its own.

    Raises
    ------
    InputError
        If the name belongs to another one, or cannot be that of a file; see `checked`, too.
    """
    known = thing if isinstance(thing, Population) else checked(thing)
    require_name(known.name, "scenario")
    if CATALOGUE.get(known.name, known) != known:
        raise InputError(
            f"a scenario has the name '{known.name}' of another one; give it a name of its own"
        )
    return known


def scenario_json(scenario: Scenario) -> dict[str, Any]:
    """A scenario with sums of sines as plain objects, its model by name.

    `designed_scenario` reads it again where the model is one of the catalogue.
    """
    entry = to_jsonable(scenario)
    for name in ("class", "violation", "family", "start_spread", "one_recording"):
        entry.pop(name)
    return {**entry, "model": scenario.model.name}


def designed_scenario(path: Path) -> Scenario:
    """The scenario in a design.json or a trust.json.

    Raises
    ------
    InputError
        If the file cannot be read or holds none.
    """
    from pydantic import TypeAdapter

    require_file(path)
    try:
        entry = dict(json.loads(path.read_text(encoding="utf-8"))["scenario"])
        model = model_named(str(entry.pop("model")))
        kinds: dict[str, Any] = {
            "truth": tuple[float, ...],
            "element": ControlledElement,
            "remnant": TabulatedRemnant if "density" in entry["remnant"] else Remnant,
            "target": Multisine | None,
            "disturbance": Multisine | None,
            "recorder": Recorder | None,
            "units": tuple[tuple[str, str], ...],
        }
        entry = {"units": DEGREES, "recorder": None, **entry}
        parts = {
            name: TypeAdapter(kind).validate_python(entry[name]) for name, kind in kinds.items()
        }
        return Scenario(**{**entry, **parts, "model": model})
    except InputError:
        raise
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise InputError(
            f"{path}: holds no scenario ({str(error).splitlines()[0]}); name the "
            "JSON of `pilotid design`, or of `pilotid fit` with --element and a method that has a "
            "remnant"
        ) from None


def truth(scenario: Scenario) -> dict[str, object]:
    """What a scenario's recordings were made of, as plain objects."""
    made = {
        "scenario": scenario.name,
        "description": scenario.description,
        "model": scenario.model.name,
        "runs": scenario.runs,
        "parameters": {
            p.key: {"value": float(value), "unit": p.unit}
            for p, value in zip(scenario.model.parameters, scenario.values, strict=True)
        },
        "remnant": {**asdict(scenario.remnant), "expected_power_ratio": remnant_ratio(scenario)},
        "controlled_element": asdict(scenario.element),
    }
    further = {"controlled_element_change": scenario.change, "recorder": scenario.recorder}
    made |= {name: asdict(part) for name, part in further.items() if part is not None}
    for name, (end, _) in zip(("loops", "loops_after_the_change"), scenario.constant_ends):  # noqa: B905
        target, disturbance = margins(end.model, end.values, end.element)
        made[name] = {"target": asdict(target), "disturbance": asdict(disturbance)}
    return made


# ----------------------------------------------------------------------------- recordings in files


HERE = Path(__file__).parent
TASKS = HERE / "tasks"
#: The variable that names the folder of the recordings of people.
DATA = "PILOTID_DATA"


class FixedTask(NamedTuple):
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
