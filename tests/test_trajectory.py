"""Parameters over time: what follows from a model that changes, and what methods claim of it."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from pilotid.datasets import SCENARIOS, simulate
from pilotid.estimates.method import fault_of, identify
from pilotid.estimates.parts import Trajectory, times_of, trajectory_of
from pilotid.methods.mle import MLE
from pilotid.pilot.catalogue import ADAPTING, SINGLE

pytestmark = pytest.mark.numerical

FAST = SCENARIOS["adapting-fast"]
VALUES = np.array([0.09, 0.07, 0.4, 1.2, 40.0, 100.0, 0.28, 11.0, 0.35])
ERRORS = np.array([0.005, 0.01, 0.05, 0.2, 1.0, 30.0, 0.01, 0.4, 0.03])


def _trajectory(time: np.ndarray) -> Trajectory:
    intervals = np.stack([VALUES - 2 * ERRORS, VALUES + 2 * ERRORS], axis=1)
    covariance = np.diag(ERRORS**2)
    rng = np.random.default_rng(1)
    return trajectory_of(ADAPTING, VALUES, covariance, intervals, time, rng)


def test_a_trajectory_passes_from_what_is_before_to_what_is_after() -> None:
    found = _trajectory(np.array([0.0, 39.0, 41.0, 80.0]))
    assert found.keys == SINGLE.keys
    gain, lead, delay, *_ = found.values
    np.testing.assert_allclose(gain, [0.09, 0.09, 0.07, 0.07])
    np.testing.assert_allclose(lead, [0.4, 0.4, 1.2, 1.2])
    np.testing.assert_allclose(delay, 0.28)


def test_the_band_of_a_step_holds_both_sides_for_as_long_as_its_time_is_open() -> None:
    found = _trajectory(np.array([20.0, 39.5, 40.5, 60.0]))
    lead = found.keys.index("tlead")
    low, high = found.lower[lead], found.upper[lead]
    assert high[0] < 0.6 < 0.7 < low[3]  # far from the step it is known which side it is
    assert (low[1:3] < 0.5).all()
    assert (high[1:3] > 1.1).all()
    assert ((found.lower <= found.values) & (found.values <= found.upper)).all()


def test_the_band_of_a_parameter_that_does_not_vary_is_its_interval() -> None:
    found = _trajectory(np.array([1.0, 50.0]))
    delay = found.keys.index("tdvis")
    np.testing.assert_allclose(found.lower[delay], 0.26)
    np.testing.assert_allclose(found.upper[delay], 0.30)


def test_times_lie_in_the_window_ends_included() -> None:
    time = times_of(81.92)
    assert (time[0], time[-1]) == (0.0, 81.92)
    assert np.diff(time).max() <= 0.25
    assert len(times_of(1e5)) == 1001


def test_between_times_it_is_straight_and_beyond_them_nothing_is_known() -> None:
    rows = np.array([[1.0, 3.0, np.nan]])
    known = Trajectory(("K",), np.array([0.0, 1.0, 2.0]), rows, rows - 1.0, rows + 1.0)
    moved = known.at(np.array([-0.5, 0.5, 1.5]))
    np.testing.assert_array_equal(moved.values, [[np.nan, 2.0, np.nan]])
    np.testing.assert_array_equal(moved.upper, [[np.nan, 3.0, np.nan]])


def test_an_estimate_of_a_model_that_changes_has_one_and_json_has_it() -> None:
    recording = simulate(FAST, np.random.default_rng(1))
    fit = identify(MLE(), recording, ADAPTING, np.random.default_rng(2))
    assert fit.trajectory is not None
    assert fit.trajectory.keys == SINGLE.keys
    held = json.loads(json.dumps(fit.to_dict()))["trajectory"]
    assert held["time"][-1] == pytest.approx(81.92)
    assert held["parameters"]["tlead"]["value"][0] == pytest.approx(fit["tlead1"].value)
    assert fault_of(fit, ADAPTING) == ""
    other = replace(fit.trajectory, keys=("a", "b", "c", "d", "e"))
    assert "trajectory" in fault_of(replace(fit, trajectory=other), ADAPTING)
    with pytest.raises(ValueError, match="rise"):
        replace(fit.trajectory, time=fit.trajectory.time[::-1])
    with pytest.raises(ValueError, match="shape"):
        replace(fit.trajectory, values=fit.trajectory.values[:, 1:])


def test_an_estimate_of_a_constant_model_has_none() -> None:
    recording = simulate(SCENARIOS["single"], np.random.default_rng(1))
    assert identify(MLE(), recording, SINGLE, np.random.default_rng(2)).trajectory is None
