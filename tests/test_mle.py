"""Remnant-aware maximum likelihood: Jacobian, intervals, consistency, global convergence."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from checks.strata import of_stratum
from helpers import NOMINAL, differences, fit_of, plane, without_remnant

from pilotid.checks.checks import remarks
from pilotid.datasets import SCENARIOS, Scenario, simulate
from pilotid.estimate.estimate import Outcome
from pilotid.estimate.method import identify
from pilotid.likelihood.likelihood import Likelihood
from pilotid.likelihood.prediction import predict
from pilotid.likelihood.remnant_models import Autoregressive, LowPass, NoiseModel
from pilotid.methods.mle import MLE
from pilotid.methods.mle_white import MLEWhite
from pilotid.model.catalogue import MULTI, SINGLE
from pilotid.solve.intervals import (
    ProfileSearch,
    covariance_at_bounds,
    errors_from,
    profile_intervals,
)
from pilotid.solve.least_squares import Box, minimise
from pilotid.support.numbers import CHI_SQUARED_95, Z95
from pilotid.support.types import FloatArray

pytestmark = pytest.mark.numerical

TRUTH = NOMINAL.values


def joint_of(scenario: Scenario, noise: NoiseModel, seed: int) -> Likelihood:
    recording = simulate(scenario, np.random.default_rng(seed))
    return Likelihood(predict(recording, scenario.model, 50.0), noise)


@pytest.mark.parametrize(
    ("noise", "values"),
    [(LowPass(2), [4.0, 0.6]), (LowPass(1), [6.0]), (Autoregressive(3), [-1.2, 0.4, -0.1])],
    ids=["low-pass 2", "low-pass 1", "AR(3)"],
)
def test_rows_by_pilot_and_remnant_agree_with_finite_differences(
    noise: NoiseModel, values: list[float]
) -> None:
    joint = joint_of(replace(NOMINAL, runs=2), noise, 1)
    point = np.concatenate([1.1 * TRUTH, values])
    rows = joint.rows(point[None])[0]
    # Rounding errs by 1e-5 of the largest element with a step of 1e-6, by 4e-7 with this.
    steps = 1e-5 * np.maximum(np.abs(point), 0.1)
    expected = -differences(lambda v: joint.rows(v[None])[0, -1], point, steps)
    size = np.abs(expected).max(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(rows[:-1] / size, expected / size, atol=1e-5)


AR6 = (-1.2, 0.4, -0.1, 0.05, 0.02, -0.03)


@pytest.mark.parametrize("offset", [0.0, 0.5, 1e6], ids=["none", "usual", "huge"])
@pytest.mark.parametrize(
    ("noise", "values"),
    [(LowPass(2), (4.0, 0.6)), (Autoregressive(6), AR6)],
    ids=["low-pass", "AR"],
)
def test_gram_holds_the_inner_products_of_the_rows(
    noise: NoiseModel, values: tuple[float, ...], offset: float
) -> None:
    recording = simulate(replace(NOMINAL, runs=2), np.random.default_rng(3))
    # What is projected out of the Jacobian as well as of the residual.
    shifted = replace(recording, e=recording.e + offset, u=recording.u + offset)
    joint = Likelihood(predict(shifted, MULTI, 50.0), noise)
    assert joint.prediction.nuisance_poles
    sets = np.array([[*(0.9 * TRUTH), *values], [*(1.1 * TRUTH), *values]])
    gram, rows = joint.gram(sets), joint.rows(sets)
    size = np.sqrt(np.einsum("spp->sp", gram))
    difference = gram - np.einsum("sprt,sqrt->spq", rows, rows)
    assert np.all(np.abs(difference) < 1e-8 * size[:, :, None] * size[:, None])


def test_noise_free_recording_gives_the_truth() -> None:
    estimate = fit_of(MLE(), without_remnant(NOMINAL))
    np.testing.assert_allclose(estimate.values, TRUTH, rtol=1e-3)


def test_profile_intervals_of_a_linear_problem_are_the_quadratic_ones() -> None:
    rng = np.random.default_rng(2)
    jacobian = rng.standard_normal((2, 400))
    truth = np.array([1.5, -0.5])
    data = truth @ jacobian + rng.standard_normal(400)

    def gram(sets: FloatArray) -> FloatArray:
        rows = np.stack([np.vstack([jacobian, data - v @ jacobian]) for v in sets])
        return rows @ rows.transpose(0, 2, 1)

    minimum = minimise(gram, np.zeros((1, 2)), plane(), tolerance=1e-14)
    inverse = np.diag(np.linalg.inv(jacobian @ jacobian.T))
    variance = minimum.cost[0] / 398.0
    unknown = profile_intervals(
        gram, plane(), minimum, variance, 2, estimated=398, tolerance=1e-6
    ).intervals
    # The likelihood of an unknown variance: freedom * log(cost / lowest) = chi-squared.
    reach = np.sqrt(minimum.cost[0] * np.expm1(CHI_SQUARED_95 / 398.0) * inverse)
    np.testing.assert_allclose(unknown[:, 0], minimum.values[0] - reach, rtol=1e-6)
    np.testing.assert_allclose(unknown[:, 1], minimum.values[0] + reach, rtol=1e-6)
    for widened in (1.0, np.array([1.0, 1.7])):  # of all, or of each
        known = profile_intervals(
            gram, plane(), minimum, 1.0, 2, widened=widened, tolerance=1e-6
        ).intervals
        reach = np.sqrt(widened * CHI_SQUARED_95 * inverse)
        np.testing.assert_allclose(known[:, 0], minimum.values[0] - reach, rtol=1e-6)
        np.testing.assert_allclose(known[:, 1], minimum.values[0] + reach, rtol=1e-6)


def test_profile_intervals_beside_a_parameter_at_its_bound() -> None:
    # Two correlated columns; the second's coefficient may not reach its optimum.  The deviance
    # is (a - a0)^2 + 2 r (a - a0)(b - b0) + (b - b0)^2 with b up to 1, a0 = 1, b0 = 3, r = .8.
    r, centre = 0.8, np.array([1.0, 3.0])
    root = np.linalg.cholesky(np.array([[1.0, r], [r, 1.0]])).T

    space = replace(plane(), upper=np.array([50.0, 1.0]))

    def gram(sets: FloatArray) -> FloatArray:
        rows = np.stack([np.vstack([root.T, root @ (centre - v)]) for v in sets])
        return np.asarray(rows @ rows.transpose(0, 2, 1))

    minimum = minimise(gram, np.zeros((1, 2)), space, tolerance=1e-14)
    # At b = 1 the best a is 1 + .8 * 2 = 2.6, and the least deviance (1 - .64) * 4 = 1.44.
    np.testing.assert_allclose(minimum.values[0], [2.6, 1.0], atol=1e-6)
    found = profile_intervals(gram, space, minimum, 1.0, 2, tolerance=1e-9).intervals
    # Of a: b stays at its bound, so that the deviance rises by (a - 2.6)^2 on either side as
    # long as the free optimum of b, 3 - .8 (a - 1), is above 1: up to a = 3.5, a rise of .81.
    # From there it is (1 - .64)(a - 1)^2 = 1.44 + 3.84 at a = 1 + sqrt(5.28/.36).
    reach = np.sqrt(CHI_SQUARED_95)
    beyond = 1.0 + np.sqrt((1.44 + CHI_SQUARED_95) / 0.36)
    np.testing.assert_allclose(found[0], [2.6 - reach, beyond], rtol=1e-3)
    # Of b: the deviance is (1 - .64)(b - 3)^2 down to the lower end.
    np.testing.assert_allclose(found[1], [3.0 - np.sqrt((1.44 + CHI_SQUARED_95) / 0.36), 1.0])
    held = np.array([False, True])
    # The interval of b has one side alone, and a bound that cuts the other short changes nothing.
    near = errors_from(minimum.values[0] - [0.0, 0.01], found, space)
    np.testing.assert_allclose(near[1], (0.99 - found[1, 0]) / Z95)
    errors = errors_from(minimum.values[0], found, space)
    offsets = np.linspace(-20.0, 20.0, 40_001)
    spread = np.abs(found[0] - minimum.values[0, 0])[(offsets > 0.0).astype(int)] / Z95
    density = np.exp(-0.5 * (offsets / spread) ** 2)
    assert errors[0] ** 2 == pytest.approx(np.sum(offsets**2 * density) / np.sum(density), rel=1e-3)
    np.testing.assert_allclose(errors[1], np.diff(found[1]) / Z95)
    covariance = covariance_at_bounds(gram(minimum.values)[0, :2, :2], held, errors)
    assert covariance is not None
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), errors)
    assert covariance[0, 1] == 0.0


def test_an_end_is_found_although_the_search_begins_in_another_valley() -> None:
    """Of one parameter the deviance is x^2, of the other it has minima at 0 and, by 9 higher, 4."""

    def gram(sets: FloatArray) -> FloatArray:
        x, y = sets.T
        bend = np.where(y < 2.0, y, 4.0 - y)
        rows = np.zeros((len(sets), 3, 3))
        rows[:, 0, 0], rows[:, 1, 1] = -1.0, np.where(y < 2.0, -1.0, 1.0)
        rows[:, 2] = np.stack([x, bend, np.where(y < 2.0, 0.0, 3.0)], axis=1)
        return np.asarray(rows @ rows.transpose(0, 2, 1))

    origin = np.zeros(2)
    for beside in (0.0, 4.0):
        near = np.array([1.5, beside])
        search = ProfileSearch(gram, plane(-10.0, 10.0), 0.0, [], [])
        end = search.end(0, CHI_SQUARED_95, origin, 0.0, near)
        (point,), (cost,) = search.points, search.costs
        assert end == point[0] == pytest.approx(np.sqrt(CHI_SQUARED_95), rel=0.04)
        assert point[1] == pytest.approx(0.0, abs=1e-6)
        assert cost <= CHI_SQUARED_95


def test_profile_intervals_end_where_the_profile_likelihood_does() -> None:
    joint = joint_of(NOMINAL, LowPass(2), 3)
    start = np.concatenate([TRUTH, [3.5, 0.7]])[None]
    minimum = minimise(joint.gram, start, joint, tolerance=1e-10)
    freedom = joint.residuals - 9
    variance = minimum.cost[0] / freedom
    found = profile_intervals(joint.gram, joint, minimum, variance, 7, estimated=freedom).intervals
    for index in (0, 1, 5):
        for end in found[index]:
            held = start.copy()
            held[0] = minimum.values[0]
            held[0, index] = end
            space = Box.holding(joint, index, end)
            conditional = minimise(joint.gram, held, space, tolerance=1e-10)
            deviance = freedom * np.log(conditional.cost[0] / minimum.cost[0])
            assert deviance == pytest.approx(CHI_SQUARED_95, abs=0.1)


@pytest.mark.long
def test_bias_of_the_white_residual_is_gone() -> None:
    # 40 recordings: the bias of the delays and of the neuromuscular frequency, which is 4 to
    # 20 % with a white residual, is within 3.3 Monte-Carlo standard errors of zero.
    runs = 40
    white, aware = [], []
    for seed in range(runs):
        recording = simulate(NOMINAL, np.random.default_rng(seed))
        white.append(identify(MLEWhite(), recording, MULTI, np.random.default_rng(seed)).values)
        aware.append(identify(MLE(), recording, MULTI, np.random.default_rng(seed)))
    index = [MULTI.keys.index(key) for key in ("tdvis", "tdvest", "fnm")]
    truth = TRUTH[index]
    values = np.array([e.values for e in aware])[:, index]
    errors = values.std(axis=0, ddof=1) / np.sqrt(runs)
    assert (np.abs(values.mean(axis=0) - truth) < 3.3 * errors).all()
    biased = np.abs(np.array(white)[:, index].mean(axis=0) / truth - 1.0)
    assert (biased > 5.0 * np.abs(values.mean(axis=0) / truth - 1.0)).all()
    assert (biased > 0.03).all()
    covered = [(e.intervals[:, 0] <= TRUTH) & (e.intervals[:, 1] >= TRUTH) for e in aware]
    # 280 intervals, dependent within a recording: 0.95 less 4 binomial standard errors.
    assert np.mean(covered) > 0.95 - 4.0 * np.sqrt(0.95 * 0.05 / 280.0)
    assert {e.outcome for e in aware} == {Outcome.CONVERGED}
    assert np.mean([e.remnant.power_ratio for e in aware if e.remnant]) == pytest.approx(
        0.214, abs=0.02
    )


@pytest.mark.long
def test_no_start_leads_away_from_who_is_well_known(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(4)
    low, high = np.maximum(MULTI.lower, 1e-3), MULTI.upper
    for seed in range(12):
        recording = simulate(NOMINAL, np.random.default_rng(100 + seed))
        start = dict(zip(MULTI.keys, low * (high / low) ** rng.uniform(size=7), strict=True))
        reference = identify(MLE(), recording, MULTI, np.random.default_rng(seed))
        with monkeypatch.context() as patch:
            patch.setattr("pilotid.likelihood.optimum.WELL_KNOWN", 0.0)  # all starts are tried
            moved = identify(MLE(), recording, MULTI.with_start(start), np.random.default_rng(seed))
        assert (reference.starts, moved.starts is None) == (None, False)
        assert (np.abs(moved.values - reference.values) < 0.1 * reference.std_error).all()


@pytest.mark.parametrize(("name", "replication"), [("remnant-0.5", 42), ("remnant-0.8", 17)])
def test_a_channel_that_the_white_search_loses_is_found_again(name: str, replication: int) -> None:
    # A white residual draws these two to a vestibular gain of zero.
    scenario = SCENARIOS[name]
    estimate = fit_of(MLE(), scenario, replication)
    assert estimate.outcome is Outcome.CONVERGED
    np.testing.assert_allclose(estimate.values[2:], scenario.values[2:], rtol=0.2)


def test_standard_errors_are_those_of_the_intervals_and_products_those_of_the_curvature() -> None:
    estimate = fit_of(MLE(), NOMINAL, 3)
    below, above = np.abs(estimate.intervals.T - estimate.values)
    spread = np.sqrt(below**2 + above**2 - below * above)
    np.testing.assert_allclose(spread / estimate.std_error, Z95, rtol=2e-3)
    curvature = np.sqrt(np.diag(estimate.covariance))
    # Gain and lead time are skewed, delays and neuromuscular parameters are not.
    assert (estimate.std_error[:2] > 1.01 * curvature[:2]).all()
    np.testing.assert_allclose(estimate.std_error[[2, 4]], curvature[[2, 4]], rtol=0.05)
    np.testing.assert_allclose(np.diag(estimate.correlation), 1.0)
    scaled = np.array([estimate.values[1], estimate.values[0]])
    expected = np.sqrt(scaled @ estimate.covariance[:2, :2] @ scaled)
    assert estimate["Kvis*tlead"].std_error == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("factor", "offset"), [(1e6, 0.0), (1e-6, 0.0), (1.0, 30.0)])
def test_neither_unit_nor_offset_of_signals_matters(factor: float, offset: float) -> None:
    recording = simulate(SCENARIOS["single"], np.random.default_rng(1))
    signals = {name: factor * getattr(recording, name) for name in recording.signals}
    signals["e"] = signals["e"] + offset * signals["e"].std()
    there, here = (
        identify(MLE(), r, SINGLE, np.random.default_rng(1))
        for r in (replace(recording, **signals), recording)
    )
    assert there.outcome is here.outcome
    errors = np.abs(there.values - here.values) / here.std_error
    assert errors.max() < (0.2 if offset else 1e-6)
    np.testing.assert_allclose(there.std_error, here.std_error, rtol=0.1 if offset else 0.02)
    assert [remark.code for remark in there.remarks] == [remark.code for remark in here.remarks]
    assert offset or remarks(replace(recording, **signals)) == remarks(recording)


def test_an_offset_of_the_control_is_fitted_too() -> None:
    recording = simulate(NOMINAL, np.random.default_rng(5))
    biased = replace(recording, u=recording.u + 0.2 * recording.u.std())
    there, here = (identify(MLE(), r, MULTI, np.random.default_rng(1)) for r in (biased, recording))
    assert np.max(np.abs(there.values - here.values) / here.std_error) < 1.0


@pytest.mark.parametrize("case", ["other-models 998053", "short 998045", "other-models 998260"])
def test_errors_hold_where_little_is_known_of_others(case: str) -> None:
    # With dnm at its lower bound fnm and dnm, lead and lag seemed to be known; beside a target that
    # tells next to nothing ends of intervals lay in another valley.
    stratum, number = case.split()[0], int(case.split()[1])
    recording, model, truth = of_stratum(stratum, number)
    estimate = identify(MLE(), recording, model, np.random.default_rng(number))
    errors = np.abs(estimate.values - [truth[key] for key in model.keys]) / estimate.std_error
    assert errors.max() < 4.0


@pytest.mark.parametrize(("number", "equal"), [(20030, "tlead tleadlow"), (20047, "tlead tlag")])
def test_parameters_that_meet_have_intervals(number: int, equal: str) -> None:
    # With two leads, or a lead and a lag, of one value J'J is singular and the Hessian is not.
    recording, model, truth = of_stratum("other-models", number)
    estimate = identify(MLE(), recording, model, np.random.default_rng(number))
    assert estimate.outcome is Outcome.CONVERGED
    first, second = (estimate.values[model.index[key]] for key in equal.split())
    assert first == pytest.approx(second, rel=0.02)  # the valley between them is flat
    low, high = estimate.intervals.T
    true = np.array([truth[key] for key in model.keys])
    assert ((low <= true) & (true <= high)).all()
    assert (np.abs(estimate.values - true) < 3.0 * estimate.std_error).all()
