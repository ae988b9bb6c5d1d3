"""Scenarios as JSON: what `design` and `trust` write, and commands take for a scenario."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pilotid.datasets.forcing import Forcing, Multisine
from pilotid.datasets.recorder import Recorder
from pilotid.datasets.remnant import Remnant, TabulatedRemnant
from pilotid.datasets.scenarios import DEGREES, Scenario
from pilotid.disk import require_file
from pilotid.naming.code import is_place, taken
from pilotid.naming.settings import plain
from pilotid.pilot.catalogue import MODELS, model_named
from pilotid.pilot.element import ControlledElement
from pilotid.pilot.model import PilotModel
from pilotid.types import InputError

LARGEST = 2**24  # bytes of a design


def scenario_json(scenario: Scenario, place: str = "") -> dict[str, Any]:
    """A scenario with sums of sines as plain objects.

    Parameters
    ----------
    scenario
        The scenario.
    place
        Where a model that is not the catalogue's is found, ``file.py:NAME``, by itself or in a
        scenario.

    Raises
    ------
    InputError
        If its model is not found there, or it has other forcing functions.
    """
    model = scenario.model.name if MODELS.get(scenario.model.name) == scenario.model else place
    if not model or _model(model) != scenario.model:
        raise InputError(
            f"scenario {scenario.name}: its model {scenario.model.name} is not one of the "
            "catalogue; name it with --model file.py:NAME, so that the design can be read again"
        )
    held = plain(scenario)
    for name in ("target", "disturbance"):
        if not isinstance(getattr(scenario, name), Multisine | None):
            raise InputError(f"scenario {scenario.name}: its {name} is no sum of sines")
    if scenario.violation is not None:
        raise InputError(f"scenario {scenario.name}: a design has no violation of assumptions")
    for name in ("class", "violation", "family", "varied", "start_spread", "one_recording"):
        held.pop(name)
    return {**held, "model": model}


def model_place(text: str) -> str:
    """Where the model of a scenario that is named so is found; empty for the catalogue's."""
    if is_place(text):
        return text
    if not text.strip().lower().endswith(".json"):
        return ""
    try:
        return str(json.loads(Path(text.strip()).read_text(encoding="utf-8"))["scenario"]["model"])
    except (OSError, ValueError, TypeError, KeyError, RecursionError):
        return ""


def _model(text: str) -> PilotModel:
    """A model of the catalogue, one of somebody's own, or that of a scenario of their own."""
    if not is_place(text):
        return model_named(text)
    thing = taken(text)
    model = thing.model if isinstance(thing, Scenario) else model_named(text)
    return model


def designed_scenario(path: Path) -> Scenario:
    """The scenario in a design.json or a trust.json.

    Raises
    ------
    InputError
        If the file cannot be read or holds none.
    """
    require_file(path, LARGEST)
    try:
        held = dict(json.loads(path.read_text(encoding="utf-8"))["scenario"])
        model = _model(str(held.pop("model")))
        element, remnant = _fields(held.pop("element")), _fields(held.pop("remnant"))
        element |= {k: tuple(element[k]) for k in ("numerator", "denominator")}
        target, disturbance = _sines(held.pop("target")), _sines(held.pop("disturbance"))
        held["truth"] = tuple(float(v) for v in held["truth"])
        held["units"] = tuple((str(k), str(v)) for k, v in held.get("units", DEGREES))
        if held.get("recorder"):
            recorder = _fields(held["recorder"])
            held["recorder"] = Recorder(**{**recorder, "noise": tuple(recorder["noise"])})
        kind = Remnant
        if "density" in remnant:
            kind = TabulatedRemnant
            remnant |= {k: tuple(map(float, remnant[k])) for k in ("omega", "density")}
        return Scenario(
            **held,
            model=model,
            element=ControlledElement(**element),
            remnant=kind(**remnant),
            target=target,
            disturbance=disturbance,
        )
    except InputError:
        raise
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise InputError(
            f"{path}: cannot be read as a design ({error}); name the design.json that "
            "`pilotid design` wrote"
        ) from None


def _fields(held: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in held.items() if name != "class"}


def _sines(held: dict[str, Any] | None) -> Forcing | None:
    if held is None:
        return None
    lists = {name: tuple(held[name]) for name in ("lines", "amplitudes", "phases")}
    return Multisine(**lists, period=float(held["period"]))
