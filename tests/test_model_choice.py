"""Which model recordings speak for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import NOMINAL, PILOTS, SINGLE_LOOP

from pilotid.datasets import simulate
from pilotid.likelihood.choice import (
    Candidate,
    by_likelihood,
    choose_jointly,
    choose_model,
    compare_models,
    default_candidates,
    fit_forced_response,
    select,
)
from pilotid.model.catalogue import MODELS
from pilotid.recording.files import load_recording
from pilotid.recording.recording import Recording
from pilotid.support.numbers import recording_rng

pytestmark = pytest.mark.numerical


def recording_of(name: str, runs: int = 1, seed: int = 7) -> Recording:
    scenario = replace(PILOTS[name], runs=runs)
    return simulate(scenario, recording_rng(seed, scenario.name))


def candidate(model: str, pilot: int, left_out: tuple[float, ...], vaf: float = 80.0) -> Candidate:
    """A candidate that lines judge."""
    return Candidate(
        model=model,
        pilot_parameters=pilot,
        parameters=pilot + 3,
        log_likelihood=-100.0,
        aicc=210.0 + pilot,
        bic=220.0 + pilot,
        vaf=vaf,
        left_out_log_likelihood=tuple(-0.5 * number for number in left_out),
        chi_squared=30.0,
        freedom=30,
        left_out_chi_squared=left_out,
        bounds="",
    )


#: What ten runs leave unexplained.
RUNS = tuple(30.0 + run for run in range(10))


@pytest.mark.parametrize(
    ("gains", "taken"),
    [
        ((2.0, -1.0, 1.0, -2.0, 0.5, 1.0, -1.5, 2.0, -1.0, 0.5), "single"),
        ((3.0, 4.0, 2.0, 5.0, 1.0, 2.5, 3.5, 0.5, 4.5, 1.5), "multi"),
        # One run alone may differ a hundred times as much as the others, and decides nothing.
        ((400.0, -1.0, 1.0, -2.0, 0.5, 1.0, -1.5, 2.0, -1.0, 0.5), "single"),
        # Nor does it hide what all others say.
        ((400.0, 4.0, 2.0, 5.0, 1.0, 2.5, 3.5, 0.5, 4.5, 1.5), "multi"),
        # All for it, but by nothing.
        ((0.1, 0.2, 0.3, 0.4, 0.5, 0.25, 0.15, 0.35, 0.45, 0.05), "single"),
    ],
)
def test_a_richer_model_is_taken_where_runs_left_out_clearly_favour_it(
    gains: tuple[float, ...], taken: str
) -> None:
    simple = candidate("single", 5, RUNS)
    richer = candidate("multi", 7, tuple(np.subtract(RUNS, gains).tolist()))
    assert choose_model([[simple, richer]]).model == taken


def test_recordings_of_a_condition_are_judged_together() -> None:
    """One subject who seems to need more does not outvote the others."""
    gains = (np.arange(1.0, 11.0), -np.arange(1.0, 11.0), -np.arange(2.0, 12.0))
    pairs = [
        [candidate("single", 5, RUNS), candidate("multi", 7, tuple((RUNS - gain).tolist()))]
        for gain in gains
    ]
    assert choose_model(pairs[:1]).model == "multi"
    assert choose_model(pairs).model == "single"


def test_a_single_run_is_judged_by_a_criterion() -> None:
    simple = candidate("single", 5, ())
    for misfit, taken in ((25.0, "single"), (20.0, "multi")):
        richer = replace(candidate("multi", 7, ()), chi_squared=misfit)
        assert choose_model([[simple, richer]]).model == taken


@pytest.mark.parametrize(
    ("varies", "bic", "taken"),
    [(False, 10.0, "lead-lag"), (True, 10.0, "single"), (True, -90.0, "lead-lag")],
)
def test_a_time_of_change_has_to_win_by_bic(varies: bool, bic: float, taken: str) -> None:
    """A constant pilot leaves it free, so that it fits what is largest by chance."""
    simple = replace(candidate("single", 5, ()), chi_squared=float("nan"), freedom=0)
    richer = replace(simple, model="lead-lag", pilot_parameters=9, varies=varies)
    richer = replace(richer, aicc=simple.aicc - 11.0, bic=simple.bic + bic)
    assert choose_model([[simple, richer]]).model == taken


def test_what_describes_the_loop_and_not_the_pilot_is_not_taken() -> None:
    """Where no line judges, a likelihood without a simulated response counts for nothing."""
    pilot = replace(candidate("single", 5, ()), chi_squared=float("nan"), freedom=0)
    loop = replace(pilot, model="multi", pilot_parameters=7, aicc=-1000.0, bic=-1000.0, vaf=3.0)
    choice = choose_model([[pilot, loop]])
    assert choice.model == "single"
    assert "Not credible, with a VAF more than 10 points below the best: multi" in choice.reason


#: Pilot parameters of the models that compete below.
SIZES = {"single": 5, "lead-lag": 6, "rate": 7, "multi": 7, "lead-lag-motion": 8}


def condition(more: dict[str, float], delayless: str = "") -> list[list[Candidate]]:
    """Three recordings, and what models leave in each run above the best."""
    every = [
        replace(
            candidate(name, SIZES[name], tuple(run + more.get(name, 0.0) for run in RUNS)),
            no_delay=name == delayless,
        )
        for name in SIZES
    ]
    return [every] * 3


MOTIONLESS = {"rate": 0.1, "multi": 0.1, "lead-lag-motion": 0.1}


@pytest.mark.parametrize(
    ("conditions", "taken"),
    [
        # What one condition needs and the other allows.
        (
            {"A": condition(MOTIONLESS), "B": condition({**MOTIONLESS, "single": 2.0})},
            {"A": "lead-lag", "B": "lead-lag"},
        ),
        # What makes do without a delay is no pilot; then nothing suits, and the misfit decides.
        (
            {"A": condition({}), "B": condition({"single": 2.0}, delayless="lead-lag")},
            {"A": "single", "B": "single"},
        ),
        # Channels on other signals stay.
        (
            {
                "A": condition(MOTIONLESS),
                "B": condition({"single": 9.0, "lead-lag": 9.0, "rate": 2.0}),
            },
            {"A": "single", "B": "multi"},
        ),
        # The channel on the error is one: a lag here is a lag there.
        (
            {
                "A": condition({**MOTIONLESS, "single": 2.0}),
                "B": condition({"single": 9.0, "lead-lag": 9.0}),
            },
            {"A": "lead-lag", "B": "lead-lag-motion"},
        ),
    ],
)
def test_conditions_that_are_compared_have_one_model(
    conditions: dict[str, list[list[Candidate]]], taken: dict[str, str]
) -> None:
    assert choose_jointly(conditions, MODELS)[0] == taken


@pytest.mark.long
def test_subjects_in_two_vehicles_have_the_model_of_the_publication(measured: Path) -> None:
    """A lag in one of the two would take the delays of some subjects to zero."""
    held = {
        name: [
            compare_models(recording, default_candidates(recording), 0)
            for file in sorted(measured.glob(f"adaptation/pilot*_{name}_roll.mat"))
            for recording in [load_recording(file)]
        ]
        for name in ("C1", "C2")
    }
    assert choose_model(held["C2"]).model == "lead-lag"
    assert choose_jointly(held, MODELS)[0] == dict.fromkeys(held, "single")


def test_misfits_are_those_of_chance_for_the_true_model() -> None:
    """Chi-squared of the lines, over 20 recordings, within 3 errors of its freedom."""
    found = [
        fit_forced_response(
            simulate(SINGLE_LOOP, recording_rng(11, "single", k)), [MODELS["single"]], 0
        )[0]
        for k in range(20)
    ]
    excess = np.array([f.misfit / f.freedom for f in found])
    # Powers of the remnant are estimated from bins beside the lines.
    assert abs(excess.mean() - 1.0) < 3.0 * excess.std(ddof=1) / np.sqrt(20.0) + 0.05


def test_criteria_are_of_the_same_samples() -> None:
    recording = recording_of("multi", runs=2)
    models = [MODELS["multi"], MODELS["single"]]
    both = by_likelihood(recording, models, 0)
    assert both[0].samples == both[1].samples
    assert both[0].log_likelihood > both[1].log_likelihood + 10.0
    for own in both:
        # Runs left out are predicted a little worse than runs that were fitted, and no more.
        assert -60.0 < sum(own.left_out_log_likelihood) - own.log_likelihood < 0.0


def test_a_richer_model_never_explains_less() -> None:
    """With the true model's optimum inside it, the likelihood cannot fall."""
    recording = recording_of("single")
    simple, richer = by_likelihood(recording, [MODELS["single"], MODELS["lead-lag"]], 0)
    assert richer.log_likelihood > simple.log_likelihood - 1.0


