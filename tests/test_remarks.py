"""What estimates say in words, on numbers that can be worked out by hand."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from helpers import draws_at, estimate_at

from pilotid.datasets import SCENARIOS, simulate
from pilotid.estimate.estimate import Estimate, Outcome
from pilotid.estimate.method import identify
from pilotid.estimate.quantities import RemnantEstimate
from pilotid.estimate.warnings import all_remarks, one_signal, remarks_on
from pilotid.methods import MLE
from pilotid.model.catalogue import MODELS, MULTI, SINGLE
from pilotid.model.model import PilotModel
from pilotid.support.disk import strict_json
from pilotid.support.remarks import codes_of

pytestmark = pytest.mark.numerical

PILOTS = {
    "single": {"Kvis": 0.5, "tlead": 2.0, "tdvis": 0.3, "fnm": 12.0, "dnm": 0.2},
    "lead-lag": {"Kvis": 0.5, "tlead": 2.0, "tlag": 0.5, "tdvis": 0.3, "fnm": 12.0, "dnm": 0.2},
}


def estimate_of(
    model: PilotModel,
    errors: dict[str, float] | None = None,
    correlated: tuple[str, str, float] | None = None,
    **values: float,
) -> Estimate:
    """An estimate with relative standard errors, 0.02 unless given."""
    vector = model.vector(PILOTS[model.name] | values)
    error = vector * np.array([(errors or {}).get(key, 0.02) for key in model.keys])
    correlation = np.eye(len(error))
    if correlated:
        i, j = (model.keys.index(key) for key in correlated[:2])
        correlation[i, j] = correlation[j, i] = correlated[2]
    covariance = correlation * np.outer(error, error)
    return estimate_at(model, vector, covariance, vaf=80.0)


def with_interval(estimate: Estimate, key: str, low: float, high: float) -> Estimate:
    intervals = estimate.intervals.copy()
    intervals[estimate.model.keys.index(key)] = low, high
    return replace(estimate, intervals=intervals)


def test_an_estimate_with_nothing_wrong_says_nothing() -> None:
    assert remarks_on(estimate_of(SINGLE)) == remarks_on(estimate_of(MODELS["lead-lag"])) == ()


def test_pairs_that_cannot_be_told_apart_are_named_with_what_can_be_reported() -> None:
    estimate = estimate_of(SINGLE, {"Kvis": 0.2, "tlead": 0.2}, ("Kvis", "tlead", -0.99))
    told = "Kvis and tlead cannot be told apart (correlation -0.99): as far as one of them is wrong"
    assert remarks_on(estimate) == (f"{told}, so is the other; report Kvis*tlead",)
    (pair,) = json.loads(strict_json(estimate.to_dict()))["inseparable"]
    assert pair == {"parameters": ["Kvis", "tlead"], "correlation": pytest.approx(-0.99)}
    # A delay that may be zero has no logarithm.
    (pair,) = estimate_of(SINGLE, {"tdvis": 0.12, "fnm": 0.12}, ("tdvis", "fnm", 0.99)).inseparable
    assert (pair.first, pair.second) == ("tdvis", "fnm")
    assert pair.words.endswith("so is the other")


@pytest.mark.parametrize(("error", "correlation"), [(0.09, -0.99), (0.2, -0.94)])
def test_pairs_known_or_hardly_correlated_are_not_named(error: float, correlation: float) -> None:
    errors = {"Kvis": error, "tlead": error}
    assert estimate_of(SINGLE, errors, ("Kvis", "tlead", correlation)).inseparable == []


def test_correlations_come_from_the_draws_where_there_are_some() -> None:
    rng = np.random.default_rng(1)
    inner = rng.standard_normal((4000, 5)) * 0.02
    common = 0.5 * rng.standard_normal(4000)
    inner[:, 0] += common
    inner[:, 1] -= common
    estimate = estimate_of(SINGLE)
    draws = draws_at(SINGLE.keys, SINGLE.positive, estimate.values * np.exp(inner))
    (pair,) = replace(estimate, draws=draws).inseparable
    assert (pair.first, pair.second) == ("Kvis", "tlead")
    assert pair.correlation < -0.95


def test_a_delay_that_people_do_not_have() -> None:
    (remark,) = remarks_on(estimate_of(SINGLE, tdvis=0.013))
    assert (remark.code, remark.grade) == ("outside-range", "doubt")
    (remark,) = remarks_on(with_interval(estimate_of(SINGLE, tdvis=0.7), "tdvis", 0.6, 0.8))
    assert (remark.code, remark.grade) == ("outside-range", "doubt")
    (remark,) = remarks_on(with_interval(estimate_of(SINGLE, tdvis=0.09), "tdvis", 0.06, 0.12))
    (remark,) = remarks_on(with_interval(estimate_of(SINGLE, tdvis=0.05), "tdvis", 0.0, 0.12))
    assert remark.startswith("tdvis is 0.05 s")
    assert remark.grade == "note"
    assert remarks_on(estimate_of(SINGLE, tdvis=0.11)) == ()


@pytest.mark.parametrize(("jumps", "error"), [(1.0, 0.0005), (1.0, 0.02), (0.0, 0.0005)])
def test_a_target_that_jumps_between_two_samples(jumps: float, error: float) -> None:
    recording = simulate(SCENARIOS["single"], np.random.default_rng(1))
    steps = jumps * (np.floor(recording.time / 7.0) % 2.0)
    moved = replace(recording, e=recording.e + steps, ft=recording.ft + steps)
    said = codes_of(all_remarks(estimate_of(SINGLE, {"tdvis": error}), moved))
    assert ("late-signal" in said) == (jumps > 0.0 and error < 0.001)


def test_a_damping_that_people_do_not_have() -> None:
    (remark,) = remarks_on(with_interval(estimate_of(SINGLE, dnm=0.06), "dnm", 0.03, 0.1))
    assert (remark.code, remark.grade) == ("outside-range", "doubt")
    (remark,) = remarks_on(estimate_of(SINGLE, fnm=3.0))
    assert (remark.code, remark.grade) == ("outside-range", "doubt")
    assert remarks_on(with_interval(estimate_of(SINGLE, dnm=0.11), "dnm", 0.06, 0.2)) == ()
    # What is not determined may have any value.
    (remark,) = remarks_on(with_interval(estimate_of(SINGLE, dnm=0.06), "dnm", 0.03, 1.0))
    assert remark.code == "not-determined"


def test_what_is_known_where_an_interval_ends_at_a_bound() -> None:
    at_bound = replace(estimate_of(SINGLE, fnm=39.0), outcome=Outcome.AT_BOUND)
    (remark,) = remarks_on(with_interval(at_bound, "fnm", 12.0, 40.0))
    assert (remark.code, remark.grade) == ("not-determined", "note")
    (remark,) = remarks_on(with_interval(at_bound, "fnm", 21.0, 40.0))  # beyond what is published
    assert (remark.code, remark.grade) == ("not-determined", "doubt")
    (remark,) = remarks_on(with_interval(estimate_of(SINGLE), "tdvis", 0.0, 0.41))
    assert remark.startswith("tdvis is at most 0.41 s")
    (remark,) = remarks_on(with_interval(estimate_of(SINGLE), "dnm", 0.02, 3.0))
    assert (remark.code, remark.grade) == ("not-determined", "note")
    (remark,) = remarks_on(with_interval(at_bound, "fnm", 39.99, 40.0))
    assert (remark.code, remark.grade) == ("not-determined", "doubt")


def test_wide_intervals_are_one_remark() -> None:
    estimate = with_interval(estimate_of(SINGLE), "tlead", 0.5, 5.5)
    (remark,) = remarks_on(estimate)
    assert (remark.code, remark.grade) == ("not-determined", "note")
    assert remark.startswith("tlead is 0.5 .. 5.5 s:")
    (remark,) = remarks_on(with_interval(estimate, "tdvis", 0.0, 0.41))
    assert remark.startswith("tlead is 0.5 .. 5.5 s; tdvis is at most 0.41 s:")
    assert remarks_on(with_interval(estimate_of(SINGLE), "tlead", 1.0, 2.4)) == ()


def test_nothing_is_said_of_what_failed_or_means_nothing() -> None:
    short = estimate_of(SINGLE, tdvis=0.013)
    assert remarks_on(replace(short, outcome=Outcome.NOT_CONVERGED)) == ()
    (remark,) = remarks_on(replace(short, vaf=10.0))
    assert (remark.code, remark.grade) == ("little-explained", "wrong")
    assert "explains at most 10.0 %" in remark
    assert remarks_on(replace(short, vaf=10.0), 0.0) == (remark,)  # as much as its VAF says
    for power, grade in ((0.4, "note"), (0.6, "wrong")):  # of the remnant in the analysed band
        remnant = RemnantEstimate("AR(2)", {}, power, np.ones(1), np.ones(1))
        (remark,) = remarks_on(replace(estimate_of(SINGLE), vaf=10.0, remnant=remnant))
        assert (remark.code, remark.grade) == ("little-explained", grade)
    # Where the forced part is explained a VAF of 10 % is no doubt, and one of 0 % is if that is
    # not explained clearly.
    sound = estimate_of(SINGLE)
    assert remarks_on(replace(sound, vaf=10.0), 60.0) == ()
    for share, grade in ((40.0, "doubt"), (60.0, "note")):
        (said,) = remarks_on(replace(sound, vaf=0.0), share)
        assert (said.code, said.grade) == ("little-explained", grade)


def test_channels_that_act_on_one_signal() -> None:
    alone, both, step = (
        simulate(SCENARIOS[name], np.random.default_rng(1))
        for name in ("disturbance-only", "nominal", "disturbance-step")
    )
    word = "two channels act on one signal, as without a target e = -x"
    assert word in (one_signal(alone, MULTI) or "")
    assert one_signal(alone, SINGLE) is one_signal(both, MULTI) is None
    rng = np.random.default_rng(1)
    assert any(word in remark for remark in identify(MLE(), alone, MULTI, rng).remarks)
    # A step tells much, but its likelihood can have two summits.
    assert any(word in remark for remark in identify(MLE(), step, MULTI, rng).remarks)
