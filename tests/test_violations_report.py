"""What a study keeps of remarks, and the report's chapter on violations, from fits by hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import NOMINAL, recording_of
from test_output import estimate
from test_study_report import KEYS, Made, check_page, entry, fit, report

from pilotid.datasets import SCENARIOS
from pilotid.recordings.checks import remarks
from pilotid.report.content import Table
from pilotid.report.violations import violation_chapters
from pilotid.study.comparison import Comparison, comparison_of
from pilotid.study.entries import MethodEntry, Result, Unit
from pilotid.study.fits import LONGEST_TOLD, told
from pilotid.study.store import Store
from pilotid.study.study import PROFILES, Study

DRIFT = "recording: u drifts by {:.3g} over run 1, and no other signal does"
OTHER = "the first half of the recording asks for another pilot than the second"


def fill(store: Store) -> None:
    """An honest method; one that is wrong and told of; one that is wrong; one that objects."""
    for position, name in enumerate(("nominal", "violation-drift")):
        own = replace(entry(name, position), family="violation" if position else "")
        store.add_scenario(own)
        truth = np.array([p.truth for p in own.parameters])
        claim = np.full(truth.size, 0.1)
        rng = np.random.default_rng(position)
        for r in range(40):
            near = truth + 0.1 * rng.normal(size=truth.size)
            wrong = near + np.where(np.arange(truth.size) == 1, -0.5 * position, 0.0)
            words = f"{DRIFT.format(0.1 * r)} | {OTHER}" if position and r < 30 else ""
            for method, values in (("mle", near), ("told", wrong), ("silent", wrong)):
                found = fit(Unit(name, method, r), values.tolist(), claim.tolist())
                store.add(replace(found, remarks=words if method == "told" else ""))
            store.add(Result(Unit(name, "objects", r), "not-applicable", "needs two"))
            store.add(Result(Unit(name, "fails", r), "diverged"))


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    methods = ("mle", "told", "silent", "objects", "fails")
    return report(tmp_path_factory.mktemp("violations"), fill, methods)


def rows(made: Made) -> dict[tuple[str, str], list[str]]:
    """The entries of the chapter's table behind scenario and method."""
    chapter = made.markdown.partition('<a id="violations"></a>')[2].partition("<a id=")[0]
    lines = [line for line in chapter.splitlines() if line.startswith(("| nominal", "| violation"))]
    table = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return {(scenario, method): others for scenario, method, *others in table if len(others) == 7}


def test_a_method_is_covered_warned_or_silent(made: Made) -> None:
    found = rows(made)
    graded = {place: others[0] for place, others in found.items()}
    assert graded["violation-drift", "mle"] == "covered"
    assert graded["violation-drift", "told"] == "warned"
    assert graded["violation-drift", "silent"] == "silent"
    assert graded["violation-drift", "fails"] == "warned"
    assert graded["nominal", "silent"] == "covered"
    assert not any(method == "objects" for _, method in graded)


def test_the_numbers_are_those_of_the_fits(made: Made) -> None:
    _, failures, bias, coverage, lowest, warned, words = rows(made)["violation-drift", "told"]
    assert failures == "0 of 40"
    assert bias.startswith("-5.") or bias.startswith("-4.")  # -0.5, and claims of 0.1
    assert bias.endswith(KEYS[1])
    assert 75.0 < float(coverage.split()[0]) < 90.0  # six of seven parameters hold
    assert lowest == f"0 {KEYS[1]}"
    assert warned == "30 of 40"
    assert words == (
        "recording: u drifts by 0 over run 1, and no other signal ... (30); "
        "the first half of the recording asks for another pilot than ... (30)"
    )
    fails = rows(made)["violation-drift", "fails"]
    assert fails[1:] == ["40 of 40", "-", "-", "-", "40 of 40", "-"]


def test_the_page_has_the_chapter_and_its_rules(made: Made) -> None:
    check_page(made.html)
    assert "When the assumptions do not hold" in made.html
    assert "a user would believe what is wrong" in made.markdown
    assert "--scenario nominal,violation-drift --method" in made.markdown
    assert "`violation-drift`: all numbers" in made.markdown


def test_few_fits_are_no_grade_and_no_violation_is_no_chapter(tmp_path: Path) -> None:
    with Store(tmp_path, create=True) as store:
        for method in ("mle", "told"):
            store.add_method(MethodEntry(method, 0, {}))
        fill(store)
        study = comparison_of(store)
    few = [replace(cell, results=cell.results[:9]) for cell in study.cells]
    (chapter,) = violation_chapters(Comparison(tuple(few), study.typed))
    table = chapter.blocks[0]
    assert isinstance(table, Table)
    assert {row[2].text for row in table.rows} == {"\N{EN DASH}"}
    sound = [cell for cell in study.cells if cell.scenario.name == "nominal"]
    assert violation_chapters(Comparison(tuple(sound), study.typed)) == []


def test_a_study_keeps_what_a_user_is_told() -> None:
    sound = recording_of(NOMINAL)
    assert told(remarks(sound), estimate()) == ""
    drifting = replace(sound, u=sound.u + 0.01 * sound.time)
    line = told(remarks(drifting), estimate(remarks=("mind the gap", "and the step")))
    assert line.startswith("recording: u drifts by")
    assert "take it out with --detrend | " in line
    assert line.endswith(" | mind the gap | and the step") or line.endswith(" ...")
    assert len(told(remarks(sound), estimate(remarks=("long " * 100,)))) == LONGEST_TOLD


@pytest.mark.numerical
def test_remarks_of_a_study_are_in_its_store(tmp_path: Path) -> None:
    Study(["nominal", "violation-lost"], "mle", 1).run_in(tmp_path, workers=1)
    with Store(tmp_path) as store:
        kept = {result.unit.scenario: result.remarks for result in store.results()}
    assert kept["nominal"] == ""
    assert kept["violation-lost"].startswith("u keeps its value from one sample to the next")


def test_the_full_profile_has_the_family_and_the_quick_one_has_not() -> None:
    own = {name for name, scenario in SCENARIOS.items() if scenario.family == "violation"}
    assert len(own) == 6
    assert own <= set(PROFILES["full"][0])
    assert not own & set(PROFILES["quick"][0])
