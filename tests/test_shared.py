"""Parameters that the conditions of a subject have in common."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import PILOTS, Run

from pilotid import Estimate, Outcome, simulate
from pilotid.estimates.estimate import failed, symmetric_intervals
from pilotid.estimates.shared import share
from pilotid.pilot.catalogue import MODELS
from pilotid.recordings.files import save_recording
from pilotid.remarks import codes_of
from pilotid.types import FloatArray

SINGLE = MODELS["single"]
KEYS = ["fnm", "dnm"]
PLACES = [SINGLE.keys.index(key) for key in KEYS]


def estimate(values: FloatArray, seed: int) -> Estimate:
    """An estimate with relative errors of some per cent, all of them correlated."""
    root = np.random.default_rng(seed).normal(0.0, 0.03, (5, 5)) * values[:, None]
    covariance = root @ root.T + np.diag((0.01 * values) ** 2)
    intervals = symmetric_intervals(values, covariance)
    return Estimate("mle", SINGLE, Outcome.CONVERGED, values, covariance, intervals)


START = np.array([0.3, 1.5, 0.3, 11.0, 0.25])
PAIR = {"A": estimate(START, 1), "B": estimate(START * [0.7, 1.4, 1.0, 1.05, 0.97], 2)}


def test_it_is_least_squares_under_equality() -> None:
    shared, test = share(PAIR, KEYS)
    first, second = PAIR.values()
    # Both estimates by the free parameters, five of A and three of B alone; all but delays are
    # positive and count by their logarithms.
    logs = SINGLE.positive
    design = np.zeros((10, 8))
    design[:5, :5] = np.eye(5)
    design[5:8, 5:] = np.eye(3)
    design[[5 + place for place in PLACES], PLACES] = 1.0
    weight = np.zeros((10, 10))
    for at, own in ((0, first), (5, second)):
        unit = np.where(logs, own.values, 1.0)
        weight[at : at + 5, at : at + 5] = np.linalg.inv(own.covariance / np.outer(unit, unit))
    seen = np.concatenate([np.where(logs, np.log(e.values), e.values) for e in (first, second)])
    covariance = np.linalg.inv(design.T @ weight @ design)
    found = covariance @ design.T @ weight @ seen
    left = seen - design @ found
    values = np.where(logs, np.exp(found[:5]), found[:5])
    np.testing.assert_allclose(shared["A"].values, values, rtol=1e-9)
    other = np.where(logs[:3], np.exp(found[5:]), found[5:])
    np.testing.assert_allclose(shared["B"].values[:3], other, rtol=1e-9)
    errors = np.sqrt(np.diag(covariance))[:5] * np.where(logs, values, 1.0)
    np.testing.assert_allclose(shared["A"].std_error, errors, rtol=1e-6)
    assert test is not None
    assert test.freedom == 2
    assert test.statistic == pytest.approx(left @ weight @ left)
    np.testing.assert_array_equal(shared["A"].values[PLACES], shared["B"].values[PLACES])
    np.testing.assert_allclose(shared["A"].intervals[PLACES], shared["B"].intervals[PLACES])
    assert codes_of(shared["A"].remarks) == ["shared"]
    assert "8 free parameters in place of 10" in shared["A"].remarks[0]


def test_unequal_parameters_are_named() -> None:
    other = estimate(START * [1.0, 1.0, 1.0, 1.6, 1.0], 2)
    shared, test = share({"A": PAIR["A"], "B": other}, KEYS)
    assert test is not None
    assert test.p < 1e-6
    assert codes_of(shared["B"].remarks) == ["shared", "unequal"]


def test_what_ends_at_a_bound_or_failed_shares_nothing() -> None:
    values = START.copy()
    values[PLACES[1]] = SINGLE.lower[PLACES[1]]
    alone = {
        "A": PAIR["A"],
        "B": estimate(values, 3),
        "C": failed("mle", SINGLE, Outcome.DIED),
    }
    shared, test = share(alone, KEYS)
    assert test is None
    assert [codes_of(own.remarks) for own in shared.values()] == [["not-shared"]] * 2 + [[]]
    np.testing.assert_array_equal(shared["A"].values, START)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("subjects")
    for condition, factor in (("A", 1.0), ("B", 1.3)):
        pilot = PILOTS["single"]
        truth = np.array(pilot.truth) * [1.0, factor, 1.0, 1.0, 1.0]
        recording = simulate(replace(pilot, truth=tuple(truth)), 4)
        save_recording(recording, folder / f"s1_{condition}.csv")
    return folder


COMMON = ("--pattern", "s{subject}_{condition}", "--method", "fourier", "--workers", "1")


@pytest.mark.numerical
@pytest.mark.long
def test_an_analysis_shares(folder: Path, run: Run, tmp_path: Path) -> None:
    files = sorted(folder.glob("*.csv"))
    options = (*COMMON, "--model", "single", "--share", "fnm,dnm")
    answer = run("analyse", *files, *options, "--out", tmp_path)
    assert answer.status == 0, answer.err
    with (tmp_path / "estimates.csv").open(newline="", encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["model"]]
    of = {(row["parameter"], row["condition"]): row for row in rows}
    for column in ("value", "std_error", "lower_95", "upper_95"):
        for key in KEYS:
            assert of[key, "A"][column] == of[key, "B"][column]
        assert of["tlead", "A"][column] != of["tlead", "B"][column]
    assert "8 free parameters in place of 10" in of["fnm", "A"]["remarks"]
    with (tmp_path / "contrasts.csv").open(newline="", encoding="utf-8") as file:
        compared = {row["parameter"] for row in csv.DictReader(file)}
    assert "tlead" in compared
    assert not compared & set(KEYS)
    assert (tmp_path / "report.html").read_text("utf-8").count(">shared<") == 2


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--model", "single", "--share", "tlag"), "the model single has no tlag"),
        (("--model", "single", "--share", "fnm", "--exclude", "condition=B"), "two conditions"),
        (("--model", "single", "--share", "fnm", "--pattern", "s{subject}"), "no {condition}"),
    ],
)
def test_what_cannot_be_shared_is_refused(
    folder: Path, run: Run, tmp_path: Path, options: tuple[str, ...], words: str
) -> None:
    files = sorted(folder.glob("*.csv"))[: 1 if "--pattern" in options else 2]
    answer = run("analyse", *files, *COMMON, *options, "--out", tmp_path)
    assert answer.status == 2
    assert answer.err.startswith("pilotid: --share")
    assert words in answer.err
    assert answer.err.count("\n") == 1
