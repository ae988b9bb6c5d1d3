"""Whether an estimate agrees with the lines: silent where the model is right, loud where not."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from pilotid.datasets import SCENARIOS, scenario_named, simulate
from pilotid.estimate.estimate import Estimate
from pilotid.estimate.method import identify
from pilotid.estimate.quantities import RemnantEstimate, Specification
from pilotid.methods import method_named
from pilotid.model.catalogue import MODELS
from pilotid.spectral.coefficients import NEIGHBOURS, TREND, coefficients_of
from pilotid.spectral.equations import Equations, smoothed_power, specification_of
from pilotid.support.limits import ESTIMATE
from pilotid.support.numbers import fit_rng, recording_rng, start_rng

pytestmark = pytest.mark.numerical


@cache
def fit(scenario: str, model: str, seed: int, method: str = "mle") -> Estimate:
    recording = simulate(SCENARIOS[scenario], np.random.default_rng(seed))
    return identify(method_named(method), recording, MODELS[model], np.random.default_rng(seed))


@pytest.mark.parametrize("method", ["mle", "bayes"])
def test_a_model_that_lacks_a_channel_disagrees(method: str) -> None:
    estimate = fit("nominal", "single", 0, method)
    assert not estimate.specification.agrees
    assert estimate.specification.p_value < ESTIMATE.surely_misspecified
    (remark,) = (r for r in estimate.remarks if getattr(r, "code", "") == "misspecified")
    assert remark.grade == "wrong"
    numbers = {key: getattr(estimate.specification, key) for key in ("statistic", "p_value")}
    told = estimate.to_dict()["specification"]
    assert np.isnan(told.pop("moved"))
    assert told.pop("missed") == estimate.specification.missed > 2.0
    assert told == {**numbers, "against": "fourier", "agrees": False}


def test_without_a_line_that_a_recorder_left_there_is_no_test() -> None:
    estimate = fit("single", "single", 0)
    recording = simulate(SCENARIOS["single"], np.random.default_rng(0))
    given = estimate.model, estimate.values, estimate.covariance, estimate.remnant
    assert specification_of(recording, *given, 0.0) is None
    assert specification_of(recording, *given, 50.0).missed == 0.0


def test_the_power_that_scores_are_weighed_by_is_that_of_the_remnant() -> None:
    scenario, squares = SCENARIOS["single"], []
    model, omega = scenario.model, np.geomspace(0.05, 60.0, 500)
    density = np.abs(scenario.remnant.filter(omega)) ** 2
    remnant = RemnantEstimate("second-order", {}, 0.2, omega, density)
    for seed in range(40):
        recording = simulate(scenario, np.random.default_rng(seed))
        lines = coefficients_of(recording, model, NEIGHBOURS, TREND)
        responses = model.response(lines.omega, scenario.values)
        residuals = lines.residuals(responses)
        power = smoothed_power(lines, residuals, remnant)
        rows = Equations(lines, model, power).rows(scenario.values[None])
        squares.append(np.mean(rows[0, -1] ** 2))
    error = np.std(squares) / np.sqrt(len(squares))
    assert abs(np.mean(squares) - 1.0) < 2.5 * error < 0.15


def test_without_lines_the_forcing_functions_are_instruments() -> None:
    right = fit("disturbance-step", "multi", 0).specification
    assert right.against == "mle-reference"
    assert right.agrees


def test_aperiodic_forcing_functions_find_a_model_that_lacks_a_channel() -> None:
    name = "population-aperiodic"
    drawn = scenario_named(name).drawn(start_rng(5, name, 39))
    assert drawn.model.name == "multi"
    recording = simulate(drawn, np.random.default_rng(2))
    estimate = identify(method_named("mle"), recording, MODELS["single"], np.random.default_rng(2))
    assert not estimate.specification.agrees


def test_direct_prediction_errors_have_no_weights_to_test_with() -> None:
    recording = simulate(SCENARIOS["disturbance-step"], np.random.default_rng(0))
    direct = method_named("mle(loop=false)")
    estimate = identify(direct, recording, MODELS["multi"], np.random.default_rng(0))
    assert estimate.outcome.usable
    assert estimate.specification is None


def test_an_estimate_at_its_bound_is_tested_with_that_held() -> None:
    model = MODELS["multi"]
    narrow = tuple(
        replace(p, lower=3.0, start=4.0, upper=5.0, usual=(3.5, 4.5)) if p.key == "fnm" else p
        for p in model.parameters
    )
    recording = simulate(SCENARIOS["nominal"], np.random.default_rng(0))
    bounded = replace(model, overrides=narrow)
    estimate = identify(method_named("mle"), recording, bounded, np.random.default_rng(0))
    assert estimate.specification.p_value < ESTIMATE.surely_misspecified


def test_beside_a_forcing_function_that_was_not_recorded_it_is_a_doubt() -> None:
    recording = replace(simulate(SCENARIOS["nominal"], np.random.default_rng(0)), fd=None)
    estimate = identify(method_named("mle"), recording, MODELS["single"], np.random.default_rng(0))
    assert estimate.specification.p_value < ESTIMATE.surely_misspecified
    assert [r.grade for r in estimate.remarks if r.code == "misspecified"] == ["doubt"]


def test_the_first_recording_of_nominal_is_no_accident_of_one_in_14000() -> None:
    rng = fit_rng(1, "mle", "nominal", 0)
    recording = simulate(SCENARIOS["nominal"], recording_rng(1, "nominal", 0))
    tested = identify(method_named("mle"), recording, MODELS["multi"], rng).specification
    assert ESTIMATE.misspecified < tested.p_value < 0.01


def test_the_level() -> None:
    assert Specification(1.0, ESTIMATE.misspecified, "fourier").agrees
    for moved, grade in ((np.nan, "wrong"), (3.1, "wrong"), (2.0, "doubt"), (0.9, "note")):
        assert [r.grade for r in Specification(60.0, 1e-9, "fourier", moved).remarks] == [grade]
    for missed, grades in ((0.0, []), (1.9, ["note"]), (2.1, ["doubt"])):
        assert [r.grade for r in Specification(1.0, 0.5, "f", 0.0, missed).remarks] == grades
    assert not Specification(1.0, 0.9 * ESTIMATE.misspecified, "fourier").agrees
    for words, p in (("no significant", 0.06), ("not clearly", 0.004), ("contradicts", 0.0001)):
        assert words in Specification(1.0, p, "f").sentence


@pytest.mark.long
@pytest.mark.parametrize("name", ["nominal", "population-usual", "population-recorded"])
def test_p_values_of_right_models_are_as_they_say(name: str) -> None:
    known = []
    for number in range(40):
        drawn = scenario_named(name).drawn(start_rng(12, name, number))
        recording = simulate(drawn, np.random.default_rng(number))
        estimate = identify(
            method_named("mle"), recording, drawn.model, np.random.default_rng(number)
        )
        if estimate.specification is not None:
            known.append(estimate.specification.p_value)
    assert len(known) > 20
    assert np.mean(np.array(known) < 0.1) < 0.25
    assert min(known) > 1e-4
