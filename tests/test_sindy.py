"""Sparse regression: what is pruned, what the ensemble says, and when it is no model."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pysindy
import pytest
from helpers import (
    NOMINAL,
    SINGLE_LOOP,
    fit_of,
    part_of,
    recording_of,
    running_away,
    without_remnant,
)

from pilotid.datasets import Scenario, scenario_named
from pilotid.estimate.estimate import Estimate, Outcome
from pilotid.estimate.method import identify
from pilotid.estimate.quantities import FrequencyResponse
from pilotid.methods.sindy import Library, SINDy, ensemble_covariance, prune, undetermined
from pilotid.model.catalogue import MULTI, SINGLE
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.spectral.regression import Structure, lagged_rows
from pilotid.support.types import FloatArray

pytestmark = pytest.mark.numerical


def response_of(estimate: Estimate) -> FrequencyResponse:
    assert estimate.frequency_response is not None, estimate.sentence
    return estimate.frequency_response


# ------------------------------------------------------------------------------- the library


def sparse_system(noise: float) -> tuple[FloatArray, FloatArray]:
    """u(t) = 1.2 u(t-1) - 0.5 u(t-2) + 0.8 e(t-3) - 0.3 e(t-5) + w(t)."""
    rng = np.random.default_rng(5)
    e, w = rng.standard_normal((2, 600))
    u = np.zeros(600)
    for t in range(5, 600):
        u[t] = 1.2 * u[t - 1] - 0.5 * u[t - 2] + 0.8 * e[t - 3] - 0.3 * e[t - 5] + noise * w[t]
    return u[None], e[None]


def test_the_lags_of_a_sparse_system_survive_and_no_others() -> None:
    u, e = sparse_system(noise=0.1)
    rows = lagged_rows(u, [e], Structure(4, (8,), (1,)), 8)[0]
    found = prune(rows, threshold=0.05)
    # Four lags of -u, then lags 1 to 8 of e.
    truth = np.array([-1.2, 0.5, 0, 0, 0, 0, 0.8, 0, -0.3, 0, 0, 0])
    assert np.array_equal(found != 0.0, truth != 0.0)
    assert found == pytest.approx(truth, abs=0.02)


def test_pysindy_s_own_discrete_model_has_the_same_terms() -> None:
    u, e = sparse_system(noise=0.1)
    rows = lagged_rows(u, [e], Structure(4, (8,), (1,)), 8)[0]
    scaled = rows / np.linalg.norm(rows, axis=0)
    model = pysindy.DiscreteSINDy(
        optimizer=pysindy.STLSQ(threshold=0.05, alpha=0.0),
        feature_library=pysindy.IdentityLibrary(),
    )
    # The state is -u(t-1) and what follows it u(t); all other lags are inputs.
    model.fit(scaled[:, :1], t=1.0, x_next=scaled[:, -1:], u=scaled[:, 1:-1])
    own = prune(scaled, threshold=0.05)
    assert own == pytest.approx(model.coefficients()[0], abs=1e-9)


@pytest.mark.parametrize("samples", [1, 2, 3])
def test_the_delay_is_found_on_the_grid(samples: int) -> None:
    # A gain and a delay on a white input: u(t) = 0.5 e(t - delay).
    delay = 0.12 * samples
    rng = np.random.default_rng(2)
    e = rng.standard_normal(4096)
    bins = 2.0 * np.pi * np.fft.rfftfreq(4096, 0.02)
    u = np.fft.irfft(0.5 * np.fft.rfft(e) * np.exp(-1j * bins * delay))
    u += 0.05 * rng.standard_normal(4096)
    recording = Recording(dt=0.02, e=e[None], u=u[None], x=e[None])
    library = Library(SINDy(own_lags=0), recording, SINGLE)
    assert library.dt == pytest.approx(0.12)
    assert library.best_delays().delays == (samples,)


def test_no_row_reaches_across_runs() -> None:
    both = recording_of(replace(SINGLE_LOOP, runs=2))
    library = Library(SINDy(), both, SINGLE)
    structure = library.best_delays()
    blocks = library.blocks(structure, 1.0)
    apart = []
    for run in range(2):
        alone = part_of(both, runs=slice(run, run + 1))
        apart += Library(SINDy(), alone, SINGLE).blocks(structure, 1.0)
    assert len(blocks) == len(apart)
    for one, other in zip(blocks, apart, strict=True):
        assert one.T @ one == pytest.approx(other.T @ other, rel=1e-6, abs=1e-9)


# ------------------------------------------------------------------------------- the estimate


@pytest.mark.parametrize(("name", "own_lags"), [("nominal", 4), ("single", 2)])
def test_a_recording_without_remnant_gives_the_truth(name: str, own_lags: int) -> None:
    scenario = without_remnant(scenario_named(name))
    estimate = fit_of(SINDy(own_lags=own_lags), scenario)
    assert estimate.outcome is Outcome.CONVERGED
    assert estimate.values == pytest.approx(scenario.values, rel=1.5e-2)
    response = response_of(estimate)
    truth = scenario.model.response(response.omega, scenario.values)
    assert np.median(np.abs(response.value / truth - 1.0)) < 1e-2


@pytest.mark.parametrize(
    ("method", "scenario", "words"),
    [
        # 24 sines and no remnant leave two of the four lags of the control without information.
        (SINDy(), without_remnant(SINGLE_LOOP), "unstable pole"),
        # Without a disturbance the acceleration is a multiple of the control.
        (SINDy(), scenario_named("target-only"), ""),
        (SINDy(threshold=0.9), NOMINAL, "channel survives"),
    ],
)
def test_no_usable_model_is_an_outcome(method: SINDy, scenario: Scenario, words: str) -> None:
    estimate = fit_of(method, scenario)
    assert estimate.outcome is Outcome.UNSTABLE_MODEL
    assert words in estimate.message
    assert np.isnan(estimate.values).all()


@pytest.mark.parametrize("model", [SINGLE, MULTI], ids=lambda m: m.name)
def test_a_response_that_says_nothing_is_not_believed(model: PilotModel) -> None:
    value = np.ones((len(model.channels), 4), dtype=complex)
    errors = np.tile(np.repeat([3.0, 1.0][: len(value)], 4), 2)
    response = FrequencyResponse(np.arange(1.0, 5.0), value, np.diag(0.5 * errors**2))
    assert "visual channel has errors of 3" in undetermined(response, model)
    assert not undetermined(replace(response, covariance=0.01 * response.covariance), model)
    endless = replace(response, covariance=np.full_like(response.covariance, np.inf))
    assert "errors of inf" in undetermined(endless, model)


@pytest.mark.long
def test_the_claimed_spread_of_the_response_is_its_scatter() -> None:
    method = SINDy(misfit=1e-3)  # the ensemble alone
    responses = [response_of(fit_of(method, SINGLE_LOOP, i)) for i in range(20)]
    scatter = np.sqrt(np.var([r.value for r in responses], axis=0, ddof=1))
    claimed = np.median([r.std for r in responses], axis=0)
    ratio = claimed / scatter
    assert 0.5 < np.median(ratio) < 2.0
    assert np.mean((ratio > 0.5) & (ratio < 2.0)) > 0.8, ratio


def test_an_ensemble_that_scatters_more_raises_the_covariance() -> None:
    rng = np.random.default_rng(6)
    triangle = np.triu(rng.standard_normal((5, 5))) + 4.0 * np.eye(5)
    least_squares = np.linalg.inv(triangle.T @ triangle) * 0.3
    draws = rng.multivariate_normal(np.zeros(5), least_squares, size=4000)
    for factor in (0.1, 1.0, 3.0):
        found = ensemble_covariance(factor * draws, triangle, 0.3)
        assert found == pytest.approx(max(1.0, factor**2) * least_squares, rel=0.05, abs=1e-9)


# -------------------------------------------------------------------------- no usable model


def test_an_unstable_pole_is_an_outcome() -> None:
    recording = running_away(recording_of(SINGLE_LOOP))
    estimate = identify(SINDy(), recording, SINGLE, np.random.default_rng(1))
    assert estimate.outcome is Outcome.UNSTABLE_MODEL
    (magnitude,) = re.findall(r"unstable pole of magnitude ([\d.]+)", estimate.message)
    # exp(0.2/s * 0.12 s), were the remnant not there.
    assert float(magnitude) == pytest.approx(1.024, abs=0.015)
