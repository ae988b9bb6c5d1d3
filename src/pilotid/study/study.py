"""Scenarios x methods x replications: where truth meets estimate."""

from __future__ import annotations

import platform
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib.metadata import version
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pilotid.datasets import CATALOGUE, AnyScenario, Population, Scenario, scenarios_named, simulate
from pilotid.datasets.named import sound
from pilotid.datasets.simulation import remnant_ratio
from pilotid.estimates.estimate import Outcome
from pilotid.estimates.method import Method
from pilotid.jobs import TIME_LIMIT, run_tasks
from pilotid.methods import label_of, method_named, methods
from pilotid.naming.code import code_digest, own_digest, packed, place_of, reason
from pilotid.naming.settings import labelled, plain
from pilotid.study.comparison import Comparison, comparison_of
from pilotid.study.fits import OUTSIDE, Task, given_up, run_task, scenario_of, truths_of
from pilotid.study.store import (
    MethodEntry,
    ParameterTruth,
    Result,
    ScenarioEntry,
    Store,
    Unit,
)
from pilotid.support.disk import make_folder
from pilotid.support.numbers import DEFAULT_SEED
from pilotid.support.types import InputError

if TYPE_CHECKING:
    from pandas import DataFrame


UNANSWERED = "no answer came"
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


def method_entry(
    method: Method, position: int = 0, typed: str = "", label: str = ""
) -> MethodEntry:
    """A method for the store.

    Parameters
    ----------
    method
        The method.
    position
        Its place behind those that are registered.
    typed
        What the user typed for it, if anything.
    label
        Its label in the study; empty for its own.
    """
    known, own = list(methods()), label_of(method)
    registered = method.name in known
    place = known.index(method.name) if registered else len(known) + position
    if not typed:
        typed = own if registered else labelled(place_of(type(method)), method)
    return MethodEntry(label or own, place, plain(method), code_digest(method), typed)


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
    name, about = scenario.name, scenario.description
    place = known.index(name) if name in known else len(known) + position
    own = plain(scenario), parameters, family, code_digest(scenario)
    return ScenarioEntry(name, place, about, model, *own, typed or name)


def scenario_facts(scenario: Scenario) -> dict[str, str]:
    """What a report needs besides: the remnant's share."""
    return {f"remnant ratio {scenario.name}": f"{remnant_ratio(scenario):.4f}"}


def _try_out(population: Population) -> None:
    """Draw a pilot and a recording that nobody keeps, so that what cannot be is told at once."""
    rng = np.random.default_rng(0)
    scenario = population.drawn(rng)
    simulate(scenario, rng)
    truths_of(scenario)


#: Shows results as they come: the results, and how many there will be by method.
Bar = Callable[[Iterator[Result], Mapping[str, int]], Iterable[Result]]
#: Scenarios and replications of each, by name of the profile.
PROFILES: dict[str, tuple[tuple[str, ...], int]] = {
    "quick": (("nominal", "population-usual"), 25),
    "full": (tuple(CATALOGUE), 500),
}


