"""Prediction errors of estimates, and their correlations, against those of the fit itself."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from helpers import NOMINAL, estimate_at, recording_of

from pilotid.estimate.estimate import Estimate
from pilotid.estimate.method import identify
from pilotid.likelihood.diagnostics import portmanteau
from pilotid.likelihood.estimates import correlations, prediction_errors
from pilotid.likelihood.optimum import Optimum
from pilotid.likelihood.search import maximise_likelihood
from pilotid.methods.mle import MLE
from pilotid.model.catalogue import MODELS, MULTI

pytestmark = pytest.mark.numerical


RECORDING = recording_of(NOMINAL)


@cache
def found() -> Optimum:
    return maximise_likelihood(RECORDING, MULTI, np.random.default_rng(2), MLE())


@cache
def estimate() -> Estimate:
    own = identify(MLE(), RECORDING, MULTI, np.random.default_rng(2))
    values = found().end.values[0, : found().joint.pilot_count]
    return replace(own, values=values, remnant=found().remnant)


def test_they_are_those_of_the_likelihood() -> None:
    errors = found().joint.rows(found().end.values[:1])[0, -1]
    own = prediction_errors(RECORDING, estimate())
    assert own.errors.shape == errors.shape
    assert own.dt == pytest.approx(found().joint.prediction.dt)
    # Nuisance terms that the fit left out are projected out here: that is all the difference.
    left = own.errors - errors
    assert np.std(left) < 0.05 * np.std(errors)
    assert np.corrcoef(own.errors.ravel(), errors.ravel())[0, 1] > 0.999


def test_without_a_model_of_the_remnant_one_is_chosen_that_whitens() -> None:
    own = prediction_errors(RECORDING, replace(estimate(), remnant=None))
    # 40 lags; the residual itself is far from white.
    assert portmanteau(own.errors, np.ones(own.errors.shape[1] // 2 + 1), 40)[0] < 100.0
    assert np.std(own.errors) == pytest.approx(
        np.std(prediction_errors(RECORDING, estimate()).errors), rel=0.1
    )


def test_correlations_on_numbers_worked_out_by_hand() -> None:
    errors, signal = np.array([[1.0, -2.0, 1.0]]), np.array([[2.0, 0.0, -2.0]])
    scale = np.sqrt(6.0 * 8.0)
    expected = [-2.0 * 1.0, 1.0 * 0.0 + -2.0 * -2.0, 0.0, -2.0 * 2.0 + 1.0 * 0.0, 1.0 * 2.0]
    got = correlations(errors, signal, range(-2, 3))
    np.testing.assert_allclose(got, np.array(expected) / scale)


def test_a_target_that_was_not_recorded_is_an_input_all_the_same() -> None:
    model = MODELS["pursuit"]
    found = estimate_at(model, model.start, np.diag((0.1 * model.start) ** 2))
    both = (
        prediction_errors(RECORDING, found),
        prediction_errors(replace(RECORDING, ft=None), found),
    )
    for own in both:
        assert list(own.inputs) == ["e", "ft"]
    scale = np.std(both[0].inputs["ft"])
    np.testing.assert_allclose(both[0].inputs["ft"], both[1].inputs["ft"], atol=1e-6 * scale)
