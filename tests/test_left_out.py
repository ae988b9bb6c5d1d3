"""Runs left out: what their likelihood and VAF are, and how they rank methods."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pilotid.analysis.cross_validation import (
    LeftOut,
    log_likelihood,
    predict_left_out,
    rank_methods,
)
from pilotid.analysis.recordings import Part, alone, without
from pilotid.analysis.report_tables import left_out_table
from pilotid.datasets import SCENARIOS, simulate
from pilotid.methods.mle_white import MLEWhite
from pilotid.recordings.recording import Recording

SINGLE = SCENARIOS["single"]


@pytest.fixture(scope="module")
def recording() -> Recording:
    """Four runs of a pilot who does not change."""
    return simulate(replace(SINGLE, runs=4), np.random.default_rng(5))


def line(method: str, run: int, likelihood: float, vaf: float = 80.0, file: str = "a") -> LeftOut:
    part = Part((Path("/secret/place") / f"{file}.mat",), (("subject", file), ("condition", "C1")))
    usable = math.isfinite(likelihood)
    outcome = "converged" if usable else "crashed"
    return LeftOut(part, run, "single", method, outcome, usable, vaf, likelihood, 0.1)


def test_a_run_and_the_others_make_the_recording(recording: Recording) -> None:
    one, others = alone(recording, 2), without(recording, 2)
    assert (one.runs, others.runs) == (1, 3)
    assert np.array_equal(one.u[0], recording.u[1])
    assert np.array_equal(others.u, recording.u[[0, 2, 3]])


@pytest.mark.numerical
def test_the_true_pilot_is_likelier_than_a_wrong_one(recording: Recording) -> None:
    truth = SINGLE.values
    wrong = truth * np.where(np.array(SINGLE.model.keys) == "tdvis", 1.3, 1.0)
    apart = []
    for run in range(1, 5):
        others, own = without(recording, run), alone(recording, run)
        apart.append(
            log_likelihood(others, own, SINGLE.model, truth)
            - log_likelihood(others, own, SINGLE.model, wrong)
        )
    assert min(apart) > 5.0


@pytest.mark.numerical
def test_scaled_signals_shift_all_likelihoods_alike(recording: Recording) -> None:
    # 1000 times as large: each prediction error is 1000 times less likely, for all methods.
    names = [name for name in ("e", "u", "x", "ft", "fd") if getattr(recording, name) is not None]
    large = replace(recording, **{name: 1e3 * getattr(recording, name) for name in names})
    values = [SINGLE.values, 1.05 * SINGLE.values]
    found = [
        [log_likelihood(without(r, 1), alone(r, 1), SINGLE.model, v) for v in values]
        for r in (recording, large)
    ]
    assert found[1][0] < found[0][0] - 1000.0
    apart = [a - b for a, b in found]
    assert apart[1] == pytest.approx(apart[0], abs=1e-4)


@pytest.mark.numerical
def test_every_run_is_predicted_by_the_others(recording: Recording) -> None:
    (found,) = predict_left_out(recording, SINGLE.model, {"mine": MLEWhite()}, 3, 1)
    assert found["method"] == "mine"
    assert found["usable"] is True
    vaf = found["vaf"]
    assert isinstance(vaf, float)
    assert 40.0 < vaf < 100.0


def test_methods_are_ranked_by_pairs_of_runs() -> None:
    lines = [line("good", run, 100.0 + run, 80.0 + run) for run in (1, 2, 3)]
    lines += [line("bad", run, 100.0 + run - own) for run, own in ((1, 4.0), (2, 5.0), (3, 6.0))]
    lines += [line("lost", run, math.nan, math.nan) for run in (1, 2, 3)]
    good, bad, lost = rank_methods(lines)
    assert (good.method, good.behind[0], good.runs, good.failed) == ("good", 0.0, 3, 0)
    assert good.vaf[0] == pytest.approx(82.0)
    assert good.vaf[1] == pytest.approx(1.0 / math.sqrt(3.0))
    assert bad.behind == pytest.approx((-5.0, 1.0 / math.sqrt(3.0)))
    assert (lost.method, lost.failed) == ("lost", 3)
    assert math.isnan(lost.behind[0])


def test_a_method_that_fails_once_costs_the_others_that_run_alone() -> None:
    lines = [line("a", run, 10.0) for run in (1, 2, 3)]
    lines += [line("b", run, math.nan if run == 2 else 12.0) for run in (1, 2, 3)]
    first, second = rank_methods(lines)
    assert (first.method, first.failed) == ("b", 1)
    assert second.behind[0] == pytest.approx(-2.0)


def test_the_table_has_the_likeliest_first() -> None:
    lines = [line(m, n, 10.0 - (m == "worse")) for n in (1, 2) for m in ("worse", "better")]
    found = left_out_table(lines)
    place = found.columns.index("method")
    assert [row[place] for row in found.rows] == ["better", "worse"]
