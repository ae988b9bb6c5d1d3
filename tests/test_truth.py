"""No method is told the truth: what a study hands to one, walked to its last number."""

from __future__ import annotations

import enum
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from types import BuiltinFunctionType, FunctionType, MethodType, ModuleType
from typing import ClassVar

import numpy as np
import pytest

from pilotid.datasets import POPULATIONS, SCENARIOS, Scenario
from pilotid.datasets.population import Population
from pilotid.estimate.estimate import Estimate, Outcome, failed
from pilotid.model.catalogue import MODELS
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.study.run import run_task, scenario_of, started
from pilotid.study.study import Study
from pilotid.support.types import InputError

#: What the spies were handed, by scenario.
HANDED: list[tuple[Recording, PilotModel]] = []


@dataclass(frozen=True)
class Spy:
    """Keeps what it is handed; a study runs it in this process, so that the test can look."""

    name: ClassVar[str] = "spy"

    def objection(self, recording: Recording, model: PilotModel) -> str | None:
        return None

    def fit(self, recording: Recording, model: PilotModel, rng: np.random.Generator) -> Estimate:
        HANDED.append((recording, model))
        return failed(self.name, model, Outcome.NOT_CONVERGED)


def handed_by(scenario: Scenario | Population, replication: int) -> tuple[Recording, PilotModel]:
    """What a study hands to a method: recording and model; the generator is not followed."""
    HANDED.clear()
    study = Study(scenario, Spy(), replication + 1)
    *_, task = study.tasks(study.keys)
    result = run_task(task)
    assert result.outcome == Outcome.NOT_CONVERGED.slug, result.message
    (handed,) = HANDED
    return handed


def parts(thing: object, path: str, seen: dict[int, object]) -> Iterator[tuple[str, object]]:
    """Everything that can be reached from a thing, with the way there.

    Classes and modules are left out: their contents are the same in every study.  Of functions
    the defaults and what they enclose are followed.
    """
    if isinstance(thing, type | ModuleType | BuiltinFunctionType) or id(thing) in seen:
        return
    if not isinstance(thing, bool | int | float | complex | str | bytes | enum.Enum | None):
        seen[id(thing)] = thing  # held, so that nothing else gets its number
    yield path, thing
    if isinstance(thing, dict):
        children = [(f"{path}[{k!r}]", v) for k, v in thing.items()]
        children += [(f"{path} key", k) for k in thing]
    elif isinstance(thing, list | tuple | set | frozenset):
        children = [(f"{path}[{i}]", v) for i, v in enumerate(thing)]
    elif isinstance(thing, np.ndarray):
        children = [(f"{path}.base", thing.base)]
    elif isinstance(thing, FunctionType):
        cells = [cell.cell_contents for cell in thing.__closure__ or ()]
        inside = (thing.__defaults__, thing.__kwdefaults__, cells, vars(thing))
        children = [(f"{path}()", v) for v in inside]
    elif isinstance(thing, MethodType):
        children = [(f"{path}.self", thing.__self__), (f"{path}()", thing.__func__)]
    else:
        slots = [name for kind in type(thing).__mro__ for name in getattr(kind, "__slots__", ())]
        own = dict(getattr(thing, "__dict__", {}))  # cached properties are in it
        own |= {name: getattr(thing, name) for name in slots if hasattr(thing, name)}
        children = [(f"{path}.{name}", value) for name, value in own.items()]
    for where, child in children:
        yield from parts(child, where, seen)


@cache
def elsewhere(key: str) -> frozenset[float]:
    """Numbers that tell nothing of a parameter: models without it hold them, too."""
    others = [model for model in MODELS.values() if key not in model.keys]
    return frozenset(
        thing for model in others for _, thing in parts(model, "", {}) if isinstance(thing, float)
    )


