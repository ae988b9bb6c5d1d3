"""Pilots who change: models whose parameters vary in time, their scenarios, and who fits them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import differences, recording_of, without_remnant

from pilotid.datasets import SCENARIOS, Scenario, experiments, simulate
from pilotid.datasets.experiments import bound_of
from pilotid.datasets.stepping import stepped
from pilotid.estimate.estimate import Estimate, Outcome
from pilotid.estimate.method import identify
from pilotid.likelihood.choice import default_candidates
from pilotid.likelihood.likelihood import Likelihood
from pilotid.likelihood.prediction import predict
from pilotid.likelihood.search import maximise_likelihood
from pilotid.methods import METHODS
from pilotid.methods.bayes import Bayes
from pilotid.methods.mle import MLE
from pilotid.methods.mle_white import MLEWhite
from pilotid.model.catalogue import ADAPTING, SINGLE, fault_of
from pilotid.model.channel import Changing
from pilotid.model.factors import Delay, Differentiator, Gain, Lead, Neuromuscular
from pilotid.model.model import Channel, PilotModel
from pilotid.solve.least_squares import Box, minimise
from pilotid.study.run import truths_of
from pilotid.support.numbers import recording_rng
from pilotid.support.types import FloatArray

pytestmark = pytest.mark.numerical

SLOW, FAST = SCENARIOS["adapting-slow"], SCENARIOS["adapting-fast"]
both = pytest.mark.parametrize("scenario", [SLOW, FAST], ids=lambda s: s.name)
#: A step between samples, and a change that takes the whole run.
SETS = np.array(
    [[0.09, 0.06, 0.5, 1.3, 41.013, rate, 0.25, 11.0, 0.3] for rate in (0.05, 0.5, 9.0, 90.0)]
)

#: A structure of one's own: a lead that changes on a channel whose gain does not.
OWN = PilotModel(
    "learner",
    (
        Channel(
            "visual", "error", 1, (Gain("Kvis"), Changing((Lead(),)), Delay(), Neuromuscular())
        ),
        Channel(
            "motion",
            "output",
            -1,
            (Differentiator(1), Changing((Gain("Km"),)), Delay("tdm"), Neuromuscular()),
        ),
    ),
)


def test_runs_that_are_rotated_into_one_another_have_the_same_likelihood() -> None:
    recording = simulate(replace(SLOW, runs=4), recording_rng(5, "rotated"))
    prediction = predict(recording, ADAPTING, 50.0)
    rotation = np.linalg.qr(np.random.default_rng(5).standard_normal((4, 4))).Q
    given, rotated = (Likelihood(p).gram(SETS) for p in (prediction, prediction.mixed(rotation)))
    np.testing.assert_allclose(rotated, given, rtol=1e-9, atol=1e-9 * np.abs(given).max())
    two = prediction.binned
    assert two.runs == 2
    # The forcing function is the same in all runs.
    power = [np.sum(p.control**2) for p in (two, prediction)]
    assert power[0] > 0.8 * power[1]
    one = prediction.mixed(np.eye(4)[[1]])
    assert one.binned is one


def test_every_changing_parameter_is_two_and_the_rest_is_one() -> None:
    assert ADAPTING.keys == (
        "Kvis1", "Kvis2", "tlead1", "tlead2", "tmid", "rate", "tdvis", "fnm", "dnm",
    )  # fmt: skip
    assert ADAPTING.linear == (0, 1)
    assert ADAPTING.changes
    assert not SINGLE.changes
    assert OWN.keys == (
        "Kvis", "tlead1", "tlead2", "tmid", "rate", "tdvis", "Km1", "Km2", "tdm", "fnm", "dnm",
    )  # fmt: skip
    assert fault_of(OWN) == ""


def test_frozen_it_is_the_constant_pilot_of_each_time() -> None:
    assert ADAPTING.constant.keys == SINGLE.keys
    assert SINGLE.constant is SINGLE
    before, after = (SLOW.values[i] for i in ADAPTING.ends)
    np.testing.assert_allclose(before, [0.09, 0.4, 0.28, 11.25, 0.35])
    np.testing.assert_allclose(after, [0.07, 1.2, 0.28, 11.25, 0.35])
    changing = ADAPTING.channels[0].changing
    times = np.array([41.92, 41.92 - 4.0, 41.92 + 4.0])
    gains, products = changing.weights(times, SLOW.values[:6])
    shares = 1.0 / (1.0 + np.exp(-0.5 * (times - 41.92)))
    kvis, tlead = (b + shares * (a - b) for b, a in zip(before[:2], after[:2], strict=True))
    np.testing.assert_allclose(gains, kvis, rtol=1e-12)
    np.testing.assert_allclose(products, kvis * tlead, rtol=1e-12)


@pytest.mark.parametrize("band", [None, 120.0, 50.0])
def test_a_change_by_nothing_is_the_constant_model(band: float | None) -> None:
    recording = recording_of(SLOW)
    constant = np.array([0.08, 0.9, 0.25, 11.0, 0.3])
    same = np.array([0.08, 0.08, 0.9, 0.9, 40.0, 20.0, 0.25, 11.0, 0.3])
    expected = predict(recording, SINGLE, band)
    left = expected.errors(constant)
    found = predict(recording, ADAPTING, band).errors(same)
    assert np.std(found - left) < 5e-4 * np.std(expected.control - left)


@pytest.mark.parametrize(
    ("scenario", "model", "sets", "band", "within"),
    [
        (replace(SLOW, runs=2), ADAPTING, SETS, None, 1e-5),
        (replace(SLOW, runs=2), ADAPTING, SETS, 50.0, 1e-5),
        (SCENARIOS["nominal"], OWN, OWN.start[None], 50.0, 1e-4),
    ],
)
def test_the_jacobian_is_that_of_finite_differences(
    scenario: Scenario, model: PilotModel, sets: FloatArray, band: float | None, within: float
) -> None:
    prediction = predict(simulate(scenario, np.random.default_rng(1)), model, band)
    rows = prediction.samples_of(prediction.row_spectra(sets))
    for values, own in zip(sets, rows, strict=True):
        expected = -differences(
            lambda v: prediction.samples_of(prediction.row_spectra(v[None]))[0, -1],
            values,
            1e-6 * np.maximum(values, 0.01),
        )
        # OWN's lead does not change at the start: nothing depends on when.
        size = np.maximum(np.abs(own[:-1]).max(axis=(1, 2)), 1e-6)
        assert np.all(np.abs(expected - own[:-1]).max(axis=(1, 2)) < within * size)


def test_all_ways_to_the_residual_agree() -> None:
    prediction = predict(simulate(replace(SLOW, runs=2), np.random.default_rng(1)), ADAPTING, 50.0)
    spectra = prediction.row_spectra(SETS)[:, -1]
    np.testing.assert_allclose(prediction.residual_spectra(SETS), spectra, atol=1e-9)
    for values, own in zip(SETS, spectra, strict=True):
        left = prediction.without_nuisance(prediction.samples_of(own))
        np.testing.assert_allclose(prediction.errors(values), left, atol=1e-12)
    assert prediction.binned is prediction
    second = prediction.mixed(np.eye(2)[[1]])
    np.testing.assert_allclose(second.row_spectra(SETS)[:, -1], spectra[:, 1:], atol=1e-12)


# ------------------------------------------------------------------ scenarios


def clean(scenario: Scenario, step: float = 0.005) -> tuple[FloatArray, FloatArray]:
    """Control and output without remnant, shape (samples,)."""
    samples = round((scenario.run_in + scenario.duration) / scenario.dt)
    u, x = stepped(scenario, np.zeros((1, 2 * samples)), 1.0, step)
    return u[0], x[0]


def integrated(scenario: Scenario, h: float = 0.001) -> tuple[FloatArray, FloatArray]:
    """The same by another way: Heun's method on all states, the delay by a buffer."""
    gain1, gain2, lead1, lead2, middle, rate, delay, f, d = scenario.truth
    late, begin = round(delay / h), -60.0 - scenario.run_in
    time = begin + h * np.arange(round((scenario.duration - begin) / h) + 1)
    share = 1.0 / (1.0 + np.exp(np.clip(-rate * (time - middle), -700.0, 700.0)))
    kvis, lead = gain1 + (gain2 - gain1) * share, lead1 + (lead2 - lead1) * share
    ends = (scenario.element, scenario.change.after)
    k1, k2 = (float(element.numerator[0]) for element in ends)
    b1, b2 = (float(element.denominator[1]) for element in ends)
    gain, damping = k1 + (k2 - k1) * share, b1 + (b2 - b1) * share
    target = scenario.target.at(time)
    slope = np.gradient(target, h, edge_order=2)
    state, seen = np.zeros(4), np.zeros(time.size)  # x, dx/dt, u, du/dt
    us, xs = np.zeros(time.size), np.zeros(time.size)

    def change(state: FloatArray, k: int) -> FloatArray:
        _x, v, u, w = state
        command = seen[k - late] if k >= late else 0.0
        return np.array(
            [v, gain[k] * u - damping[k] * v, w, f * f * (command - u) - 2.0 * d * f * w]
        )

    for k in range(time.size - 1):
        us[k], xs[k] = state[2], state[0]
        seen[k] = kvis[k] * (target[k] - state[0] + lead[k] * (slope[k] - state[1]))
        first = change(state, k)
        state = state + 0.5 * h * (first + change(state + h * first, k + 1))
    recorded = slice(round(60.0 / h), time.size - 1, round(scenario.dt / h))
    return us[recorded], xs[recorded]


