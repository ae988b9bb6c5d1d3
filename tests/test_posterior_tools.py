"""Samplers, convergence measures and summaries of draws, on distributions that are known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from pilotid.estimates.draws import Draws, quantiles, shortest_interval
from pilotid.posterior.ensembles import Run, autocorrelation_times, ensembles, r_hat
from pilotid.posterior.importance import LogDensity, StudentT, fitted, importance
from pilotid.support.types import FloatArray

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


def test_importance_sampling_gives_the_closed_form_posterior() -> None:
    _, _, mean, covariance = linear_gaussian()
    # Starts from a poor guess, one deviation away.
    start = mean + np.sqrt(np.diag(covariance)), 2.0 * covariance
    found = importance(log_density, *start, np.random.default_rng(1), count=20_000, wanted=100.0)
    assert found.effective > 10_000.0
    assert found.weights.sum() == pytest.approx(1.0)
    deviation = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(
        found.weights @ found.points, mean, atol=4.0 * deviation.max() / np.sqrt(found.effective)
    )
    offset = found.points - found.weights @ found.points
    spread = np.sqrt(found.weights @ offset**2)
    np.testing.assert_allclose(spread / deviation, 1.0, atol=4.0 / np.sqrt(2.0 * found.effective))


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
    ("target", "centre", "spread", "mean", "variance"),
    [
        (funnel, np.zeros(5), 1.0, 0.0, 1.0),
        (two_summits, np.array([-3.0, 0.0, 0.0, 0.0]), 1.0, 1.2, 1.0 + 9.0 * 0.84),
    ],
    ids=["funnel", "two summits"],
)
def test_mixtures_follow_a_density_that_no_single_distribution_does(
    target: LogDensity, centre: FloatArray, spread: float, mean: float, variance: float
) -> None:
    start = centre, spread**2 * np.eye(centre.size)
    means, variances, sizes = [], [], []
    for seed in range(8):
        # More than the single distributions can give, so that mixtures are tried.
        rng = np.random.default_rng(seed)
        found = importance(target, *start, rng, count=1000, wanted=3200.0)
        assert found.effective >= 3200.0
        first = found.points[:, 0]
        means.append(found.weights @ first)
        variances.append(found.weights @ (first - mean) ** 2)
        sizes.append(found.effective)
    total = float(np.sum(sizes))
    # Four Monte-Carlo errors; the kurtosis of neither is above 3.
    assert np.mean(means) == pytest.approx(mean, abs=4.0 * np.sqrt(variance / total))
    assert np.mean(variances) == pytest.approx(variance, rel=4.0 * np.sqrt(2.0 / total))


def test_a_mixture_draws_what_its_density_says() -> None:
    rng = np.random.default_rng(10)
    points = np.concatenate([rng.standard_normal((600, 2)), 6.0 + rng.standard_normal((300, 2))])
    mixture = fitted(points, np.full(900, 1.0 / 900), np.cov(points.T), rng)
    assert mixture.shares.sum() == pytest.approx(1.0)
    drawn = mixture.draw(rng, 40_000)
    # Weighted by one Student-t distribution over the mixture, draws are of that distribution.
    other = StudentT(np.array([1.0, 2.0]), np.array([[2.0, 0.5], [0.5, 1.0]]))
    weights = np.exp(other.log_density(drawn) - mixture.log_density(drawn))
    assert weights.mean() == pytest.approx(1.0, abs=4.0 * weights.std() / 200.0)
    assert weights @ drawn / weights.sum() == pytest.approx(other.centre, abs=0.1)
    # Both heaps, in the proportion they have.
    near = np.sum((drawn - 6.0) ** 2, axis=1) < np.sum(drawn**2, axis=1)
    assert np.mean(near) == pytest.approx(1.0 / 3.0, abs=0.05)


def test_a_mixture_copes_with_draws_of_which_one_has_all_the_weight() -> None:
    rng = np.random.default_rng(11)
    points, weights = rng.standard_normal((50, 3)), np.eye(50)[7]
    drawn = fitted(points, weights, np.eye(3), rng).draw(rng, 4000)
    np.testing.assert_allclose(np.median(drawn, axis=0), points[7], atol=0.1)


@pytest.mark.long
@pytest.mark.parametrize("independent", [0.0, 0.5])
def test_ensembles_give_the_closed_form_posterior(independent: float) -> None:
    _, _, mean, covariance = linear_gaussian()
    run = Run(walkers=20, effective=6000.0, independent=independent)
    chains = ensembles(log_density, mean, covariance, np.random.default_rng(2), run)
    assert chains is not None
    assert chains.converged
    assert (chains.r_hat < 1.01).all()
    flat = chains.points.reshape(-1, 3)
    deviation = np.sqrt(np.diag(covariance))
    error = 1.0 / np.sqrt(chains.effective)
    assert (np.abs(flat.mean(axis=0) - mean) < 4.0 * error * deviation).all()
    assert (np.abs(flat.std(axis=0) / deviation - 1.0) < 4.0 * error).all()


def test_where_the_density_is_zero_there_is_no_chain() -> None:
    def nowhere(points: FloatArray) -> FloatArray:
        return np.full(len(points), -np.inf)

    start = np.zeros(2), np.eye(2)
    rng = np.random.default_rng(3)
    assert ensembles(nowhere, *start, rng, Run(walkers=8)) is None
    assert importance(nowhere, *start, rng, count=50, wanted=1.0).effective <= 1.0


def test_the_watch_is_told_how_far_a_run_is() -> None:
    shares: list[float] = []
    run = Run(walkers=10, first=60, most=60, effective=1e9)
    centre, covariance = linear_gaussian()[2:]
    ensembles(log_density, centre, covariance, np.random.default_rng(4), run, shares.append)
    assert shares == sorted(shares)
    assert 0.0 <= shares[0] < shares[-1] <= 1.0


def test_a_student_t_distribution_is_that_of_scipy() -> None:
    centre, scale = np.array([1.0, -2.0]), np.array([[2.0, 0.6], [0.6, 1.0]])
    own, oracle = StudentT(centre, scale, 6.0), stats.multivariate_t(centre, scale, df=6.0)
    points = own.draw(np.random.default_rng(5), 50_000)
    differences = own.log_density(points[:50]) - oracle.logpdf(points[:50])
    assert np.ptp(differences) < 1e-9
    np.testing.assert_allclose(np.cov(points.T), 1.5 * scale, rtol=0.06)


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


def test_chains_that_do_not_move_have_some_autocorrelation_time() -> None:
    assert autocorrelation_times(np.ones((2, 10, 3, 1)))[0] == 1.0


# -------------------------------------------------------------------------------- summaries


def draws_of(values: FloatArray, weights: FloatArray | None = None) -> Draws:
    count, parameters = values.shape
    own = np.full(count, 1.0 / count) if weights is None else weights
    nothing = np.full(parameters, np.nan)
    return Draws(
        "importance",
        tuple("abcdefg"[:parameters]),
        np.array([True, False, False][:parameters]),
        values,
        np.zeros(count),
        own,
        (1, count, 1),
        np.full(parameters, float(count)),
        nothing,
        np.ones(parameters),
    )


def test_intervals_are_those_of_known_distributions() -> None:
    shares = (np.arange(20_000) + 0.5) / 20_000
    equal = np.full(20_000, 1.0 / 20_000)
    normal, exponential = stats.norm.ppf(shares), stats.expon.ppf(shares)
    np.testing.assert_allclose(shortest_interval(normal, equal), [-1.96, 1.96], atol=0.03)
    # The density falls from zero on, and so the shortest interval starts there.
    np.testing.assert_allclose(shortest_interval(exponential, equal), [0.0, 2.996], atol=0.01)
    tails = quantiles(exponential, equal, (0.025, 0.975))
    np.testing.assert_allclose(tails, [0.02532, 3.689], rtol=0.01)


def test_weights_count() -> None:
    # Uniform draws with weights that make them exponential.
    values = (np.arange(40_000) + 0.5) * 5e-4
    weights = np.exp(-values) / np.exp(-values).sum()
    draws = draws_of(values[:, None], weights)
    assert draws.mean[0] == pytest.approx(1.0, rel=1e-3)
    assert draws.covariance[0, 0] == pytest.approx(1.0, rel=1e-3)
    np.testing.assert_allclose(draws.equal_tailed[0], [0.02532, 3.689], rtol=0.01)
    np.testing.assert_allclose(draws.highest_density[0], [0.0, 2.996], atol=0.01)
    # exp(E ln x) of an exponential distribution is e^-gamma.
    assert draws.centre[0] == pytest.approx(np.exp(-np.euler_gamma), rel=1e-3)
    equal = draws.equally_weighted(2000)[:, 0]
    assert equal.mean() == pytest.approx(1.0, rel=0.01)
    assert stats.kstest(equal, stats.expon.cdf).statistic < 0.01


def test_the_centre_of_a_parameter_that_may_be_zero_is_its_mean() -> None:
    values = np.random.default_rng(8).standard_normal((500, 2))
    values[:, 0] = np.exp(values[:, 0])
    draws = draws_of(values)
    assert draws.centre[0] == pytest.approx(stats.gmean(values[:, 0]))
    assert draws.centre[1] == pytest.approx(values[:, 1].mean())
