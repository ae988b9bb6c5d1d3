"""What a study keeps of remarks, and what its report says of them."""

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
from pilotid.study.fits import LONGEST_TOLD, told
from pilotid.study.store import Result, Store, Unit
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


def test_the_ranking_of_a_violation_says_who_is_warned(made: Made) -> None:
    check_page(made.html)
    table = made.markdown.partition("`violation-drift`, 40 recordings")[2].partition("\n\n**")[0]
    rows = {}
    for line in table.splitlines():
        if line.startswith("| "):
            method, *others = (entry.strip() for entry in line.strip("|").split("|"))
            rows[method] = others
    place = rows["method"].index("warned")
    warned = {method: others[place] for method, others in rows.items()}
    assert warned["told"] == "30 of 40"
    assert warned["silent"] == warned["mle"] == "0"
    assert warned["fails"] == "40 of 40"
    (line,) = (x for x in made.markdown.splitlines() if x.startswith("| told | 30 of 40 | rec"))
    assert line.split("|")[3].strip() == (
        "recording: u drifts by 0 over run 1, and no other signal ... (30); "
        "the first half of the recording asks for another pilot than ... (30)"
    )
    assert rows["objects"][0] == "not applicable"
    bias = rows["told"][rows["method"].index("largest bias/error")]
    assert bias.startswith((f"{KEYS[1]} -5.", f"{KEYS[1]} -4."))  # -0.5, and claims of 0.1
    nominal = made.markdown.partition("`nominal`, 40 recordings")[2].partition("\n\n**")[0]
    assert "warned" not in nominal


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
    assert kept["violation-lost"].startswith("u keeps its value at")


def test_the_full_profile_has_the_family_and_the_quick_one_has_not() -> None:
    own = {name for name, scenario in SCENARIOS.items() if scenario.family == "violation"}
    assert len(own) == 6
    assert own <= set(PROFILES["full"][0])
    assert not own & set(PROFILES["quick"][0])