@pytest.mark.long
@both
def test_simulation_is_exact_enough_and_agrees_with_another_way(scenario: Scenario) -> None:
    u, x = clean(scenario)
    finer = clean(scenario, 0.0025)
    for found, half in zip((u, x), finer, strict=True):
        assert np.std(found - half) < 5e-4 * np.std(half)
    for found, other in zip(finer, integrated(scenario), strict=True):
        assert np.std(found - other) < 2e-3 * np.std(other)


#: Bounds are kept by scenario; under this name they are from a third of the usual recordings,
#: which gives them to 5 %.
BOUNDED = replace(SLOW, name="bounded")
RECORDINGS = 8


@pytest.fixture(scope="module")
def bound() -> FloatArray:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(experiments, "RECORDINGS", RECORDINGS)
        return bound_of(BOUNDED)


# ------------------------------------------------------------------ fits


@both
def test_without_remnant_the_pilot_comes_back(scenario: Scenario) -> None:
    recording = simulate(without_remnant(scenario), np.random.default_rng(1))
    found = identify(MLEWhite(), recording, ADAPTING, np.random.default_rng(2))
    assert found.outcome.usable
    keys = [i for i, key in enumerate(ADAPTING.keys) if key != "rate"]
    np.testing.assert_allclose(found.values[keys], scenario.values[keys], rtol=3e-3)
    assert found.vaf > 99.99
    rate = float(found.values[ADAPTING.keys.index("rate")])
    assert rate > 20.0 if scenario is FAST else abs(rate - 0.5) < 0.01


