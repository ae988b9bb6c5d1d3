"""The pilots that a design is for: a scenario's, those of a pilot study, or many at random."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pilotid.datasets.forcing import Multisine
from pilotid.datasets.population import RANGES, drawn_pilot, drawn_remnant, reachable
from pilotid.datasets.remnant import Remnant, TabulatedRemnant
from pilotid.datasets.scenarios import NOMINAL, Scenario
from pilotid.designing.lines import powers_of, reference_lines, with_held_remnant
from pilotid.disk import require_file
from pilotid.naming.settings import name_of
from pilotid.pilot.catalogue import model_named
from pilotid.pilot.element import element_named
from pilotid.pilot.model import PilotModel
from pilotid.seeds import draw_rng
from pilotid.types import InputError

LARGEST = 2**26  # bytes of estimates
SAME = 0.02  # amplitudes of two recordings of one experiment differ by a smaller share
EVERYWHERE = 1e9  # rad/s
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
    changed = ", ".join(f"{key}={value:g}" for key, value in values.items())
    return replace(
        held,
        description=f"{held.description}, with {changed}" if changed else held.description,
        model=model,
        truth=tuple(truth[key] for key in model.keys),
    )


def studied(
    scenario: Scenario | None, path: Path, model: PilotModel | None = None
) -> list[Scenario]:
    """The pilots of a pilot study, from the JSON of ``pilotid fit --json``.

    Forcing functions and window are the recordings' own, or those of a `scenario`, which then
    stands in for a controlled element and a remnant that the file does not have, too.  A remnant
    of second order is the estimated one, with its share of the control's power; another has the
    estimated spectrum, and above its band the density at its end.  A `model` of that name stands
    for what the catalogue does not have.

    Raises
    ------
    InputError
        If the file holds no usable estimate, or they are of several models or of recordings with
        different forcing functions.
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
    first, *others = found
    for other in others:
        if reference_lines(other) != reference_lines(first) or not np.allclose(
            powers_of(other), powers_of(first), rtol=2.0 * SAME
        ):
            raise InputError(
                f"{path}: its recordings have different forcing functions; fit those of one "
                "experiment, or name a scenario whose forcing functions are the reference"
            )
    # Windows alike: pilots are compared in one experiment.
    return [replace(p, runs=first.runs, dt=first.dt, run_in=first.run_in) for p in found]


def _pilot(
    scenario: Scenario | None, entry: dict[str, Any], path: Path, own: PilotModel | None
) -> Scenario | None:
    usable = [e for e in entry["estimates"] if e["outcome"] in ("converged", "at-bound")]
    if not usable:
        return None
    estimate = next((e for e in usable if e.get("remnant")), usable[0])
    name = str(entry["model"])
    model = own if own is not None and own.name == name else model_named(name)
    values = {key: float(p["value"]) for key, p in estimate["parameters"].items()}
    found = (estimate.get("loops") or {}).get("element")
    element = element_named(found) if found else None
    remnant = _remnant(estimate.get("remnant") or {})
    made: dict[str, Any] = {"model": model, "truth": tuple(model.vector(values).tolist())}
    if scenario is None:
        recording = entry["recording"]
        source = recording["source"]
        if element is None:
            raise InputError(
                f"{path}: no controlled element of {source} is known; fit it with --element 4/s^2"
            )
        if remnant is None:
            raise InputError(
                f"{path}: no estimate of {source} has a remnant; fit it with --method mle"
            )
        known = (
            f"forcing functions of {Path(source).name}, pilot and remnant of {path.name} by "
            f"{estimate['method']}"
        )
        made |= {**_window(recording, path), "name": f"like-{path.stem}", "description": known}
        scenario = NOMINAL
    else:
        made["name"] = f"{scenario.name}-{path.stem}"
        made["description"] = (
            f"forcing functions of scenario {scenario.name}, pilot and remnant of {path.name}"
        )
    made["name"] = name_of(made["name"])[:60]
    made |= {"element": element or scenario.element, "remnant": remnant or scenario.remnant}
    return replace(scenario, **made, family="", varied="")


def _window(recording: dict[str, Any], path: Path) -> dict[str, Any]:
    """Forcing functions, window and units of a recording, by the names that a scenario has."""
    forcing = recording.get("forcing") or {}
    if not forcing:
        raise InputError(
            f"{path}: holds no sums of sines as forcing functions of {recording['source']}; name "
            "the scenario to start from, as in `pilotid design nominal`, or fit the recording again"
        )
    sines = {
        name: Multisine(
            tuple(s["lines"]), tuple(s["amplitudes"]), tuple(s["phases"]), float(s["period"])
        )
        for name, s in forcing.items()
    }
    return {
        "target": sines.get("ft"),
        "disturbance": sines.get("fd"),
        "alternating": any(s["alternating"] for s in forcing.values()),
        "units": tuple(recording["units"].items()),
        **{key: recording[key] for key in ("duration", "run_in", "dt", "runs")},
    }


def _remnant(estimated: dict[str, Any]) -> Remnant | None:
    """The estimated remnant; None if there is none."""
    if not estimated:
        return None
    if estimated.get("model") == "second-order":
        frequency, damping = (float(estimated["parameters"][k]) for k in ("frequency", "damping"))
        level = float(estimated["power_ratio"])
        return Remnant(2, frequency, damping, level, level_is="ratio")
    omega, density = estimated["omega"], estimated["density"]
    return TabulatedRemnant(
        omega=(*omega, EVERYWHERE),
        density=(*density, density[-1]),
        coefficients=len(estimated["parameters"]),
        band=float(omega[-1]),
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
