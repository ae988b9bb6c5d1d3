"""Pilots who change freely, along splines, and pilots who become another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import recording_of, without_remnant
from scipy.integrate import quad
from scipy.interpolate import CubicSpline

from pilotid.datasets import SCENARIOS, simulate
from pilotid.estimates.estimate import Estimate
from pilotid.estimates.fitted import Fitted
from pilotid.estimates.method import identify
from pilotid.methods import methods
from pilotid.methods.bayes import Bayes
from pilotid.methods.mle import MLE
from pilotid.methods.mle_white import MLEWhite
from pilotid.model_choice import default_candidates
from pilotid.pilot.catalogue import ADAPTING, ADAPTING_FREE, SINGLE, fault_of
from pilotid.pilot.factors import Delay, Gain, Lag, Lead, Neuromuscular, Parameter
from pilotid.pilot.model import (
    Channel,
    PilotModel,
)
from pilotid.pilot.timevarying import Changing, Curve, Fading, Sigmoid, Spline
from pilotid.posterior.priors import LogUniform, priors_of
from pilotid.recordings.recording import Recording
from pilotid.remarks import codes_of
from pilotid.report.fit import html_report
from pilotid.solve.least_squares import Penalty
from pilotid.solve.smoothing import Restricted
from pilotid.time_domain.prediction import predict
from pilotid.time_domain.remnant_models import LowPass
from pilotid.types import FloatArray

pytestmark = pytest.mark.numerical

SLOW, FAST = SCENARIOS["adapting-slow"], SCENARIOS["adapting-fast"]
#: A pilot who stays, of an element that stays.
STAYS = replace(SLOW, truth=(0.08, 0.08, 0.7, 0.7, 41.92, 0.5, 0.28, 11.25, 0.35), change=None)


def side(number: int) -> Channel:
    """A pilot before (1) or after (2) a change."""
    return Channel(
        ("before", "after")[number - 1],
        "error",
        1,
        (
            Fading((Gain(f"Kvis{number}", 0.25), Lead(f"tlead{number}")), after=number == 2),
            Delay(f"tdvis{number}"),
            Neuromuscular(f"fnm{number}", f"dnm{number}"),
        ),
    )


#: A pilot who becomes another.
OTHER = PilotModel("other", (side(1), side(2)))


def varied(model: PilotModel) -> FloatArray:
    """Two sets of parameters that differ from the start, (2, parameters)."""
    rng = np.random.default_rng(5)
    sets = model.start * np.exp(0.2 * rng.standard_normal((2, len(model.keys))))
    for i, key in enumerate(model.keys):
        if key == "tmid":
            sets[:, i] = 41.013, 30.0
    return np.asarray(sets)


# ------------------------------------------------------------------ courses


def test_a_free_parameter_is_its_values_at_the_knots() -> None:
    assert ADAPTING_FREE.keys[:2] == ("Kvis00", "Kvis01")
    assert ADAPTING_FREE.keys[12:14] == ("Kvis12", "tlead00")
    assert ADAPTING_FREE.keys[-3:] == ("tdvis", "fnm", "dnm")
    assert ADAPTING_FREE.linear == ()
    assert fault_of(ADAPTING_FREE) == ""
    assert ADAPTING_FREE.searched.keys == SINGLE.keys
    assert ADAPTING.searched is ADAPTING
    model, values = ADAPTING_FREE.over(60.0), varied(ADAPTING_FREE)
    assert model.over(60.0) == model
    at_knots = model.over_time(values, 5.0 * np.arange(13))
    for knot in (0, 5, 12):
        np.testing.assert_allclose(at_knots[:, 0, knot], values[:, knot], rtol=1e-12)
        np.testing.assert_allclose(at_knots[:, 1, knot], values[:, 13 + knot], rtol=1e-12)
    first, last = (values[..., i] for i in ADAPTING_FREE.ends)
    beyond = model.over_time(values, np.array([-4.0, 64.0]))
    np.testing.assert_allclose(beyond[..., 0], first, rtol=1e-12)
    np.testing.assert_allclose(beyond[..., 1], last, rtol=1e-12)
    with pytest.raises(ValueError, match="once the model is `over` some seconds"):
        ADAPTING_FREE.over_time(values, np.array([1.0]))


def test_roughness_is_the_integral_of_the_squared_second_derivative() -> None:
    matrix = Spline(5).roughness
    logs = np.array([0.1, 0.7, -0.2, 0.4, 0.3, 0.9])
    spline = CubicSpline(np.arange(6.0), logs, bc_type="natural")
    expected = sum(quad(lambda t: float(spline(t, 2)) ** 2, k, k + 1)[0] for k in range(5))
    assert logs @ matrix @ logs == pytest.approx(expected, rel=1e-9)
    np.testing.assert_allclose(matrix @ (2.0 + 0.3 * np.arange(6.0)), 0.0, atol=1e-12)


def test_what_a_course_refuses() -> None:
    with pytest.raises(ValueError, match="3 to 99 intervals"):
        Spline(2)
    with pytest.raises(ValueError, match="has no logarithm"):
        Spline().parameters((Parameter("a", "", -1.0, 1.0, 0.5, (-0.5, 0.9), positive=False),))
    with pytest.raises(ValueError, match="goes along a Sigmoid"):
        Fading((Gain("K"),), Spline())
    with pytest.raises(ValueError, match="whole channels by Fading"):
        Changing((Lag(),), Spline())


@pytest.mark.parametrize("model", [ADAPTING, ADAPTING_FREE, OTHER], ids=lambda m: m.name)
def test_a_constant_pilot_is_one_of_each_model(model: PilotModel) -> None:
    recording = recording_of(SLOW)
    found = predict(recording, model, 50.0).residual(model.of_constant(model.constant.start))
    expected = predict(recording, SINGLE, 50.0)
    left = expected.residual(SINGLE.start)
    assert np.std(found - left) < 1e-3 * np.std(expected.control - left)


@pytest.mark.parametrize("band", [None, 50.0])
@pytest.mark.parametrize("model", [ADAPTING_FREE, OTHER], ids=lambda m: m.name)
def test_the_jacobian_is_that_of_finite_differences(model: PilotModel, band: float | None) -> None:
    prediction = predict(simulate(replace(SLOW, runs=2), np.random.default_rng(1)), model, band)
    sets = varied(model)
    rows = prediction.rows(sets)
    for values, own in zip(sets, rows, strict=True):
        for i, slope in enumerate(own[:-1]):
            step = 1e-5 * values[i] * np.eye(len(values))[i]
            ends = prediction.rows(np.array([values - step, values + step]))[:, -1]
            found = (ends[0] - ends[1]) / (2.0 * step[i])
            assert np.max(np.abs(found - slope)) < 1e-5 * np.max(np.abs(slope)), model.keys[i]


def test_the_stepped_pilot_along_a_spline_is_the_predicted_one() -> None:
    gain, lead = 0.08 + 0.01 * np.sin(np.arange(13.0)), 0.6 + 0.02 * np.arange(13.0)
    truth = (*gain, *lead, 0.28, 11.25, 0.35)
    scenario = replace(without_remnant(STAYS), model=ADAPTING_FREE, truth=truth)
    prediction = predict(simulate(scenario, np.random.default_rng(1)), ADAPTING_FREE, 50.0)
    left = prediction.residual(np.array(truth))
    assert np.std(left) < 3e-3 * np.std(prediction.control)


# ------------------------------------------------------------------ smoothing


def test_a_penalty_is_a_sum_of_squares() -> None:
    curves = tuple(
        Curve(key, tuple(range(first, first + 4)), Spline(3).roughness)
        for key, first in (("a", 0), ("b", 4))
    )
    penalty = Penalty(curves, np.array([2.0, 0.5]))
    assert penalty.rank == 4
    sets = np.exp(np.random.default_rng(1).standard_normal((3, 9)))
    grams = penalty.gram(sets)
    np.testing.assert_allclose(grams[:, -1, -1], penalty.of(sets), rtol=1e-12)
    for i in range(8):
        step = 1e-6 * sets[0, i] * np.eye(9)[i]
        ends = penalty.of(np.array([sets[0] - step, sets[0] + step]))
        # The cost falls by twice J'r for each step.
        slope = (ends[0] - ends[1]) / (4.0 * step[i])
        assert grams[0, i, -1] == pytest.approx(slope, rel=1e-6, abs=1e-8)
    assert not grams[:, 8].any()


def test_weights_are_those_of_the_largest_marginal_likelihood() -> None:
    """Against the density of the data themselves, all parameters integrated out."""
    rng = np.random.default_rng(3)
    matrix = Spline(8).roughness
    design = rng.standard_normal((40, 10))  # nine knots, and a parameter without a penalty
    data = design @ np.concatenate([np.sin(np.arange(9.0)), [0.5]]) + rng.standard_normal(40)
    curves = (Curve("a", tuple(range(9)), matrix),)
    point = rng.standard_normal(10)
    left = data - design @ point
    gram = np.empty((11, 11))
    gram[:-1, :-1], gram[:-1, -1], gram[-1, -1] = design.T @ design, design.T @ left, left @ left
    gram[-1, :-1] = gram[:-1, -1]
    restricted = Restricted(gram, point, curves, 40)

    straight = np.zeros((10, 3))
    straight[:9, 0], straight[:9, 1], straight[9, 2] = 1.0, np.arange(9.0), 1.0
    contrasts = np.linalg.svd(design @ straight)[0][:, 3:]  # data free of what is not penalised
    spread = np.zeros((10, 10))
    spread[:9, :9] = np.linalg.pinv(matrix)

    def direct(log: float) -> float:
        """-2 log of the density of contrasts and weight, the residuals' variance at its best."""
        covariance = contrasts.T @ (np.eye(40) + np.exp(-log) * design @ spread @ design.T)
        covariance = covariance @ contrasts
        own = contrasts.T @ data
        squares = own @ np.linalg.solve(covariance, own)
        likelihood = 37.0 * np.log(squares) + np.linalg.slogdet(covariance)[1]
        return float(likelihood + log)  # and a flat density of the standard deviation exp(-log/2)

    logs = np.array([-3.0, 0.0, 2.0, 5.0])
    found = [restricted(np.array([log]))[0] - direct(log) for log in logs]
    np.testing.assert_allclose(found, found[0], atol=1e-6)
    for log in logs:
        ends = [restricted(np.array([log + step]))[0] for step in (-1e-4, 1e-4)]
        slope = restricted(np.array([log]))[1][0]
        assert slope == pytest.approx((ends[1] - ends[0]) / 2e-4, rel=1e-5, abs=1e-5)
    best = restricted.best()[0]
    assert (
        direct(best) <= min(direct(log) for log in np.linspace(best - 4.0, best + 4.0, 81)) + 1e-6
    )
    assert restricted.degrees(np.array([20.0]))[0] == pytest.approx(2.0, abs=1e-3)
    assert restricted.degrees(np.array([-20.0]))[0] == pytest.approx(9.0, abs=1e-3)


