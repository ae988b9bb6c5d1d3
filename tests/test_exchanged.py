"""Runs whose forcing functions have different lines, fitted together."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from helpers import NOMINAL, PILOTS, without_remnant

from pilotid.checks.checks import remarks
from pilotid.datasets import Scenario, simulate
from pilotid.datasets.bounds import bounds
from pilotid.datasets.experiments import experiment_of
from pilotid.estimate.estimate import Outcome
from pilotid.estimate.method import Method, identify
from pilotid.methods.arx import ARX
from pilotid.methods.fourier import Fourier
from pilotid.methods.mle import MLE
from pilotid.model.catalogue import MULTI
from pilotid.model.element import element_named
from pilotid.recording.recording import Recording, joined
from pilotid.recording.spectra import forcing_lines, same_lines

pytestmark = pytest.mark.numerical


def exchanged(scenario: Scenario) -> Scenario:
    """The same with the target on the lines of the disturbance, and the other way round."""
    target, disturbance = scenario.target, scenario.disturbance
    return replace(
        scenario,
        target=replace(target, lines=disturbance.lines),  # type: ignore[type-var]
        disturbance=replace(disturbance, lines=target.lines),  # type: ignore[type-var]
    )


def recorded(*scenarios: Scenario, seed: int = 1) -> list[Recording]:
    return [simulate(own, np.random.default_rng([seed, i])) for i, own in enumerate(scenarios)]


@cache
def noise_free(name: str) -> Recording:
    """Runs with exchanged lines, without a disturbance, and with twice the target, out of phase."""
    scenario = without_remnant(PILOTS[name])
    first, other = recorded(scenario, exchanged(scenario))
    (alone,) = recorded(replace(scenario, disturbance=None))
    alone = replace(alone, fd=None)
    target = scenario.target.scaled(2.0).with_random_phases(np.random.default_rng(1))  # type: ignore[attr-defined]
    (louder,) = recorded(replace(scenario, target=target))
    return joined([first, other, alone, louder])


@pytest.mark.parametrize("name", ["multi", "look-ahead"])
def test_without_a_remnant_they_give_the_truth(name: str) -> None:
    recording, scenario = noise_free(name), PILOTS[name]
    assert [len(own) for own in same_lines(recording)] == [2, 1, 1]
    assert "fd is taken for zero" in " ".join(recording.treatment)
    estimate = identify(Fourier(), recording, scenario.model, np.random.default_rng(1))
    assert estimate.outcome is Outcome.CONVERGED
    np.testing.assert_allclose(estimate.values, scenario.values, rtol=1e-4)


def test_at_common_lines_channels_are_separated_without_interpolation() -> None:
    scenario = without_remnant(PILOTS["look-ahead"])
    recording = joined(recorded(scenario, exchanged(scenario)))
    found = Fourier().first_step(recording, scenario.model)
    lines = forcing_lines(recording)
    assert np.array_equal(lines["ft"], lines["fd"])
    np.testing.assert_allclose(
        found.omega, 2.0 * np.pi * lines["ft"] / recording.duration, rtol=1e-12
    )
    truth = scenario.model.response(found.omega, scenario.values)
    np.testing.assert_allclose(found.value, truth, rtol=1e-5)


def test_bars_of_separated_responses_hold_the_truth() -> None:
    scenario = PILOTS["look-ahead"]
    standardised = []
    for seed in range(12):
        recording = joined(recorded(scenario, exchanged(scenario), seed=seed))
        found = Fourier().first_step(recording, scenario.model)
        truth = scenario.model.response(found.omega, scenario.values)
        # At the fastest lines the remnant is as large as the answers.
        standardised.append((np.abs(found.value - truth) / found.std)[:, :14])
    assert np.mean(np.square(standardised)) == pytest.approx(1.0, abs=0.3)


def test_nothing_is_remarked_on() -> None:
    first = PILOTS["look-ahead"]
    recording = joined(recorded(first, exchanged(first), replace(first, disturbance=None)))
    assert not remarks(recording)
    (other,) = recorded(replace(first, element=element_named("2/s")), seed=2)
    assert "element-differs" in {r.code for r in remarks(joined([recording, other]))}


def test_lines_in_both_functions_of_a_run_are_refused() -> None:
    (recording,) = recorded(NOMINAL)
    same = replace(recording, fd=recording.ft, lines={})
    assert "common lines" in str(Fourier().objection(same, MULTI))
    turned = joined([same, replace(recording, u=2.0 * recording.u, lines={}, fd=-recording.ft)])
    assert Fourier().objection(turned, MULTI) is None  # signs between runs tell them apart


def test_bounds_of_several_experiments_add_up() -> None:
    one, other = (experiment_of(own) for own in (NOMINAL, exchanged(NOMINAL)))
    alike = bounds(one, one)
    twice = bounds(replace(one, runs=2))
    np.testing.assert_allclose(alike.low_pass, twice.low_pass, rtol=1e-9)
    both = bounds(one, other)
    for name in ("full", "forcing", "low_pass"):
        single = [np.linalg.inv(getattr(bounds(own), name)) for own in (one, other)]
        np.testing.assert_allclose(
            np.linalg.inv(getattr(both, name)), sum(single), rtol=1e-6, atol=1e-6
        )


@pytest.mark.parametrize("method", [MLE(), Fourier(), ARX()], ids=lambda m: m.name)
def test_claimed_information_adds_up(method: Method) -> None:
    rng = np.random.default_rng(1)
    single = recorded(NOMINAL, exchanged(NOMINAL), seed=3)
    errors = [identify(method, own, MULTI, rng).std_error[2:] for own in (*single, joined(single))]
    expected = (errors[0] ** -2 + errors[1] ** -2) ** -0.5
    np.testing.assert_allclose(errors[2], expected, rtol=0.25)


@pytest.mark.long
@pytest.mark.parametrize("method", [MLE(), Fourier(), ARX()], ids=lambda m: m.name)
def test_together_they_have_root_half_of_the_error(method: Method) -> None:
    count, truth = 60, NOMINAL.values
    errors = np.empty((count, 3, truth.size))
    for i in range(count):
        single = recorded(NOMINAL, exchanged(NOMINAL), seed=100 + i)
        for place, own in enumerate((*single, joined(single))):
            rng = np.random.default_rng(i)
            errors[i, place] = identify(method, own, MULTI, rng).values - truth
    # Gain and lead of one recording are known too poorly for their errors to be normal.
    square = np.mean(errors[..., 2:] ** 2, axis=0)
    ratio = np.sqrt(square[2] * (1.0 / square[0] + 1.0 / square[1]) / 2.0)
    assert np.sqrt(np.mean(ratio**2)) == pytest.approx(np.sqrt(0.5), abs=0.08)
    joint = errors[:, 2, 2:]
    bias = joint.mean(axis=0) / (joint.std(axis=0) / np.sqrt(count))
    assert np.all(np.abs(bias) < 4.0)
