"""Stores of studies for tests."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from pilotid.study.table import Comparison, Entry, Fit, Store, frame_of
from pilotid.support.store import Key

KEYS = ("Kvis", "tlead", "tdvis", "fnm", "zetanm")
NAMES = ("mle", "arx", "fourier")


def finish(folder: Path, replications: int = 25) -> Store:
    """Two scenarios, a population, three methods, and some fits that failed; still open."""
    rng = np.random.default_rng(4)
    store = Store(folder, create=True)
    store.describe({"seed": "1", "code": "c0de", "numpy": "2.0"})
    settings = {"class": "Scenario", "truth": [1.5] * 5, "remnant": {"level": 0.4}}
    scenarios = [
        Entry(name, place, settings, description="words", model="single", remnant=0.1)
        for place, name in enumerate(("first", "second"))
    ]
    scenarios.append(Entry("any", 2, {"class": "Population"}, population=True))
    methods = [Entry(m, place, {"class": m, "memory": 2.0}) for place, m in enumerate(NAMES)]
    store.enter(scenarios, methods)
    for replication in range(replications):
        for place, scenario in enumerate(("first", "second")):
            truth = [1.5 + place] * len(KEYS)
            for method in NAMES:
                found = fit((scenario, method, replication), rng, truth)
                store.add(found if rng.random() > 0.1 else failed(found))
        for method in NAMES:
            store.add(replace(drawn(("any", method, replication), rng), excess=rng.normal()))
    return store


def drawn(key: Key, rng: np.random.Generator) -> Fit:
    """A fit of what a population drew for a replication."""
    truth = np.random.default_rng(key[2]).normal(1.5, 0.1, len(KEYS)).tolist()
    facts = {"element": "K/s", "dt": 0.01, "runs": 1 + key[2] % 2}
    return replace(fit(key, rng, truth), facts=facts)


def fit(key: Key, rng: np.random.Generator, truth: Sequence[float] = (1.5,) * 5) -> Fit:
    """A fit with numbers of chance."""
    rows = tuple(
        (k, "s", t, 0.1, v, 0.1, v - 0.2, v + 0.2)
        for k, t, v in zip(KEYS, truth, rng.normal(1.5, 0.1, 5).tolist(), strict=True)
    )
    return Fit(*key, "converged", "", True, 80.0, 9, 0.2, model="single", estimates=rows)


def failed(fit: Fit, outcome: str = "crashed", message: str = "why") -> Fit:
    """A fit that gave no estimate."""
    rows = tuple((*known[:4], None, None, None, None) for known in fit.estimates)
    return replace(fit, outcome=outcome, message=message, usable=False, estimates=rows)


def comparison(fits: Iterable[Fit], *, population: bool = False) -> Comparison:
    """What a study of one scenario holds that gave these fits."""
    frame = frame_of(list(fits)).assign(population=population)
    own = {name: Entry(name, 0, {}, population=population) for name in frame.scenario.unique()}
    methods = {name: Entry(name, 0, {}) for name in frame.method.unique()}
    return Comparison(frame, own, methods, {}, Path())
