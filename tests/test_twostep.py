"""Frequency responses with errors, the model fitted to them, and what the recording says of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import NOMINAL, PILOTS, SINGLE_LOOP, estimate_at, fit_of, recording_of
from scipy.optimize import approx_fprime

from pilotid.estimate.estimate import Estimate, Outcome
from pilotid.estimate.quantities import FrequencyResponse, circular, real_parts
from pilotid.likelihood.prediction import predict
from pilotid.likelihood.prepare import Band
from pilotid.likelihood.remnant_models import Autoregressive, lagged_products
from pilotid.likelihood.second_step import (
    MAX_MOVE,
    ResponseFit,
    against_recording,
    moved,
    second_step,
)
from pilotid.methods.arx import ARX
from pilotid.methods.sindy import SINDy
from pilotid.model.catalogue import MULTI, SINGLE
from pilotid.model.element import element_named
from pilotid.model.model import PilotModel
from pilotid.support.types import ComplexArray, FloatArray

pytestmark = pytest.mark.numerical

OMEGA = np.geomspace(0.4, 17.0, 20)
TRUTH = NOMINAL.values
RECORDING = recording_of(NOMINAL)


def with_errors(
    model: PilotModel, covariance: ComplexArray, errors: ComplexArray
) -> FrequencyResponse:
    true = model.response(OMEGA, PILOTS[model.name].values)
    return FrequencyResponse(OMEGA, true + errors.reshape(true.shape), circular(covariance))


def some_covariance(size: FloatArray, correlation: float) -> ComplexArray:
    """Relative errors of 3 %, neighbours correlated, with a phase."""
    index = np.arange(size.size)
    away = index[:, None] - index
    return 0.03**2 * np.outer(size, size) * correlation ** np.abs(away) * np.exp(0.3j * away)


def test_circular_covariance_is_that_of_real_and_imaginary_parts() -> None:
    rng = np.random.default_rng(1)
    root = np.array([[1.0, 0.0], [0.5 + 0.7j, 0.3]])
    noise = rng.standard_normal((2, 2, 200_000))
    errors = root @ ((noise[0] + 1j * noise[1]) / np.sqrt(2.0))
    found = np.cov(np.concatenate([errors.real, errors.imag]))
    np.testing.assert_allclose(circular(root @ root.conj().T), found, atol=0.01)


def test_std_is_the_root_mean_square_of_the_complex_error() -> None:
    response = with_errors(SINGLE, np.diag(np.full(20, 0.25)).astype(complex), np.zeros(20))
    np.testing.assert_allclose(response.std, np.full((1, 20), 0.5))
    np.testing.assert_array_equal(
        real_parts(np.array([[1 + 2j, 3.0], [4.0, 5j]])), [1, 3, 4, 0, 2, 0, 0, 5]
    )


def test_rows_are_the_derivatives_of_the_whitened_residual() -> None:
    size = np.abs(MULTI.response(OMEGA, TRUTH)).ravel()
    problem = ResponseFit(with_errors(MULTI, some_covariance(size, 0.6), np.zeros(40)), MULTI)
    point = 1.1 * TRUTH
    rows = problem.rows(point[None])[0]
    slopes = approx_fprime(point, lambda v: problem.rows(v[None])[0, -1], 1e-7)
    np.testing.assert_allclose(rows[:-1], -slopes.T, rtol=1e-4, atol=1e-3)
    np.testing.assert_allclose(problem.gram(point[None])[0], rows @ rows.T)


def test_exact_responses_give_the_exact_parameters() -> None:
    size = np.abs(MULTI.response(OMEGA, TRUTH)).ravel()
    response = with_errors(MULTI, some_covariance(size, 0.6), np.zeros(40))
    estimate = second_step("test", RECORDING, MULTI, response, np.random.default_rng(1))
    assert estimate.outcome is Outcome.CONVERGED
    np.testing.assert_allclose(estimate.values, TRUTH, rtol=1e-6)
    assert estimate.frequency_response is response


@pytest.mark.long
@pytest.mark.parametrize("correlation", [0.0, 0.8])
def test_scatter_is_the_claimed_covariance(correlation: float) -> None:
    size = np.abs(MULTI.response(OMEGA, TRUTH)).ravel()
    covariance = some_covariance(size, correlation)
    root = np.linalg.cholesky(covariance)
    rng = np.random.default_rng(3)
    runs = 150
    values, held = [], []
    for _ in range(runs):
        noise = rng.standard_normal((2, size.size)) / np.sqrt(2.0)
        response = with_errors(MULTI, covariance, root @ (noise[0] + 1j * noise[1]))
        estimate = second_step("test", RECORDING, MULTI, response, rng)
        values.append(estimate.values)
        low, high = estimate.intervals.T
        held.append((low <= TRUTH) & (high >= TRUTH))
    # The claim at the truth: claims at the estimates scatter with them.
    exact = with_errors(MULTI, covariance, np.zeros(size.size))
    claimed = second_step("test", RECORDING, MULTI, exact, rng).std_error
    # A standard deviation from 150 runs is known to 6 %, a coverage to 1.8 %.
    np.testing.assert_allclose(np.std(values, axis=0) / claimed, 1.0, atol=0.18)
    assert np.all(np.abs(np.mean(held, axis=0) - 0.95) < 0.055)


def test_combinations_that_are_not_known_carry_no_weight() -> None:
    # Both channels' errors equal, as after an interpolation: their difference is exact by
    # construction, and wrong here.
    true = MULTI.response(OMEGA, TRUTH)
    size = np.abs(true)
    half = np.diag((0.03 * size[0]) ** 2).astype(complex)
    covariance = np.block([[half, half], [half, half]])
    problem = ResponseFit(with_errors(MULTI, covariance, np.zeros(40)), MULTI)
    assert len(problem.whitener) == 40


def test_claimed_errors_grow_where_the_model_cannot_follow() -> None:
    size = np.abs(MULTI.response(OMEGA, TRUTH)).ravel()
    covariance = some_covariance(size, 0.0)
    bend = 1.0 + 0.3 * np.sin(8.0 * np.log(OMEGA))
    errors = (MULTI.response(OMEGA, TRUTH) * (bend - 1.0)).ravel()
    rng = np.random.default_rng(1)
    good = second_step("t", RECORDING, MULTI, with_errors(MULTI, covariance, 0 * errors), rng)
    bad = second_step("t", RECORDING, MULTI, with_errors(MULTI, covariance, errors), rng)
    assert np.all(bad.std_error > 2.0 * good.std_error)


def test_too_few_responses_are_refused_with_the_reason() -> None:
    few = FrequencyResponse(OMEGA[:2], np.ones((1, 2), dtype=complex), np.eye(4))
    estimate = second_step("test", RECORDING, SINGLE, few, np.random.default_rng(1))
    assert estimate.outcome is Outcome.NOT_APPLICABLE
    assert "4 independent numbers" in estimate.message


# ------------------------------------------------------------ held against the recording

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
    found = Autoregressive(3).guess(lagged_products(signal), Band(0.02, 1))[0]
    assert found == pytest.approx([-1.2, 0.5, 0.0], abs=0.03)


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
    loop = replace(SINGLE_LOOP, name="gain-element", element=element_named("0.05"))
    recording = recording_of(loop)
    assert "follows the control at once" in (method.objection(recording, loop.model) or "")
    assert fit_of(method, loop).outcome is Outcome.NOT_APPLICABLE
    assert method.objection(recording_of(NOMINAL), loop.model) is None
