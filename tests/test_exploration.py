"""The search of `mle`: few frequencies, starts everywhere, the band, what does not follow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from checks.strata import of_stratum
from helpers import NOMINAL, PILOTS, fit_of, minima_at, without_remnant

from pilotid.datasets import Scenario, scenario_named, simulate
from pilotid.datasets.signals import Remnant
from pilotid.estimate.estimate import Outcome, Starts
from pilotid.likelihood import search
from pilotid.likelihood.likelihood import Likelihood
from pilotid.likelihood.optimum import MIN_VAF_RATIO, Optimum, PilotCheck
from pilotid.likelihood.prediction import predict
from pilotid.likelihood.prepare import Band
from pilotid.likelihood.remnant_models import (
    FIRST_NOISE_MODEL,
    NOISE_MODELS,
    LowPass,
    criterion,
    guesses,
)
from pilotid.likelihood.search import (
    first_fit,
    group_by_optimum,
    lines_pilot,
    maxima_from,
    optima,
    sweep,
    wide_enough,
    with_remnants,
)
from pilotid.methods.bayes import Bayes
from pilotid.methods.mle import MLE
from pilotid.model.catalogue import MODELS
from pilotid.model.element import element_named
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.spectral.equations import fit_lines
from pilotid.study.scores import WRONG
from pilotid.support.numbers import recording_rng
from pilotid.support.types import FloatArray

pytestmark = pytest.mark.numerical


def swept(
    recording: Recording, model: PilotModel, seed: int, known: FloatArray
) -> tuple[FloatArray, Starts]:
    rng = np.random.default_rng(seed)
    first = first_fit(recording, model, MLE(wide=()), known, rng)
    return sweep(replace(first, check=PilotCheck(first.joint.prediction.binned, known)), rng, known)


def test_without_groups_the_reduction_is_the_windowed_transform(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Oracle: one bin a group leaves the sums of squares of the windowed spectra."""
    monkeypatch.setattr("pilotid.likelihood.prediction.MAX_BINNED_WIDTH", 0.0)
    recording = simulate(replace(NOMINAL, runs=2), np.random.default_rng(1))
    prediction = predict(recording, NOMINAL.model, 50.0)
    values = 1.1 * NOMINAL.values[None]
    scored = prediction.window.scored
    window = np.sqrt(8.0 / 3.0) * np.hanning(scored + 1)[:-1]
    given = np.array([*prediction.spectra, prediction.control_spectrum])
    # Half a sample's shift of the window makes no difference that counts.
    bins = np.fft.rfft(prediction.samples_of(given) * window)
    s = 2j * np.pi * np.fft.rfftfreq(scored, prediction.dt)
    left = bins[-1].copy()
    responses = NOMINAL.model.response(s.imag, values[0])
    for channel, response, signal in zip(NOMINAL.model.channels, responses, bins[:-1], strict=True):
        left -= response / np.where(s, s, 1.0) ** channel.derivative * signal
    expected = 2.0 / scored * np.sum(np.abs(left[:, 2:]) ** 2)
    found = Likelihood(prediction.binned).gram(values)[0, -1, -1]
    assert found == pytest.approx(expected, rel=0.02)


def test_lines_whose_fit_went_astray_do_not_lead_the_search_astray() -> None:
    """As on replication 154 of `nominal`, seed 1, whose lines' pilot had four values at bounds."""
    start = {"Kvis": 0.1, "tlead": 0.7, "tdvis": 0.5, "Kvest": 0.8, "tdvest": 0.1}
    model = NOMINAL.model.with_start(start)
    astray = np.array([1.5e4, 0.016, 1.0, 0.013, 1.0, 12.1, 0.02])
    recording = simulate(NOMINAL, recording_rng(1, "nominal", 154))
    candidates, _ = swept(recording, model, 1, astray[None])
    np.testing.assert_allclose(candidates[0][2:], NOMINAL.values[2:], rtol=0.3)


def test_optima_are_told_apart_by_the_information() -> None:
    costs = np.array([100.0, 100.01, 101.0, 130.0])
    values = np.array([[0.0, 0.0], [0.01, 0.0], [0.0, 3.0], [5.0, 5.0]])
    ends = minima_at(values, costs, 100.0)
    kept, agreeing = optima(ends, samples=100, far=10.0)
    np.testing.assert_array_equal(kept, [[0.0, 0.0], [0.0, 3.0]])  # the last is too far
    assert agreeing == 2
    assert group_by_optimum(ends, samples=100) == [[0, 1], [2], [3]]
    assert group_by_optimum(ends.only(np.array([2, 1, 0])), samples=100) == [[0], [1, 2]]
    many = minima_at(np.arange(20.0)[:, None] * 9.0, np.ones(20))
    assert len(optima(many, samples=100, far=1.0)[0]) == 20


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_one_optimum_that_many_starts_end_in_does_not_crowd_out_the_others(seed: int) -> None:
    """A position control whose nine best starts meet in a wrong optimum of the usual band."""
    rng = np.random.default_rng([77, 22])
    scenario = scenario_named("population-usual").drawn(rng)
    recording = simulate(scenario, rng)
    known = fit_lines(recording, scenario.model, np.random.default_rng(seed)).values[None]
    candidates, _ = swept(recording, scenario.model, seed, known)
    delay = scenario.model.keys.index("tdvis")
    off = np.abs(candidates[:, delay] - scenario.truth[delay])
    assert off[0] > 0.1, "the recording is no longer one on which the best start is wrong"
    assert len(candidates) > 1
    estimate = MLE().fit(recording, scenario.model, np.random.default_rng(seed))
    assert abs(estimate.values[delay] - scenario.truth[delay]) < 2.0 * estimate.std_error[delay]


