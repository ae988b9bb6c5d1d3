"""Estimates from black-box models against the recording they came from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import NOMINAL, SINGLE_LOOP, estimate_at, fit_of, recording_of

from pilotid.estimate.estimate import Estimate, Outcome
from pilotid.likelihood.prediction import predict
from pilotid.likelihood.second_step import (
    MAX_MOVE,
    against_recording,
    moved,
    output_at_once,
    whitener,
)
from pilotid.methods.arx import ARX
from pilotid.methods.sindy import SINDy
from pilotid.model.catalogue import SINGLE
from pilotid.model.element import position_control
from pilotid.support.types import FloatArray

pytestmark = pytest.mark.numerical

PREDICTION = predict(recording_of(SINGLE_LOOP), SINGLE, 26.0)
#: Shares of the parameters about as large as their errors; gain and lead are hardly known.
SHARES = np.array([0.3, 0.3, 0.01, 0.04, 0.06])


def end_from(values: FloatArray) -> FloatArray:
    return moved(values, PREDICTION, np.random.default_rng(1))


def held_against(given: Estimate) -> Estimate:
    return against_recording(given, PREDICTION, np.random.default_rng(1))


def estimate(values: FloatArray, errors: FloatArray) -> Estimate:
    return estimate_at(SINGLE, values, np.diag(errors**2), method="arx")


def test_the_whitener_of_an_autoregression_is_its_coefficients() -> None:
    rng = np.random.default_rng(3)
    noise = rng.standard_normal((2, 20_000))
    signal = np.zeros_like(noise)
    for t in range(2, noise.shape[1]):
        signal[:, t] = 1.2 * signal[:, t - 1] - 0.5 * signal[:, t - 2] + noise[:, t]
    assert whitener(signal, 3) == pytest.approx([1.0, -1.2, 0.5, 0.0], abs=0.03)


def test_prediction_errors_move_any_start_to_the_same_place() -> None:
    truth = SINGLE_LOOP.values
    ends = [end_from(start * truth) for start in (0.9, 1.0, 1.1)]
    for end in ends[1:]:
        assert np.all(np.abs(end - ends[0]) < 0.7 * SHARES * truth)
    # Delay and neuromuscular system, which the recording knows well.
    assert ends[0][2:] == pytest.approx(truth[2:], rel=0.15)


def test_an_estimate_far_from_what_the_recording_says_is_refused() -> None:
    end = end_from(SINGLE_LOOP.values)
    errors = SHARES * end
    far = end + np.array([0.0, 0.0, 2.0 * MAX_MOVE, 0.0, 0.0]) * errors
    refused = held_against(estimate(far, errors))
    assert refused.outcome is Outcome.CONTRADICTED
    assert not refused.outcome.usable
    assert "move tdvis by" in refused.message
    np.testing.assert_array_equal(refused.values, far)


def test_errors_hold_how_far_the_recording_moves_an_estimate() -> None:
    end = end_from(SINGLE_LOOP.values)
    errors = SHARES * end
    near = end + np.array([0.0, 0.0, 0.0, 2.0, 0.0]) * errors
    plain = estimate(near, errors)
    held = held_against(plain)
    assert held.outcome is Outcome.CONVERGED
    np.testing.assert_array_equal(held.values, near)
    ratio = held.std_error / plain.std_error
    assert ratio[3] == pytest.approx(np.sqrt(5.0), rel=0.15)
    assert np.all((ratio >= 1.0) & (ratio < 1.3) | (np.arange(5) == 3))
    assert np.all(held.intervals[:, 0] <= plain.intervals[:, 0])
    assert np.all(held.intervals[:, 1] >= plain.intervals[:, 1])
    # The correlations that the difference has are in the covariance.
    bias = end_from(near) - near
    np.testing.assert_allclose(held.covariance - plain.covariance, np.outer(bias, bias))


@pytest.mark.parametrize("method", [ARX(), SINDy()], ids=lambda m: m.name)
def test_an_output_that_follows_the_control_at_once_is_objected_to(method: ARX | SINDy) -> None:
    loop = replace(SINGLE_LOOP, name="gain-element", element=position_control(0.05))
    recording = recording_of(loop)
    assert "follows the control at once" in (output_at_once(recording) or "")
    assert fit_of(method, loop).outcome is Outcome.NOT_APPLICABLE
    assert output_at_once(recording_of(NOMINAL)) is None
    assert output_at_once(replace(recording_of(NOMINAL), fd=None)) is None
