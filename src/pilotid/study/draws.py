"""What a replication of a population is: its pilot, bounds and facts, and strata of these."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Mapping
from functools import lru_cache

import numpy as np

from pilotid.datasets import Population, Scenario
from pilotid.datasets.experiments import bound_of, experiment_of
from pilotid.datasets.forcing import Multisine
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


# ----------------------------------------------------------------------------------- strata

#: Values by replication, in the order of tables and figures.
Stratum = dict[str, frozenset[int]]


def strata_of(draws: Mapping[int, Draw]) -> dict[str, Stratum]:
    """Replications of a population by the value of each fact, by the fact's name.

    Facts that vary in steps have a stratum for each value; remnant level and length are
    divided into thirds of the recordings.

    Parameters
    ----------
    draws
        What was drawn, by replication.
    """
    found = {name: _steps(draws, label) for name, label in LABELS.items()}
    found["length"] = _thirds(draws, "duration", lambda low, high: f"{low:.0f} to {high:.0f} s")
    found["level"] = _thirds(
        draws, "remnant_level", lambda low, high: f"{100 * low:.0f} to {100 * high:.0f} %"
    )
    return {name: found[name] for name in NAMES}


def _runs(draw: Draw) -> str:
    count = int(_number(draw, "runs"))
    return "1 run" if count == 1 else f"{count} runs"


def _number(draw: Draw, name: str) -> float:
    value = draw.facts.get(name)
    return float(value) if isinstance(value, int | float) else math.nan


#: What a stratum is called, for facts that vary in steps.
LABELS: dict[str, Callable[[Draw], str]] = {
    "model": lambda draw: draw.model,
    "element": lambda draw: str(draw.facts.get("element", "?")),
    "remnant": lambda draw: str(draw.facts.get("remnant", "?")),
    "forcing": lambda draw: str(draw.facts.get("forcing", "?")),
    "rate": lambda draw: f"{1.0 / _number(draw, 'dt'):.0f} Hz",
    "run-in": lambda draw: f"{_number(draw, 'run_in'):.0f} s",
    "runs": _runs,
}
#: Names of the strata, in the order of tables and figures.
NAMES = (
    *("model", "element", "remnant", "level", "rate", "length", "run-in", "runs"),
    "forcing",
)


def _steps(draws: Mapping[int, Draw], label: Callable[[Draw], str]) -> Stratum:
    labels = {replication: label(draw) for replication, draw in draws.items()}
    return {
        value: frozenset(r for r, own in labels.items() if own == value)
        for value in sorted(set(labels.values()), key=_in_order)
    }


def _in_order(label: str) -> tuple[float, str]:
    """Numbers by their size, words by the alphabet behind them."""
    first = label.split()[0]
    return (float(first), label) if first.replace(".", "").isdigit() else (math.inf, label)


def _thirds(draws: Mapping[int, Draw], name: str, label: Callable[[float, float], str]) -> Stratum:
    """Thirds of the recordings by a number, fewer where many have the same."""
    every = {replication: round(_number(draw, name), 6) for replication, draw in draws.items()}
    numbers = {replication: x for replication, x in every.items() if math.isfinite(x)}
    if not numbers:
        return {}
    edges = np.quantile(list(numbers.values()), (0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0)).tolist()
    found: Stratum = {}
    for replication, x in numbers.items():
        place = min(bisect_right(edges[1:3], x), 2)
        value = label(edges[place], edges[place + 1])
        found[value] = found.get(value, frozenset()) | {replication}
    return dict(sorted(found.items(), key=lambda item: _in_order(item[0])))
