"""Prediction errors of estimates, and their correlations, against those of the fit itself."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from pilotid.datasets import scenario_named, simulate
from pilotid.estimate.estimate import Estimate, Outcome, symmetric_intervals
from pilotid.estimate.method import identify
from pilotid.likelihood.diagnostics import portmanteau
from pilotid.likelihood.estimates import correlations, prediction_errors
from pilotid.likelihood.optimum import Optimum
from pilotid.likelihood.search import maximise_likelihood
from pilotid.methods.mle import MLE
from pilotid.model.catalogue import MODELS, MULTI
from pilotid.recording.recording import Recording

pytestmark = pytest.mark.numerical


@cache
def recording() -> Recording:
    return simulate(scenario_named("nominal"), np.random.default_rng(1))


@cache
def found() -> Optimum:
    return maximise_likelihood(recording(), MULTI, np.random.default_rng(2), MLE())


@cache
def estimate() -> Estimate:
    own = identify(MLE(), recording(), MULTI, np.random.default_rng(2))
    values = found().end.values[0, : found().joint.pilot_count]
    return replace(own, values=values, remnant=found().remnant)


def test_they_are_those_of_the_likelihood() -> None:
    errors = found().joint.rows(found().end.values[:1])[0, -1]
    own = prediction_errors(recording(), estimate())
    assert own.errors.shape == errors.shape
    assert own.dt == pytest.approx(found().joint.prediction.dt)
    # Nuisance terms that the fit left out are projected out here: that is all the difference.
    left = own.errors - errors
    assert np.std(left) < 0.05 * np.std(errors)
    assert np.corrcoef(own.errors.ravel(), errors.ravel())[0, 1] > 0.999


def test_without_a_model_of_the_remnant_one_is_chosen_that_whitens() -> None:
    own = prediction_errors(recording(), replace(estimate(), remnant=None))
    # 40 lags; the residual itself is far from white.
    assert portmanteau(own.errors, np.ones(own.errors.shape[1] // 2 + 1), 40)[0] < 100.0
    assert np.std(own.errors) == pytest.approx(
        np.std(prediction_errors(recording(), estimate()).errors), rel=0.1
    )


def test_correlations_on_numbers_worked_out_by_hand() -> None:
    errors, signal = np.array([[1.0, -2.0, 1.0]]), np.array([[2.0, 0.0, -2.0]])
    scale = np.sqrt(6.0 * 8.0)
    expected = [-2.0 * 1.0, 1.0 * 0.0 + -2.0 * -2.0, 0.0, -2.0 * 2.0 + 1.0 * 0.0, 1.0 * 2.0]
    got = correlations(errors, signal, range(-2, 3))
    np.testing.assert_allclose(got, np.array(expected) / scale)


def test_a_target_that_was_not_recorded_is_an_input_all_the_same() -> None:
    model = MODELS["pursuit"]
    covariance = np.diag((0.1 * model.start) ** 2)
    found = Estimate(
        "mine",
        model,
        Outcome.CONVERGED,
        model.start,
        covariance,
        symmetric_intervals(model.start, covariance),
    )
    both = (
        prediction_errors(recording(), found),
        prediction_errors(replace(recording(), ft=None), found),
    )
    for own in both:
        assert list(own.inputs) == ["e", "ft"]
    scale = np.std(both[0].inputs["ft"])
    np.testing.assert_allclose(both[0].inputs["ft"], both[1].inputs["ft"], atol=1e-6 * scale)
