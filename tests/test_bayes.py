"""`bayes`: its likelihood, its draws, and what it does when they are too few."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy import stats

from pilotid.datasets import (
    POPULATIONS,
    SCENARIOS,
    fixed_tasks,
    load_task,
    reference_posterior,
    simulate,
)
from pilotid.estimate.estimate import Estimate, Outcome
from pilotid.estimate.method import identify
from pilotid.estimate.quantities import Draws
from pilotid.likelihood.band_likelihood import most_likely_regression
from pilotid.likelihood.likelihood import Likelihood
from pilotid.likelihood.posterior import (
    HalfCauchy,
    LogNormal,
    Normal,
    Posterior,
    default_prior,
    priors_of,
)
from pilotid.likelihood.prediction import predict
from pilotid.likelihood.remnant_models import Autoregressive, LowPass, NoiseModel, are_invertible
from pilotid.likelihood.search import LikelihoodSettings, maximise_likelihood
from pilotid.methods.bayes import Bayes
from pilotid.methods.mle import MLE
from pilotid.methods.mle_white import MLEWhite
from pilotid.model.catalogue import MODELS, MULTI, SINGLE
from pilotid.study.run import recording_of, scenario_of
from pilotid.support.numbers import recording_rng
from pilotid.support.types import FloatArray, InputError

pytestmark = pytest.mark.numerical

NOMINAL, ONE = SCENARIOS["nominal"], SCENARIOS["single"]
RECORDING = simulate(NOMINAL, np.random.default_rng(21))
SIMPLE = simulate(ONE, np.random.default_rng(22))


def likelihood_of(
    noise: NoiseModel, terms: tuple[float, ...] = (), runs: int = 1, offset: float = 0.0
) -> Posterior:
    recording = simulate(replace(NOMINAL, runs=runs), np.random.default_rng(1))
    recording = replace(recording, u=recording.u + offset)
    prediction = replace(predict(recording, MULTI, 50.0), nuisance_poles=terms)
    return Posterior(Likelihood(prediction, noise))


def sets_of(noise: NoiseModel, count: int) -> FloatArray:
    remnant = {0: [], 1: [5.0], 2: [3.5, 0.7], 3: [3.5, 0.7]}[getattr(noise, "order", 0) % 4]
    factors = np.exp(0.1 * np.random.default_rng(2).standard_normal((count, 7 + len(remnant))))
    return np.array([*NOMINAL.truth, *remnant]) * factors


# ------------------------------------------------------------------------------- likelihood


@pytest.mark.parametrize("terms", [(), (0.0, -1.0 / 6.0)], ids=["plain", "nuisance"])
@pytest.mark.parametrize("order", [0, 1, 2, 3])
def test_sums_of_squares_are_the_last_elements_of_the_gram_matrices(
    order: int, terms: tuple[float, ...]
) -> None:
    likelihood = likelihood_of(LowPass(order), terms, runs=2)
    values = sets_of(LowPass(order), 37)
    joint = likelihood.joint
    taps = joint.noise.filters(values[:, joint.pilot_count :], joint.band)
    expected = joint.gram(values)[:, -1, -1]
    np.testing.assert_allclose(likelihood.sums_of_squares(values, taps), expected, rtol=1e-6)


@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_autoregressive_coefficients_are_integrated_out(offset: float) -> None:
    noise = Autoregressive(3)
    likelihood = likelihood_of(noise, (0.0, -1.0 / 6.0), runs=2, offset=offset)
    values = sets_of(LowPass(0), 2)
    found = likelihood.log_likelihood(values)
    # On a grid around the optimum: the integral of (sum of squares)^(-N/2).
    logs = []
    for own in values:
        products = likelihood.lagged_products(own[None])[0]
        centre = most_likely_regression(products[None], None)[0][0, 1:]
        spread = np.linalg.inv(products[1:, 1:])
        root = np.linalg.cholesky(spread * (products[0] @ np.array([1.0, *centre]))) / np.sqrt(
            likelihood.joint.residuals
        )
        axis = np.linspace(-5.0, 5.0, 21)
        mesh = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
        taps = np.concatenate([np.ones((len(mesh), 1)), centre + mesh @ root.T], axis=1)
        squares = np.einsum("si,ij,sj->s", taps, products, taps)
        power = -0.5 * likelihood.joint.residuals * np.log(squares)
        logs.append(np.logaddexp.reduce(power) + np.log(np.linalg.det(root)))
    assert found[0] - found[1] == pytest.approx(logs[0] - logs[1], abs=1e-3)


# ----------------------------------------------------------------------------------- priors


@pytest.mark.parametrize(
    ("prior", "oracle"),
    [
        (LogNormal(2.0, 0.7), stats.lognorm(0.7, scale=2.0)),
        (Normal(0.3, 0.1), stats.norm(0.3, 0.1)),
        (HalfCauchy(1.7), stats.halfcauchy(scale=1.7)),
    ],
    ids=["log-normal", "normal", "half-Cauchy"],
)
def test_priors_are_those_of_scipy(
    prior: LogNormal | Normal | HalfCauchy, oracle: stats.rv_frozen
) -> None:
    x = np.array([0.05, 0.3, 1.0, 4.0])
    np.testing.assert_allclose(prior.logpdf(x), oracle.logpdf(x), rtol=1e-12)


def test_four_fifths_of_a_prior_lie_in_the_range_of_published_values() -> None:
    for parameter in MULTI.parameters:
        prior = default_prior(parameter)
        x = np.linspace(*parameter.usual, 20_001)
        share = np.trapezoid(np.exp(prior.logpdf(x)), x)
        if isinstance(prior, HalfCauchy):
            assert prior.scale == parameter.usual[1]
        else:
            assert share == pytest.approx(0.8, abs=1e-3)


def test_of_two_lags_that_may_be_exchanged_the_shorter_is_first() -> None:
    model = MODELS["precision"]
    prediction = predict(simulate(SCENARIOS["nominal"], recording_rng(1, "nominal", 0)), model, 20)
    noise = LowPass(1)
    posterior = Posterior(Likelihood(prediction, noise), priors_of(model, noise))
    pilot = {"tlag": 2.0, "tlaglow": 6.0, "tlead": 0.5, "tleadlow": 3.0}
    changed = dict(zip(model.keys, model.start, strict=True)) | pilot
    swapped = changed | {"tlag": 6.0, "tlaglow": 2.0}
    sets = np.array([[*model.vector(values), 3.0] for values in (changed, swapped)])
    first, second = posterior.log_likelihood(sets)
    assert first == pytest.approx(second, rel=1e-9)
    points = np.where(posterior.positive, np.log(sets), sets)
    assert list(np.isfinite(posterior.log_density(points))) == [True, False]
    np.testing.assert_allclose(model.ordered(sets[:, :-1])[1], sets[0, :-1])
    bounded = model.with_bounds(tlag=(3.0, 30.0))
    np.testing.assert_array_equal(bounded.ordered(sets[1:, :-1]), sets[1:, :-1])


def test_priors_may_be_replaced_by_distributions_of_scipy() -> None:
    tight = stats.lognorm(0.1, scale=0.2)
    told, own = fit(Bayes(priors=(("Kvis", tight),))), fit(Bayes())
    assert abs(told.values[0] - 0.2) < 0.25 * abs(own.values[0] - 0.2)
    # As precisions of independent pieces of evidence add up.
    expected = (own.std_error[0] ** -2.0 + 0.02**-2.0) ** -0.5
    assert told.std_error[0] == pytest.approx(expected, rel=0.15)
    assert priors_of(MULTI, LowPass(1), (("frequency", tight),))[-1] is tight
    with pytest.raises(InputError, match="Kvos, which model multi lacks"):
        priors_of(MULTI, LowPass(1), (("Kvos", tight),))


# ------------------------------------------------------------------------------------ draws


@cache
def fit(method: Bayes) -> Estimate:
    return identify(method, RECORDING, MULTI, np.random.default_rng(3))


def drawn(estimate: Estimate) -> Draws:
    assert estimate.draws is not None, estimate.sentence
    return estimate.draws


@pytest.mark.parametrize(
    "name",
    [n if n == "single-0" else pytest.param(n, marks=pytest.mark.long) for n in fixed_tasks()],
)
def test_reference_posteriors_are_found_again(name: str) -> None:
    task, reference = load_task(name), reference_posterior(name)
    draws = drawn(identify(Bayes(), task.recording, task.model, np.random.default_rng(8)))
    assert draws.converged
    assert draws.keys == tuple(reference)
    for key, values, effective in zip(draws.keys, draws.values.T, draws.effective, strict=True):
        own, known = np.log(values), np.log(reference[key])
        error = np.sqrt(1.0 / effective + 1.0 / known.size)
        assert abs(own.mean() - known.mean()) < 4.5 * error * known.std(), key
        for share in (0.1, 0.9):
            # The share below a quantile of the reference, with its binomial error.
            below = np.mean(own < np.quantile(known, share))
            assert abs(below - share) < 4.5 * error * np.sqrt(share * (1.0 - share)), key


def test_the_posterior_of_a_gain_alone_is_that_of_a_quadrature() -> None:
    # White prediction errors, all parameters but the gain held, and its prior flat.
    known = dict(zip(SINGLE.keys, ONE.truth, strict=True))
    model = SINGLE.with_fixed(**{key: value for key, value in known.items() if key != "Kvis"})
    flat = stats.uniform(0.0, 10.0)
    method = Bayes(likelihood="white", band=None, priors=(("Kvis", flat),), effective=4000.0)
    estimate = method.fit(SIMPLE, model, np.random.default_rng(6))
    settings = replace(method, noise=LowPass(0), loop=False)
    optimum = maximise_likelihood(SIMPLE, model, np.random.default_rng(6), settings)
    grid = np.linspace(0.8, 1.2, 401) * estimate.values[0]
    # A Student-t density in closed form: the response is linear in the gain.
    squares = Posterior(optimum.joint).sums_of_squares(grid[:, None], np.ones((grid.size, 1)))
    a, b, c = np.polyfit(grid, squares, 2)
    freedom = optimum.joint.residuals - 1
    oracle = stats.t(freedom, -b / (2.0 * a), np.sqrt((c - b * b / (4.0 * a)) / (a * freedom)))
    values = drawn(estimate).values[:, 0]
    error = oracle.std() / np.sqrt(drawn(estimate).effective[0])
    assert values.mean() == pytest.approx(oracle.mean(), abs=4.0 * error)
    assert values.std() == pytest.approx(oracle.std(), abs=4.0 * error)
    assert drawn(estimate).equal_tailed[0] == pytest.approx(
        oracle.ppf([0.025, 0.975]), abs=10.0 * error
    )


def test_a_run_that_is_too_short_is_an_outcome() -> None:
    method = Bayes(effective=1e5, most=30)
    estimate = identify(method, SIMPLE, SINGLE, np.random.default_rng(7))
    assert estimate.outcome is Outcome.NOT_CONVERGED
    assert "of 100000 wanted" in estimate.message


# --------------------------------------------------------------------------------- estimate


def test_the_posterior_agrees_with_maximum_likelihood_where_that_is_nearly_normal() -> None:
    bayes, mle = fit(Bayes()), identify(MLE(), RECORDING, MULTI, np.random.default_rng(3))
    well_known = slice(2, 7)
    apart = np.abs(bayes.values - mle.values)[well_known] / mle.std_error[well_known]
    assert (apart < 0.2).all()
    ratio = (bayes.std_error / mle.std_error)[well_known]
    np.testing.assert_allclose(ratio, 1.0, atol=0.12)
    assert bayes.vaf == pytest.approx(mle.vaf, abs=0.5)
    assert bayes.remnant.model == "second-order"


def test_a_white_likelihood_is_as_overconfident_as_that_of_output_error() -> None:
    # A recording in which both find the same transients.
    recording = simulate(NOMINAL, np.random.default_rng(24))
    method = Bayes(likelihood="white", band=None)
    bayes, white, honest = (
        identify(m, recording, MULTI, np.random.default_rng(3))
        for m in (method, MLEWhite(), Bayes())
    )
    assert bayes.method == "bayes-white"
    apart = np.abs(bayes.values - white.values) / white.std_error
    assert (apart < 0.3).all()
    np.testing.assert_allclose((bayes.std_error / white.std_error)[:3], 1.0, atol=0.25)
    assert (honest.std_error[:2] > 3.0 * bayes.std_error[:2]).all()


def test_the_product_of_gain_and_lead_time_comes_from_the_draws() -> None:
    estimate = fit(Bayes())
    (product,) = estimate.derived
    draws = drawn(estimate)
    own = draws.values[:, 0] * draws.values[:, 1]
    assert product.value == pytest.approx(own.mean())
    assert product.std_error < 0.06 * product.value
    # The values are geometric means, whose product is that of the draws.
    assert estimate.values[0] * estimate.values[1] == pytest.approx(product.value, rel=5e-3)


def test_filters_that_cannot_be_inverted_and_unstable_loops_have_no_density() -> None:
    """Of this recording such filters have densities far above that of the optimum."""
    population = POPULATIONS["population-short"]
    scenario = scenario_of(population, 1, 61)
    recording = recording_of(population, 1, 61)
    settings, rng = LikelihoodSettings(noise=Autoregressive(10)), np.random.default_rng(1)
    optimum = maximise_likelihood(recording, scenario.model, rng, settings)
    posterior = Posterior(optimum.joint, priors_of(scenario.model, optimum.joint.noise))
    assert posterior.integrated
    centre, covariance = posterior.approximation(optimum)
    points = np.random.default_rng(2).multivariate_normal(centre, covariance, 400)
    density = posterior.log_density(points)
    products = posterior.lagged_products(posterior.values(points))
    taps, _ = most_likely_regression(products, optimum.joint.band_terms)
    known = are_invertible(taps)
    assert not known.all()
    assert not np.isfinite(density[~known]).any()
    assert density.max() < posterior.log_density(centre[None])[0] + 6.0
    stable, unstable = centre, centre + np.log(6.0) * np.eye(centre.size)[0]  # of a gain
    assert list(np.isfinite(posterior.log_density(np.array([stable, unstable])))) == [True, False]
