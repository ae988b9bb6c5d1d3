"""Sums of squares from snapshots: those of full evaluations, whatever sets are asked for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pilotid.datasets import SCENARIOS, simulate
from pilotid.pilot.catalogue import ADAPTING, MULTI
from pilotid.posterior import nearby
from pilotid.posterior.likelihood import Likelihood
from pilotid.posterior.nearby import SNAPSHOTS, Nearby, sums_of_squares
from pilotid.time_domain.prediction import predict
from pilotid.time_domain.prediction_errors import PredictionErrors
from pilotid.time_domain.prepare import analysis_band
from pilotid.time_domain.remnant_models import LowPass
from pilotid.types import FloatArray

pytestmark = pytest.mark.numerical

NOMINAL = SCENARIOS["nominal"]
RECORDING = simulate(replace(NOMINAL, runs=2), np.random.default_rng(1))
REMNANT = {0: [], 2: [3.5, 0.7]}


def likelihood_of(order: int) -> Likelihood:
    prediction = replace(predict(RECORDING, MULTI, 50.0), terms=(0.0, -1.0 / 6.0))
    return Likelihood(PredictionErrors(prediction, LowPass(order), analysis_band(NOMINAL.dt, 50.0)))


def sets_of(order: int, count: int, spread: float, seed: int = 2) -> FloatArray:
    centre = np.array([*NOMINAL.truth, *REMNANT[order]])
    drawn = np.random.default_rng(seed).standard_normal((count, centre.size))
    return np.asarray(centre * np.exp(spread * drawn))


def in_full(likelihood: Likelihood, values: FloatArray) -> FloatArray:
    joint = likelihood.joint
    taps = joint.noise.filters(values[:, joint.pilot :], joint.band)
    return sums_of_squares(joint, likelihood.residuals, values, taps)


@pytest.mark.parametrize("order", [0, 2])
def test_sums_are_those_of_full_evaluations(order: int, monkeypatch: pytest.MonkeyPatch) -> None:
    likelihood = likelihood_of(order)
    near = sets_of(order, 800, 0.02)
    # Some that lie far off, one that has no sum, and then others with what is known by now.
    near[::50] = sets_of(order, 16, 0.8)
    near[333, 0] = np.nan
    expected = in_full(likelihood, near)
    again = sets_of(order, 500, 0.02, seed=3)
    others = in_full(likelihood, again)
    evaluated = 0
    full = nearby.prediction_errors

    def counted(*args: FloatArray) -> FloatArray:
        nonlocal evaluated
        found = full(*args)
        evaluated += len(found)
        return found

    monkeypatch.setattr(nearby, "prediction_errors", counted)
    np.testing.assert_allclose(likelihood.sums_of_squares(near), expected, rtol=1e-9)
    assert SNAPSHOTS < evaluated < 2 * SNAPSHOTS
    np.testing.assert_allclose(likelihood.sums_of_squares(again), others, rtol=1e-9)
    assert evaluated < 2.5 * SNAPSHOTS


def test_sets_all_over_the_place_have_their_sums_too() -> None:
    likelihood = likelihood_of(0)
    values = sets_of(0, 700, 0.8)
    np.testing.assert_allclose(
        likelihood.sums_of_squares(values), in_full(likelihood, values), rtol=1e-7
    )


def test_sums_that_prove_wrong_are_not_trusted(monkeypatch: pytest.MonkeyPatch) -> None:
    # So few frequencies do not tell sets apart, though all seems to lie within the span.
    monkeypatch.setattr(nearby, "FREQUENCIES", 6)
    likelihood = likelihood_of(0)
    values = sets_of(0, 900, 0.02)
    expected = in_full(likelihood, values)
    np.testing.assert_allclose(likelihood.sums_of_squares(values), expected, rtol=1e-12)


def test_sets_without_sums_teach_nothing() -> None:
    likelihood = likelihood_of(0)
    assert np.isnan(likelihood.sums_of_squares(np.full((700, 7), np.nan))).all()


def test_inputs_that_vary_and_long_recordings_are_not_for_it() -> None:
    assert Nearby.suits(predict(RECORDING, MULTI, 50.0))
    assert not Nearby.suits(predict(RECORDING, ADAPTING, 50.0))
    long = replace(predict(RECORDING, MULTI, 50.0), scored=10**6)
    assert not Nearby.suits(long)
