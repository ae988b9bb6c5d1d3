"""The problem that large searches solve: exact sum of squares and slopes, a Hessian nearby."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import NOMINAL

from pilotid.datasets import SCENARIOS, simulate
from pilotid.likelihood.likelihood import Likelihood
from pilotid.likelihood.prediction import Prediction, predict
from pilotid.likelihood.remnant_models import (
    Autoregressive,
    BandPass,
    LowPass,
    NoiseModel,
    guess_parameters,
)
from pilotid.methods.mle import MLE
from pilotid.model.catalogue import MODELS
from pilotid.model.model import PilotModel
from pilotid.support.types import FloatArray

pytestmark = pytest.mark.numerical

RUNS = 12
RATE = 50.0
STEADY = [name for name, model in MODELS.items() if not model.changes]
REMNANTS: list[NoiseModel] = [LowPass(0), LowPass(2), BandPass(1), Autoregressive(20)]


def prediction_of(model: PilotModel, runs: int, terms: tuple[float, ...] = (0.0,)) -> Prediction:
    recording = simulate(replace(NOMINAL, runs=runs), np.random.default_rng(4))
    return replace(predict(recording, model, RATE), nuisance_poles=terms)


def problem_of(
    prediction: Prediction, noise: NoiseModel
) -> tuple[Likelihood, Likelihood, FloatArray]:
    """Exact problem, that of a search, and two points: a pilot with the remnant it leaves."""
    pilots = prediction.model.start * np.array([[1.0], [0.9]])
    residual = prediction.errors(pilots[0])
    remnant = np.tile(guess_parameters(noise, residual, prediction.band), (2, 1))
    exact, adjoint = (Likelihood(prediction, noise, adjoint=each) for each in (False, True))
    return exact, adjoint, np.hstack([pilots, remnant])


def assert_last_rows_equal(exact: FloatArray, found: FloatArray) -> None:
    size = np.sqrt(np.diagonal(exact, axis1=1, axis2=2))
    expected = exact[:, -1] / (size * size[:, -1:])
    np.testing.assert_allclose(found[:, -1] / (size * size[:, -1:]), expected, atol=1e-11)
    np.testing.assert_array_equal(found, found.transpose(0, 2, 1))


@pytest.mark.parametrize("name", STEADY)
def test_slopes_are_exact_of_every_pilot(name: str) -> None:
    exact, adjoint, points = problem_of(prediction_of(MODELS[name], 2), LowPass(2))
    assert_last_rows_equal(exact.gram(points), adjoint.gram(points))


@pytest.mark.parametrize("runs", [1, 3])
@pytest.mark.parametrize("terms", [(), (0.0,), (0.0, -0.3)], ids=["none", "offset", "decay"])
@pytest.mark.parametrize("noise", REMNANTS, ids=[noise.name for noise in REMNANTS])
def test_slopes_are_exact_with_every_remnant(
    noise: NoiseModel, terms: tuple[float, ...], runs: int
) -> None:
    exact, adjoint, points = problem_of(prediction_of(NOMINAL.model, runs, terms), noise)
    assert_last_rows_equal(exact.gram(points), adjoint.gram(points))


def test_slopes_are_exact_of_transforms_of_odd_length() -> None:
    prediction = prediction_of(NOMINAL.model, 2)
    length = prediction.length - 1
    signals = [
        np.fft.irfft(each, n=prediction.length)[:, :length]
        for each in (*prediction.spectra, prediction.control_spectrum)
    ]
    *inputs, control = (np.fft.rfft(each) for each in signals)
    odd = replace(
        prediction,
        s=2j * np.pi * np.fft.rfftfreq(length, prediction.dt),
        spectra=tuple(inputs),
        control_spectrum=control,
        length=length,
    )
    exact, adjoint, points = problem_of(odd, LowPass(1))
    assert_last_rows_equal(exact.gram(points), adjoint.gram(points))


def test_only_several_runs_are_searched_by_the_adjoint() -> None:
    for runs in (1, 2, RUNS):
        assert prediction_of(NOMINAL.model, runs).is_large is (runs == RUNS)
    changing = SCENARIOS["adapting-slow"]  # has no reduced form
    recording = simulate(replace(changing, runs=RUNS), np.random.default_rng(1))
    assert not predict(recording, changing.model, RATE).is_large


@pytest.mark.parametrize("name", ["nominal", "remnant-0.5"])
def test_what_is_reported_is_that_of_a_search_with_exact_products(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario = replace(SCENARIOS[name], runs=RUNS)
    recording = simulate(scenario, np.random.default_rng(2))
    found = MLE().fit(recording, scenario.model, np.random.default_rng(3))
    monkeypatch.setattr(Prediction, "is_large", False)
    expected = MLE().fit(recording, scenario.model, np.random.default_rng(3))
    errors = np.sqrt(np.diag(expected.covariance))
    np.testing.assert_allclose((found.values - expected.values) / errors, 0.0, atol=1e-3)
    # An end of an interval is sought to a tenth of its deviance.
    np.testing.assert_allclose(
        (found.intervals - expected.intervals) / errors[:, None], 0.0, atol=0.1
    )
    np.testing.assert_allclose(found.covariance, expected.covariance, rtol=1e-3)
