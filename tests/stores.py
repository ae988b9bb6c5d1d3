"""Stores of studies for tests: a finished one, and the same with bytes of it changed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pilotid.study.comparison import comparison_of
from pilotid.study.store import (
    Draw,
    MethodEntry,
    ParameterTruth,
    Result,
    ScenarioEntry,
    Store,
    Unit,
)

KEYS = ("Kvis", "tlead", "tdvis", "fnm", "zetanm")


def finish(folder: Path, replications: int = 25) -> Store:
    """Two scenarios, a population, three methods, and some fits that failed; still open."""
    rng = np.random.default_rng(4)
    store = Store(folder, create=True)
    store.describe({"seed": "1", "code": "c0de", "numpy": "2.0", "remnant ratio first": "0.1"})
    for position, name in enumerate(("first", "second")):
        known = tuple(ParameterTruth(key, "s", 1.5 + position, 0.1) for key in KEYS)
        settings = {"class": "Scenario", "truth": [1.5] * 5, "remnant": {"level": 0.4}}
        store.add_scenario(ScenarioEntry(name, position, "words", "single", settings, known))
    store.add_scenario(ScenarioEntry("any", 2, "words", "single", {"class": "Population"}, ()))
    for position, name in enumerate(("mle", "arx", "fourier")):
        store.add_method(MethodEntry(name, position, {"class": name, "memory": 2.0}))
    for replication in range(replications):
        for scenario in ("first", "second"):
            for method in ("mle", "arx", "fourier"):
                unit = Unit(scenario, method, replication)
                store.add(fit(unit, rng) if rng.random() > 0.1 else Result(unit, "crashed", "why"))
        for method in ("mle", "arx", "fourier"):
            found = fit(Unit("any", method, replication), rng)
            store.add(replace(found, excess=rng.normal(), draw=drawn(replication)))
    return store


def drawn(replication: int) -> Draw:
    """What the population drew for a replication."""
    truth = np.random.default_rng(replication).normal(1.5, 0.1, len(KEYS)).tolist()
    known = tuple(ParameterTruth(k, "s", v, 0.1) for k, v in zip(KEYS, truth, strict=True))
    return Draw("single", known, {"element": "K/s", "dt": 0.01, "runs": 1 + replication % 2})


def fit(unit: Unit, rng: np.random.Generator) -> Result:
    """A fit with numbers of chance."""
    rows = tuple(
        (key, v, 0.1, v - 0.2, v + 0.2)
        for key, v in zip(KEYS, rng.normal(1.5, 0.1, 5).tolist(), strict=True)
    )
    return Result(unit, "converged", "", True, rng.uniform(70.0, 90.0), 9, False, 0.2, rows)


@dataclass(frozen=True)
class Content:
    """All that a report is made of."""

    about: dict[str, str]
    scenarios: list[ScenarioEntry]
    methods: dict[str, MethodEntry]
    fits: dict[Unit, Result]


def content_of(store: Store) -> Content:
    """What a store holds; its scores can be computed."""
    for cell in comparison_of(store).cells:
        assert len(cell.scores) == 1 + len(KEYS)
    fits = {result.unit: result for result in store.results()}
    assert fits.keys() <= store.done().keys()
    return Content(store.about(), store.scenarios(), store.methods(), fits)


def changed(content: bytes, rng: np.random.Generator) -> bytes:
    """A file with a few bytes changed, a stretch of them overwritten, or its end cut off."""
    how, data = rng.choice(["byte", "bytes", "head", "stretch", "cut"]), bytearray(content)
    if how == "cut":
        return bytes(data[: rng.integers(1, len(data))])
    if how == "stretch":
        start = int(rng.integers(len(data) - 1))
        new = rng.bytes(min(int(rng.integers(1, 5000)), len(data) - start))
        data[start : start + len(new)] = new
        return bytes(data)
    last = 200 if how == "head" else len(data)
    for _ in range(1 if how == "byte" else int(rng.integers(2, 20))):
        data[rng.integers(last)] = rng.integers(256)
    return bytes(data)