def test_aperiodic_recordings_are_judged_by_their_prediction_errors() -> None:
    recording = replace(recording_of("single", runs=2), lines={})
    rng = np.random.default_rng(0)
    noisy = replace(recording, ft=recording.ft + 0.2 * rng.standard_normal(recording.e.shape))
    choice = choose_model([compare_models(noisy, [MODELS["gain"], MODELS["single"]], 0)])
    assert choice.model == "single"
    assert "by prediction errors" in choice.reason


@pytest.mark.long
def test_people_without_motion_are_not_given_a_motion_channel(measured: Path) -> None:
    """The likelihood would: with its simulated response at 0 % (subject 4, C2, is the case)."""
    for condition, expected in (("C1", {"lead-lag"}), ("C2", {"single"}), ("C3", {"single"})):
        path = measured / "yaw" / f"ae2224I_measurement_data_subj4_{condition}.mat"
        recording = load_recording(path)
        models = [MODELS[n] for n in ("gain", "single", "lead-lag", "rate", "multi")]
        assert choose_model([compare_models(recording, models, 0)]).model in expected


def test_people_with_motion_are(measured: Path) -> None:
    recording = load_recording(measured / "yaw" / "ae2224I_measurement_data_subj4_C6.mat")
    models = [MODELS[n] for n in ("gain", "single", "lead-lag", "rate", "multi")]
    assert choose_model([compare_models(recording, models, 0)]).model in {"rate", "multi"}