@pytest.fixture(scope="module")
def fit() -> Estimate:
    return identify(MLE(), recording_of(SLOW), ADAPTING, np.random.default_rng(2))


def test_mle_finds_the_change(fit: Estimate, bound: FloatArray) -> None:
    assert [bound for *_, bound in truths_of(BOUNDED)] == pytest.approx(bound.tolist(), rel=1e-3)
    assert fit.outcome is Outcome.CONVERGED
    off = np.abs(fit.values - SLOW.values) / bound
    assert np.all(np.delete(off, ADAPTING.keys.index("rate")) < 4.0)
    constant = identify(MLE(), recording_of(SLOW), SINGLE, np.random.default_rng(2))
    assert fit.vaf > constant.vaf + 2.0
    assert {"Kvis1*tlead1", "Kvis2*tlead2"} <= {q.key for q in fit.quantities}


@pytest.mark.long
def test_bayes_agrees_with_mle(fit: Estimate) -> None:
    found = identify(Bayes(), recording_of(SLOW), ADAPTING, np.random.default_rng(2))
    assert found.outcome.usable
    off = np.abs(found.values - fit.values) / fit.std_error
    assert np.all(np.delete(off, ADAPTING.keys.index("rate")) < 1.0)


def test_methods_that_know_constant_pilots_alone_say_so() -> None:
    recording = recording_of(SLOW)
    refusing = {
        name
        for name, method in METHODS.items()
        if "varies in time" in (method.objection(recording, ADAPTING) or "")
    }
    assert refusing == {"mmle3", "mle-reference", "fourier", "arx", "sindy"}
    for name in refusing:
        assert "varies in time" not in (METHODS[name].objection(recording, SINGLE) or "")
    assert not any(model.changes for model in default_candidates(recording))


def test_intervals_of_when_go_to_the_joint_level_of_two_parameters() -> None:
    quiet = replace(SLOW, remnant=replace(SLOW.remnant, level=0.01))
    recording = simulate(quiet, np.random.default_rng(1))
    found = maximise_likelihood(recording, ADAPTING, np.random.default_rng(2), MLE())
    intervals = identify(MLE(), recording, ADAPTING, np.random.default_rng(2)).intervals
    joint, end = found.joint, found.end
    freedom = joint.residuals - end.values.shape[1]
    for key, level in (("tlead2", 3.841), ("tmid", 5.991), ("rate", 5.991)):
        which = ADAPTING.keys.index(key)
        for value in intervals[which]:
            space = Box.holding(joint, which, value)
            start = np.clip(end.values[:1], space.lower, space.upper)
            held = minimise(joint.gram, start, space, tolerance=1e-5)
            deviance = freedom * np.log(held.cost[0] / end.cost[0]) / found.variance_factor
            assert deviance == pytest.approx(level, rel=0.1)
