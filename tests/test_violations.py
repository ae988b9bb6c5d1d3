"""Sticks that are not linear, stepped through time in the loop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import NOMINAL, PILOTS

from pilotid.datasets import SCENARIOS, Scenario, simulate
from pilotid.datasets.scenarios import Violation
from pilotid.datasets.simulation import linear_rms
from pilotid.datasets.stepping import STEP, stepped
from pilotid.recording.recording import Recording
from pilotid.study.run import truths_of
from pilotid.support.types import FloatArray, InputError

pytestmark = pytest.mark.numerical

FAMILY = [name for name, scenario in SCENARIOS.items() if scenario.family == "violation"]
#: Stops that no stick reaches: the loop is linear, and stepped.
FAR = Violation("saturated", 1e6)


def made(scenario: Scenario, seed: int = 1) -> Recording:
    return simulate(scenario, np.random.default_rng(seed))


def rms(signal: FloatArray) -> float:
    return float(np.sqrt(np.mean(signal**2)))


def off(found: FloatArray, known: FloatArray) -> float:
    """Root mean square of a difference over that of what is known."""
    return rms(found - known) / rms(known)


def test_the_family_is_there_and_its_truth_is_that_of_the_nominal_pilot() -> None:
    assert [name.removeprefix("violation-") for name in FAMILY] == [
        "threshold", "quantised", "saturated",
    ]  # fmt: skip
    known = truths_of(NOMINAL)
    for name in FAMILY:
        assert SCENARIOS[name].truth == NOMINAL.truth
        assert truths_of(SCENARIOS[name]) == known


@pytest.mark.parametrize("model", [name for name in PILOTS if name != "crossover"])
def test_stepping_agrees_with_the_exact_linear_loop(model: str) -> None:
    scenario = replace(PILOTS[model], runs=2)
    same = replace(scenario, violation=FAR)
    exact, found = made(scenario), made(same)
    assert off(found.u, exact.u) < 2e-3
    assert off(found.x, exact.x) < 5e-4
    np.testing.assert_array_equal(found.ft, exact.ft)


def test_a_delay_of_the_element_and_delays_between_steps_are_simulated() -> None:
    element = replace(NOMINAL.element, numerator=(3.0,), delay=0.0313)
    scenario = replace(NOMINAL, element=element, truth=(0.17, 2.0, 0.2817, 1.59, 0.2443, 12.0, 0.3))
    same = replace(scenario, violation=FAR)
    assert off(made(same).u, made(scenario).u) < 5e-3


def halved(name: str) -> tuple[float, float]:
    """What half the step changes in u and x, over their root mean squares."""
    scenario = SCENARIOS[name]
    noise = np.random.default_rng(3).standard_normal((1, 9000))
    # As smooth as a remnant is.
    spectrum = np.fft.rfft(noise) / (1.0 + 2j * np.pi * np.fft.rfftfreq(9000, 0.02) / 3.5) ** 2
    remnant = 0.7 * np.fft.irfft(spectrum)
    (u, x), (fine, far) = (stepped(scenario, remnant, 0.24, s) for s in (STEP, STEP / 2.0))
    return off(u, fine), off(x, far)


@pytest.mark.parametrize(
    ("name", "limit"),
    # Where the control jumps, a jump that comes a sample later counts; it stays one in many.
    [("saturated", 0.001), ("threshold", 0.05), ("quantised", 0.1)],
)
def test_half_the_step_changes_next_to_nothing(name: str, limit: float) -> None:
    of_u, of_x = halved(f"violation-{name}")
    assert of_u < limit
    assert of_x < 0.02


def test_a_stick_with_a_threshold_rests_at_zero() -> None:
    u = made(SCENARIOS["violation-threshold"]).u
    least = 0.25 * linear_rms(NOMINAL)
    assert np.all((u == 0.0) | (np.abs(u) >= least))
    assert 0.1 < np.mean(u == 0.0) < 0.3  # .20 of a normal distribution


def test_a_stick_with_levels_has_no_others() -> None:
    u = made(SCENARIOS["violation-quantised"]).u / (0.2 * linear_rms(NOMINAL))
    np.testing.assert_allclose(u, np.round(u), atol=1e-9)
    assert np.unique(np.round(u)).size > 10


def test_a_stick_with_stops_stays_within_them() -> None:
    u = made(SCENARIOS["violation-saturated"]).u
    limit = 1.5 * linear_rms(NOMINAL)
    assert np.max(np.abs(u)) == limit
    assert 0.02 < np.mean(np.abs(u) == limit) < 0.2


def test_the_loop_answers_to_what_is_in_it() -> None:
    nominal = made(NOMINAL)
    for name in FAMILY:
        found = made(SCENARIOS[name])
        assert off(found.x, nominal.x) > 0.005
        np.testing.assert_array_equal(found.e, found.ft - found.x)


def test_a_pilot_who_answers_at_once_is_refused() -> None:
    # Steps are a quarter of a sample.
    own = replace(SCENARIOS["violation-saturated"], truth=(0.17, 2.93, 0.32, 0.5, 0.004, 12.0, 0.3))
    with pytest.raises(InputError, match=r"must be at least 0\.005 s each"):
        made(own)
