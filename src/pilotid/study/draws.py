"""What a replication of a population is: its pilot, bounds, and the facts that strata need."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from pilotid.datasets import Population, Scenario
from pilotid.datasets.experiments import experiment_of
from pilotid.datasets.forcing import Multisine
from pilotid.datasets.linearised import bound_of
from pilotid.datasets.named import AnyScenario
from pilotid.datasets.simulation import lines_in
from pilotid.pilot.element import ControlledElement
from pilotid.seeds import draw_rng
from pilotid.study.entries import Draw, ParameterTruth, number
from pilotid.theory.bounds import bounds

#: Kinds of elements by which coefficients below the highest are zero.
KINDS = {
    (): "K",
    (True,): "K/s",
    (False,): "first order",
    (True, True): "K/s^2",
    (False, True): "K/(s(s+a))",
    (False, False): "second order",
}


@lru_cache(maxsize=8)  # methods of a replication come one after the other
def scenario_of(origin: AnyScenario, seed: int, replication: int) -> tuple[Scenario, Draw | None]:
    """The scenario of a replication, and what is to be kept of it if it was drawn."""
    scenario = origin.drawn(draw_rng(seed, origin.name, replication))
    if not isinstance(origin, Population):
        return scenario, None
    return scenario, Draw(scenario.model.name, truths_of(scenario), facts_of(scenario))


def truths_of(scenario: Scenario) -> tuple[ParameterTruth, ...]:
    """True values, and the bounds of the whole record with the remnant's spectrum known.

    Raises
    ------
    InputError
        If no bounds can be given, for example because the loop is unstable.
    """
    if scenario.changes:
        deviations = bound_of(scenario)
    else:
        deviations = np.sqrt(np.diag(bounds(experiment_of(scenario)).full))
    return tuple(
        ParameterTruth(p.key, p.unit, float(value), number(float(deviation)))
        for p, value, deviation in zip(
            scenario.model.parameters, scenario.values, deviations, strict=True
        )
    )


def facts_of(scenario: Scenario) -> dict[str, str | float]:
    """What was drawn, but for the pilot's parameters: words and numbers."""
    remnant = scenario.remnant
    forced = {"target": scenario.target, "disturbance": scenario.disturbance}
    given = {name: f for name, f in forced.items() if f is not None}
    sines = [f for f in given.values() if isinstance(f, Multisine)]
    periodic = bool(sines) and all(lines_in(f, scenario.duration) for f in sines)
    return {
        "element": element_kind(scenario.element),
        "element_name": scenario.element.name,
        "forcing": "both" if len(given) == 2 else "".join(given) or "none",
        "periodic": "periodic" if periodic and len(sines) == len(given) else "aperiodic",
        "remnant": remnant_kind(scenario),
        "remnant_shape": remnant.shape,
        "remnant_order": remnant.order,
        "remnant_enters": remnant.enters,
        "remnant_level": remnant.level,
        "dt": scenario.dt,
        "duration": scenario.duration,
        "run_in": scenario.run_in,
        "runs": scenario.runs,
    }


def element_kind(element: ControlledElement) -> str:
    """The kind of a controlled element, such as ``K/s^2``."""
    zero = tuple(c == 0.0 for c in element.denominator[1:])
    return KINDS.get(zero, "other") if len(element.numerator) == 1 else "other"


def remnant_kind(scenario: Scenario) -> str:
    """The family of a remnant, in a word or two."""
    remnant = scenario.remnant
    if remnant.freedom is not None:
        return "heavy tails"
    if remnant.enters != "control":
        return f"before {remnant.enters}"
    return f"order {remnant.order}" if remnant.shape == "low-pass" else remnant.shape
