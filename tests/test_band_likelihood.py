"""The likelihood of a band: against Whittle's, its gradients, and what it is worth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import NOMINAL, PILOTS, differences, predict_circular

from pilotid.datasets import SCENARIOS, scenario_named, simulate
from pilotid.datasets.bounds import View, gradient_of
from pilotid.datasets.experiments import experiment_of
from pilotid.datasets.population import POPULATIONS
from pilotid.datasets.scenarios import Scenario
from pilotid.estimate.method import identify
from pilotid.likelihood import band_likelihood
from pilotid.likelihood.band_likelihood import (
    OUTSIDE_WEIGHT,
    BandTerms,
    Weighting,
    closing_element,
    most_likely_regression,
    weighting_of,
)
from pilotid.likelihood.likelihood import Likelihood
from pilotid.likelihood.posterior import Posterior
from pilotid.likelihood.prediction import Prediction, predict
from pilotid.likelihood.remnant_models import (
    Autoregressive,
    BandPass,
    LowPass,
    NoiseModel,
    lagged_products,
)
from pilotid.methods import MLE
from pilotid.model.catalogue import MODELS
from pilotid.model.element import element_named
from pilotid.model.loops import pilot_on
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.recording.spectra import floors_of
from pilotid.support.numbers import recording_rng
from pilotid.support.remarks import codes_of
from pilotid.support.types import FloatArray

pytestmark = pytest.mark.numerical

#: A pilot whose motion delay direct prediction errors in a narrow band get wrong.
BIASED = replace(POPULATIONS["population-usual"], models=("multi",)).drawn(
    np.random.default_rng(911)
)
NOISES = (LowPass(2), BandPass(1), Autoregressive(6))


def recorded(name: str, seed: int = 1, noise: float = 0.0) -> tuple[Scenario, Recording]:
    """A scenario and a recording of it, with noise of the recorder on e and x."""
    rng = np.random.default_rng(seed)
    scenario = POPULATIONS[name].drawn(rng) if name in POPULATIONS else scenario_named(name)
    assert isinstance(scenario, Scenario)
    recording = simulate(scenario, rng)
    signals = {
        key: signal + noise * signal.std() * rng.standard_normal(signal.shape)
        for key, signal in (("e", recording.e), ("x", recording.x))
    }
    return scenario, replace(recording, **signals)


def banded(recording: Recording, scenario: Scenario, terms: tuple[float, ...]) -> Prediction:
    prediction = replace(predict(recording, scenario.model, 50.0), nuisance_poles=terms)
    weighting = weighting_of(recording, scenario.model, prediction.control, prediction.dt)
    assert weighting is not None
    return replace(prediction, weighting=weighting)


def near_truth(joint: Likelihood, scenario: Scenario) -> FloatArray:
    residual = joint.prediction.errors(scenario.values)
    remnant = joint.noise.guess(lagged_products(residual), joint.band)[0]
    return np.concatenate([1.07 * scenario.values, remnant])


@pytest.mark.parametrize("noise", NOISES, ids=lambda noise: noise.name)
@pytest.mark.parametrize("terms", [(), (0.0,)])
@pytest.mark.parametrize("runs", ["nominal", "nominal(runs=3)"])
def test_gradients_are_those_of_differences(
    noise: NoiseModel, terms: tuple[float, ...], runs: str
) -> None:
    scenario, recording = recorded(runs, noise=1e-3)
    prediction = banded(recording, scenario, terms)
    joint = Likelihood(prediction, noise)
    values = near_truth(joint, scenario)
    exact = joint.gram(values[None])[0]
    adjoint = Likelihood(prediction, noise, adjoint=True)
    found = adjoint.gram(values[None])[0, -1]
    np.testing.assert_allclose(found, exact[-1], rtol=1e-9, atol=1e-9 * exact[-1, -1])
    for each in (joint, adjoint, joint.coarse):
        gram = each.gram(values[None])[0]
        steps = 1e-5 * np.maximum(np.abs(values), 1e-3)
        slopes = differences(lambda v, own=each: own.gram(v[None])[0, -1, -1], values, steps)
        # The last column is J'r, half the negative slope.
        size = np.sqrt(np.diag(gram)[:-1] * gram[-1, -1])
        np.testing.assert_allclose(slopes / size, -2.0 * gram[:-1, -1] / size, atol=2e-6)


def test_differences_are_those_of_whittles_likelihood_of_the_closed_loop() -> None:
    """One whole period without edges, where the likelihood can be written down bin by bin."""
    scenario = replace(
        scenario_named("nominal"), run_in=0.0, element=element_named("4/s^2"), dt=0.06, runs=1
    )
    recording = simulate(scenario, np.random.default_rng(3))
    model, truth = scenario.model, scenario.values
    prediction = replace(predict_circular(recording, model), nuisance_poles=(0.0,))  # no mean
    omega = prediction.s.imag
    weighting = weighting_of(recording, model, prediction.control, prediction.dt)
    # Half the band counts, in steps, and the remnant's model nowhere else.
    share = np.where(weighting.omega < 24.0, 1.0, 0.0)
    prediction = replace(prediction, weighting=replace(weighting, share=share, control=0.0 * share))
    joint = Likelihood(prediction, LowPass(2))
    terms = prediction.band_terms
    weights = np.zeros(omega.size)
    weights[: terms.weights.size] = terms.weights
    outside = terms.whitened.sum() - terms.inside.sum()
    assert outside > 0.0
    signals = (recording.u, recording.e, recording.x)
    control, error, output = (np.fft.rfft(recording.window(each)[0])[1:] for each in signals)
    omega, weights = omega[1:], weights[1:]
    described = weights + OUTSIDE_WEIGHT * (1.0 - weights)
    element = scenario.element.response(omega)

    def whittle(values: FloatArray) -> float:
        """-log of the likelihood by its definition, at the variance that is most likely."""
        on_error, on_output = pilot_on(model, omega, values[:7])
        lags = np.exp(-1j * np.outer(omega * recording.dt, np.arange(21)))
        taps, _ = joint.noise.taps(values[None, joint.pilot_count :], joint.band)
        shape = 1.0 / np.abs(lags @ taps[0]) ** 2
        left = np.abs(control - on_error * error + on_output * output) ** 2 / recording.samples
        variance = float(weights @ (left / shape)) / float(described.sum())
        spectrum = variance * shape
        loop = np.abs(1.0 + element * (on_error + on_output)) ** 2
        return float(weights @ (left / spectrum - np.log(loop)) + described @ np.log(spectrum))

    products = lagged_products(prediction.errors(truth))
    first = np.concatenate([truth, LowPass(2).guess(products, joint.band)[0]])
    sets = [first]
    for index in range(first.size):
        for factor in (0.8, 1.25):
            sets.append(first.copy())
            sets[-1][index] *= factor
    criteria = 0.5 * joint.residuals * np.log(joint.gram(np.array(sets))[:, -1, -1])
    expected = np.array([whittle(values) for values in sets])
    # Groups of bins stand for bins in the log-determinant.
    assert np.ptp(expected) > 500.0
    np.testing.assert_allclose(criteria - criteria[0], expected - expected[0], atol=0.5)


def test_what_the_recorder_adds_does_not_count() -> None:
    _, clean = recorded("nominal")
    _, noisy = recorded("nominal", noise=1e-3)
    at = np.searchsorted(floors_of(clean).omega, [5.0, 15.0, 32.0])
    np.testing.assert_allclose(floors_of(clean).share(("e", "x"))[at], 1.0, atol=0.05)
    share = floors_of(noisy).share(("x",))[at]
    assert share[0] > 0.98
    assert share[2] < 0.1
    # The floor is that of the noise: white, of this variance, from rest to half the rate.
    expected = (1e-3 * clean.x.std()) ** 2 * clean.dt / np.pi
    assert floors_of(noisy).floor["x"] == pytest.approx(expected, rel=0.1)


def test_the_element_that_closes_the_loop_is_what_signals_show() -> None:
    _, recording = recorded("nominal")
    wrong = replace(recording, controlled_element="9/s^2")
    unnamed = replace(recording, controlled_element="")
    for each in (recording, wrong, unnamed):
        element = closing_element(each)
        np.testing.assert_allclose(
            element.response(np.array([3.0])),
            element_named("4/s^2").response(np.array([3.0])),
            rtol=0.02,
        )


def test_a_recorder_that_hides_the_pilot_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario, recording = recorded("single")
    sound = identify(MLE(), recording, scenario.model, np.random.default_rng(1))
    assert "motionless" not in codes_of(sound.remarks)
    assert sound.band.half == sound.band.highest
    own = floors_of(recording)
    flat = {name: np.full(own.omega.size, floor) for name, floor in own.floor.items()}
    monkeypatch.setattr(band_likelihood, "floors_of", lambda recording: replace(own, power=flat))
    hidden = identify(MLE(), recording, scenario.model, np.random.default_rng(1))
    assert hidden.outcome.usable
    assert "motionless" in codes_of(hidden.remarks)


def test_without_an_element_prediction_errors_are_direct() -> None:
    scenario, recording = recorded("nominal")
    blind = replace(recording, x=np.roll(recording.x, 700, axis=1), controlled_element="")
    assert closing_element(blind) is None
    prediction = predict(blind, scenario.model, 50.0)
    assert weighting_of(blind, scenario.model, prediction.control, prediction.dt) is None


@pytest.mark.parametrize("noise", NOISES, ids=lambda noise: noise.name)
def test_samplers_have_the_same_likelihood(noise: NoiseModel) -> None:
    scenario, recording = recorded("nominal(runs=2)", noise=1e-3)
    prediction = banded(recording, scenario, (0.0,))
    joint = Likelihood(prediction, noise)
    likelihood = Posterior(joint)
    centre = near_truth(joint, scenario)
    sets = centre * np.exp(0.01 * np.random.default_rng(1).standard_normal((12, centre.size)))
    found = likelihood.log_likelihood(sets[:, : likelihood.count])
    if noise.regressive:  # integrated out about the most likely coefficients, which have no slope
        given = likelihood.lagged_products(sets[:, :7]), prediction.band_terms
        sets[:, 7:] = most_likely_regression(*given)[0][:, 1:]
    products = joint.gram(sets)
    expected = -0.5 * joint.residuals * np.log(products[:, -1, -1])
    if noise.regressive:
        size = np.sqrt(np.diagonal(products, axis1=1, axis2=2))
        slopes = products[:, 7:-1, -1] / (size[:, 7:-1] * size[:, -1:])
        np.testing.assert_allclose(slopes, 0.0, atol=1e-5)
        hessian = products[:, 7:-1, 7:-1] / products[:, -1:, -1:] * joint.residuals
        expected -= 0.5 * np.linalg.slogdet(hessian)[1]
    np.testing.assert_allclose(found - found[0], expected - expected[0], atol=2e-3)


def test_a_part_of_the_frequencies_is_biased_without_the_loop() -> None:
    """The expected score at the truth, from exact spectra: nil over all frequencies alone."""
    scenario = BIASED
    delay = scenario.model.keys.index("tdvest")

    def shift(band: float | None) -> float:
        """To first order, in standard errors: of direct prediction errors, for tdvest."""
        view = View(experiment_of(scenario), band)
        rows, forced = (
            gradient_of(scenario.model, inputs, scenario.values)
            for inputs in (view.remnant, view.lines)
        )
        forced = forced / np.sqrt(view.at_lines.density)
        information = view.samples * np.real(rows * view.weights @ rows.conj().T)
        information += 0.5 * scenario.duration / scenario.dt * (forced @ forced.conj().T).real
        # The prediction error is a unit of remnant; what the loop's term takes off is this score.
        score = view.samples * (rows.real @ view.weights)
        covariance = np.linalg.inv(information)
        return float((covariance @ score)[delay] / np.sqrt(covariance[delay, delay]))

    assert shift(25.0) == pytest.approx(-1.53, abs=0.01)
    assert abs(shift(100.0)) < 0.15
    assert abs(shift(None)) < 0.1


@pytest.mark.long
def test_a_narrow_band_is_unbiased_with_the_loop() -> None:
    scenario = BIASED
    index = scenario.model.keys.index("tdvest")
    errors = []
    for seed in range(30):
        recording = simulate(scenario, recording_rng(seed, "narrow", 0))
        fits = [
            MLE(band=25.0, wide=(), loop=loop).fit(
                recording, scenario.model, recording_rng(seed, "starts", 0)
            )
            for loop in (True, False)
        ]
        errors.append([(e.values - scenario.values)[index] / e.std_error[index] for e in fits])
    closed, direct = np.array(errors).T
    # The mean of 30 standardised errors scatters by .18; theory says -1.5 for the difference.
    assert abs(closed.mean()) < 0.5
    assert (direct - closed).mean() == pytest.approx(-1.5, abs=0.6)


@pytest.mark.long
def test_noise_of_the_recorder_moves_no_estimate_by_much() -> None:
    errors = []  # with one model of the remnant: at a seed the choice between two is a toss-up
    for seed in range(6):
        scenario, noisy = recorded("nominal", seed, noise=1e-3)
        _, clean = recorded("nominal", seed)
        fits = [
            MLE(noise=LowPass(2)).fit(each, scenario.model, recording_rng(seed, "starts", 0))
            for each in (clean, noisy)
        ]
        errors.append((fits[1].values - fits[0].values) / fits[0].std_error)
    # Paired: what the noise does, not the remnant, which direct prediction errors get wrong by 60.
    assert np.abs(errors).max() < 1.0


@pytest.mark.parametrize("decimals", [15, 3])
def test_what_lies_between_the_lines_of_a_target_takes_nothing_from_the_band(decimals: int) -> None:
    recording = simulate(PILOTS["look-ahead"], np.random.default_rng(1))
    recording = replace(recording, ft=np.round(recording.ft, decimals))
    assert (floors_of(recording).share(("ft",)) == 1.0).all()
    estimate = identify(MLE(), recording, MODELS["look-ahead"], np.random.default_rng(1))
    assert estimate.band.half > 15.0


@pytest.mark.parametrize(
    ("element", "unstable"), [("4/s^2", 0), ("4/(s^2-0.001s+0.0025)", 0), ("4/(s(s-0.5))", 1)]
)
def test_unstable_poles_slower_than_the_window_tells_are_integrators(
    element: str, unstable: int
) -> None:
    omega = np.linspace(0.05, 40.0, 500)
    every = np.ones_like(omega)
    weighting = Weighting(omega, every, every, element_named(element), hidden=False)
    assert BandTerms(weighting, 0.02, 4096, 1, (0.0,)).unstable == unstable


#: The problem that large searches solve: exact sum of squares and slopes, a Hessian nearby.
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
    remnant = np.tile(noise.guess(lagged_products(residual), prediction.window.band)[0], (2, 1))
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
    length = prediction.window.length - 1
    signals = [
        np.fft.irfft(each, n=prediction.window.length)[:, :length]
        for each in (*prediction.spectra, prediction.control_spectrum)
    ]
    *inputs, control = (np.fft.rfft(each) for each in signals)
    odd = replace(
        prediction,
        s=2j * np.pi * np.fft.rfftfreq(length, prediction.dt),
        spectra=tuple(inputs),
        control_spectrum=control,
        window=replace(prediction.window, length=length),
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
    # An end of an interval is sought to .04 of its distance, about two errors, by either.
    np.testing.assert_allclose(
        (found.intervals - expected.intervals) / errors[:, None], 0.0, atol=0.16
    )
    np.testing.assert_allclose(found.covariance, expected.covariance, rtol=1e-3)