# ------------------------------------------------------------------ fits


@pytest.mark.parametrize(("intervals", "off"), [(12, (0.01, 0.05)), (24, (0.002, 0.006))])
def test_without_remnant_the_course_comes_back(intervals: int, off: tuple[float, float]) -> None:
    channel = ADAPTING_FREE.channels[0]
    changing = channel.changing
    assert changing is not None
    factors = (replace(changing, course=Spline(intervals)), *channel.dynamics)
    model = replace(ADAPTING_FREE, channels=(replace(channel, factors=factors),))
    recording = simulate(without_remnant(SLOW), np.random.default_rng(1))
    found = identify(MLEWhite(), recording, model, np.random.default_rng(2))
    assert found.outcome.usable
    assert found.trajectory is not None
    truth = ADAPTING.over_time(SLOW.values, found.trajectory.time)
    error = np.sqrt(np.mean((found.trajectory.values / truth - 1.0) ** 2, axis=1))
    assert tuple(error[:2] < off) == (True, True)
    np.testing.assert_allclose(error[2:], 0.0, atol=2e-3)


@pytest.fixture(scope="module")
def fit() -> Estimate:
    return identify(MLE(), recording_of(SLOW), ADAPTING_FREE, np.random.default_rng(2))


def test_mle_finds_a_course_that_resembles_the_sigmoid(fit: Estimate) -> None:
    assert fit.outcome.usable
    assert fit.trajectory is not None
    truth = ADAPTING.over_time(SLOW.values, fit.trajectory.time)
    error = np.sqrt(np.mean(np.log(fit.trajectory.values / truth) ** 2, axis=1))
    assert np.all(error < 0.35)
    lead = fit.trajectory.values[1]
    assert lead[-1] > 1.5 * lead[0]
    constant = identify(MLE(), recording_of(SLOW), SINGLE, np.random.default_rng(2))
    assert fit.vaf > constant.vaf + 1.0


