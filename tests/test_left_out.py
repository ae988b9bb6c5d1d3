"""Runs left out: what their likelihood and VAF are, and how they rank methods."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from pandas import DataFrame, concat

from pilotid.datasets import SCENARIOS, simulate
from pilotid.estimate.estimate import Outcome, failed
from pilotid.experiment.fits import predict_left_out
from pilotid.experiment.report import ranked
from pilotid.methods.mle_white import MLEWhite
from pilotid.recording.recording import Recording
from pilotid.recording.windows import of_runs

SINGLE = SCENARIOS["single"]


@pytest.fixture(scope="module")
def recording() -> Recording:
    """Four runs of a pilot who does not change."""
    return simulate(replace(SINGLE, runs=4), np.random.default_rng(5))


def rows(method: str, likelihoods: list[float], vaf: float = 80.0) -> DataFrame:
    known: dict[str, object] = {"file": "a", "run": [1, 2, 3], "model": "single", "method": method}
    return DataFrame({**known, "vaf": vaf, "log_likelihood": likelihoods})


@pytest.mark.numerical
def test_scaled_signals_shift_all_likelihoods_alike(recording: Recording) -> None:
    # 1000 times as large: each prediction error is 1000 times less likely, for all methods.
    names = [name for name in ("e", "u", "x", "ft", "fd") if getattr(recording, name) is not None]
    large = replace(recording, **{name: 1e3 * getattr(recording, name) for name in names})
    values = [SINGLE.values, 1.05 * SINGLE.values]
    found = [
        [
            replace(failed("given", SINGLE.model, Outcome.CONVERGED), values=v)
            .score(of_runs(r, [1], ""), of_runs(r, [2, 3, 4], ""))
            .log_score
            for v in values
        ]
        for r in (recording, large)
    ]
    assert found[1][0] < found[0][0] - 1000.0
    apart = [a - b for a, b in found]
    assert apart[1] == pytest.approx(apart[0], abs=1e-4)


@pytest.mark.numerical
def test_every_run_is_predicted_by_the_others(recording: Recording) -> None:
    (found,) = predict_left_out(recording, SINGLE.model, {"mine": MLEWhite()}, 3, 1)
    assert found["method"] == "mine"
    assert found["outcome"] == "converged"
    vaf = found["vaf"]
    assert isinstance(vaf, float)
    assert 40.0 < vaf < 100.0


def test_methods_are_ranked_by_pairs_of_runs() -> None:
    lost = rows("lost", [math.nan] * 3).assign(vaf=math.nan)
    found = ranked(
        concat([lost, rows("bad", [97.0, 97.0, 97.0]), rows("good", [101.0, 102.0, 103.0])])
    )
    assert [*found["method"]] == ["good", "bad", "lost"]
    assert [*found["failed"]] == [0, 0, 3]
    good, bad, lost = found.itertuples()
    assert (good.behind, good.vaf_mean) == (0.0, 80.0)
    assert (bad.behind, bad.behind_error) == pytest.approx((-5.0, 1.0 / math.sqrt(3.0)))
    assert math.isnan(lost.behind)


def test_a_method_that_fails_once_costs_the_others_that_run_alone() -> None:
    found = ranked(concat([rows("a", [10.0] * 3), rows("b", [12.0, math.nan, 12.0])]))
    assert [*found["method"]] == ["b", "a"]
    assert found["behind"][1] == pytest.approx(-2.0)
