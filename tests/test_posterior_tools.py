"""Samplers, convergence measures and summaries of draws, on distributions that are known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from helpers import draws_at
from scipy import stats

from pilotid.estimate.quantities import Draws
from pilotid.likelihood.posterior import (
    FREEDOM,
    LogDensity,
    Mixture,
    autocorrelation_times,
    fitted,
    r_hat,
    sample,
)
from pilotid.support.types import BoolArray, FloatArray

pytestmark = pytest.mark.numerical


def linear_gaussian() -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Regressors, data, and the posterior in closed form: mean and covariance.

    Unit noise, and standard normal priors.
    """
    rng = np.random.default_rng(0)
    regressors = rng.standard_normal((60, 3)) @ np.array([[1, 0.9, 0], [0, 0.2, 0], [0, 0, 0.5]])
    data = regressors @ np.array([0.5, -1.0, 2.0]) + rng.standard_normal(60)
    covariance = np.linalg.inv(regressors.T @ regressors + np.eye(3))
    return regressors, data, covariance @ regressors.T @ data, covariance


def log_density(points: FloatArray) -> FloatArray:
    regressors, data, _, _ = linear_gaussian()
    residuals = data - points @ regressors.T
    return -0.5 * np.sum(residuals**2, axis=1) - 0.5 * np.sum(points**2, axis=1)


@dataclass(frozen=True)
class Target:
    """What is asked of a posterior, of any density."""

    log_density: LogDensity
    count: int

    @property
    def keys(self) -> tuple[str, ...]:
        return tuple("abcdefg"[: self.count])

    @property
    def positive(self) -> BoolArray:
        return np.zeros(self.count, dtype=bool)

    def values(self, points: FloatArray) -> FloatArray:
        return points


def sampled(
    density: LogDensity, centre: FloatArray, covariance: FloatArray, seed: int, effective: float
) -> Draws:
    target: Any = Target(density, centre.size)
    draws = sample(target, centre, covariance, np.random.default_rng(seed), effective, 4000)
    assert draws.converged
    assert draws.effective.min() >= effective
    return draws


def test_ensembles_give_the_closed_form_posterior() -> None:
    _, _, mean, covariance = linear_gaussian()
    deviation = np.sqrt(np.diag(covariance))
    # From a poor guess, one deviation away.
    draws = sampled(log_density, mean + deviation, 2.0 * covariance, 2, 5000.0)
    assert (draws.r_hat < 1.01).all()
    error = 1.0 / np.sqrt(draws.effective)
    assert (np.abs(draws.values.mean(axis=0) - mean) < 4.0 * error * deviation).all()
    assert (np.abs(draws.values.std(axis=0) / deviation - 1.0) < 4.0 * error).all()
    correlation = covariance / np.outer(deviation, deviation)
    np.testing.assert_allclose(np.corrcoef(draws.values.T), correlation, atol=4.0 * error.max())
    ends = stats.norm.ppf([[0.025, 0.975]], mean[:, None], deviation[:, None])
    np.testing.assert_allclose(draws.equal_tailed, ends, atol=10.0 * (error * deviation).max())


def funnel(points: FloatArray) -> FloatArray:
    """A standard normal variable, and four whose spread it decides: exp of half of it."""
    first, rest = points[:, 0], points[:, 1:]
    return np.asarray(
        -0.5 * first**2 - 0.5 * np.sum(rest**2, axis=1) * np.exp(-first) - 2.0 * first
    )


def two_summits(points: FloatArray) -> FloatArray:
    """Unit normals in four dimensions, a share of 0.3 at -3 and of 0.7 at 3 along the first."""
    first, rest = points[:, 0], points[:, 1:]
    summits = [np.log(0.3) - 0.5 * (first + 3.0) ** 2, np.log(0.7) - 0.5 * (first - 3.0) ** 2]
    return np.asarray(np.logaddexp(*summits) - 0.5 * np.sum(rest**2, axis=1))


@pytest.mark.long
@pytest.mark.parametrize(
    ("target", "centre", "mean", "variance"),
    [
        (funnel, np.zeros(5), 0.0, 1.0),
        (two_summits, np.array([-3.0, 0.0, 0.0, 0.0]), 1.2, 1.0 + 9.0 * 0.84),
    ],
    ids=["funnel", "two summits"],
)
def test_a_density_that_no_single_distribution_follows_is_sampled(
    target: LogDensity, centre: FloatArray, mean: float, variance: float
) -> None:
    means, variances, sizes = [], [], []
    for seed in range(3):
        draws = sampled(target, centre, np.eye(centre.size), seed, 1000.0)
        first = draws.values[:, 0]
        means.append(first.mean())
        variances.append(np.mean((first - mean) ** 2))
        sizes.append(draws.effective[0])
    total = float(np.sum(sizes))
    # Four Monte-Carlo errors; the kurtosis of neither is above 3.
    assert np.mean(means) == pytest.approx(mean, abs=4.0 * np.sqrt(variance / total))
    assert np.mean(variances) == pytest.approx(variance, rel=4.0 * np.sqrt(2.0 / total))


def student_t(centre: FloatArray, scale: FloatArray) -> Mixture:
    return Mixture(np.ones(1), centre[None], scale[None])


