"""Regression on lags: rows and costs by hand, and a true ARX system found again."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.signal import lfilter

from pilotid.datasets import scenario_named, simulate
from pilotid.estimate.quantities import real_parts
from pilotid.spectral.regression import Regression, Structure, information_criterion, lagged_rows
from pilotid.support.types import FloatArray

pytestmark = pytest.mark.numerical

DT = 0.1
DENOMINATOR = np.array([1.0, -1.2, 0.5])
NUMERATORS = (np.array([0.4, 0.3]), np.array([-0.5, 0.2]))
DELAYS = (3, 2)
TRUE = Structure(2, (2, 2), DELAYS)
WIDEST = Structure(4, (8, 8), (1, 1))
NOISE = 0.3


def true_arx(rng: np.random.Generator, samples: int, runs: int = 1) -> list[FloatArray]:
    """Output and inputs of a known ARX system, each of shape (runs, samples)."""
    settled = 100
    first, second, noise = rng.standard_normal((3, runs, samples + settled))
    driven = NOISE * noise
    for signal, top, delay in zip((first, second), NUMERATORS, DELAYS, strict=True):
        driven = driven + lfilter(np.concatenate([np.zeros(delay), top]), [1.0], signal)
    output = lfilter([1.0], DENOMINATOR, driven)
    return [s[:, settled:] for s in (output, first, second)]


def grid(poles: range, zeros: range, delays: range) -> list[Structure]:
    return [
        Structure(p, (z, z), d)
        for p in poles
        for z in zeros
        for d in itertools.product(delays, repeat=2)
    ]


# ---------------------------------------------------------------------------- the regression


def test_rows_written_out() -> None:
    output = np.array([[1.0, 2.0, 3.0, 4.0, 5.0], [10.0, 20.0, 30.0, 40.0, 50.0]])
    one = np.array([[0.1, 0.2, 0.3, 0.4, 0.5], [1.1, 1.2, 1.3, 1.4, 1.5]])
    two = np.array([[6.0, 7.0, 8.0, 9.0, 0.0], [60.0, 70.0, 80.0, 90.0, 0.0]])
    rows = lagged_rows(output, [one, two], Structure(2, (2, 1), (1, 3)), 3)
    # -u(t-1), -u(t-2), one(t-1), one(t-2), two(t-3), u(t); no row of the second run looks
    # back into the first.
    assert rows.tolist() == [
        [[-3.0, -2.0, 0.3, 0.2, 6.0, 4.0], [-4.0, -3.0, 0.4, 0.3, 7.0, 5.0]],
        [[-30.0, -20.0, 1.3, 1.2, 60.0, 40.0], [-40.0, -30.0, 1.4, 1.3, 70.0, 50.0]],
    ]


def plain(
    signals: list[FloatArray], structure: Structure, first: int
) -> tuple[FloatArray, float, FloatArray]:
    """Coefficients, cost and covariance with a constant for each run, by `lstsq`."""
    rows = lagged_rows(signals[0], signals[1:], structure, first)
    runs, samples, _ = rows.shape
    constants = np.kron(np.eye(runs), np.ones((samples, 1)))
    table = np.concatenate([rows.reshape(runs * samples, -1), constants], axis=1)
    target = table[:, structure.parameters]
    regressors = np.delete(table, structure.parameters, axis=1)
    found = np.linalg.lstsq(regressors, target, rcond=None)[0]
    cost = float(np.sum((target - regressors @ found) ** 2))
    variance = cost / (len(target) - runs - structure.parameters)
    covariance = variance * np.linalg.inv(regressors.T @ regressors)
    size = structure.parameters
    return found[:size], cost, covariance[:size, :size]


def test_costs_of_one_factorisation_are_those_of_plain_least_squares() -> None:
    signals = true_arx(np.random.default_rng(1), 120, runs=3)
    regression = Regression(signals[0], signals[1:], WIDEST, 8)
    structures = grid(range(5), range(1, 5), range(1, 6))
    for structure in structures[::17]:
        coefficients, cost, covariance = plain(signals, structure, 8)
        assert regression.cost(structure) == pytest.approx(cost, rel=1e-10)
        fit = regression.fit(structure)
        assert fit.coefficients == pytest.approx(coefficients, rel=1e-8)
        assert fit.covariance == pytest.approx(covariance, rel=1e-8, abs=1e-12)


def test_a_pilot_s_ill_conditioned_rows_keep_their_precision() -> None:
    recording = simulate(scenario_named("nominal"), np.random.default_rng(3))
    u, e, x = (s[:, ::2] for s in (recording.u, recording.e, recording.x))
    structure = Structure(8, (10, 10), (3, 3))
    regression = Regression(u, [e, x], structure, 12)
    assert regression.cost(structure) == pytest.approx(plain([u, e, x], structure, 12)[1], rel=1e-6)


def test_a_drift_of_each_run_can_be_fitted_besides() -> None:
    signals = true_arx(np.random.default_rng(2), 200, runs=2)
    drift = np.arange(200.0)
    drifting = [s + np.array([[3.0], [-2.0]]) + 0.1 * drift for s in signals]
    nuisance = np.stack([np.ones(195), drift[5:]], axis=1)
    fits = [Regression(s[0], s[1:], TRUE, 5, nuisance).fit(TRUE) for s in (signals, drifting)]
    assert fits[1].coefficients == pytest.approx(fits[0].coefficients, rel=1e-8)


# --------------------------------------------------------------------------- the true system


@pytest.mark.parametrize("weight", [1.0, 3.0])
def test_the_search_finds_orders_and_delays_of_a_true_system(weight: float) -> None:
    signals = true_arx(np.random.default_rng(5), 400, runs=3)
    regression = Regression(signals[0], signals[1:], WIDEST, 8)
    best = regression.best(grid(range(1, 5), range(1, 5), range(1, 5)), weight)
    assert best == TRUE


@pytest.mark.parametrize("weight", [1.0, 3.0])
def test_the_criterion_by_hand(weight: float) -> None:
    found = information_criterion(np.array([20.0, 10.0]), np.array([2.0, 4.0]), 100, weight)
    deviance = 100.0 * np.log([0.2, 0.1])
    assert found == pytest.approx(deviance + weight * np.log(100.0) * np.array([2, 4]))


def test_the_response_s_covariance_is_its_scatter() -> None:
    omega = np.array([0.5, 3.0, 8.0, 20.0])
    factors = np.ones((2, omega.size), dtype=complex)
    found, claimed = [], []
    for replication in range(400):
        signals = true_arx(np.random.default_rng(replication), 600)
        fit = Regression(signals[0], signals[1:], TRUE, 5).fit(TRUE)
        value, covariance = fit.response(omega, DT, factors)
        found.append(real_parts(value))
        claimed.append(covariance)
    shift = np.exp(-1j * omega * DT)
    bottom = np.polyval(DENOMINATOR[::-1], shift)
    truth = [
        np.polyval(top[::-1], shift) * shift**delay / bottom
        for top, delay in zip(NUMERATORS, DELAYS, strict=True)
    ]
    scatter = np.cov(np.array(found).T)
    mean_claim = np.mean(claimed, axis=0)
    error = np.sqrt(np.diag(scatter))
    assert np.mean(found, axis=0) == pytest.approx(
        real_parts(np.array(truth)), abs=0.3 * error.max()
    )
    assert np.sqrt(np.diag(mean_claim)) / error == pytest.approx(1.0, abs=0.12)
    correlations = [
        c / np.outer(np.sqrt(np.diag(c)), np.sqrt(np.diag(c))) for c in (scatter, mean_claim)
    ]
    assert correlations[1] == pytest.approx(correlations[0], abs=0.2)
    # As many directions as coefficients are random.
    assert np.linalg.matrix_rank(claimed[0], tol=1e-9 * claimed[0].max()) == TRUE.parameters