@pytest.mark.long
def test_bayes_agrees_with_mle(fit: Estimate) -> None:
    found = identify(Bayes(), recording_of(SLOW), ADAPTING_FREE, np.random.default_rng(2))
    assert found.outcome.usable
    assert np.all(np.abs(found.values - fit.values) < fit.std_error)
    np.testing.assert_allclose(found.std_error, fit.std_error, rtol=0.4)


def test_a_pilot_who_stays_is_a_line_and_costs_no_precision() -> None:
    recording = simulate(STAYS, np.random.default_rng(4))
    free = identify(MLE(), recording, ADAPTING_FREE, np.random.default_rng(2))
    constant = identify(MLE(), recording, SINGLE, np.random.default_rng(2))
    np.testing.assert_allclose(free.std_error[-3:], constant.std_error[-3:], rtol=0.2)
    assert np.all(np.abs(free.values[-3:] - constant.values[-3:]) < constant.std_error[-3:])
    for curve in (free.values[:13], free.values[13:26]):
        assert np.ptp(np.diff(np.log(curve))) < 0.1


@pytest.mark.long
def test_remarks_are_few_and_pages_show_both_ends(fit: Estimate) -> None:
    assert len(fit.remarks) <= 4
    for pair in fit.inseparable:
        assert pair.first[:4] != pair.second[:4]
    page = html_report([Fitted(recording_of(SLOW), ADAPTING_FREE, (fit,))])
    assert "after the change" in page


