"""Fourier coefficients: exact without remnant, leakage removed, objections with reasons."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from helpers import (
    NOMINAL,
    SINGLE_LOOP,
    monte_carlo,
    part_of,
    population_fits,
    population_scores,
    without_remnant,
)
from scipy.optimize import approx_fprime

from pilotid import load_recording
from pilotid.datasets import scenario_named, simulate
from pilotid.estimate.estimate import Outcome
from pilotid.estimate.method import Method, identify
from pilotid.methods.arx import ARX
from pilotid.methods.fourier import Fourier
from pilotid.methods.sindy import SINDy
from pilotid.model.catalogue import MODELS, MULTI, SINGLE
from pilotid.model.channel import Channel
from pilotid.model.model import PilotModel
from pilotid.recording.recording import ABSENT, Recording
from pilotid.recording.spectra import NotMultisineError, forcing_lines, hidden_lines
from pilotid.spectral.coefficients import coefficients_of
from pilotid.spectral.equations import Equations

pytestmark = pytest.mark.numerical


@cache
def noisy(runs: int = 1, name: str = "nominal", seed: int = 4) -> Recording:
    return simulate(replace(scenario_named(name), runs=runs), np.random.default_rng(seed))


@pytest.mark.parametrize("name", ["nominal", "single", "target-only"])
@pytest.mark.parametrize("trend", [None, 1])
def test_noise_free_recordings_give_the_truth(name: str, trend: int | None) -> None:
    scenario = without_remnant(scenario_named(name))
    if name == "target-only":  # one channel, from the target's lines
        scenario = replace(scenario, model=SINGLE, truth=SINGLE_LOOP.truth)
    recording = simulate(scenario, np.random.default_rng(1))
    estimate = identify(Fourier(trend=trend), recording, scenario.model, np.random.default_rng(1))
    assert estimate.outcome is Outcome.CONVERGED
    np.testing.assert_allclose(estimate.values, scenario.values, rtol=1e-5)


def test_first_step_matches_the_truth_within_the_reported_error_of_interpolation() -> None:
    scenario = without_remnant(NOMINAL)
    recording = simulate(scenario, np.random.default_rng(1))
    estimate = identify(Fourier(), recording, MULTI, np.random.default_rng(1))
    found = estimate.frequency_response
    error = np.abs(found.value - MULTI.response(found.omega, scenario.values))
    assert np.all(error <= 1.001 * found.systematic + 1e-9)
    share = found.systematic / np.abs(found.value)
    assert 0.005 < np.median(share) < 0.02
    assert share.max() < 0.1
    assert "8.1 % at most" in found.note
    first = Fourier().first_step(recording, MULTI)
    np.testing.assert_allclose(first.value, found.value, rtol=1e-3)
    # Without a remnant the standard errors are those of the interpolation.
    assert np.all(error < 2.0 * first.std)
    assert np.all(first.std < 0.2 * np.abs(first.value))


@pytest.mark.parametrize("removed", [0.0, 0.5, 1.0])
def test_rows_are_the_derivatives_of_the_residual(removed: float) -> None:
    recording = noisy(runs=2)
    coefficients = coefficients_of(recording, MULTI, 16, 1)
    power = np.geomspace(1e-3, 1e-6, coefficients.lines)
    problem = Equations(coefficients, MULTI, power, removed, NOMINAL.values)
    point = 1.1 * NOMINAL.values
    rows = problem.rows(point[None])[0]
    slopes = approx_fprime(point, lambda v: problem.rows(v[None])[0, -1], 1e-7)
    np.testing.assert_allclose(rows[:-1], -slopes.T, rtol=1e-4, atol=1e-3)


def test_the_residual_is_that_of_the_lines_less_the_trend_beside_them() -> None:
    recording = noisy()
    coefficients = coefficients_of(recording, MULTI, 10, 1)
    power = np.full(coefficients.lines, 2.0)  # so that real and imaginary parts stay as they are
    problem = Equations(coefficients, MULTI, power)
    found = problem.rows(NOMINAL.values[None])[0, -1].view(complex)
    k = np.arange(300)
    omega = 2.0 * np.pi * k / recording.duration
    response = MULTI.response(omega, NOMINAL.values)
    e, u, x = (
        np.fft.rfft(recording.window(s))[0, :300] / recording.samples
        for s in (recording.e, recording.u, recording.x)
    )
    residual = u - response[0] * e + response[1] * x
    lines = forcing_lines(recording)
    forced = np.concatenate([lines["ft"], lines["fd"]])
    bins = np.setdiff1d(k[1:], forced)
    for number in (0, 5, 23):  # target lines, then disturbance lines
        line = forced[number]
        beside = bins[np.argsort(np.abs(bins - line), kind="stable")[:10]]
        trend = np.polynomial.Polynomial.fit(beside - line, residual[beside], 1)
        expected = residual[line] - trend(0.0)
        turned = expected * coefficients.weights[0, number]
        assert found[number] == pytest.approx(turned, rel=1e-6)


def test_the_residual_in_the_loop_is_the_control_less_its_forced_part() -> None:
    # A faint remnant shows the way through the loop, and leaves next to no transients.
    remnant = replace(SINGLE_LOOP.remnant, level=1e-4)
    scenario = replace(SINGLE_LOOP, remnant=remnant)
    recording = simulate(scenario, np.random.default_rng(2))
    coefficients = coefficients_of(recording, SINGLE, 16, None)
    n, point = coefficients.lines, 1.2 * scenario.values
    problem = Equations(coefficients, SINGLE, np.full(n, 2.0), 1.0, point)
    left = problem.rows(point[None])[0, -1].view(complex)
    omega = coefficients.omega[:n]
    pilot, element = SINGLE.response(omega, point)[0], scenario.element.response(omega)
    lines = np.round(omega * recording.duration / (2.0 * np.pi)).astype(int)
    ft, fd, u = (
        np.fft.rfft(recording.window(s))[0, lines] / recording.samples
        for s in (recording.ft, recording.fd, recording.u)
    )
    forced = pilot * (ft - element * fd) / (1.0 + pilot * element)
    # The weights have the size of the sensitivity.
    expected = (u - forced) * coefficients.weights[0] * np.abs(1.0 + pilot * element)
    np.testing.assert_allclose(left, expected, rtol=0.03, atol=0.01 * np.abs(expected).max())


@pytest.mark.long
def test_the_remnant_in_the_inputs_no_longer_biases_the_gain() -> None:
    # On `single` it is stronger than the forcing functions at low frequency.
    errors = {}
    for removed in (0.0, 0.5):
        fits = monte_carlo(Fourier(removed=removed), SINGLE_LOOP, 40)
        z = [(e["Kvis"].value - SINGLE_LOOP.truth[0]) / e["Kvis"].std_error for e in fits]
        assert all(e.outcome.usable for e in fits)
        errors[removed] = np.mean(z)
    assert errors[0.0] < -0.5
    assert errors[0.5] > errors[0.0] + 0.25


@pytest.mark.long
@pytest.mark.parametrize(("method", "least"), [(Fourier(), 18), (ARX(), 10), (SINDy(), 8)])
def test_holds_on_pilots_drawn_at_random_or_says_that_it_does_not(
    method: Method, least: int
) -> None:
    fits = population_fits(method, "population-usual", 20)
    covered, errors = population_scores(fits)
    assert len(errors) >= least * 5
    assert covered > 0.85
    assert np.max(np.abs(errors)) < 8.0
    known = {Outcome.CONVERGED, Outcome.AT_BOUND, Outcome.CONTRADICTED, Outcome.NOT_APPLICABLE}
    assert sum(e.outcome not in known for _, e in fits) <= 3


@pytest.mark.parametrize(("model", "grades"), [(MULTI, []), (SINGLE, ["doubt"])])
def test_a_model_that_misses_the_lines_is_said_to(model: PilotModel, grades: list[str]) -> None:
    estimate = identify(Fourier(), noisy(3), model, np.random.default_rng(1))
    assert [r.grade for r in estimate.remarks if r.code == "misspecified"] == grades


def test_power_of_the_remnant_is_that_of_its_spectrum() -> None:
    # Above 8 rad/s leakage would exceed it many times.
    from pilotid.datasets.experiments import experiment_of

    expected = None
    ratios = []
    for seed in range(20):
        recording = noisy(seed=seed)
        coefficients = coefficients_of(recording, MULTI, 16, 1)
        exact = coefficients.residuals(MULTI.response(coefficients.omega, NOMINAL.values))
        if expected is None:
            omega = coefficients.omega[: coefficients.lines]
            density = experiment_of(NOMINAL).circulation(omega)[2]
            expected = density / (recording.samples)
        ratios.append(coefficients.power(exact) / expected)
    # What makes up for weights that are estimated, from 14 degrees of freedom.
    mean = np.mean(ratios, axis=0) / (14.0 / 12.0)
    assert np.all((mean > 0.6) & (mean < 1.9)), mean
    assert abs(np.mean(mean) - 1.0) < 0.25


def test_several_runs_lower_the_power_and_tell_it_by_their_differences() -> None:
    one, five = noisy(seed=7), noisy(runs=5, seed=7)
    powers = []
    for recording in (one, five):
        coefficients = coefficients_of(recording, MULTI, 16, 1)
        exact = coefficients.residuals(MULTI.response(coefficients.omega, NOMINAL.values))
        powers.append(coefficients.power(exact))
    assert 3.0 < np.exp(np.mean(np.log(powers[0] / powers[1]))) < 8.0
    # A pilot who changes from run to run is less certain than the bins between lines say.
    gains = np.linspace(0.7, 1.3, 5)[:, None]
    unsteady = replace(five, u=gains * five.u)
    coefficients = coefficients_of(unsteady, MULTI, 16, 1)
    exact = coefficients.residuals(MULTI.response(coefficients.omega, NOMINAL.values))
    assert np.median(coefficients.power(exact) / powers[1]) > 3.0


def test_lines_are_found_where_they_are_not_given() -> None:
    recording = replace(noisy(), lines={})
    lines = forcing_lines(recording)
    assert tuple(lines["ft"]) == NOMINAL.target.lines
    assert tuple(lines["fd"]) == NOMINAL.disturbance.lines
    still = replace(recording, ft=np.full_like(recording.u, 3.0))
    assert list(forcing_lines(still)) == ["fd"]


def test_a_forcing_function_without_whole_periods_is_no_multisine() -> None:
    recording = replace(noisy(), lines={})
    with pytest.raises(NotMultisineError, match="ft is no multisine with whole periods"):
        forcing_lines(part_of(recording, samples=slice(-300)))


@pytest.mark.parametrize("missed", [-3, -1, 0, 2])
def test_a_window_that_misses_its_periods_by_samples_has_no_more_lines(missed: int) -> None:
    lines, samples = np.array([3, 5, 8, 13, 22, 37, 61, 87, 103]), 8192
    time = np.arange(samples + missed) / samples
    sines = np.sin(2.0 * np.pi * np.outer(lines, time) + lines[:, None])
    target = ((1.0 + lines / 10.0) ** -1.0) @ sines
    u = np.random.default_rng(1).standard_normal(time.size)
    recording = Recording(dt=0.01, e=target - u, u=u, x=u, ft=target)
    assert forcing_lines(recording)["ft"].tolist() == lines.tolist()


def test_lines_that_the_forcing_function_does_not_have_are_refused() -> None:
    recording = noisy()
    off = {name: tuple(1 + np.array(lines)) for name, lines in recording.lines.items()}
    with pytest.raises(NotMultisineError):
        forcing_lines(replace(recording, lines=off))
    one = {name: lines[:-1] for name, lines in recording.lines.items()}
    assert forcing_lines(replace(recording, lines=one))["ft"].tolist() == list(one["ft"])


def two_on_error() -> PilotModel:
    visual = SINGLE.channels[0]
    return PilotModel("both", (visual, replace(visual, name="again")))


def no_forcing(recording: Recording) -> Recording:
    return replace(recording, ft=None, fd=None, lines={}, origin={"x": ABSENT})


def test_lines_of_forcing_functions_that_were_not_recorded() -> None:
    whole = replace(noisy(), lines={})
    without_target = replace(whole, ft=None)
    assert forcing_lines(without_target)["ft"].tolist() == forcing_lines(whole)["ft"].tolist()
    noise = 0.01 * np.random.default_rng(1).standard_normal(whole.e.shape)
    assert list(forcing_lines(replace(without_target, e=whole.e + noise))) == ["fd"]
    alone, lines = replace(whole, fd=None), {*forcing_lines(whole)["fd"].tolist()}
    found = lines & {*hidden_lines(alone).tolist()}
    assert len(found) > 0.4 * len(lines)  # the others do not stand out of the remnant
    bins = coefficients_of(alone, SINGLE, 16, 1).omega * whole.duration / (2.0 * np.pi)
    assert not found & {*bins.round().astype(int).tolist()}


def test_images_of_lines_in_a_target_that_was_held_are_no_lines() -> None:
    whole = replace(noisy(), lines={})
    held = np.repeat(whole.ft[:, ::4], 4, axis=1)[:, : whole.ft.shape[1]]
    lines = forcing_lines(replace(whole, ft=held))["ft"]
    assert lines.tolist() == forcing_lines(whole)["ft"].tolist()


@pytest.mark.parametrize(
    ("recording", "model", "reason"),
    [
        (simulate(scenario_named("target-step"), np.random.default_rng(1)), MULTI, "no multisine"),
        (no_forcing(noisy()), SINGLE, "neither ft or fd"),
        (simulate(scenario_named("target-only"), np.random.default_rng(1)), MULTI, "both a target"),
        (noisy(), two_on_error(), "two channels on one input"),
        (
            replace(noisy(), fd=noisy().ft, lines={"ft": (6, 9), "fd": (6, 9)}),
            MULTI,
            "common lines",
        ),
        (replace(noisy(), lines={"ft": (6,)}, fd=None), MODELS["gain"], "single line"),
        (replace(noisy(), lines={"ft": (6, 9)}, fd=None), SINGLE, "too few"),
        (replace(noisy(), lines={"ft": (6, 2048)}), SINGLE, "half the number of samples"),
    ],
)
def test_objections_have_reasons(recording: Recording, model: PilotModel, reason: str) -> None:
    assert reason in str(Fourier().objection(recording, model))
    estimate = identify(Fourier(), recording, model, np.random.default_rng(1))
    assert estimate.outcome is Outcome.NOT_APPLICABLE


def test_a_channel_on_the_output_alone_is_identified() -> None:
    # What a pilot without a visual channel would be: u = -Km s x.
    motion = Channel("motion", "output", -1, MODELS["rate"].channels[1].factors)
    model = PilotModel("motion", (motion,))
    truth = {"Km": 0.5, "tdm": 0.15, "fnm": 11.0, "dnm": 0.4}
    recording = noisy()
    k = np.arange(recording.samples // 2 + 1)
    response = model.response(2.0 * np.pi * k / recording.duration, model.vector(truth))[0]
    window = recording.window(recording.x)
    u = np.fft.irfft(-response * np.fft.rfft(window), n=recording.samples)
    periodic = replace(
        recording,
        run_in=0,
        u=u,
        **{n: recording.window(getattr(recording, n)) for n in ("e", "x", "ft", "fd")},
    )
    estimate = identify(Fourier(), periodic, model, np.random.default_rng(1))
    np.testing.assert_allclose(estimate.values, model.vector(truth), rtol=1e-4)


@pytest.mark.parametrize("condition", ["C2", "C3"])
@pytest.mark.parametrize("subject", [1, 3, 4])
def test_without_motion_the_response_is_the_laboratory_s_own(
    measured: Path, subject: int, condition: str
) -> None:
    from scipy.io import loadmat

    path = measured / "yaw" / f"ae2224I_measurement_data_subj{subject}_{condition}.mat"
    theirs = loadmat(path)
    ours = Fourier(trend=None).first_step(load_recording(path), SINGLE)
    np.testing.assert_allclose(ours.omega, theirs["w_FC"].ravel(), rtol=1e-6)
    np.testing.assert_allclose(ours.value[0], theirs["Hpe_FC"].ravel(), rtol=1e-3)
