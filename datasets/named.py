"""Scenarios by name, ``file.py:NAME`` or design.json; their JSON, and the truth as JSON."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from pilotid.datasets.population import POPULATIONS, Population
from pilotid.datasets.recorder import Recorder
from pilotid.datasets.scenarios import DEGREES, SCENARIOS, Scenario, checked
from pilotid.datasets.signals import Multisine, Remnant, TabulatedRemnant
from pilotid.datasets.simulation import remnant_ratio
from pilotid.estimate.method import Fitted
from pilotid.model.catalogue import model_named
from pilotid.model.element import ControlledElement
from pilotid.model.loops import margins
from pilotid.naming.code import is_place, load_object
from pilotid.naming.settings import from_catalogue, name_of, require_name, to_jsonable
from pilotid.recording.spectra import known_lines
from pilotid.support.disk import require_file
from pilotid.support.types import InputError

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
    if is_place(text):
        thing = load_object(text)
        if not isinstance(thing, AnyScenario):
            raise InputError(f"{text}: is no Scenario and no Population; name one")
        return sound(thing)
    name, changed = from_catalogue(text, CATALOGUE, "scenario", "NAME")
    if changed == CATALOGUE[name] or changed.name != name:
        return sound(changed)
    return sound(replace(changed, name=name_of(text)))


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


def fitted_scenario(fitted: Fitted) -> dict[str, Any] | None:
    """What would be recorded if a fit were the truth, as `scenario_json` has it.

    None where no estimate can be simulated, or where the file cannot hold its scenario.
    """
    if not known_lines(fitted.recording) or fitted.loop_element is None:
        return None
    recording = fitted.loop_element.named_in(fitted.recording)
    for estimate in fitted.estimates:
        # Starts and bounds of the search are none of the pilot's.
        model = replace(estimate.model, overrides=())
        with suppress(InputError):
            return scenario_json(Scenario.from_fit(replace(estimate, model=model), recording))
    return None


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
