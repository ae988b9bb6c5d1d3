"""Scenarios as JSON: what `pilotid design` writes, and commands take for a scenario."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pilotid.datasets.forcing import Forcing, Multisine
from pilotid.datasets.remnant import Remnant
from pilotid.datasets.scenarios import Scenario
from pilotid.naming.settings import plain
from pilotid.pilot.catalogue import MODELS
from pilotid.pilot.element import ControlledElement
from pilotid.recordings.paths import file_size
from pilotid.types import InputError

LARGEST = 2**24  # bytes of a design


def scenario_json(scenario: Scenario) -> dict[str, Any]:
    """A scenario of a model of the catalogue and sums of sines as plain objects.

    Raises
    ------
    InputError
        If it has another model or other forcing functions.
    """
    if MODELS.get(scenario.model.name) != scenario.model:
        raise InputError(
            f"scenario {scenario.name}: a design can be kept for models of the catalogue alone "
            f"({', '.join(MODELS)})"
        )
    held = plain(scenario)
    for name in ("target", "disturbance"):
        if not isinstance(getattr(scenario, name), Multisine | None):
            raise InputError(f"scenario {scenario.name}: its {name} is no sum of sines")
    if scenario.violation is not None:
        raise InputError(f"scenario {scenario.name}: a design has no violation of assumptions")
    for name in ("class", "violation", "family", "varied", "start_spread", "one_recording"):
        held.pop(name)
    return {**held, "model": scenario.model.name}


def designed_scenario(path: Path) -> Scenario:
    """The scenario in a design.json.

    Raises
    ------
    InputError
        If the file cannot be read or holds none.
    """
    file_size(path, LARGEST)
    try:
        held = dict(json.loads(path.read_text(encoding="utf-8"))["scenario"])
        model = MODELS[held.pop("model")]
        element, remnant = _fields(held.pop("element")), _fields(held.pop("remnant"))
        element |= {k: tuple(element[k]) for k in ("numerator", "denominator")}
        target, disturbance = _sines(held.pop("target")), _sines(held.pop("disturbance"))
        return Scenario(
            **{**held, "truth": tuple(float(v) for v in held["truth"])},
            model=model,
            element=ControlledElement(**element),
            remnant=Remnant(**remnant),
            target=target,
            disturbance=disturbance,
        )
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
