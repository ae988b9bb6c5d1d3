"""Scenarios x methods x replications: where truth meets estimate."""

from __future__ import annotations

import hashlib
import math
import platform
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from statistics import median

import numpy as np

from pilotid.datasets import scenario_named, simulate
from pilotid.datasets.experiments import spectra
from pilotid.datasets.scenarios import SCENARIOS, Scenario
from pilotid.datasets.simulation import remnant_ratio
from pilotid.estimates.estimate import Estimate, Outcome
from pilotid.estimates.method import identify
from pilotid.methods import method_named, methods
from pilotid.pilot.model import PilotModel
from pilotid.seeds import fit_rng, recording_rng, start_rng
from pilotid.study.store import ParameterTruth, Result, ScenarioEntry, Store, Unit
from pilotid.study.workers import run_tasks
from pilotid.theory.bounds import bounds
from pilotid.types import InputError

#: Scenarios and replications of each, by name of the profile.
PROFILES: dict[str, tuple[tuple[str, ...], int]] = {
    "quick": (("nominal",), 25),
    "full": (tuple(SCENARIOS), 500),
}
LIBRARIES = ("numpy", "scipy", "control", "pysindy", "emcee")


@dataclass(frozen=True)
class Study:
    """What is to be compared.

    Attributes
    ----------
    scenarios, methods
        Their names.
    replications
        Recordings of each scenario.
    seed
        Seed of all random numbers.
    """

    scenarios: tuple[str, ...]
    methods: tuple[str, ...]
    replications: int
    seed: int

    def units(self) -> list[Unit]:
        """All fits: one recording of every scenario after the other."""
        return [
            Unit(scenario, method, replication)
            for replication in range(self.replications)
            for scenario in self.scenarios
            for method in self.methods
        ]

    def enter(self, store: Store, *, mix: bool = False) -> list[Unit]:
        """Describe the study in a store; returns the fits that the store lacks.

        Parameters
        ----------
        store
            A new store, or one of the same study that was stopped or was smaller.
        mix
            Whether results of other code or settings may stay beside the new ones.

        Raises
        ------
        InputError
            If the store holds results of other code or settings.
        """
        about = about_this(self.seed)
        held = store.about()
        changed = [key for key in about if key in held and held[key] != about[key]]
        labels = store.methods()
        changed += [m for m in self.methods if labels.get(m, label_of(m)) != label_of(m)]
        details = {entry.name: entry.details for entry in store.scenarios()}
        changed += [s for s in self.scenarios if details.get(s, details_of(s)) != details_of(s)]
        if changed and not mix:
            raise InputError(
                f"{store.path}: holds results of other code or settings (different: "
                f"{', '.join(changed)}); name another folder with --out, or put both into one "
                "report with --mix"
            )
        if changed:
            about["mixed"] = ", ".join(changed)
        store.describe(about)
        for name in self.scenarios:
            store.add_scenario(entry_of(name))
            ratio = remnant_ratio(scenario_named(name))
            store.describe({f"remnant ratio {name}": f"{ratio:.4f}"})
        known = list(methods())
        for name in self.methods:
            store.add_method(name, known.index(name), label_of(name))
        done = store.done()
        return [unit for unit in self.units() if unit not in done]

    def run(
        self,
        store: Store,
        pending: Iterable[Unit],
        workers: int | None = None,
        scheduler: str | None = None,
    ) -> Iterator[Result]:
        """Fitted what is pending; each result is in the store before it comes out."""
        fit = partial(run_unit, self.seed)
        for result in run_tasks(fit, pending, given_up, workers, scheduler):
            store.add(result)
            yield result


def run_unit(seed: int, unit: Unit) -> Result:
    """Simulate and identify; whatever goes wrong is a result."""
    try:
        scenario = scenario_named(unit.scenario)
        replication = 0 if scenario.one_recording else unit.replication
        recording = simulate(scenario, recording_rng(seed, scenario.name, replication))
        model = _started(scenario, seed, unit.replication)
        rng = fit_rng(seed, unit.method, unit.scenario, unit.replication)
        estimate = identify(method_named(unit.method), recording, model, rng)
    except Exception as error:  # a bug, and no reason to lose the other results
        return given_up(unit, f"{type(error).__name__}: {error}")
    return _result(unit, estimate)


def _started(scenario: Scenario, seed: int, replication: int) -> PilotModel:
    """The scenario's model with the initial guesses of a replication."""
    if not scenario.start_spread:
        return scenario.model
    rng = start_rng(seed, scenario.name, replication)
    factors = 1.0 + scenario.start_spread * rng.uniform(-1.0, 1.0, len(scenario.truth))
    starts = scenario.values * factors
    return scenario.model.with_start(dict(zip(scenario.model.keys, starts.tolist(), strict=True)))


def given_up(unit: Unit, why: str) -> Result:
    """The row of a fit that gave no estimate at all."""
    return Result(unit, Outcome.CRASHED.slug, why)


def _result(unit: Unit, estimate: Estimate) -> Result:
    return Result(
        unit,
        estimate.outcome.slug,
        estimate.message,
        estimate.outcome.usable,
        _number(estimate.vaf),
        estimate.iterations,
        estimate.draws is not None,
        _number(estimate.seconds),
        tuple(
            (q.key, _number(q.value), _number(q.std_error), _number(q.lower), _number(q.upper))
            for q in estimate.parameters
        ),
    )


def _number(value: float) -> float | None:
    """A number for the store, None where it is none."""
    return float(value) if math.isfinite(value) else None


def remaining_seconds(store: Store, pending: Sequence[Unit], workers: int) -> float:
    """About how long the pending fits will take, by what fits of each method took so far."""
    took: dict[str, list[float]] = {}
    for result in store.results():
        if result.seconds is not None:
            took.setdefault(result.unit.method, []).append(result.seconds)
    typical = {method: median(seconds) for method, seconds in took.items()}
    return sum(typical.get(unit.method, 0.0) for unit in pending) / workers


def about_this(seed: int) -> dict[str, str]:
    """Code, versions and seed: what two results must share to be compared."""
    return {
        "seed": str(seed),
        "code": code_digest(),
        "pilotid": version("pilotid"),
        "python": ".".join(platform.python_version_tuple()[:2]),
        **{name: version(name) for name in LIBRARIES},
    }


def code_digest() -> str:
    """A short digest of this package's source."""
    import pilotid.datasets
    import pilotid.methods

    digest = hashlib.sha256()
    for package in (pilotid, pilotid.methods, pilotid.datasets):
        for folder in package.__path__:
            for file in sorted(Path(folder).rglob("*.py")):
                place = file.relative_to(folder).as_posix()
                digest.update(place.encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()[:12]


def label_of(method: str) -> str:
    """A method's settings."""
    return repr(method_named(method))


def details_of(scenario: str) -> str:
    """All that defines a scenario."""
    return repr(scenario_named(scenario))


def entry_of(name: str) -> ScenarioEntry:
    """A scenario with its truth and its bounds, for the store.

    The bound is that of the whole record with the remnant's spectrum known: the floor under
    every unbiased method.
    """
    scenario = scenario_named(name)
    deviations = np.sqrt(np.diag(bounds(spectra(scenario)).full))
    return ScenarioEntry(
        name,
        list(SCENARIOS).index(name),
        scenario.description,
        scenario.model.name,
        details_of(name),
        tuple(
            ParameterTruth(p.key, p.unit, float(truth), _number(float(bound)))
            for p, truth, bound in zip(
                scenario.model.parameters, scenario.values, deviations, strict=True
            )
        ),
    )