def test_a_mixture_draws_what_its_density_says() -> None:
    rng = np.random.default_rng(10)
    points = np.concatenate([rng.standard_normal((600, 2)), 6.0 + rng.standard_normal((300, 2))])
    mixture = fitted(points, np.full(900, 1.0 / 900), np.cov(points.T), 4, rng)
    assert mixture.shares.sum() == pytest.approx(1.0)
    drawn = mixture.draw(rng, 40_000)
    # Weighted by one Student-t distribution over the mixture, draws are of that distribution.
    other = student_t(np.array([1.0, 2.0]), np.array([[2.0, 0.5], [0.5, 1.0]]))
    weights = np.exp(other.log_density(drawn) - mixture.log_density(drawn))
    assert weights.mean() == pytest.approx(1.0, abs=4.0 * weights.std() / 200.0)
    assert weights @ drawn / weights.sum() == pytest.approx(other.centres[0], abs=0.1)
    # Both heaps, in the proportion they have.
    near = np.sum((drawn - 6.0) ** 2, axis=1) < np.sum(drawn**2, axis=1)
    assert np.mean(near) == pytest.approx(1.0 / 3.0, abs=0.05)


def test_a_student_t_distribution_is_that_of_scipy() -> None:
    centre, scale = np.array([1.0, -2.0]), np.array([[2.0, 0.6], [0.6, 1.0]])
    own, oracle = student_t(centre, scale), stats.multivariate_t(centre, scale, df=FREEDOM)
    points = own.draw(np.random.default_rng(5), 50_000)
    differences = own.log_density(points[:50]) - oracle.logpdf(points[:50])
    assert np.ptp(differences) < 1e-9
    np.testing.assert_allclose(np.cov(points.T), FREEDOM / (FREEDOM - 2.0) * scale, rtol=0.06)


# ------------------------------------------------------------------------------ convergence


def autoregressive(rng: np.random.Generator, phi: float, shape: tuple[int, int, int]) -> FloatArray:
    """Stationary AR(1) chains, whose autocorrelation time is (1 + phi)/(1 - phi)."""
    ensembles_, steps, walkers = shape
    chains = np.empty(shape)
    chains[:, 0] = rng.standard_normal((ensembles_, walkers))
    for step in range(1, steps):
        noise = rng.standard_normal((ensembles_, walkers))
        chains[:, step] = phi * chains[:, step - 1] + np.sqrt(1.0 - phi**2) * noise
    return chains[..., None]


@pytest.mark.parametrize("phi", [0.0, 0.5, 0.9])
def test_the_autocorrelation_time_is_that_of_known_chains(phi: float) -> None:
    chains = autoregressive(np.random.default_rng(6), phi, (4, 1500, 20))
    expected = (1.0 + phi) / (1.0 - phi)
    assert autocorrelation_times(chains)[0] == pytest.approx(expected, rel=0.06)
    assert r_hat(chains)[0] < 1.002


def test_ensembles_that_disagree_are_found_out() -> None:
    chains = autoregressive(np.random.default_rng(7), 0.5, (4, 600, 20))
    moved = chains.copy()
    moved[0] += 0.5
    assert r_hat(moved)[0] > 1.02
    moved[0] += 1.0
    assert autocorrelation_times(moved)[0] > 5.0 * autocorrelation_times(chains)[0]
    # The same mean and another spread.
    wide = chains.copy()
    wide[0] *= 2.0
    assert r_hat(wide)[0] > 1.02
    # A drift that all ensembles share.
    drift = chains + np.linspace(0.0, 1.0, 600)[None, :, None, None]
    assert r_hat(drift)[0] > 1.02


# -------------------------------------------------------------------------------- summaries


def draws_of(values: FloatArray) -> Draws:
    keys = tuple("abcdefg"[: values.shape[1]])
    return draws_at(keys, np.array([True, False]), values)


def test_intervals_are_those_of_known_distributions() -> None:
    shares = (np.arange(20_000) + 0.5) / 20_000
    normal, exponential = stats.norm.ppf(shares), stats.expon.ppf(shares)
    draws = draws_of(np.column_stack([exponential, normal]))
    np.testing.assert_allclose(draws.equal_tailed[0], [0.02532, 3.689], rtol=0.01)
    np.testing.assert_allclose(np.diag(draws.covariance), 1.0, rtol=1e-3)
    # exp(E ln x) of an exponential distribution is e^-gamma; of what may be zero it is the mean.
    assert draws.centre[0] == pytest.approx(np.exp(-np.euler_gamma), rel=1e-3)
    assert draws.centre[1] == pytest.approx(normal.mean(), abs=1e-9)
    some = draws.thinned(2000)[:, 0]
    assert stats.kstest(some, stats.expon.cdf).statistic < 0.01
    np.testing.assert_array_equal(draws.thinned(20_000), draws.values)


def test_draws_go_to_arviz() -> None:
    pytest.importorskip("arviz_base", reason="needs the extra pilotid[posterior]")
    values = np.random.default_rng(9).uniform(1.0, 2.0, (60, 2))
    tree = draws_of(values).to_arviz()
    assert tree["posterior"]["a"].shape == (1, 60)
    np.testing.assert_array_equal(tree["posterior"]["b"].values[0], values[:, 1])