def test_of_a_curve_the_penalty_is_the_prior() -> None:
    first, *_, delay = priors_of(ADAPTING_FREE, LowPass(0))[:27]
    assert isinstance(first, LogUniform)
    assert not isinstance(delay, LogUniform)
    assert quad(lambda x: float(np.exp(first.logpdf(np.array(x)))), 0.01, 0.1)[0] == pytest.approx(
        1.0 / 12.0  # of the decades of a gain's bounds
    )
    drawn = first.draw(np.random.default_rng(1), 1000)
    assert 1e-6 <= drawn.min() < 1e-4 < 1e4 < drawn.max() <= 1e6


def test_a_sandwich_holds_the_curves_together() -> None:
    method = MLEWhite(covariance="sandwich")
    found = identify(method, recording_of(SLOW), ADAPTING_FREE, np.random.default_rng(2))
    claimed = identify(MLEWhite(), recording_of(SLOW), ADAPTING_FREE, np.random.default_rng(2))
    np.testing.assert_array_equal(found.values, claimed.values)
    assert "white-remnant" in codes_of(found.remarks)
    # The remnant is not white, so that its scores spread further than the information says.
    assert np.all(found.std_error[-3:] > 1.3 * claimed.std_error[-3:])


def test_searches_from_elsewhere_end_in_the_same_optimum(fit: Estimate) -> None:
    moved = fit.values.copy()
    moved[:13] *= 1.3
    criteria = MLE().criteria_from(recording_of(SLOW), ADAPTING_FREE, np.array([fit.values, moved]))
    assert criteria[1] == pytest.approx(criteria[0], abs=0.5)