def test_the_criterion_is_akaikes_with_its_correction() -> None:
    for model in NOISE_MODELS:
        count = len(model.keys) + 7 + 1
        plain = 500 * np.log(0.3) + 2 * count
        correction = 2 * count * (count + 1) / (500 - count - 1)
        assert criterion(model, 0.3, 500, 7) == pytest.approx(plain + correction)


def position_pilot() -> Scenario:
    """A pilot in position control, where the error shows the remnant at once."""
    return replace(
        PILOTS["lead-lag"],
        name="position",
        truth=(0.46, 0.4, 2.8, 0.23, 10.5, 0.5),
        element=element_named("6"),
        disturbance=None,
        remnant=Remnant(1, 11.0, 0.7, 0.12, "ratio"),
    )


def test_every_start_is_judged_in_one_band() -> None:
    """The band follows from the forcing lines, not from where a search ended."""
    recording = simulate(replace(position_pilot(), dt=0.01), np.random.default_rng(1))
    model, rng = position_pilot().model, np.random.default_rng(0)
    first = first_fit(recording, model, MLE(), lines_pilot(recording, model, rng), rng)
    assert first.joint.band == Band(0.01, 2)
    near, far = maxima_from(recording, model, MLE(), model.start * np.array([[1.0], [1.3]]))
    assert near.joint.band == far.joint.band


def test_the_band_is_wider_where_the_loop_gain_is_flat_above_band() -> None:
    wide = fit_of(MLE(), replace(position_pilot(), dt=0.01))
    usual = fit_of(MLE(), NOMINAL)
    assert usual.remnant.omega[-1] < 53.0
    assert wide.remnant.omega[-1] > 100.0
    direct = fit_of(MLE(loop=False), replace(position_pilot(), dt=0.01))
    assert direct.remnant.omega[-1] > 100.0
    assert fit_of(MLE(wide=()), position_pilot()).remnant.omega[-1] < 53.0


def test_criteria_from_the_optimum_and_from_the_truth_agree() -> None:
    recording = simulate(NOMINAL, np.random.default_rng(5))
    estimate = fit_of(MLE(), NOMINAL)
    own, true = MLE().criteria_from(recording, NOMINAL.model, np.array([estimate.values, TRUTH]))
    assert abs(own - true) < WRONG


# ------------------------------------------------------------------ who follows the control

TRUTH = NOMINAL.values
#: A pilot who does next to nothing.
IDLE = np.concatenate([[1e-3 * TRUTH[0]], TRUTH[1:3], [1e-3 * TRUTH[3]], TRUTH[4:]])


def following(known: FloatArray) -> PilotCheck:
    recording = simulate(NOMINAL, np.random.default_rng(1))
    return PilotCheck(predict(recording, NOMINAL.model, 50.0).binned, known)


def test_the_lines_alone_tell_the_pilot_where_there_is_no_remnant() -> None:
    recording = simulate(without_remnant(NOMINAL), np.random.default_rng(1))
    found = fit_lines(recording, NOMINAL.model, np.random.default_rng(2))
    np.testing.assert_allclose(found.values, TRUTH, rtol=0.02)
    # Best of all at the lines, but for what each of the two ways of fitting leaves.
    others = np.array([found.values, 1.2 * TRUTH, IDLE])
    misfits = [replace(found, values=values).misfit for values in others]
    assert np.argmin(misfits) == 0


def test_the_lines_optimum_does_not_depend_on_the_starts() -> None:
    recording = simulate(NOMINAL, np.random.default_rng(3))
    ends = [
        fit_lines(recording, NOMINAL.model, np.random.default_rng(seed)).minimised().values
        for seed in range(3)
    ]
    np.testing.assert_allclose(ends[1:], [ends[0], ends[0]], rtol=0.02)