def test_a_model_without_input_is_left_out() -> None:
    still = replace(NOMINAL, runs=1)
    recording = simulate(still, recording_rng(3, "still"))
    frozen = replace(recording, x=np.zeros_like(recording.x), ft=recording.e, fd=None, lines={})
    found = compare_models(frozen, [MODELS["single"], MODELS["multi"]], 0)
    assert [c.model for c in found] == ["single"]


@pytest.mark.parametrize(
    "name",
    [
        *("look-ahead", "single", "multi"),
        *(pytest.param(name, marks=pytest.mark.long) for name in ("pursuit", "lead2-lag-motion")),
    ],
)
def test_all_models_that_the_signals_allow_are_tried_and_the_others_named(name: str) -> None:
    found = select(recording_of(name, runs=3))
    assert found.model.name == name
    tried = {c.model for c in found.candidates}
    untried = found.reason.partition("Not tried: ")[2]
    assert all(name in untried for name in set(MODELS) - tried)
    assert {"pursuit", "precision", "crossover"} <= tried
    assert {"adapting", "preview", "following"}.isdisjoint(tried)


def test_a_channel_that_a_lacking_forcing_function_would_tell_is_not_tried() -> None:
    both = recording_of("single")
    assert "multi" in select(replace(both, fd=None)).reason.partition("Not tried: ")[2]
    assert "Not tried" not in select(replace(both, fd=None), [MODELS["single"]]).reason
