"""Intervals where the likelihood has two summits, and where its optimum lies at a bound."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from helpers import NOMINAL, plane, recording_of

from pilotid.datasets import SCENARIOS, simulate
from pilotid.estimate.estimate import Outcome, at_bounds
from pilotid.likelihood import profile
from pilotid.likelihood.optimum import Optimum
from pilotid.likelihood.profile import off_bounds, profile_about, profile_likelihood, with_profile
from pilotid.likelihood.search import maximise_likelihood
from pilotid.methods.mle import MLE
from pilotid.model.factors import Parameter
from pilotid.recording.spectra import jumps_of
from pilotid.solve.intervals import Profile, profile_intervals
from pilotid.solve.least_squares import Box, Minima, minimise
from pilotid.support.numbers import CHI_SQUARED_95, recording_rng
from pilotid.support.types import FloatArray

pytestmark = pytest.mark.numerical

TILT, WALL = 0.2, 3.0


def two_summits(sets: FloatArray) -> FloatArray:
    """Deviance 9 (x^2 - 1)^2 + .04 (x - 1)^2 + 100 (y - x)^2: minima near x = y = 1 and -1."""
    grams = []
    for x, y in sets:
        residual = np.array([WALL * (x * x - 1.0), TILT * (x - 1.0), 10.0 * (y - x)])
        slope = -np.array([[2.0 * WALL * x, 0.0], [TILT, 0.0], [-10.0, 10.0]])
        rows = np.vstack([slope.T, residual])
        grams.append(rows @ rows.T)
    return np.array(grams)


def best() -> Minima:
    return minimise(two_summits, np.array([[1.2, 1.1]]), plane(), tolerance=1e-14)


def test_all_intervals_hold_what_suits_and_go_on_from_there() -> None:
    minimum = best()
    np.testing.assert_allclose(minimum.values[0], 1.0, atol=1e-6)
    # The wall between the summits, 9 at x = 0, is higher than the 3.84 sought: the profile of
    # the optimum ends at its own hill, on which x^2 - 1 is -sqrt(3.84) / 3, a little less.
    own = profile_intervals(two_summits, plane(), minimum, 1.0, 2, tolerance=1e-6).intervals
    assert (own[:, 0] > 0.3).all()
    np.testing.assert_allclose(own[0, 1], np.sqrt(1.0 + np.sqrt(CHI_SQUARED_95) / 3.0), rtol=2e-3)
    # The other summit has a deviance of .16: it suits, and is walked on from to its far side,
    # where 9 (x^2 - 1)^2 + .04 (x - 1)^2 is 3.84.
    others = np.array([[-1.0, -1.0]])
    both = profile_intervals(
        two_summits, plane(), minimum, 1.0, 2, others=others, tolerance=1e-6
    ).intervals
    np.testing.assert_allclose(both[:, 1], own[:, 1])
    far = -np.sqrt(1.0 + np.sqrt(CHI_SQUARED_95 - 0.04 * 2.28**2) / 3.0)
    assert (both[:, 0] < -1.0).all()
    np.testing.assert_allclose(both[0, 0], far, rtol=0.03)
    assert both[1, 0] <= both[0, 0] + 0.02  # y has room of its own


def test_what_does_not_suit_stays_outside() -> None:
    minimum = best()
    own = profile_intervals(two_summits, plane(), minimum, 1.0, 2).intervals
    others = np.array([[0.0, 0.0], [-1.0, 0.0]])  # deviances of 9 and 100
    found = profile_intervals(two_summits, plane(), minimum, 1.0, 2, others=others)
    np.testing.assert_array_equal(found.intervals, own)
    assert found.better is None


def test_a_better_summit_elsewhere_is_told() -> None:
    worse = minimise(two_summits, np.array([[-1.2, -1.1]]), plane(), tolerance=1e-14)
    found = profile_intervals(two_summits, plane(), worse, 0.1, 2, others=np.array([[0.99, 0.99]]))
    assert found.better is not None
    np.testing.assert_allclose(found.better, 0.99)


def test_where_a_parameter_has_no_influence_and_where_there_is_no_number() -> None:
    def gram(sets: FloatArray) -> FloatArray:
        here = np.where(sets[:, 0] < -1.5, np.nan, sets[:, 0] < 1.0)
        rows = [[[-1.0, 0.0], [0.0, -h], [x, h * y]] for h, (x, y) in zip(here, sets, strict=True)]
        return np.array(rows) @ np.array(rows).transpose(0, 2, 1)

    minimum = minimise(gram, np.array([[0.1, 0.1]]), plane())
    (low, high), _ = profile_intervals(gram, plane(), minimum, 1.0, 2).intervals
    assert high == pytest.approx(np.sqrt(CHI_SQUARED_95), rel=1e-3)
    assert -1.5 <= low < -1.0


def test_the_delay_of_a_gain_that_is_zero_may_be_any() -> None:
    space = Box(np.array([1e-9, 0.0]), np.array([9.0, 1.0]), np.array([True, False]))

    def gram(sets: FloatArray) -> FloatArray:
        """The deviance is k^2 + 2 k cos(t), least at k = 0."""
        k, c, s = sets[:, 0], *(turn(sets[:, 1]) for turn in (np.cos, np.sin))
        rows = np.array([[-c, -s], [k * s, -k * c], [1.0 + k * c, k * s]]).transpose(2, 0, 1)
        return np.asarray(rows @ rows.transpose(0, 2, 1))

    minimum = minimise(gram, np.array([[0.5, 0.5]]), space)
    gain, delay = profile_intervals(gram, space, minimum, 1.0, 2).intervals
    assert gain[1] == pytest.approx(
        np.sqrt(CHI_SQUARED_95 + np.cos(1.0) ** 2) - np.cos(1.0), rel=0.05
    )
    assert (gain[0], *delay) == pytest.approx((0.0, 0.0, 1.0), abs=1e-6)


def test_where_the_optimum_is_at_a_bound_others_are_sought_inside() -> None:
    recording = simulate(NOMINAL, np.random.default_rng(4))
    free = maximise_likelihood(recording, NOMINAL.model, np.random.default_rng(1), MLE())
    assert len(off_bounds(free)) == 0
    # A delay that may not reach the pilot's .32 s stops at its bound.
    late = Parameter("tdvis", "s", 0.36, 1.0, 0.45, (0.38, 0.6), positive=False, delay=True)
    bounded = replace(NOMINAL.model, name="late", overrides=(late,))
    found = maximise_likelihood(recording, bounded, np.random.default_rng(1), MLE())
    at = bounded.keys.index("tdvis")
    low, high = at_bounds(bounded, found.pilot, found.pilot)
    assert low[at]
    assert not high.any()
    points = off_bounds(found)
    usual = bounded.parameters[at].usual
    np.testing.assert_allclose(np.unique(points[:, at])[[0, -1]], usual)
    # All others are at their best there, or as near as a few iterations come.
    held = Box.holding(found.joint, at, points[0, at])
    again = minimise(found.joint.gram, points[:1], held)
    cost = found.joint.gram(points[:1])[0, -1, -1]
    assert cost <= 1.0005 * again.cost[0]
    estimate = MLE().fit(recording, bounded, np.random.default_rng(1))
    assert estimate.outcome is Outcome.AT_BOUND
    assert (np.diff(estimate.intervals) > 0.0).all()


def test_intervals_hold_the_other_summits_that_the_search_came_upon(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Without a target two delays act on one signal, and may be taken for one another."""
    scenario = SCENARIOS["disturbance-step"]
    recording = simulate(scenario, recording_rng(1, scenario.name, 3))
    # Direct prediction errors, whose optimum is the other one here.
    settings = MLE(loop=False)
    found = maximise_likelihood(recording, scenario.model, np.random.default_rng(1), settings)
    delays = [scenario.model.keys.index(key) for key in ("tdvis", "tdvest")]
    truth = scenario.values[delays]
    assert (np.abs(found.pilot[delays] - truth) > 0.05).all()  # .25 and .36 s for .33 and .29 s
    own = intervals_of(replace(found, others=()))[delays]
    assert not ((own[:, 0] < truth) & (truth < own[:, 1])).any()
    known = SimpleNamespace(pilot=scenario.values, criterion=found.criterion)
    both = intervals_of(replace(found, others=[known]))[delays]
    assert ((both[:, 0] < truth) & (truth < both[:, 1])).all()
    assert ((both[:, 0] < own[:, 0] + 0.01) & (own[:, 1] - 0.01 < both[:, 1])).all()
    # The search comes upon it of itself, too.
    assert any(np.abs(pilot[delays] - truth).max() < 0.03 for pilot in found.competing)
    # An optimum that a profile leaves for a better one stays among those that compete.
    remnant = found.values[found.joint.pilot_count :]
    left = replace(found, others=()).restarted_at(np.concatenate([scenario.values, remnant]))
    assert found.criterion < left.criterion < found.criterion + 5.0
    seen, about = iter([Profile(np.zeros((1, 2)), found.values)]), profile.profile_about
    monkeypatch.setattr(profile, "profile_about", lambda o: next(seen, None) or about(o))
    (pilot,) = profile.profile_likelihood(left)[0].competing
    np.testing.assert_array_equal(pilot, left.pilot)


