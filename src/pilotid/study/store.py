"""The store of a study: facts, scenarios, methods and fits, all that a report is made from."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pilotid.support.store import Rows, damaged

LARGEST = 1e300  # number among the settings


@dataclass(frozen=True)
class Unit:
    """One fit: a method, by its label, on one replication of a scenario.

    Attributes
    ----------
    scenario, method
        Name of the scenario, label of the method.
    replication
        Which recording of the scenario, from 0.
    """

    scenario: str
    method: str
    replication: int


@dataclass(frozen=True)
class ParameterTruth:
    """True value of a parameter and the Cramer-Rao bound on its deviation.

    Attributes
    ----------
    parameter, unit
        Key and unit.
    truth
        True value.
    bound
        Cramer-Rao bound on the standard deviation, None where there is none.
    """

    parameter: str
    unit: str
    truth: float
    bound: float | None


@dataclass(frozen=True)
class Draw:
    """What a population drew for a replication, the same for all methods.

    Attributes
    ----------
    model
        Name of the pilot's model.
    parameters
        Its parameters with their true values and bounds, in model order.
    facts
        Words and numbers on element, forcing, remnant and length; see
        `pilotid.study.fits.facts_of`.
    """

    model: str
    parameters: tuple[ParameterTruth, ...]
    facts: Mapping[str, str | float]

    def same(self, other: Draw) -> bool:
        """Whether both are of one pilot, but for the rounding of different processors."""
        ours, theirs = self.parameters, other.parameters
        return (self.model, len(ours)) == (other.model, len(theirs)) and all(
            a.parameter == b.parameter and math.isclose(a.truth, b.truth, rel_tol=1e-6)
            for a, b in zip(ours, theirs, strict=True)
        )


@dataclass(frozen=True)
class Result:
    """What a fit gave; numbers are None where there are none.

    Attributes
    ----------
    unit
        What was fitted.
    outcome, message, usable
        How it ended, and whether the estimate counts.
    vaf, iterations, seconds
        See `pilotid.estimates.estimate.Estimate`.
    posterior
        Whether the standard errors are those of a posterior distribution.
    estimates
        Parameter, value, standard error and the interval's ends.
    excess
        Of a fit to a recording of a population: the criterion over that of a search which
        starts at the truth, where the method has one; see
        `pilotid.estimates.method.Searching`.
    draw
        What a population drew for the recording.
    remarks
        What a user would have been told of the recording and of the estimate, on one line, see
        `pilotid.study.fits.told`; empty for nothing.
    """

    unit: Unit
    outcome: str
    message: str = ""
    usable: bool = False
    vaf: float | None = None
    iterations: int = 0
    posterior: bool = False
    seconds: float | None = None
    estimates: tuple[tuple[str, float | None, float | None, float | None, float | None], ...] = ()
    excess: float | None = None
    draw: Draw | None = None
    remarks: str = ""


@dataclass(frozen=True)
class MethodEntry:
    """A method as the store knows it.

    Attributes
    ----------
    label
        Its name, and the settings that are not its usual ones.
    position
        Its place in tables and figures.
    settings
        All settings as plain objects, see `pilotid.naming.settings.plain`.
    code
        Digest of the code that it is from, empty if that is this package.
    typed
        What to type for it on the command line.
    """

    label: str
    position: int
    settings: Mapping[str, Any]
    code: str = ""
    typed: str = ""


@dataclass(frozen=True)
class ScenarioEntry:
    """A scenario as the store knows it.

    Attributes
    ----------
    name, position, description, model, family
        See `pilotid.datasets.scenarios.Scenario`; the model by its name, or several with
        commas.
    settings, code, typed
        See `MethodEntry`.
    parameters
        The parameters with their true values and bounds; none for a population, whose
        replications have their own.
    """

    name: str
    position: int
    description: str
    model: str
    settings: Mapping[str, Any]
    parameters: tuple[ParameterTruth, ...]
    family: str = ""
    code: str = ""
    typed: str = ""

    @property
    def population(self) -> bool:
        """Whether every replication has a pilot of its own."""
        return not self.parameters

    @property
    def one_recording(self) -> bool:
        """Whether all fits are of the same recording, so that means say nothing."""
        return self.settings.get("one_recording") is True

    @property
    def start(self) -> str:
        """Which initial guesses methods are handed, in words."""
        spread = self.number("start_spread")
        drawn = math.isfinite(spread) and spread > 0.0
        return f"drawn within {100.0 * spread:g} % of the truth" if drawn else "of the model"

    def number(self, path: str) -> float:
        """A number among the settings, such as ``remnant.level``; NaN if it is not there."""
        held: Any = self.settings
        for name in path.split("."):
            held = held.get(name) if isinstance(held, Mapping) else None
        is_number = isinstance(held, int | float) and not isinstance(held, bool)
        return float(held) if is_number and abs(held) <= LARGEST else math.nan


def number(value: float) -> float | None:
    """A number for the store, None where it is none."""
    return float(value) if math.isfinite(value) else None


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
    return {
        name: _thirds(draws, *how) if isinstance(how, tuple) else _steps(draws, how)
        for name, how in STRATA.items()
    }


def _number(draw: Draw, name: str) -> float:
    value = draw.facts.get(name)
    return float(value) if isinstance(value, int | float) else math.nan


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


def _thirds(draws: Mapping[int, Draw], name: str, scale: float, unit: str) -> Stratum:
    """Thirds of the recordings by a number, fewer where many have the same."""
    every = {replication: round(_number(draw, name), 6) for replication, draw in draws.items()}
    numbers = {replication: x for replication, x in every.items() if math.isfinite(x)}
    if not numbers:
        return {}
    edges = np.quantile(list(numbers.values()), (0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0)).tolist()
    found: Stratum = {}
    for replication, x in numbers.items():
        place = min(bisect_right(edges[1:3], x), 2)
        value = f"{scale * edges[place]:.0f} to {scale * edges[place + 1]:.0f} {unit}"
        found[value] = found.get(value, frozenset()) | {replication}
    return dict(sorted(found.items(), key=lambda item: _in_order(item[0])))


def _runs(draw: Draw) -> str:
    runs = _number(draw, "runs")
    return "1 run" if runs == 1 else f"{runs:.0f} runs"


#: How recordings are divided, by the name of the fact and in the order of tables and figures: by
#: the label of a draw, or in thirds of a number, with its factor and unit.
STRATA: dict[str, Callable[[Draw], str] | tuple[str, float, str]] = {
    "model": lambda draw: draw.model,
    "element": lambda draw: str(draw.facts.get("element", "?")),
    "remnant": lambda draw: str(draw.facts.get("remnant", "?")),
    "level": ("remnant_level", 100.0, "%"),
    "rate": lambda draw: f"{1.0 / _number(draw, 'dt'):.0f} Hz",
    "length": ("duration", 1.0, "s"),
    "run-in": lambda draw: f"{_number(draw, 'run_in'):.0f} s",
    "runs": _runs,
    "forcing": lambda draw: str(draw.facts.get("forcing", "?")),
}


#: Which rows are scenarios, methods and fits; that without names has the facts.
SCENARIOS = "scenario != '' AND method = ''"
METHODS = "scenario = '' AND method != ''"
FITS = "scenario != '' AND method != ''"


class Store(Rows):
    """A study's results in a folder; what is known already stays as it is."""

    format = 8

    def describe(self, about: Mapping[str, str]) -> None:
        """Keep facts on the study."""
        self.put(("", "", 0), {**self.about(), **about}, again=True)

    def about(self) -> dict[str, str]:
        """Facts on the study."""
        facts: dict[str, str] = self.get(dict[str, str], ("", "", 0)) or {}
        for key, value in facts.items():  # reports read numbers from some
            if not _is_readable(key, value):
                raise damaged(self.path, f"its fact '{key}' is none")
        return dict(sorted(facts.items()))

    def add_scenario(self, entry: ScenarioEntry) -> None:
        """Keep what a scenario is."""
        self.put((entry.name, "", 0), entry)

    def scenarios(self) -> list[ScenarioEntry]:
        """The scenarios, in the order of the catalogue."""
        found = self.every(ScenarioEntry, SCENARIOS)
        return sorted(found, key=lambda entry: (entry.position, entry.name))

    def add_method(self, entry: MethodEntry) -> None:
        """Keep what a method is."""
        self.put(("", entry.label, 0), entry)

    def methods(self) -> dict[str, MethodEntry]:
        """The methods by their labels, in the order of the catalogue."""
        found = self.every(MethodEntry, METHODS)
        found.sort(key=lambda entry: (entry.position, entry.label))
        return {entry.label: entry for entry in found}

    def add(self, result: Result) -> None:
        """Keep a fit."""
        unit = result.unit
        self.put((unit.scenario, unit.method, unit.replication), result)

    def forget(self, units: Iterable[Unit]) -> None:
        """Drop fits, which are then fitted again."""
        self.drop((unit.scenario, unit.method, unit.replication) for unit in units)

    def results(self) -> list[Result]:
        """All fits, by scenario, method and replication in the order of the catalogues."""
        scenarios, methods = [entry.name for entry in self.scenarios()], list(self.methods())
        places = {(s, m): (i, j) for i, s in enumerate(scenarios) for j, m in enumerate(methods)}
        found = {
            (*places[unit.scenario, unit.method], unit.replication): result
            for result in self.every(Result, FITS)
            if ((unit := result.unit).scenario, unit.method) in places
        }
        return [found[place] for place in sorted(found)]

    def done(self) -> dict[Unit, str]:
        """The fits that are in the store, and how they ended."""
        return {result.unit: result.outcome for result in self.every(Result, FITS)}


def _is_readable(key: str, value: str) -> bool:
    """Whether a fact is what reports take it for."""
    try:
        if key.startswith("remnant ratio "):
            float(value)
    except ValueError:
        return False
    return True
