"""The controlled element identified from the signals, and held against the one given."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from helpers import NOMINAL, SINGLE_LOOP, recording_of

from pilotid.checks import element_fit
from pilotid.checks.element_fit import chosen_element, differ, identified_element
from pilotid.checks.element_forms import (
    FORMS,
    OMEGA,
    Form,
    FormFit,
    fits_of,
    fitted_form,
    simplest,
    spectra_of,
)
from pilotid.datasets import POPULATIONS, simulate
from pilotid.model.element import ControlledElement, element_named
from pilotid.recording.files import load_recording
from pilotid.recording.recording import Recording
from pilotid.support.types import FloatArray

pytestmark = pytest.mark.numerical

WIDE = np.geomspace(0.3, 17.0, 60)  # rad/s, the band of the lines
DT = 0.01


def driven(element: ControlledElement, seconds: float, seed: int = 0) -> tuple[FloatArray, ...]:
    """Noise u through an element, and its exact output x: the middle of a long period."""
    count = 40_000
    omega = 2.0 * np.pi * np.fft.rfftfreq(count, DT)
    s = 1j * np.maximum(omega, 1e-3)
    noise = np.random.default_rng(seed).standard_normal(count)
    control = np.fft.rfft(noise) / ((1.0 + s / 2.0) ** 2 * (1.0 + s / 8.0))
    control[omega < 0.15] = 0.0
    part = slice(5000, 5000 + round(seconds / DT))
    return tuple(
        np.fft.irfft(spectrum, count)[None, part]
        for spectrum in (control, control * element.response(np.maximum(omega, 1e-3)))
    )


def recorded(element: ControlledElement, seconds: float = 60.0, noise: float = 0.0) -> Recording:
    """A recording of `driven`, x with white noise of a share of its size."""
    u, x = driven(element, seconds)
    x = x + noise * x.std() * np.random.default_rng(1).standard_normal(x.shape)
    return Recording(dt=DT, e=-x, u=u, x=x)


def deviation(found: ControlledElement | None, true: ControlledElement) -> float:
    assert found is not None
    return float(np.max(np.abs(found.response(WIDE) / true.response(WIDE) - 1.0)))


# ------------------------------------------------------------------ known truths


@pytest.mark.long
@pytest.mark.parametrize("name", [n for n in POPULATIONS if n != "population-single"])
def test_elements_of_populations_are_found(name: str) -> None:
    for draw in range(5):
        scenario = POPULATIONS[name].drawn(np.random.default_rng([draw, 5]))
        recording = simulate(scenario, np.random.default_rng([draw, 6]))
        found = identified_element(recording)
        assert not found.why
        assert deviation(found.element, scenario.element) < 0.01, scenario.element.name


@pytest.mark.parametrize(
    "text",
    [
        "2",
        "1/s",
        "2/(s-0.5)",
        "5/(s+3)",
        "67.6exp(-0.01s)/(s(s+5.4))",
        "64/(s^2+11s+64)",
        "5/(s^2+0.2s+9)",
        "4/(s(1+s/29.8)^2)",
        "4exp(-0.05s)/(s(1+s/30)^2)",
        "10.62(s+0.99)/(s(s^2+2.58s+7.61))",
        "30/((s+30)(1+s/10)^2)",
        "3(s+2)/s^2",
        "1exp(-0.3s)/s",
    ],
)
@pytest.mark.parametrize("seconds", [10.0, 60.0])
def test_any_element_of_low_order_is_found_from_signals_without_a_period(
    text: str, seconds: float
) -> None:
    true = element_named(text)
    found = identified_element(recorded(true, seconds))
    assert not found.why
    assert deviation(found.element, true) < 0.01
    assert found.element is not None
    assert found.element.delay == pytest.approx(true.delay, abs=5e-4)
    assert len(found.element.denominator) == len(true.denominator)
    assert element_named(found.element.name).delay == found.element.delay
    read = element_named(found.element.name)
    np.testing.assert_allclose(read.response(WIDE), found.element.response(WIDE), rtol=1e-9)


@pytest.mark.parametrize("text", ["2", "1/s", "64/(s^2+11s+64)", "15/(s(1+s/5)^2)"])
def test_noise_on_the_output_costs_accuracy_not_the_form(text: str) -> None:
    true = element_named(text)
    recording = recorded(true, 80.0, noise=0.02)
    found, fit = identified_element(recording), simplest(fits_of(recording))
    assert found.element is not None
    assert len(found.element.denominator) == len(true.denominator)
    error = np.abs(found.element.response(OMEGA) / true.response(OMEGA) - 1.0)
    claimed = fit.error_at(OMEGA)
    assert error.max() < 4.0 * claimed.max() + 1e-3
    assert error.max() < 0.1


@pytest.mark.parametrize("text", ["10/s", "4/s^2", "8/(s(s+2))"])
def test_noise_of_the_control_makes_no_element_that_people_cannot_hold(text: str) -> None:
    true = element_named(text)
    for seed, (share, fastest) in product(range(12), [(0.05, np.inf), (0.1, 1.0)]):
        u, x = driven(true, 30.0, seed)
        noise = np.random.default_rng(seed).standard_normal(u.shape)
        found = identified_element(Recording(dt=DT, e=-x, u=u + share * u.std() * noise, x=x))
        assert found.element is not None
        unstable = [p.real for p in np.roots(found.element.denominator) if 0.0 < p.real < fastest]
        assert not unstable, found.element.name


@pytest.mark.parametrize("seed", range(1, 4))
def test_fast_remnant_that_sampling_folds_down_hides_no_element(seed: int) -> None:
    remnant = replace(SINGLE_LOOP.remnant, order=1, frequency=8.0)
    scenario = replace(SINGLE_LOOP, remnant=remnant, duration=163.84, dt=0.01)
    fine = recording_of(scenario, seed)
    every_fourth = {name: signal[:, ::4] for name, signal in fine.arrays.items()}
    found = identified_element(replace(fine, dt=0.04, run_in=fine.run_in // 4, **every_fourth))
    assert not found.why
    assert found.element is not None
    assert len(found.element.denominator) == 3
    ratio = found.element.response(OMEGA) / scenario.element.response(OMEGA)
    assert np.sqrt(np.mean(np.abs(ratio - 1.0) ** 2)) < 0.05


def test_claimed_errors_hold_where_noise_is_what_limits() -> None:
    # White noise of a tenth of x at the output of a lag: two numbers and a delay.
    true = element_named("5/(s+3)")
    form = Form(0, 1)
    values, errors = [], []
    u, x = driven(true, 60.0)
    for seed in range(60):
        noise = 0.3 * x.std() * np.random.default_rng(seed).standard_normal(x.shape)
        fit = fitted_form(spectra_of(Recording(dt=DT, e=-x, u=u, x=x + noise)), form)
        values.append(fit.values)
        errors.append(np.linalg.norm(fit.steps, axis=0))
    scatter, claimed = np.std(values, axis=0, ddof=1), np.mean(errors, axis=0)
    # The scatter is known to a tenth; the claim includes what counts as exact.
    assert np.all(claimed > 0.75 * scatter), claimed / scatter
    assert np.all(claimed < 1.5 * scatter), claimed / scatter
    assert np.all(np.abs(np.mean(values, axis=0) - [5.0, 3.0, 0.0]) < 0.5 * claimed)


@pytest.mark.parametrize(
    ("runs", "offset", "most"),
    [(2, 0.0, 1e-9), (20, 0.0, 1e-9), (1, 5.0, 0.01)],  # 4/s^2, as 4 is short
)
def test_many_runs_count_as_much_as_they_tell_and_an_offset_of_u_for_nothing(
    runs: int, offset: float, most: float
) -> None:
    recording = recording_of(replace(SINGLE_LOOP, runs=runs))
    found = identified_element(replace(recording, u=recording.u + offset))
    assert not found.why
    assert deviation(found.element, SINGLE_LOOP.element) < most


# ------------------------------------------------------------------ what it says


@pytest.mark.long
def test_missing_disturbance_wrong_sign_and_wrong_signal_are_said() -> None:
    recording = recording_of(NOMINAL)
    flipped = replace(recording, u=-recording.u, fd=-np.asarray(recording.fd))
    for wrong in (flipped, replace(recording, fd=None), replace(recording, x=recording.ft)):
        found = identified_element(wrong)
        assert found.left > 0.2
        missing = "most often a" if wrong.fd is None else "perhaps another"
        assert f"{missing} disturbance was not recorded, or the element changes" in found.why
        assert chosen_element(replace(wrong, controlled_element="")).element is None
    still = identified_element(replace(recording, x=np.zeros_like(recording.x)))
    assert still.element is None
    assert "does not move" in still.why


@pytest.mark.parametrize(("control", "output"), [(1e-45, 1e45), (1e45, 1e-45), (1e90, 1e90)])
def test_no_unit_is_too_large_or_too_small(control: float, output: float) -> None:
    true = element_named("64/(s^2+11s+64)")
    u, x = driven(true, 30.0)
    recording = Recording(dt=DT, e=-x * output, u=u * control, x=x * output)
    found = identified_element(recording)
    assert not found.why
    assert found.element is not None
    ratio = found.element.response(WIDE) / true.response(WIDE) / (output / control)
    np.testing.assert_allclose(np.abs(ratio - 1.0), 0.0, atol=0.01)
    assert len(found.element.name) < 60
    np.testing.assert_allclose(
        element_named(found.element.name).response(WIDE), found.element.response(WIDE), rtol=1e-9
    )


def test_numbers_are_rounded_to_their_errors() -> None:
    values = np.array([67.8734, 5.4291, -0.004])
    covariance = np.array([[0.01, 0.0009, 0.0], [0.0009, 0.0001, 0.0], [0.0, 0.0, 1e-8]])
    steps = np.linalg.cholesky(covariance).T
    fit = FormFit(Form(1, 1), values, steps, 0.0, 0.0)
    # With the other held, K is known to .044 and a to .0044; the delay is an offset of channels.
    assert fit.rounded() == element_named("67.9/(s^2+5.43s)")
    rough = FormFit(Form(0), np.array([2973.0, 0.0]), np.diag([86.0, 1e-4]), *fit[3:])
    assert rough.rounded() == element_named("3000")


@pytest.mark.parametrize("form", FORMS, ids=str)
def test_a_form_is_the_element_of_its_name_and_tells_its_error(form: Form) -> None:
    values = np.random.default_rng(3).uniform(1.0, 4.0, form.size).round(4)
    known = FormFit(form, values, 1e-30 * np.eye(form.size), 0.0, 0.0)
    element = known.rounded()
    assert element.delay == values[-1]
    np.testing.assert_allclose(known.element.response(WIDE), element.response(WIDE), rtol=1e-12)
    # A gain alone that is uncertain makes the response as uncertain.
    gain = np.where(np.arange(form.size) <= form.zeros, values, 0.0)
    fit = known._replace(steps=0.01 * gain[None])
    np.testing.assert_allclose(fit.error_at(OMEGA), 0.01, rtol=1e-5)
    # A delay turns by omega times its error.
    fit = fit._replace(steps=np.array([0.01 * gain, 0.02 * (np.arange(form.size) > form.size - 2)]))
    expected = np.hypot(0.01, 0.02 * OMEGA)
    np.testing.assert_allclose(fit.error_at(OMEGA), expected, rtol=1e-2)


@pytest.mark.parametrize(
    ("form", "values", "name"),
    [
        (Form(2), (0.00012, 0.05), "0.00012exp(-0.05s)/s^2"),
        (Form(0, 2), (64.0, 11.0, -64.0, 0.0), "64/(s^2+11s-64)"),
        (Form(1, 1, zeros=1), (-3e-12, 6e-12, 5.4, 0.0), "(-3e-12s+6e-12)/(s^2+5.4s)"),
        (Form(0, 1, zeros=1), (1.0, 2.0, 1.0, 0.1), "(s+2)exp(-0.1s)/(s+1)"),
    ],
)
def test_the_name_of_a_form_is_short(form: Form, values: tuple[float, ...], name: str) -> None:
    fit = FormFit(form, np.array(values), 1e-30 * np.eye(form.size), 0.0, 0.0)
    assert fit.rounded().name == name


# ------------------------------------------------------------------ against the one given


def test_elements_that_differ_are_said_to() -> None:
    assert not differ(element_named("15/s^2"), element_named("15.3/s^2"))
    late = ControlledElement((15.0,), (1.0, 0.0, 0.0), delay=0.01, name="late")
    assert not differ(element_named("15/s^2"), late)  # a sample
    assert differ(element_named("4/s^2"), element_named("15/s^2"))


def test_the_element_is_the_user_s_else_the_file_s_else_the_signals() -> None:
    recording = recording_of(SINGLE_LOOP)
    assert recording.controlled_element == "4/s^2"
    unnamed = replace(recording, controlled_element="")
    given = chosen_element(recording, element_named("4.1/s^2"))
    assert (given.element, given.origin, given.remarks) == (element_named("4.1/s^2"), "given", ())
    named = chosen_element(recording)
    assert (named.element, named.origin, named.remarks) == (element_named("4/s^2"), "recording", ())
    shown = chosen_element(unnamed)
    assert shown.origin == "identified"
    assert deviation(shown.element, SINGLE_LOOP.element) < 0.01
    wrong = chosen_element(replace(recording, controlled_element="9/s"), element_named("1/s^2"))
    assert wrong.element == element_named("1/s^2")
    # What the file names is not asked where the user says better.
    assert [r.split(" is ")[0] for r in wrong.remarks] == ["the controlled element given"]
    boat = chosen_element(replace(recording, controlled_element="a boat"))
    assert (boat.origin, [r.grade for r in boat.remarks]) == ("identified", ["note"])


def test_a_named_element_with_zeros_is_held_against_the_signals() -> None:
    named = "3(s+1)(s+4)/(s^2(s+8))"
    recording = replace(recorded(element_named(named)), controlled_element=named)
    chosen = chosen_element(recording)
    assert (chosen.element, chosen.remarks) == (element_named(named), ())
    wrong = replace(recording, controlled_element="3(s+1)(s+8)/(s^2(s+8))")
    assert element_fit.confirmed_element(wrong) is None


# ------------------------------------------------------------------ human pilots


@pytest.mark.parametrize(
    ("file", "true"),
    [
        ("yaw/ae2224I_measurement_data_subj4_C4.mat", "30/((s+30)(1+s/10)^2)"),
        ("yaw/ae2224I_measurement_data_subj3_C5.mat", "4/(s(1+s/29.8)^2)"),
        ("yaw/ae2224I_measurement_data_subj4_C6.mat", "15/s^2"),
        ("rollpitch/pilot2_C1_run1_pitch.csv", "67.6exp(-0.01s)/(s(s+5.40))"),
        ("rollpitch/pilot2_C2_run3_pitch.csv", "20.87exp(-0.01s)/(s(s+.167))"),
        ("adaptation/pilot3_C1_roll.mat", "67.6exp(-0.01s)/(s(s+5.40))"),
        ("adaptation/pilot7_C2_pitch.mat", "20.87exp(-0.01s)/(s(s+.167))"),
    ],
)
def test_elements_of_experiments_are_found(measured: Path, file: str, true: str) -> None:
    recording, known = load_recording(measured / file), element_named(true)
    found = identified_element(recording)
    assert not found.why
    assert deviation(found.element, known) < 0.02
    assert found.element is not None
    assert len(found.element.denominator) == len(known.denominator)


@pytest.mark.long
@pytest.mark.parametrize("condition", ["C3_roll", "C4_pitch", "C6_roll", "C8_pitch"])
def test_element_that_changes_in_an_experiment_is_said(measured: Path, condition: str) -> None:
    recording = load_recording(measured / f"adaptation/pilot3_{condition}.mat")
    assert identified_element(recording).left > 0.3