def test_who_explains_far_less_than_the_lines_pilot_does_not_follow() -> None:
    judged = following(TRUTH[None])
    own, idle = judged.explained(np.array([TRUTH, IDLE]))
    assert 0.6 < own < 1.0  # a remnant of 20 % or less is left
    assert idle < MIN_VAF_RATIO * own
    np.testing.assert_array_equal(judged.ranks(np.array([TRUTH, IDLE])), [2, 0])
    # What stands behind the pilot's parameters is not looked at.
    behind = np.hstack([np.array([TRUTH, IDLE]), np.full((2, 3), np.nan)])
    np.testing.assert_array_equal(judged.ranks(behind), [2, 0])
    assert (following(np.zeros((0, len(TRUTH)))).ranks(np.array([TRUTH, IDLE])) == 2).all()
    # Such ends are left out unless none follows.
    ends = minima_at(np.array([IDLE, TRUTH]), np.array([1.0, 2.0]))
    np.testing.assert_array_equal(judged.which(ends), [1])
    none = replace(ends, values=np.array([IDLE, IDLE]))
    np.testing.assert_array_equal(judged.which(none), [0, 1])


@pytest.mark.parametrize("case", [("short", 1030048), ("odd-forcing", 1030112)])
def test_hidden_and_exchanged_pilots_are_found(case: tuple[str, int]) -> None:
    recording, model, truth = of_stratum(*case)
    estimate = MLE().fit(recording, model, np.random.default_rng(1))
    true = np.array([truth[key] for key in model.keys])
    assert (np.abs(estimate.values - true) < 2.0 * estimate.std_error).all()


def test_an_optimum_that_is_no_pilot_did_not_converge(monkeypatch: pytest.MonkeyPatch) -> None:
    assert fit_of(MLE(), NOMINAL).outcome is Outcome.CONVERGED
    monkeypatch.setattr(PilotCheck, "ranks", lambda _, sets: np.zeros(len(sets), dtype=int))
    refused = fit_of(MLE(), NOMINAL), fit_of(Bayes(), NOMINAL)
    assert {estimate.outcome for estimate in refused} == {Outcome.CONTRADICTED}
    assert refused[1].draws is None  # which takes its time


def test_a_level_that_a_late_change_never_reaches_does_not_widen_the_band() -> None:
    scenario = scenario_named("adapting-fast")
    model, recording = scenario.model, simulate(scenario, np.random.default_rng(1))
    joint = Likelihood(predict(recording, model, 50.0), FIRST_NOISE_MODEL)
    ends = with_remnants(joint, scenario.values[None])
    assert wide_enough(Optimum(joint, ends))
    late = ends.values.copy()
    late[0, list(model.change)] = 1e4, 100.0
    rows = joint.prediction.row_spectra(late[:, : len(model.keys)])[0, :-1]
    assert np.count_nonzero(~rows.any(axis=(1, 2))) > len(model.change)
    assert wide_enough(Optimum(joint, replace(ends, values=late)))


def test_few_frequencies_hold_what_the_lines_of_both_functions_say() -> None:
    # Of groups of bins that hold one line the response counts at the line, not at their middle.
    model = MODELS["pursuit"]
    known = dict(zip(NOMINAL.model.keys, TRUTH.tolist(), strict=True))
    pilot = {key: known[key] for key in ("Kvis", "tlead", "tdvis", "fnm", "dnm")}
    near = model.vector({**pilot, "Kt": 0.2, "tlagt": 0.4, "tdt": 0.14})
    scenario = replace(without_remnant(NOMINAL), model=model, truth=tuple(near))
    prediction = predict(simulate(scenario, np.random.default_rng(2)), model, 50.0)
    idle = model.vector({**pilot, "Kvis": 1e-6, "Kt": 1e-6, "tlagt": 0.4, "tdt": 0.14})
    power = Likelihood(prediction.binned).gram(np.array([near, idle]))[:, -1, -1]
    assert power[0] < 0.0012 * power[1]  # .0020 at the middles


def test_an_autoregression_is_fitted_where_the_filter_before_it_ends_at_a_bound() -> None:
    """It is 13 behind at the first pilot, and thousands ahead in the end."""
    scenario, both = scenario_named("target-step"), []
    for noise in (None, LowPass(2)):
        recording, rng = simulate(scenario, np.random.default_rng(1)), np.random.default_rng(1)
        both += [search.maximise_likelihood(recording, scenario.model, rng, MLE(noise=noise))]
    assert both[0].criterion < both[1].criterion - 1000.0


def test_beside_what_is_known_or_far_ahead_no_other_remnant_is_fitted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    recording = simulate(NOMINAL, np.random.default_rng(1))
    prediction = predict(recording, NOMINAL.model, 50.0)
    at = search.RemnantChoice(prediction, TRUTH, LowPass(2)).suited_fit()
    far = replace(at, end=replace(at.end, values=at.end.values * 1.5))
    monkeypatch.setattr(search, "contenders", lambda *a: guesses(*a[:2], [LowPass(2), LowPass(1)]))
    for known, behind, fits in (([], 0.0, 2), ([at], 1e5, 0), ([far], 1e5, 2), ([far], -1e5, 1)):
        monkeypatch.setattr(search, "BEHIND_CRITERION", behind)
        choice = search.RemnantChoice(prediction, TRUTH, None)
        choice.suited_fit(known=known)
        assert len(choice._fits) == fits
