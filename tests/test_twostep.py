"""Frequency responses with errors, and the pilot model fitted to them."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import NOMINAL, PILOTS, recording_of
from scipy.optimize import approx_fprime

from pilotid.estimate.estimate import Outcome
from pilotid.estimate.quantities import FrequencyResponse, circular, real_parts
from pilotid.likelihood.second_step import ResponseFit, second_step
from pilotid.model.catalogue import MULTI, SINGLE
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
    assert problem.residuals == 40


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