def leaks(handed: object, scenario: Scenario) -> list[str]:
    """Where a true parameter value, or the scenario, can be reached."""
    # A true zero or one would be found everywhere; no scenario has one.
    assert not set(scenario.truth) & {0.0, 1.0}
    found = []
    for path, thing in parts(handed, "", {}):
        if isinstance(thing, Scenario):
            found.append(f"{path} is the scenario {thing.name}")
        if isinstance(thing, bool | int | enum.Enum) and not isinstance(thing, np.generic):
            continue  # counts and the numbers of forcing lines: no parameter is counted
        numbers = isinstance(thing, float | complex | np.number | np.ndarray)
        if not numbers or np.asarray(thing).dtype.kind not in "fc":
            continue
        for key, truth in zip(scenario.model.keys, scenario.truth, strict=True):
            if truth in elsewhere(key):
                continue
            if np.any(np.isclose(np.asarray(thing), truth, rtol=1e-9, atol=0.0)):
                found.append(f"{path} holds {key} = {truth:g}")
    return found


#: With three decimals a sample is as likely as not to be a parameter.
SOURCES = {**SCENARIOS, "population-short": POPULATIONS["population-short"]}
NOT_ROUNDED = [name for name in SOURCES if name != "recorder-rounded"]
#: The others differ from one of these in a number.
FIRST = ("nominal", "single", "starts", "violation-saturated", "recorder-late",
         "target-step", "population-short")  # fmt: skip


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=() if n in FIRST else pytest.mark.long) for n in NOT_ROUNDED],
)
def test_nothing_that_a_method_is_handed_holds_the_truth(name: str) -> None:
    # The other recording of `starts` is the same one, from another start.
    for replication in (0, 1):
        recording, model = handed_by(SOURCES[name], replication)
        scenario = scenario_of(SOURCES[name], 1, replication)
        # What is cached on first use.
        _ = model.start, model.lower, model.upper, model.layout, model.places
        assert leaks({"recording": recording, "model": model}, scenario) == []


def hiding_in_a_start(recording: Recording, model: PilotModel, scenario: Scenario) -> object:
    return recording, model.with_start({"tlead": scenario.truth[1]})


def hiding_in_a_signal(recording: Recording, model: PilotModel, scenario: Scenario) -> object:
    e = recording.e.copy()
    e[0, 3] = scenario.truth[2]
    return replace(recording, e=e), model


def hiding_in_a_function(recording: Recording, model: PilotModel, scenario: Scenario) -> object:
    def scale(by: float = scenario.truth[0]) -> float:
        return by

    return recording, model, scale


def hiding_in_an_attribute(recording: Recording, model: PilotModel, scenario: Scenario) -> object:
    copy = replace(recording)
    object.__setattr__(copy, "made_by", scenario)
    return copy, model


def hiding_behind_a_view(recording: Recording, model: PilotModel, scenario: Scenario) -> object:
    held = np.array([*scenario.truth, 0.0])
    return recording, model, held[-1:]


Hide = Callable[[Recording, PilotModel, Scenario], object]


@pytest.mark.parametrize(
    "hide",
    [
        hiding_in_a_start,
        hiding_in_a_signal,
        hiding_in_a_function,
        hiding_in_an_attribute,
        hiding_behind_a_view,
    ],
)
def test_a_truth_that_is_hidden_is_found(hide: Hide) -> None:
    scenario = SCENARIOS["nominal"]
    recording, model = handed_by(scenario, 0)
    assert leaks(hide(recording, model, scenario), scenario)


def test_the_starts_of_the_catalogue_are_those_of_no_truth() -> None:
    for model in MODELS.values():
        for scenario in SCENARIOS.values():
            for key, truth in zip(scenario.model.keys, scenario.truth, strict=True):
                if key in model.keys:
                    # A study fits the scenario's own model.
                    least = 0.1 if model is scenario.model else 0.01
                    assert abs(model.start[model.keys.index(key)] / truth - 1.0) > least, key


def test_only_a_scenario_about_starts_draws_them_about_the_truth() -> None:
    drawn = [s.name for s in SCENARIOS.values() if s.start_spread]
    assert drawn == ["starts"]
    for name, scenario in SCENARIOS.items():
        if name != "starts":
            assert started(scenario, 1, 3) is scenario.model is MODELS[scenario.model.name]


def test_a_scenario_whose_model_starts_at_its_truth_is_refused() -> None:
    nominal = SCENARIOS["nominal"]
    own = replace(nominal, name="own", truth=tuple(nominal.model.start.tolist()))
    with pytest.raises(InputError, match="own: its truth is the start of its model"):
        Study(own, Spy())
    Study(replace(own, start_spread=0.2), Spy())