@dataclass(init=False)
class Study:
    """What is to be compared.

    Attributes
    ----------
    scenarios, methods
        Objects; when a study is made, what the command line takes for one will do as well.
    replications
        Recordings of each scenario.
    seed
        Seed of all random numbers.
    labels
        The methods' labels, which identify them in tables and in the store.
    """

    scenarios: tuple[AnyScenario, ...]
    methods: tuple[Method, ...]
    replications: int
    seed: int
    labels: tuple[str, ...] = field(init=False, repr=False, compare=False)

    def __init__(
        self,
        scenarios: Iterable[AnyScenario | str],
        methods: Iterable[Method | str],
        replications: int = PROFILES["quick"][1],
        seed: int = DEFAULT_SEED,
    ) -> None:
        typed = [
            (scenario, given if isinstance(given, str) else "")
            for given in _each(scenarios)
            for scenario in (scenarios_named(given) if isinstance(given, str) else [given])
        ]
        tried = [labelled_method(given) for given in _each(methods)]
        self.labels = tuple(label for label, *_ in tried)
        _require_different("scenarios", [sound(scenario).name for scenario, _ in typed])
        _require_different("methods", self.labels)
        self.scenarios = tuple(scenario for scenario, _ in typed)
        self.methods = tuple(method for _, method, _ in tried)
        self.replications, self.seed = replications, seed
        # What to type for each again.
        self._typed = [text for _, text in typed], [text for *_, text in tried]

    @property
    def size(self) -> int:
        """Number of all fits."""
        return len(self.pairs) * self.replications

    @cached_property
    def pairs(self) -> dict[tuple[str, str], tuple[AnyScenario, Method]]:
        """What is tried on what, by the scenario's name and the method's label."""
        return {
            (scenario.name, label): (scenario, method)
            for scenario in self.scenarios
            for label, method in zip(self.labels, self.methods, strict=True)
        }

    def units(self) -> Iterator[Unit]:
        """All fits: one recording of every scenario after the other."""
        for replication in range(self.replications):
            for scenario, label in self.pairs:
                yield Unit(scenario, label, replication)

    def holds(self, unit: Unit) -> bool:
        """Whether a fit is one of this study."""
        return (unit.scenario, unit.method) in self.pairs and unit.replication < self.replications

    def enter(self, store: Store, *, retry: bool = False) -> Pending:
        """Describe the study in a store; returns the fits that the store lacks.

        Parameters
        ----------
        store
            A new store, or one of the same study that was stopped or was smaller.
        retry
            Whether fits that crashed, died, or ran out of memory or time are to be fitted again.

        Raises
        ------
        InputError
            If the store holds results of other code or settings.
        """
        about = about_this(self.seed)
        scenarios = list(map(scenario_entry, self.scenarios, count(), self._typed[0]))
        methods = list(map(method_entry, self.methods, count(), self._typed[1], self.labels))
        held = store.about()
        changed = [key for key in about if key in held and held[key] != about[key]]
        changed += _changed({m.label: m for m in methods}, store.methods())
        changed += _changed({s.name: s for s in scenarios}, {s.name: s for s in store.scenarios()})
        if changed:
            raise InputError(
                f"{store.path}: holds results of other code or settings (different: "
                f"{', '.join(changed)}); name another folder with --out"
            )
        store.describe(about)
        for scenario, entry in zip(self.scenarios, scenarios, strict=True):
            store.add_scenario(entry)
            if isinstance(scenario, Scenario):
                store.describe(scenario_facts(scenario))
        for method in methods:
            store.add_method(method)
        fits = store.done()
        if retry:
            lost = {outcome.slug for outcome in OUTSIDE}
            again = [u for u, end in fits.items() if end in lost and self.holds(u)]
            store.forget(again)
            fits = store.done()
        return Pending(self, frozenset(fits))

    def run(
        self,
        store: Store,
        pending: Iterable[Unit],
        workers: int | None = None,
        scheduler: str | None = None,
        time_limit: float | None = TIME_LIMIT,
    ) -> Iterator[Result]:
        """Fit what is pending; each result is in the store before it comes out.

        A fit that nobody answered, or for which an answer to another came, is one that failed.
        """
        answered: set[Unit] = set()
        tasks = self.tasks(pending)
        answers = run_tasks(run_task, tasks, given_up, workers, scheduler, time_limit)
        lost = (u for u in pending if u not in answered)
        for found in chain(answers, (Result(u, Outcome.DIED.slug, UNANSWERED) for u in lost)):
            answered.add(found.unit)
            result = self._with_draw(found)
            store.add(result)
            yield result

    def _with_draw(self, result: Result) -> Result:
        """A fit whose process died could not say which pilot a population drew for it."""
        origin = next(s for s in self.scenarios if s.name == result.unit.scenario)
        if result.draw is not None or not isinstance(origin, Population):
            return result
        try:
            _, draw = scenario_of(origin, self.seed, result.unit.replication)
        except InputError:  # of this pilot no bounds can be given
            return result
        return replace(result, draw=draw)

    def run_in(
        self, folder: Path, workers: int | None = None, bar: Bar = lambda results, _: results
    ) -> Comparison:
        """Fit what a folder's store lacks, and return all that it holds then.

        Parameters
        ----------
        folder
            Where the store is, or is to be.
        workers
            Processes; None for one for each processor.
        bar
            Shows results as they come.
        """
        make_folder(folder)
        with Store(folder, create=True) as store:
            pending = self.enter(store)
            for _ in bar(self.run(store, pending, workers), pending.counts):
                pass
            return comparison_of(store)

    def to_dataframe(self, folder: Path) -> DataFrame:
        """All estimates that a folder's store holds, as `Comparison.to_dataframe` has them."""
        with Store(folder) as store:
            return comparison_of(store).to_dataframe()

    def tasks(self, units: Iterable[Unit]) -> Iterator[Task]:
        """Fits as they cross to other processes.

        Raises
        ------
        InputError
            If a method or a scenario cannot cross.
        """
        contents = {
            pair: _content(scenario, method, pair[1])
            for pair, (scenario, method) in self.pairs.items()
        }
        for unit in units:
            yield Task(unit, self.seed, contents[unit.scenario, unit.method])


