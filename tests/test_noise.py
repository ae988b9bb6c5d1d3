"""Noise models: whitening filters, their derivatives, and the choice among them."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import differences

from pilotid.likelihood.prepare import Band
from pilotid.likelihood.remnant_models import (
    Autoregressive,
    BandPass,
    LowPass,
    are_invertible,
    best_noise_model,
    lagged_products,
)
from pilotid.likelihood.search import contenders
from pilotid.support.types import FloatArray

pytestmark = pytest.mark.numerical

BAND = Band(0.02, 3)
FULL = Band(0.06, 1)
TRUTHS = {1: [5.0], 2: [4.0, 0.6], 3: [6.0, 0.5]}
FAMILIES: dict[LowPass, list[float]] = {
    **{LowPass(order): values for order, values in TRUTHS.items()},
    BandPass(1): [5.0, 1.0],
    BandPass(2): [4.0, 0.6, 0.7],
}


def shaped(model: LowPass, values: list[float], samples: int, seed: int) -> FloatArray:
    """A remnant as it looks after low-pass filter and decimation, made by brute force."""
    rng = np.random.default_rng(seed)
    grid = samples * BAND.factor
    omega = 2.0 * np.pi * np.fft.rfftfreq(grid, BAND.recorded_dt)
    power, _ = model.power(omega, np.array([values]))
    noise = np.fft.irfft(np.fft.rfft(rng.standard_normal(grid)) * np.sqrt(power[0]), n=grid)
    ring = np.fft.irfft(np.fft.rfft(noise) * BAND.lowpass(omega), n=grid)
    return ring[:: BAND.factor][None]


@pytest.mark.parametrize("model", FAMILIES, ids=lambda model: model.name)
@pytest.mark.parametrize("band", [BAND, FULL], ids=["decimated", "full"])
def test_derivatives_of_the_whitening_filter_agree_with_finite_differences(
    model: LowPass, band: Band
) -> None:
    values = np.array([FAMILIES[model]])
    _, slopes = model.taps(values, band)
    expected = differences(lambda v: model.taps(v[None], band)[0][0], values[0], 1e-5 * values[0])
    # The Toeplitz matrix of a steep spectrum is ill-conditioned, so differences are rough.
    size = np.abs(expected).max(axis=1, keepdims=True)
    np.testing.assert_allclose(slopes[0] / size, expected / size, rtol=0.0, atol=1e-4)


@pytest.mark.parametrize("model", FAMILIES, ids=lambda model: model.name)
def test_the_whitening_filter_is_the_inverse_of_the_spectrum(model: LowPass) -> None:
    values = np.array([FAMILIES[model]])
    taps, _ = model.taps(values, BAND)
    response = np.exp(-1j * np.outer(BAND.omega * BAND.dt, np.arange(model.reach + 1))) @ taps[0]
    power = np.zeros(BAND.omega.size)
    for omega in (BAND.omega, 2.0 * np.pi / BAND.dt - BAND.omega):
        power += model.power(omega, values)[0][0] * BAND.lowpass(omega) ** 2
    flat = power * np.abs(response) ** 2
    # What 20 taps leave over of an infinite filter, and 60 of one with a corner at .7 rad/s; below
    # that there is next to no power.
    passes = isinstance(model, BandPass)
    seen = BAND.omega > (2.0 * values[0, -1] if passes else 0.0)
    np.testing.assert_allclose(flat[seen] / flat.mean(), 1.0, atol=0.2 if passes else 0.07)
    np.testing.assert_allclose(model.filters(values, BAND)[0], taps[0], atol=1e-6)


def test_a_remnant_without_low_frequencies_is_taken_for_a_band_pass() -> None:
    """Twenty taps do not see the corner, whatever the autoregression."""
    truth = [4.0, 0.7, 0.8]
    found = [best_noise_model(shaped(BandPass(2), truth, 1360, seed), BAND) for seed in range(40)]
    assert sum(isinstance(guess.model, BandPass) for guess in found) >= 32
    corners = [guess.values[-1] for guess in found if isinstance(guess.model, BandPass)]
    assert np.median(corners) == pytest.approx(truth[-1], rel=0.4)


def test_a_band_pass_has_to_win_against_a_low_pass() -> None:
    """Its corner and the pilot's gain explain one another: both are fitted and compared."""
    close = 0
    for seed in range(20):
        residual = shaped(BandPass(2), [4.0, 0.7, 0.3], 1360, seed)
        found = [guess.model for guess in contenders(residual, BAND)]
        if any(isinstance(model, BandPass) for model in found):
            close += any(type(model) is LowPass for model in found)
    assert close >= 5


@pytest.mark.parametrize("order", [1, 2])
def test_the_family_that_made_the_remnant_is_chosen(order: int) -> None:
    chosen = [
        best_noise_model(shaped(LowPass(order), TRUTHS[order], 1360, seed), BAND).model.name
        for seed in range(40)
    ]
    assert chosen.count(LowPass(order).name) >= 28


def test_white_noise_is_taken_for_white() -> None:
    chosen = [
        best_noise_model(np.random.default_rng(seed).standard_normal((1, 1360)), FULL).model.name
        for seed in range(20)
    ]
    assert chosen.count("white") >= 16  # of fifteen families; Akaike's criterion errs so often


def test_a_resonance_that_no_low_pass_has_calls_for_a_free_spectrum() -> None:
    rng = np.random.default_rng(3)
    poles = [0.95 * np.exp(0.6j), 0.95 * np.exp(-0.6j), 0.9 * np.exp(1.8j), 0.9 * np.exp(-1.8j)]
    coefficients = np.real(np.poly(poles))
    signal = rng.standard_normal(3000)
    for i in range(4, signal.size):
        signal[i] -= coefficients[1:] @ signal[i - 4 : i][::-1]
    best = best_noise_model(signal[None, 200:], FULL).model
    assert isinstance(best, Autoregressive)
    guess, _ = best.guess(lagged_products(signal[None, 200:]), FULL)
    np.testing.assert_allclose(guess[:4], coefficients[1:], atol=0.1)


def test_filters_with_zeros_outside_the_unit_circle_have_no_likelihood() -> None:
    rng = np.random.default_rng(3)
    for order in (1, 2, 5, 20):
        inside = rng.uniform(0.3, 0.98, order // 2) * np.exp(1j * rng.uniform(0.0, 3.1, order // 2))
        zeros = np.concatenate([inside, inside.conj(), [0.97] * (order % 2)])
        taps = np.poly(zeros).real[None]
        assert are_invertible(taps).tolist() == [True]
        beyond = np.convolve(taps[0], [1.0, -1.1]), [1.0, *[1e20] * order]
        assert [bool(are_invertible(np.array([each]))[0]) for each in beyond] == [False, False]
