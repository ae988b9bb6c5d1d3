"""What a store notes on a study: versions, digests of code, and all that defines its parts."""

from __future__ import annotations

import json
import platform
from importlib.metadata import version

import numpy as np

from pilotid.datasets import CATALOGUE, AnyScenario, Population, Scenario, simulate
from pilotid.estimates.method import Method
from pilotid.methods import label_of, methods
from pilotid.naming.code import code_digest, own_digest, place_of, reason
from pilotid.naming.settings import labelled, plain
from pilotid.study.draws import truths_of
from pilotid.study.entries import TRAJECTORY, MethodEntry, ParameterTruth, ScenarioEntry
from pilotid.study.tracks import truth_over_time
from pilotid.types import InputError

LIBRARIES = ("numpy", "scipy", "control", "pysindy", "emcee")


def about_this(seed: int) -> dict[str, str]:
    """Code, versions and seed: what two results must share to be compared."""
    return {
        "seed": str(seed),
        "code": own_digest(),
        "pilotid": version("pilotid"),
        "python": ".".join(platform.python_version_tuple()[:2]),
        **{name: version(name) for name in LIBRARIES},
    }


def method_entry(method: Method, position: int = 0, typed: str = "") -> MethodEntry:
    """A method for the store.

    Parameters
    ----------
    method
        The method.
    position
        Its place behind those that are registered.
    typed
        What the user typed for it, if anything.
    """
    known, label = list(methods()), label_of(method)
    registered = method.name in known
    place = known.index(method.name) if registered else len(known) + position
    if not typed:
        typed = label if registered else labelled(place_of(type(method)), method)
    return MethodEntry(label, place, plain(method), code_digest(method), typed)


def scenario_entry(scenario: AnyScenario, position: int = 0, typed: str = "") -> ScenarioEntry:
    """A scenario with its truth and its bounds, for the store; see `method_entry`.

    The bound is that of the whole record with the remnant's spectrum known: the floor under
    every unbiased method.  A population has neither: its replications have their own.

    Raises
    ------
    InputError
        If no bounds can be given, for example because the loop is unstable, or if a population
        cannot be drawn from.
    """
    known = list(CATALOGUE)
    try:
        if isinstance(scenario, Population):
            model, family = ", ".join(dict.fromkeys(scenario.models)), ""
            _try_out(scenario)
            parameters: tuple[ParameterTruth, ...] = ()
        else:
            model, family = scenario.model.name, scenario.family
            parameters = truths_of(scenario)
    except InputError:
        raise
    except Exception as error:  # a scenario of the user's own may be anything
        raise InputError(
            f"scenario {scenario.name}: cannot be simulated ({reason(error)}); check its settings"
        ) from error
    return ScenarioEntry(
        scenario.name,
        known.index(scenario.name) if scenario.name in known else len(known) + position,
        scenario.description,
        model,
        plain(scenario),
        parameters,
        family,
        code_digest(scenario),
        typed or scenario.name,
    )


def trajectory_fact(scenario: Scenario) -> dict[str, str]:
    """What a report needs of the truth of a pilot who changes; nothing for one who stays."""
    truth = truth_over_time(scenario)
    if truth is None:
        return {}
    values = dict(zip(truth.keys, truth.values.tolist(), strict=True))
    return {f"{TRAJECTORY} {scenario.name}": json.dumps({"time": truth.time.tolist(), **values})}


def _try_out(population: Population) -> None:
    """Draw a pilot and a recording that nobody keeps, so that what cannot be is told at once."""
    rng = np.random.default_rng(0)
    scenario = population.drawn(rng)
    simulate(scenario, rng)
    truths_of(scenario)
