"""The report's chapter on populations, from stores that are written by hand."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from stores import failed
from test_study_report import Made, report

from pilotid.study.table import Entry, Fit, Store, Verdict, judge, read_study

KEYS = {"single": ("Kvis", "tdvis"), "rate": ("Kvis", "tdvis", "Km")}
POPULATION = "population-usual"


def fitted(method: str, replication: int, *, size: float = 1.0, excess: float | None = None) -> Fit:
    """A fit that claims the bound and errs by `size` times as much."""
    rng = np.random.default_rng(replication)
    noise = np.random.default_rng((replication, sum(map(ord, method))))
    model, rows = ("single", "rate")[replication % 2], []
    for key in KEYS[model]:
        truth = rng.uniform(1.0, 2.0)
        value = truth + 0.1 * size * noise.normal()
        rows.append((key, "s", truth, 0.1, value, 0.1, value - 0.196, value + 0.196))
    facts = {
        "element": "K/s", "remnant": f"order {1 + replication % 3 % 2}", "forcing": "both",
        "remnant_level": rng.uniform(0.05, 0.3), "duration": rng.uniform(60.0, 120.0),
        "dt": 0.01, "run_in": 8.0, "runs": 1 + replication % 2,
    }  # fmt: skip
    key, drawn = (POPULATION, method, replication), {"model": model, "facts": facts}
    ended = "converged", "", True, 80.0, 5, 0.02
    return Fit(*key, *ended, excess=excess, estimates=tuple(rows), **drawn)


def fill(store: Store, fits: Sequence[Fit]) -> None:
    own = Entry(POPULATION, 30, {"runs": [1]}, description="pilots at random", population=True)
    store.enter([replace(own, model="single, rate")])
    for found in fits:
        store.add(found)


def ended(method: str, replication: int, outcome: str, why: str) -> Fit:
    return failed(fitted(method, replication), outcome, why)


def of_all_kinds() -> list[Fit]:
    """A careful method, a bold one, one that fails, one that objects, one with few fits."""
    found = []
    for r in range(60):
        found.append(fitted("mle", r, size=0.8, excess=10.0 if r < 3 else 0.0))
        found.append(fitted("mle-white", r, size=4.0))
        found.append(fitted("arx", r) if r % 5 else ended("arx", r, "died", "signal SIGKILL"))
        found.append(ended("fourier", r, "not-applicable", "needs two forcing functions"))
        if r < 4:
            found.append(fitted("someone-else", r))
    return found


METHODS = ("mle", "mle-white", "arx", "fourier", "someone-else")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    folder = tmp_path_factory.mktemp("report")
    return report(folder, lambda store: fill(store, of_all_kinds()), METHODS)


def verdict(folder: Path, method: str) -> Verdict:
    return judge(read_study(folder).scored(POPULATION, method))


def test_the_verdicts_tell_methods_apart(made: Made) -> None:
    found = {m: verdict(made.folder, m) for m in METHODS}
    assert found["mle"].grade == "efficient"
    assert found["mle-white"].grade == "poor"
    assert [flag.code for flag in found["mle-white"].flags] == ["too-short"]
    assert [flag.code for flag in found["arx"].flags] == ["fails"]
    assert found["arx"].flags[0].value == pytest.approx(0.2)
    assert found["fourier"].grade == "not applicable"


def test_a_population_of_which_nothing_succeeded_makes_a_report(tmp_path: Path) -> None:
    lost = [Fit(POPULATION, "mle", r, "crashed", "why") for r in range(2)]
    made = report(tmp_path, lambda store: fill(store, lost), ("mle",))
    assert "2 of 2" in made.markdown
    assert not re.search(r"\b(nan|inf)\b", made.html.partition("<script>")[0], re.I)
