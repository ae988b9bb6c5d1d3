"""The report's chapter on populations, from stores that are written by hand."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from test_study_report import Made, check_page, report, scenarios

from pilotid.report.population import overview_table
from pilotid.report.population_verdicts import PopulationVerdict
from pilotid.report.verdicts import Grade
from pilotid.study.comparison import comparison_of
from pilotid.study.entries import Draw, ParameterTruth, Result, ScenarioEntry, Unit
from pilotid.study.population import PopulationCell
from pilotid.study.store import Store
from pilotid.terminal import make_console

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


def verdict(folder: Path, method: str) -> PopulationVerdict:
    with Store(folder) as store:
        (cell,) = (c for c in comparison_of(store).populations if c.method == method)
    return PopulationVerdict(cell)


def test_the_rules_tell_methods_apart(made: Made) -> None:
    found = {m: verdict(made.folder, m) for m in METHODS}
    grades = [v.grade for v in found.values()]
    assert grades == [Grade.GOOD, Grade.POOR, Grade.PARTLY, Grade.NONE, Grade.NONE]
    assert found["mle"].words == found["mle"].code == "good"
    assert re.fullmatch(r"covers \d\d %, errors [34]\.\d times its claims",
                        found["mle-white"].words)  # fmt: skip
    assert re.fullmatch(r"C\d\d S[34]\.\d", found["mle-white"].code)
    assert (found["arx"].words, found["arx"].code) == ("fails 20 %", "F20")
    assert (found["fourier"].words, found["fourier"].code) == ("not applicable", "n/a")
    assert (found["someone-else"].words, found["someone-else"].code) == ("4 fits", "few")


def cell_of(results: Sequence[Result]) -> PopulationCell:
    entry = ScenarioEntry(POPULATION, 30, "pilots", "single, rate", {}, ())
    return PopulationCell(entry, "mle", tuple(results), {})


def test_chance_is_allowed_for() -> None:
    """Of 200 studies of an honest method hardly any calls it anything but good or open."""
    verdicts = [
        PopulationVerdict(cell_of([fitted("mle", 30 * s + r) for r in range(30)]))
        for s in range(200)
    ]
    grades = [v.grade for v in verdicts]
    # It is called bold or narrow with certainty once in some 1000 studies.
    assert grades.count(Grade.GOOD) >= 150
    assert grades.count(Grade.GOOD) + grades.count(Grade.OPEN) >= 198
    open_ = next(v for v in verdicts if v.grade is Grade.OPEN)
    assert open_.words.startswith("open: ")
    assert open_.code.endswith("?")


def test_a_method_that_mostly_fails_is_poor(tmp_path: Path) -> None:
    results = [ended("mle", r, "diverged", "") if r > 4 else fitted("mle", r) for r in range(20)]
    report(tmp_path, lambda store: fill(store, results), ("mle",))
    own = verdict(tmp_path, "mle")
    assert own.grade is Grade.POOR
    assert own.words == "fails 75 %, 5 fits"


def test_a_population_has_its_row_chapter_and_figures(made: Made) -> None:
    text = made.markdown
    assert f"| [{POPULATION}](#any-pilot) | good | C" in text
    assert "| mle | good | 60 of 60 | 0 of 60 | 3 of 60 | " in text
    assert "| fourier | not applicable | 0 of 60 | 0 of 0 | - | - | - |" in text
    assert re.search(
        r"\| arx \| fails 20 % \| 60 of 60 \| 12 of 60 \| - \| 9\d \(\d\d-\d\d\) ", text
    )
    assert re.search(r"`mle` covers least in: .*, \d\d \(\d\d-\d\d\) % in \d\d fits\.", text)
    assert "On a population a method covers too little if fewer than 92 % " in text
    assert f"--scenario {POPULATION} --method" in text
    page = check_page(made.html)
    assert {"summary", "any-pilot", "failures", "settings"} <= set(page.ids)
    for name in ("coverage", "errors"):
        file = made.folder / "figures" / f"{name}-{POPULATION}.svg"
        ElementTree.fromstring(file.read_text(encoding="utf-8"))
        assert f"(figures/{file.name})" in text


def test_its_failures_and_settings_stand_in_the_appendix(made: Made) -> None:
    text = made.markdown
    assert f"| {POPULATION} | arx | 12 | 60 | failure | failed: its process died | signal" in text
    assert "no try | not applicable to this recording | needs two forcing functions |" in text
    assert f"| {POPULATION} | pilots at random | single, rate |" in text
    assert "**inferred**" not in text  # that is of the paper's scenarios


def test_a_study_of_both_has_both(tmp_path: Path) -> None:
    both = scenarios("nominal", "single", methods=("mle", "bayes"))

    def fill_both(store: Store) -> None:
        both(store)
        fill(store, [fitted("mle", r, size=0.8) for r in range(12)])

    made = report(tmp_path, fill_both, ("mle", "bayes"))
    text = made.markdown
    assert f"| [{POPULATION}](#any-pilot) | good | - |" in text
    assert "| [nominal](#nominal) | " in text
    assert "`nominal`: all parameters in a row" in text
    assert f"--scenario nominal,single,{POPULATION} " in text
    check_page(made.html)
    assert POPULATION not in made.terminal  # that table is of one truth


def test_the_terminal_has_a_row_for_each_method(made: Made) -> None:
    with Store(made.folder) as store:
        table = overview_table(comparison_of(store))
    console = make_console()
    with console.capture() as captured:
        console.print(table)
    assert len(re.findall(rf"^{POPULATION} ", captured.get(), re.M)) == len(METHODS)
    assert re.search(r" mle +good +60/60 +9\d ", captured.get())


def test_a_population_of_which_nothing_succeeded_makes_a_report(tmp_path: Path) -> None:
    lost = [replace(ended("mle", r, "crashed", "why"), draw=None) for r in range(2)]
    made = report(tmp_path, lambda store: fill(store, lost), ("mle",))
    check_page(made.html)
    assert "| mle | fails 100 %, 0 fits | 2 of 2 | 2 of 2 |" in made.markdown
    assert not re.search(r"\b(nan|inf)\b", made.html.partition("<script>")[0], re.I)
