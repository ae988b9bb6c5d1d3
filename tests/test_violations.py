"""Violations of what methods assume: by time stepping in the loop, or in the recorder."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import NOMINAL, PILOTS

from pilotid.datasets import SCENARIOS, Scenario, scenario_named, simulate
from pilotid.datasets.simulation import linear_rms
from pilotid.datasets.stepping import STEP, stepped
from pilotid.datasets.violations import Violation
from pilotid.recording.recording import Recording
from pilotid.study.run import truths_of
from pilotid.support.types import FloatArray, InputError

pytestmark = pytest.mark.numerical

FAMILY = [name for name, scenario in SCENARIOS.items() if scenario.family == "violation"]
NOTHING = (("fnm", 0.0),)  # a pilot who changes by nothing: the loop is linear, and stepped


def made(scenario: Scenario, seed: int = 1) -> Recording:
    return simulate(scenario, np.random.default_rng(seed))


def rms(signal: FloatArray) -> float:
    return float(np.sqrt(np.mean(signal**2)))


def off(found: FloatArray, known: FloatArray) -> float:
    """Root mean square of a difference over that of what is known."""
    return rms(found - known) / rms(known)


def test_the_family_is_there_and_its_truth_is_that_of_the_nominal_pilot() -> None:
    assert [name.removeprefix("violation-") for name in FAMILY] == [
        "change", "threshold", "quantised", "saturated", "drift", "lost",
    ]  # fmt: skip
    known = truths_of(NOMINAL)
    for name in FAMILY[1:]:
        assert SCENARIOS[name].truth == NOMINAL.truth
        assert truths_of(SCENARIOS[name]) == known
    gain, lead, *others = SCENARIOS["violation-change"].truth
    assert (gain, lead) == pytest.approx((0.8 * NOMINAL.truth[0], 1.3 * NOMINAL.truth[1]))
    assert others == list(NOMINAL.truth[2:])


@pytest.mark.parametrize("model", [name for name in PILOTS if name != "crossover"])
def test_stepping_agrees_with_the_exact_linear_loop(model: str) -> None:
    scenario = replace(PILOTS[model], runs=2)
    same = replace(scenario, violation=Violation("change", change=NOTHING))
    exact, found = made(scenario), made(same)
    assert off(found.u, exact.u) < 2e-3
    assert off(found.x, exact.x) < 5e-4
    np.testing.assert_array_equal(found.ft, exact.ft)


def test_a_delay_of_the_element_and_delays_between_steps_are_simulated() -> None:
    element = replace(NOMINAL.element, numerator=(3.0,), delay=0.0313)
    scenario = replace(NOMINAL, element=element, truth=(0.17, 2.0, 0.2817, 1.59, 0.2443, 12.0, 0.3))
    same = replace(scenario, violation=Violation("change", change=NOTHING))
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
    [("change", 0.001), ("saturated", 0.001), ("threshold", 0.05), ("quantised", 0.1)],
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
    for name in ("change", "threshold", "quantised", "saturated"):
        found = made(SCENARIOS[f"violation-{name}"])
        assert off(found.x, nominal.x) > 0.005
        assert found.ft is not None
        np.testing.assert_array_equal(found.e, found.ft - found.x)


def test_a_drift_is_a_ramp_on_the_recorded_control_alone() -> None:
    nominal, found = made(NOMINAL), made(SCENARIOS["violation-drift"])
    ramp = 1.5 * linear_rms(NOMINAL) * nominal.time / 81.92
    np.testing.assert_allclose(found.u - nominal.u, ramp[None], atol=1e-12)
    np.testing.assert_array_equal(found.x, nominal.x)


def test_lost_samples_are_the_last_one_before_in_the_recorded_control_alone() -> None:
    scenario = replace(SCENARIOS["violation-lost"], runs=5)
    nominal, found = made(replace(NOMINAL, runs=5)), made(scenario)
    np.testing.assert_array_equal(found.x, nominal.x)
    lost = found.u != nominal.u
    assert 0.03 < np.mean(lost) < 0.07
    np.testing.assert_array_equal(found.u[:, 1:][lost[:, 1:]], found.u[:, :-1][lost[:, 1:]])
    assert not np.any(lost[:, 0])
    lengths = np.diff(np.flatnonzero(np.diff(np.pad(lost, ((0, 0), (1, 1))).ravel().astype(int))))
    assert np.median(lengths[::2]) == 10


def test_who_changes_is_one_pilot_in_the_first_half_and_another_in_the_second() -> None:
    scenario = SCENARIOS["violation-change"]
    second = replace(NOMINAL, truth=(0.6 * 0.17, 1.6 * 2.93, *NOMINAL.truth[2:]))
    found, first, last = made(scenario), made(NOMINAL), made(second)
    before = found.time < 0.5 * scenario.duration - 1.0
    assert off(found.u[:, before], first.u[:, before]) < 2e-3
    after = found.time > scenario.duration - 10.0  # what was before is forgotten
    assert off(found.u[:, after], last.u[:, after]) < 1e-2
    assert off(last.u[:, after], first.u[:, after]) > 0.05


def test_a_parameter_that_is_not_there_cannot_change() -> None:
    own = replace(NOMINAL, violation=Violation("change", change=(("tlag", 0.1),)))
    with pytest.raises(InputError, match="tlag cannot change, since model multi has Kvis"):
        made(own)


def test_a_pilot_who_answers_at_once_is_refused() -> None:
    # Steps are a quarter of a sample.
    own = replace(SCENARIOS["violation-saturated"], truth=(0.17, 2.93, 0.32, 0.5, 0.004, 12.0, 0.3))
    with pytest.raises(InputError, match=r"must be at least 0\.005 s each"):
        made(own)


def test_a_violation_can_be_typed() -> None:
    own = scenario_named('nominal(violation=Violation(kind="drift", size=2))')
    assert isinstance(own, Scenario)
    assert own.violation == Violation("drift", 2.0)