@dataclass(frozen=True)
class Pending:
    """The fits of a study that its store lacks; they may be more than any list can hold."""

    study: Study
    done: frozenset[Unit]

    def __iter__(self) -> Iterator[Unit]:
        return (unit for unit in self.study.units() if unit not in self.done)

    @cached_property
    def counts(self) -> dict[str, int]:
        """How many there are of each method."""
        study = self.study
        tried = Counter(label for _, label in study.pairs)
        held = Counter(unit.method for unit in self.done if study.holds(unit))
        return {label: n * study.replications - held[label] for label, n in tried.items()}

    @property
    def total(self) -> int:
        """How many there are."""
        return sum(self.counts.values())


def labelled_method(given: Method | str) -> tuple[str, Method, str]:
    """A method with its label, and what the user typed for it, if anything.

    Parameters
    ----------
    given
        A method, or the text of one, such as ``arx(memory=none)``; a text may give the method a
        label of its own, as ``short=mle(band=30)`` does.

    Raises
    ------
    InputError
        If there is no such method.
    """
    if not isinstance(given, str):
        return label_of(given), given, ""
    named = re.fullmatch(r"(\w[\w.+-]{0,60})=(.+)", given, re.ASCII | re.DOTALL)
    method = method_named(named[2] if named else given)
    return named[1] if named else label_of(method), method, given


def _each(given: Any) -> list[Any]:
    """Several, or one that the caller did not put into a list."""
    return list(given) if isinstance(given, Iterable) and not isinstance(given, str) else [given]


def _require_different(what: str, names: Sequence[str]) -> None:
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"two of the {what} are called '{twice}'; leave one out or rename it")


def _changed(
    new: Mapping[str, MethodEntry | ScenarioEntry], old: Mapping[str, MethodEntry | ScenarioEntry]
) -> list[str]:
    """Names of what is known already, but with other settings or from other code."""
    return [
        name
        for name, entry in new.items()
        if name in old and (entry.settings, entry.code) != (old[name].settings, old[name].code)
    ]


def _content(scenario: AnyScenario, method: Method, label: str) -> bytes:
    """A scenario and a method for another process, which must understand them."""
    for name, thing in ((scenario.name, scenario), (label, method)):
        try:
            packed(thing)
        except Exception as error:
            raise InputError(
                f"{name}: cannot be handed to another process ({reason(error)}); let its settings "
                "be numbers, words and dataclasses"
            ) from error
    return packed((scenario, method))