def test_what_is_as_likely_beside_another_remnant_is_in_the_intervals_and_nothing_else() -> None:
    recording = recording_of(NOMINAL)
    found = maximise_likelihood(recording, NOMINAL.model, np.random.default_rng(1), MLE())
    optimum, profile = profile_likelihood(found)
    far = 0.5 * optimum.pilot
    estimate = MLE().fit(recording, NOMINAL.model, np.random.default_rng(1))
    for behind, told in ((3.0, True), (6.0, False)):
        known = SimpleNamespace(pilot=far, criterion=optimum.criterion + behind)
        other = replace(optimum, others=[known])
        assert len(other.competing) == told
        low, high = with_profile(estimate, other, profile).intervals.T
        assert ((low <= far) & (far <= high)).all() == told
    other = recording_of(NOMINAL, 1)
    rival = maximise_likelihood(other, NOMINAL.model, np.random.default_rng(1), MLE())
    both = with_profile(estimate, replace(optimum, rivals=[rival]), profile).intervals
    ratio = np.sqrt(np.diag(rival.covariance) / np.diag(optimum.covariance))[:, None]
    there = rival.pilot[:, None] + ratio * (estimate.intervals - optimum.pilot[:, None])
    every = np.stack([estimate.intervals, there])
    np.testing.assert_allclose(both, np.stack([every.min(axis=(0, 2)), every.max(axis=(0, 2))], 1))