def test_methods_that_know_constant_pilots_alone_say_so_and_nobody_is_asked_unawares() -> None:
    recording = recording_of(SLOW)
    refusing = {
        name
        for name, method in methods().items()
        if "varies in time" in (method.objection(recording, ADAPTING_FREE) or "")
    }
    assert {"mmle3", "fourier", "arx", "sindy"} <= refusing
    assert not {"mle", "mle-white", "mle-genetic", "bayes"} & refusing
    assert not any(model.changes for model in default_candidates(recording))


# ------------------------------------------------------------------ a pilot who becomes another


def stepped(recording: Recording, rate: float, before: FloatArray, after: FloatArray) -> FloatArray:
    """The control of a pilot all of whose parameters go along a sigmoid, stepped through time."""
    h, count = 0.002, recording.e.shape[1]
    time = recording.time[0] + h * np.arange(round((count - 1) * recording.dt / h) + 1)
    error = CubicSpline(recording.time, recording.e[0])
    share = 0.5 + 0.5 * np.tanh(0.5 * rate * (time - 41.92))
    gain, lead, delay, f, d = np.asarray(before)[:, None] + np.outer(after - before, share)
    seen = np.interp(time - delay, time, gain * (error(time) + lead * error(time, 1)))
    u, x, w = np.zeros(time.size), 0.0, 0.0
    for k in range(time.size - 1):
        first = f[k] ** 2 * (seen[k] - x) - 2.0 * d[k] * f[k] * w
        x1, w1 = x + h * w, w + h * first
        second = f[k + 1] ** 2 * (seen[k + 1] - x1) - 2.0 * d[k + 1] * f[k + 1] * w1
        x, w = x + 0.5 * h * (w + w1), w + 0.5 * h * (first + second)
        u[k + 1] = x
    return u[:: round(recording.dt / h)]


BEFORE = np.array([0.09, 0.4, 0.20, 12.0, 0.3])


@pytest.mark.long
@pytest.mark.parametrize(
    ("rate", "after", "off"),
    [
        (100.0, (0.07, 1.2, 0.20, 12.0, 0.3), 0.005),  # gains in a step: exact but for the rate
        (100.0, (0.07, 1.2, 0.35, 9.0, 0.5), 0.05),
        (2.0, (0.07, 1.2, 0.35, 9.0, 0.5), 0.04),
        (0.5, (0.07, 1.2, 0.35, 9.0, 0.5), 0.07),
    ],
)
def test_fading_is_near_a_pilot_all_of_whose_parameters_change(
    rate: float, after: tuple[float, ...], off: float
) -> None:
    recording = simulate(SLOW, np.random.default_rng(3))
    given = {
        name: getattr(recording, name) for name in recording.__dataclass_fields__ if name != "u"
    }
    own = Recording(**given, u=stepped(recording, rate, BEFORE, np.array(after))[None])
    keys = ("Kvis", "tlead", "tdvis", "fnm", "dnm")
    both = {
        f"{key}{number}": value
        for number, end in ((1, BEFORE), (2, after))
        for key, value in zip(keys, end, strict=True)
    }
    truth = OTHER.vector({**both, "tmid": 41.92, "rate": rate})
    prediction = predict(own, OTHER, 50.0)
    assert np.std(prediction.residual(truth)) < off * np.std(prediction.control)
    if rate == 0.5:
        found = identify(MLEWhite(), own, OTHER, np.random.default_rng(1))
        share = np.abs(found.values / truth - 1.0)
        assert np.max(np.delete(share, OTHER.keys.index("rate"))) < 0.05


def test_a_pilot_who_becomes_another_is_frozen_whole() -> None:
    assert OTHER.keys[:5] == ("Kvis1", "tlead1", "tmid", "rate", "tdvis1")
    assert fault_of(OTHER) == ""
    first, last = (OTHER.start[i] for i in OTHER.ends)
    np.testing.assert_array_equal(first, last)
    assert "tmid" not in OTHER.constant.keys
    assert Sigmoid().over(3.0) == Sigmoid()
