"""Scenarios x methods x replications: where truth meets estimate."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from functools import cached_property
from itertools import count
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pilotid.datasets import CATALOGUE, AnyScenario, Population, scenario_named, simulate
from pilotid.datasets.named import sound
from pilotid.datasets.simulation import remnant_ratio
from pilotid.estimate.method import Method
from pilotid.methods import METHODS, label_of, method_named
from pilotid.study import paper
from pilotid.study.run import (
    OUTSIDE,
    Task,
    given_up,
    run_task,
    scenario_of,
    truths_of,
    with_truth,
)
from pilotid.study.table import OF_METHODS, OF_SCENARIOS, Comparison, Entry, Fit, Store
from pilotid.support.disk import make_folder
from pilotid.support.format import with_bar
from pilotid.support.jobs import TIME_LIMIT, about_this, run_tasks
from pilotid.support.naming import code_digest, labelled, packed, to_jsonable
from pilotid.support.numbers import DEFAULT_SEED
from pilotid.support.store import Key
from pilotid.support.types import InputError, reason, several


def method_entry(method: Method, position: int = 0, typed: str = "", label: str = "") -> Entry:
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
    known, name = list(METHODS), label_of(method)
    registered = method.name in known
    place = known.index(method.name) if registered else len(known) + position
    if not typed:
        kind = type(method)
        place_in_code = f"{kind.__module__}:{kind.__qualname__}"
        typed = name if registered else labelled(place_in_code, method)
    return Entry(label or name, place, to_jsonable(method), code_digest(method), typed)


def scenario_entry(scenario: AnyScenario, position: int = 0, typed: str = "") -> Entry:
    """A scenario for the store; see `method_entry`.

    Raises
    ------
    InputError
        If no bounds can be given, for example because the loop is unstable, or if a population
        cannot be drawn from.
    """
    known, population, remnant = list(CATALOGUE), isinstance(scenario, Population), None
    try:
        if isinstance(scenario, Population):
            model, family = ", ".join(dict.fromkeys(scenario.models)), ""
            # A pilot and a recording that nobody keeps, so that what cannot be is told at once.
            rng = np.random.default_rng(0)
            drawn = scenario.drawn(rng)
            simulate(drawn, rng)
            truths_of(drawn)
        else:
            model, family = scenario.model.name, scenario.family
            truths_of(scenario)
            remnant = round(remnant_ratio(scenario), 4)
    except InputError:
        raise
    except Exception as error:  # a scenario of the user's own may be anything
        raise InputError(
            f"scenario {scenario.name}: cannot be simulated ({reason(error)}); check its settings"
        ) from error
    name, about = scenario.name, scenario.description
    place = known.index(name) if name in known else len(known) + position
    entry = place, to_jsonable(scenario), code_digest(scenario), typed or name
    return Entry(name, *entry, about, model, family, population, remnant)


class Profile(NamedTuple):
    """Scenarios, replications of each, and methods, where the user names none."""

    scenarios: tuple[str, ...]
    replications: int
    methods: tuple[str, ...]


#: Methods of the quick comparison; the others repeat what is inferior, or take long.
CORE = ("mle", "bayes", "fourier", "arx", "sindy")
#: By name, what is compared; the paper's is in `pilotid.study.paper`.
PROFILES = {
    "quick": Profile(("nominal", "population-usual"), 12, CORE),
    "full": Profile(tuple(CATALOGUE), 500, (*METHODS, "bayes(prior=3)")),
    "paper": Profile((*paper.TABLE_3, *paper.REMNANTS, "starts"), 10, paper.METHODS),
}


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

    def __init__(
        self,
        scenarios: Iterable[AnyScenario | str],
        methods: Iterable[Method | str],
        replications: int = PROFILES["quick"].replications,
        seed: int = DEFAULT_SEED,
    ) -> None:
        typed = [
            (scenario_named(given), given) if isinstance(given, str) else (given, "")
            for given in several(scenarios)
        ]
        tried = [labelled_method(given) for given in several(methods)]
        self.labels = tuple(label for label, *_ in tried)
        _require_different("scenarios", [sound(scenario).name for scenario, _ in typed])
        _require_different("methods", self.labels)
        self.scenarios = tuple(scenario for scenario, _ in typed)
        self.methods = tuple(method for _, method, _ in tried)
        if replications < 1:
            raise InputError(f"replications {replications}: must be 1 or more")
        self.replications, self.seed = replications, seed
        # What to type for each again.
        self._typed = [text for _, text in typed], [text for *_, text in tried]

    @cached_property
    def pairs(self) -> dict[tuple[str, str], tuple[AnyScenario, Method]]:
        """What is tried on what, by the scenario's name and the method's label."""
        return {
            (scenario.name, label): (scenario, method)
            for scenario in self.scenarios
            for label, method in zip(self.labels, self.methods, strict=True)
        }

    @property
    def keys(self) -> list[Key]:
        """Scenario, method and replication of all fits: one recording of each after the other."""
        return [(*pair, number) for number in range(self.replications) for pair in self.pairs]

    def enter(self, store: Store, *, retry: bool = False) -> list[Key]:
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
        before = store.about()
        changed = [key for key in about if key in before and before[key] != about[key]]
        kept = (methods, store.entries(OF_METHODS)), (scenarios, store.entries(OF_SCENARIOS))
        twins = [
            (entry, old[entry.name]) for new, old in kept for entry in new if entry.name in old
        ]
        changed += [a.name for a, b in twins if (a.settings, a.code) != (b.settings, b.code)]
        if changed:
            raise InputError(
                f"{store.path}: holds results of other code or settings (different: "
                f"{', '.join(changed)}); name another folder with --out"
            )
        store.describe(about)
        store.enter(scenarios, methods)
        done = {fit.key: fit.outcome for fit in store.fits()}
        lost = {outcome.slug for outcome in OUTSIDE} if retry else set()
        pending = [key for key in self.keys if done.get(key) in {None, *lost}]
        store.drop(key for key in pending if key in done)
        return pending

    def run(
        self,
        store: Store,
        pending: Sequence[Key],
        workers: int | None = None,
        scheduler: str | None = None,
        time_limit: float | None = TIME_LIMIT,
    ) -> Iterator[Fit]:
        """Fit what is pending; each result is in the store before it comes out."""
        tasks = [*self.tasks(pending)]
        for fit in run_tasks(run_task, tasks, given_up, workers, scheduler, time_limit):
            if not fit.estimates:
                origin, _ = self.pairs[fit.scenario, fit.method]
                with suppress(InputError):  # of this pilot no bounds can be given
                    fit = with_truth(fit, scenario_of(origin, self.seed, fit.replication))
            store.add(fit)
            yield fit

    def run_in(self, folder: Path, workers: int | None = None) -> Comparison:
        """Fit what a folder's store lacks, and return all that it holds then.

        Parameters
        ----------
        folder
            Where the store is, or is to be.
        workers
            Processes; None for one for each processor.
        """
        make_folder(folder)
        with Store(folder, create=True) as store:
            pending = self.enter(store)
            for _ in with_bar(self.run(store, pending, workers), "fits", len(pending)):
                pass
            return store.comparison()

    def tasks(self, keys: Iterable[Key]) -> Iterator[Task]:
        """Fits as they cross to other processes.

        Raises
        ------
        InputError
            If a method or a scenario cannot cross.
        """
        contents = {pair: packed(tried) for pair, tried in self.pairs.items()}
        for key in keys:
            yield Task(key, self.seed, contents[key[:2]])


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


def _require_different(what: str, names: Sequence[str]) -> None:
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"two of the {what} are called '{twice}'; leave one out or rename it")
