"""The pilots that a design is for: a scenario's, those of a pilot study, or many at random."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pilotid.datasets.population import (
    RANGES,
    drawn_pilot,
    drawn_remnant,
    reachable,
)
from pilotid.datasets.remnant import Remnant
from pilotid.datasets.scenarios import Scenario
from pilotid.designing.lines import with_held_remnant
from pilotid.disk import require_file
from pilotid.pilot.catalogue import model_named
from pilotid.pilot.element import element_named
from pilotid.pilot.model import PilotModel
from pilotid.seeds import draw_rng
from pilotid.types import InputError

LARGEST = 2**26  # bytes of estimates
DRAWS = 20_000  # until pilots of a population are given up


def with_truth(
    scenario: Scenario, values: Mapping[str, float], model: PilotModel | None = None
) -> Scenario:
    """The scenario with other true values, or another model; its remnant's power is held.

    What `values` do not hold is taken from the scenario's pilot.
    """
    known = dict(zip(scenario.model.keys, scenario.truth, strict=True))
    model = model or scenario.model
    if unknown := [key for key in values if key not in model.keys]:
        raise InputError(
            f"--truth: model {model.name} has no parameter {unknown[0]}: choose from "
            f"{', '.join(model.keys)}"
        )
    truth = {**known, **values}
    if missing := [key for key in model.keys if key not in truth]:
        raise InputError(
            f"--model {model.name}: scenario {scenario.name} has no value of {', '.join(missing)}; "
            f"say it with --truth {missing[0]}=..."
        )
    for p in model.parameters:
        if p.key in values and not p.lower < truth[p.key] < p.upper:
            raise InputError(
                f"--truth: {p.key}={truth[p.key]:g} lies outside {p.lower:g} to {p.upper:g}"
            )
    held = with_held_remnant(scenario)
    return replace(held, model=model, truth=tuple(truth[key] for key in model.keys))


def studied(scenario: Scenario, path: Path, model: PilotModel | None = None) -> list[Scenario]:
    """The pilots of a pilot study, from the JSON of ``pilotid fit --json``.

    Forcing functions, window and, where the file has none, the controlled element are the
    scenario's.  A remnant of second order is the estimated one; its share of the control's
    power holds under the scenario's forcing functions.  A `model` of that name stands for what
    the catalogue does not have.

    Raises
    ------
    InputError
        If the file holds no usable estimate, or they are of several models.
    """
    require_file(path, LARGEST)
    try:
        held = json.loads(path.read_text(encoding="utf-8"))
        entries = held if isinstance(held, list) else [held]
        found = [p for entry in entries if (p := _pilot(scenario, entry, path, model))]
    except InputError:
        raise
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
        raise InputError(
            f"{path}: cannot be read as estimates; name the file that `pilotid fit --json` wrote"
        ) from None
    if not found:
        raise InputError(f"{path}: holds no estimate that converged")
    if len({pilot.model.name for pilot in found}) > 1:
        raise InputError(f"{path}: holds estimates of several models; fit one with --model")
    return found


def _pilot(
    scenario: Scenario, entry: dict[str, Any], path: Path, own: PilotModel | None
) -> Scenario | None:
    usable = [e for e in entry["estimates"] if e["outcome"] in ("converged", "at-bound")]
    if not usable:
        return None
    estimate, name = usable[0], str(entry["model"])
    model = own if own is not None and own.name == name else model_named(name)
    values = {key: float(p["value"]) for key, p in estimate["parameters"].items()}
    element = (estimate.get("loops") or {}).get("element")
    remnant = scenario.remnant
    known = estimate.get("remnant") or {}
    if known.get("model") == "second-order":
        shape = known["parameters"]
        ratio = float(known["power_ratio"])
        remnant = Remnant(
            2, float(shape["frequency"]), float(shape["damping"]), ratio, level_is="ratio"
        )
    return replace(
        scenario,
        name=f"{scenario.name}-{path.stem}"[:60],
        model=model,
        truth=tuple(model.vector(values).tolist()),
        element=element_named(element) if element else scenario.element,
        remnant=remnant,
        family="",
        varied="",
    )


def drawn_pilots(scenario: Scenario, count: int, seed: int) -> list[Scenario]:
    """Pilots and remnants from the ranges of the populations, in the scenario's loop.

    The remnant's share of the control's power holds under the scenario's forcing functions.

    Raises
    ------
    InputError
        If the ranges hold no pilot for this model or element.
    """
    outside = [key for key in scenario.model.keys if key not in RANGES]
    if outside:
        raise InputError(
            f"there is no population of model {scenario.model.name}: nothing is known of the range "
            f"of {outside[0]}"
        )
    rng = draw_rng(seed, "pilots")
    found: list[Scenario] = []
    for _ in range(DRAWS):
        if len(found) == count:
            return found
        truth = drawn_pilot(scenario.model, scenario.element, rng)
        if truth is None:
            continue
        remnant = drawn_remnant(rng, exotic=False)
        pilot = replace(scenario, truth=tuple(np.asarray(truth).tolist()), remnant=remnant)
        if reachable(pilot):
            found.append(pilot)
    raise InputError(
        f"scenario {scenario.name}: of {DRAWS} pilots drawn only {len(found)} make a sensible loop "
        f"with {scenario.element.name}; ask for fewer --pilots or name another element"
    )
