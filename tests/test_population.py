"""Populations: what is drawn lies where published pilots do, and makes sensible loops."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pilotid.datasets import POPULATIONS, simulate
from pilotid.datasets.bounds import bounds
from pilotid.datasets.experiments import experiment_of
from pilotid.datasets.population import CROSSOVER, ELEMENTS, RANGES, SENSITIVITY
from pilotid.datasets.scenarios import SCENARIOS, Scenario
from pilotid.datasets.signals import Remnant
from pilotid.datasets.simulation import closed_loop, lines_in, remnant_ratio, remnant_shaping
from pilotid.model.loops import margins, open_loops

EXOTIC = ("band-pass", "notch", "two processes", "fractional")


def drawn(name: str, count: int, seed: int = 3) -> list[Scenario]:
    rng = np.random.default_rng(seed)
    return [POPULATIONS[name].drawn(rng) for _ in range(count)]


@pytest.mark.parametrize("name", POPULATIONS)
def test_draws_are_in_range_and_make_recordings(name: str) -> None:
    scenarios = drawn(name, 4)
    for scenario in scenarios:
        assert scenario.name == name
        assert scenario.model.name in POPULATIONS[name].models
        values = dict(zip(scenario.model.keys, scenario.truth, strict=True))
        for key in set(values) - {"Kvis", "Kvest", "Km"}:  # these go by the loop
            assert RANGES[key][0] <= values[key] <= RANGES[key][1]
        target, _ = margins(scenario.model, scenario.values, scenario.element)
        assert 0.5 * CROSSOVER[0] <= target.crossover <= 1.2 * CROSSOVER[1]
        omega = np.geomspace(0.05, 60.0, 400)
        for loop in open_loops(scenario.model, scenario.values, scenario.element, omega):
            assert np.min(np.abs(1.0 + loop)) >= 1.0 / SENSITIVITY
        assert remnant_ratio(scenario) == pytest.approx(scenario.remnant.level)
        recording = simulate(scenario, np.random.default_rng(1))
        assert np.isfinite(recording.u).all()
        bound = np.sqrt(np.diag(bounds(experiment_of(scenario)).full))
        assert (bound > 0.0).all()
    assert len({scenario.truth for scenario in scenarios}) == len(scenarios)


def test_every_kind_of_element_is_drawn_as_often() -> None:
    """What is thrown away for want of stability leaves the shares as they are."""
    kinds = [s.element.denominator for s in drawn("population-single", 90)]
    double = sum(d == (1.0, 0.0, 0.0) for d in kinds)
    lagged = sum(d[-1] == 0.0 and d[-2] != 0.0 for d in kinds)
    # Of 90 fair draws of three kinds fewer than 16 or more than 46 come once in 1000.
    assert 16 <= double <= 46
    assert 16 <= lagged <= 46
    assert set(ELEMENTS) >= {m for p in POPULATIONS.values() for m in p.models}


def test_aperiodic_forcing_has_no_lines_in_the_window() -> None:
    for scenario in drawn("population-aperiodic", 5):
        for forcing in (scenario.target, scenario.disturbance):
            assert forcing is None or lines_in(forcing, scenario.duration) == ()


@pytest.mark.parametrize("shape", EXOTIC)
def test_remnants_of_other_shapes_have_the_spectrum_that_they_say(shape: str) -> None:
    """Mean periodogram of the simulated remnant at the control, over the shaping filter."""
    remnant = Remnant(order=1, frequency=4.0, level=0.1, level_is="ratio")
    remnant = replace(remnant, shape=shape, second=8.0)  # type: ignore[arg-type]
    loud = replace(SCENARIOS["nominal"], name="own", remnant=remnant, runs=60, run_in=0.0)
    recording = simulate(loud, np.random.default_rng(2))
    quiet = simulate(replace(loud, remnant=replace(remnant, level=0.0)), np.random.default_rng(2))
    noise = recording.u - quiet.u
    window = np.hanning(noise.shape[1])
    power = np.mean(np.abs(np.fft.rfft(noise * window)) ** 2, axis=0)
    omega = 2.0 * np.pi * np.fft.rfftfreq(noise.shape[1], loud.dt)
    band = (omega > 0.5) & (omega < 30.0)
    shaped = remnant_shaping(loud, omega[band]) * closed_loop(loud, omega[band]).u["remnant"]
    ratio = power[band] / np.abs(shaped) ** 2
    # In blocks of 25 bins, about 10 of them independent under the window, times 60 runs.
    blocks = ratio[: ratio.size // 25 * 25].reshape(-1, 25).mean(axis=1)
    assert np.std(blocks / np.mean(blocks)) < 0.1


def test_a_remnant_before_the_neuromuscular_system_is_shaped_by_it() -> None:
    remnant = Remnant(order=1, frequency=4.0, level=0.1, level_is="ratio", enters="neuromuscular")
    scenario = replace(SCENARIOS["nominal"], remnant=remnant)
    omega = np.array([0.0, 12.0])
    shaped = np.abs(remnant_shaping(scenario, omega) / remnant.filter(omega))
    # Unity at rest, 1/(2 damping) at the natural frequency.
    assert shaped == pytest.approx([1.0, 1.0 / 0.6])


def test_heavy_tails_have_the_power_that_they_say() -> None:
    remnant = Remnant(level=0.1, level_is="ratio", freedom=8.0)
    noise = remnant.white_noise(np.random.default_rng(3), (4, 50_000))
    assert np.var(noise) == pytest.approx(1.0, rel=0.02)
    assert np.mean(noise**4) > 3.5  # 4.5 for 8 degrees of freedom
    with pytest.raises(ValueError, match="degrees of freedom"):
        replace(remnant, freedom=2.0)
