"""Whatever a method does, it is a row with its reason, and everything else goes on."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from helpers import PROGRAM, python

from pilotid.datasets import scenario_named, simulate
from pilotid.estimate.estimate import Estimate, Outcome
from pilotid.estimate.method import fit_all, identify
from pilotid.methods import method_named
from pilotid.model.catalogue import SINGLE
from pilotid.study.run import Task, recording_of, run_task
from pilotid.study.table import Store
from pilotid.support.naming import packed
from pilotid.testing import check_method

HERE = Path(__file__).parent
RECORDING = simulate(scenario_named("single"), np.random.default_rng(1))

UNSOUND = {
    "nothing": "it returned NoneType in place of an Estimate",
    "nan": "is not finite",
    "infinite": "is not finite",
    "words": "no array of real numbers",
    "short": "of the shape (5,)",
    "flat": "its intervals are no array of real numbers of the shape (5, 2)",
    "negative": "a variance is not positive",
    "reversed": "an interval does not hold its value",
}
RAISED = {
    "leave": (Outcome.CRASHED, "SystemExit: 3"),
    "fail": (Outcome.CRASHED, r"ValueError: a\udcffb"),
    "want_all_memory": (Outcome.OUT_OF_MEMORY, "Unable to allocate"),
    "objection": (Outcome.CRASHED, "LookupError: no opinion"),
}


def hostile(how: str) -> str:
    return f"{HERE / 'hostile.py'}:Hostile(how={how})"


def answer(how: str) -> Estimate:
    return identify(method_named(hostile(how)), RECORDING, SINGLE, np.random.default_rng(1))


@pytest.mark.parametrize("how", UNSOUND)
def test_what_is_no_sound_estimate_is_a_failure(how: str) -> None:
    estimate = answer(how)
    assert estimate.outcome is Outcome.INVALID
    assert UNSOUND[how] in estimate.message
    assert np.isnan(estimate.values).all()


@pytest.mark.parametrize("how", ["bare", "ends", "partly"])
def test_what_a_method_does_not_claim_is_no_fault(how: str) -> None:
    assert answer(how).outcome is Outcome.CONVERGED


def test_a_method_that_changes_the_recording_spoils_no_other() -> None:
    method, single = method_named(hostile("spoil")), scenario_named("single")
    before = recording_of(single, 1, 0).e.copy()
    assert run_task(Task(("single", "spoil", 0), 1, packed((single, method)))).outcome == "invalid"
    assert np.array_equal(recording_of(single, 1, 0).e, before)
    with pytest.raises(AssertionError, match="changed the recording"):
        check_method(method)


@pytest.mark.parametrize("how", RAISED)
def test_what_a_method_raises_is_an_outcome(how: str) -> None:
    estimate = answer(how)
    outcome, words = RAISED[how]
    assert estimate.outcome is outcome
    assert estimate.message.startswith(words)
    assert estimate.message.isprintable()


def test_signs_that_no_file_can_hold_are_escaped() -> None:
    estimate = answer("signs")
    assert estimate.outcome is Outcome.CONVERGED
    assert estimate.message == r"a\udcffb \x1b[31mc\x00"


def test_what_a_method_prints_is_no_part_of_the_answer(capsys: pytest.CaptureFixture[str]) -> None:
    fit_all(RECORDING, SINGLE, {"loud": method_named(hostile("shout"))}, 1)
    assert capsys.readouterr().out == ""


def test_only_the_user_interrupts() -> None:
    with pytest.raises(KeyboardInterrupt):
        answer("interrupt")


@pytest.mark.long
def test_a_study_of_hostile_methods_ends_with_its_report(tmp_path: Path) -> None:
    deadly = ("interrupt", "vanish", "kill", "leave", "nan", "good")
    methods = ",".join(hostile(how) for how in deadly)
    options = ("--scenario", "single", "--replications", "1")
    limits = ("--workers", "2", "--out", tmp_path)
    done = python("-c", PROGRAM, "compare", *options, *limits, "--method", methods)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "report.html").exists()
    ends = {
        "hostile": ("converged", ""),
        "hostile(how=interrupt)": ("crashed", "KeyboardInterrupt"),
        "hostile(how=vanish)": ("died", "exit code 3"),
        "hostile(how=kill)": ("died", "exit code -9"),
        "hostile(how=leave)": ("crashed", "SystemExit: 3"),
        "hostile(how=nan)": ("invalid", "a value or its covariance is not finite"),
    }
    assert rows(tmp_path) == ends
    # What hangs is waited for in vain: in a study of its own, no others need that long.
    (tmp_path / "report.html").unlink()
    few = ",".join(hostile(how) for how in ("hang", "vanish", "nan"))
    more = ("--method", few, "--time-limit", "8", "--retry-failed")
    again = python("-c", PROGRAM, "compare", *options, *limits, *more)
    assert again.returncode == 0, again.stderr
    assert "holds 1 of 3 fits already" in again.stdout, again.stdout
    assert (tmp_path / "report.html").exists()
    found = rows(tmp_path)
    assert found.pop("hostile(how=hang)") == ("timed-out", "8 s")
    assert found == ends
    with (tmp_path / "estimates.csv").open(newline="") as stream:
        told = {(row["method"], row["outcome"]) for row in csv.DictReader(stream)}
    assert ("hostile(how=hang)", "timed-out") in told


def rows(folder: Path) -> dict[str, tuple[str, str]]:
    """Outcome and message by method; they are the same for all replications."""
    with Store(folder) as store:
        found = {(fit.method, fit.outcome, fit.message) for fit in store.fits()}
    assert len(found) == len({method for method, *_ in found})
    return {method: (outcome, message) for method, outcome, message in found}