def intervals_of(found: Optimum) -> FloatArray:
    profile = profile_about(found)
    assert profile.better is None
    return profile.intervals


def test_what_lies_at_a_bound_need_not_be_curved() -> None:
    model = NOMINAL.model
    found = maximise_likelihood(recording_of(NOMINAL), model, np.random.default_rng(1), MLE())
    end, damping = found.end.only([0]), model.index["dnm"]
    size = np.sqrt(end.gram[0, 0, 0] * end.gram[0, damping, damping])
    end.gram[0, [0, damping], [damping, 0]] = 2.0 * size  # more than a correlation can be
    assert replace(found, end=end).covariance is None
    end.values[0, damping] = model.lower[damping]
    assert (np.diag(replace(found, end=end).covariance) > 0.0).all()
    assert profile_about(replace(found, end=end)) is not None


def test_intervals_hold_jumps_at_samples_and_half_way_before() -> None:
    scenario = replace(SCENARIOS["target-step"], remnant=replace(NOMINAL.remnant, level=0.1))
    recording = recording_of(scenario)
    time = recording.time + 1e-9
    target = np.select([time < 0.0, time < 0.5 * scenario.duration], [0.0, 1.0], -1.0)[None]
    sharp = replace(recording, ft=target, e=target - recording.x)
    assert jumps_of(sharp)[jumps_of(sharp) != 0.0].tolist() == [1.0, -2.0]
    estimate = MLE().fit(sharp, scenario.model, np.random.default_rng(1))
    assert (np.abs(estimate.values - scenario.values) < 3.0 * estimate.std_error).all()
