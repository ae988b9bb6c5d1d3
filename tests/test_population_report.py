"""The report's chapter on populations, from stores that are written by hand."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_study_report import Made, report

from pilotid.study.comparison import comparison_of
from pilotid.study.judge import Verdict, judge
from pilotid.study.store import Draw, ParameterTruth, Result, ScenarioEntry, Store, Unit

KEYS = {"single": ("Kvis", "tdvis"), "rate": ("Kvis", "tdvis", "Km")}
POPULATION = "population-usual"


def drawn(replication: int) -> Draw:
    rng = np.random.default_rng(replication)
    model = ("single", "rate")[replication % 2]
    known = tuple(ParameterTruth(k, "s", rng.uniform(1.0, 2.0), 0.1) for k in KEYS[model])
    facts: dict[str, str | float] = {
        "element": "K/s", "remnant": f"order {1 + replication % 3 % 2}", "forcing": "both",
        "remnant_level": rng.uniform(0.05, 0.3), "duration": rng.uniform(60.0, 120.0),
        "dt": 0.01, "run_in": 8.0, "runs": 1 + replication % 2,
    }  # fmt: skip
    return Draw(model, known, facts)


def fitted(
    method: str, replication: int, *, size: float = 1.0, excess: float | None = None
) -> Result:
    """A fit that claims the bound and errs by `size` times as much."""
    draw = drawn(replication)
    rng = np.random.default_rng((replication, sum(map(ord, method))))
    rows = []
    for p in draw.parameters:
        value = p.truth + 0.1 * size * rng.normal()
        rows.append((p.parameter, value, 0.1, value - 0.196, value + 0.196))
    unit = Unit(POPULATION, method, replication)
    return Result(
        unit, "converged", "", True, 80.0, 5, False, 0.02, tuple(rows), excess=excess, draw=draw
    )


def fill(store: Store, results: Sequence[Result]) -> None:
    words = "pilots at random"
    store.add_scenario(ScenarioEntry(POPULATION, 30, words, "single, rate", {"runs": [1]}, ()))
    for result in results:
        store.add(result)


def ended(method: str, replication: int, outcome: str, why: str) -> Result:
    return Result(Unit(POPULATION, method, replication), outcome, why, draw=drawn(replication))


def of_all_kinds() -> list[Result]:
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
    with Store(folder) as store:
        cell = comparison_of(store).at(POPULATION, method)
    assert cell is not None
    return judge(cell.scores)


def test_the_verdicts_tell_methods_apart(made: Made) -> None:
    found = {m: verdict(made.folder, m) for m in METHODS}
    assert found["mle"].grade == "efficient"
    assert found["mle-white"].grade == "poor"
    assert [flag.code for flag in found["mle-white"].flags] == ["too-short"]
    assert [flag.code for flag in found["arx"].flags] == ["fails"]
    assert found["arx"].flags[0].value == pytest.approx(0.2)
    assert found["fourier"].grade == "not applicable"


def test_a_population_of_which_nothing_succeeded_makes_a_report(tmp_path: Path) -> None:
    lost = [replace(ended("mle", r, "crashed", "why"), draw=None) for r in range(2)]
    made = report(tmp_path, lambda store: fill(store, lost), ("mle",))
    assert "2 of 2" in made.markdown
    assert not re.search(r"\b(nan|inf)\b", made.html.partition("<script>")[0], re.I)
