"""Bounded least squares against scipy, and the search for the best optimum."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from helpers import NOMINAL, minima_at
from scipy.optimize import OptimizeResult, least_squares

from pilotid.datasets import SCENARIOS, simulate
from pilotid.likelihood.estimates import starts_of
from pilotid.likelihood.likelihood import Likelihood
from pilotid.likelihood.prediction import predict
from pilotid.model.catalogue import MODELS, MULTI
from pilotid.model.model import PilotModel
from pilotid.solve.least_squares import (
    Box,
    Gram,
    Minima,
    draw_starts,
    minimise,
    search,
    solve_linear,
)
from pilotid.support.types import FloatArray

pytestmark = pytest.mark.numerical

Rows = Callable[[FloatArray], FloatArray]

# ------------------------------------------------------------------ problems


@cache
def pilot_problem(seed: int = 1) -> Likelihood:
    """The nominal scenario with its remnant, so that the residual is large."""
    recording = simulate(SCENARIOS["nominal"], np.random.default_rng(seed))
    return Likelihood(predict(recording, MULTI, 26.0))


def flat_rows(problem: Likelihood) -> Rows:
    """Jacobian and residual of one parameter set, shape (parameters + 1, samples)."""
    return lambda values: problem.rows(values[None])[0].reshape(values.size + 1, -1)


def decay(values: FloatArray) -> FloatArray:
    """Rows of a fit of a + b e^{-c t} to data with an error that no parameter explains."""
    t = np.linspace(0.0, 4.0, 60)
    data = 0.3 + 2.0 * np.exp(-1.3 * t) + 0.2 * np.sin(7.0 * t) + 0.1 * np.cos(2.0 * t)
    a, b, c = values
    falling = np.exp(-c * t)
    return np.array([np.ones_like(t), falling, -b * t * falling, data - a - b * falling])


def decay_or_nan(values: FloatArray) -> FloatArray:
    """The same, and not a number for c of two and more."""
    return decay(values) if values[2] < 2.0 else np.full((4, 60), np.nan)


def gram_of(rows: Rows) -> Gram:
    return lambda sets: np.array([rows(values) @ rows(values).T for values in sets])


WIDE = Box(np.array([-5.0, 1e-3, 1e-2]), np.array([5.0, 50.0, 20.0]), np.array([False, True, True]))
START = np.array([1.0, 1.0, 0.5])


def by_scipy(rows: Rows, start: FloatArray, lower: FloatArray, upper: FloatArray) -> OptimizeResult:
    return least_squares(
        lambda values: rows(values)[-1],
        start,
        jac=lambda values: -rows(values)[:-1].T,
        bounds=(lower, upper),
        x_scale="jac",
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-14,
        max_nfev=500,
    )


def assert_same_minimum(minima: Minima, oracle: OptimizeResult, tolerance: float) -> None:
    assert minima.converged[0]
    np.testing.assert_allclose(minima.values[0], oracle.x, rtol=tolerance, atol=tolerance)
    assert minima.cost[0] == pytest.approx(2.0 * oracle.cost, rel=1e-10)


# ------------------------------------------------------------------ minimise


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_pilot_problem_has_the_minimum_that_scipy_finds(seed: int) -> None:
    problem = pilot_problem(seed)
    minima = minimise(problem.gram, NOMINAL.values[None], MULTI, tolerance=1e-14)
    oracle = by_scipy(flat_rows(problem), NOMINAL.values, MULTI.lower, MULTI.upper)
    assert_same_minimum(minima, oracle, 1e-5)


@pytest.mark.parametrize("positive", [(False, True, True), (False, False, False)])
def test_generic_problem_has_the_minimum_that_scipy_finds(positive: tuple[bool, ...]) -> None:
    space = replace(WIDE, positive=np.array(positive))
    minima = minimise(gram_of(decay), START[None], space, tolerance=1e-14)
    assert_same_minimum(minima, by_scipy(decay, START, WIDE.lower, WIDE.upper), 1e-6)


@pytest.mark.parametrize(
    ("lower", "upper", "bound"),
    [
        ((-5.0, 1e-3, 1e-2), (5.0, 50.0, 0.9), {2: 0.9}),
        ((-5.0, 2.5, 1e-2), (5.0, 50.0, 20.0), {1: 2.5}),
        ((0.6, 1e-3, 1e-2), (5.0, 50.0, 20.0), {0: 0.6}),
        ((0.6, 1e-3, 1.9), (5.0, 1.4, 20.0), {0: 0.6, 1: 1.4, 2: 1.9}),
    ],
    ids=["one above", "one below", "linear scale", "all"],
)
def test_active_bounds_are_those_that_scipy_finds(
    lower: tuple[float, ...], upper: tuple[float, ...], bound: dict[int, float]
) -> None:
    space = replace(WIDE, lower=np.array(lower), upper=np.array(upper))
    start = np.clip(START, space.lower + 0.05, space.upper - 0.05)
    minima = minimise(gram_of(decay), start[None], space, tolerance=1e-14)
    oracle = by_scipy(decay, start, space.lower, space.upper)
    # Bounds on a logarithmic scale come back through an exponential.
    assert {i: minima.values[0, i] for i in bound} == pytest.approx(bound, rel=1e-12)
    assert_same_minimum(minima, oracle, 1e-5)


def test_start_on_a_bound_leaves_it_again() -> None:
    on_bounds = np.array([WIDE.lower, WIDE.upper])
    minima = minimise(gram_of(decay), on_bounds, WIDE, tolerance=1e-14)
    oracle = by_scipy(decay, START, WIDE.lower, WIDE.upper)
    assert_same_minimum(minima, oracle, 1e-6)


def test_start_outside_the_bounds_is_brought_inside() -> None:
    starts = np.array([[9.0, -3.0, 99.0]])
    minima = minimise(gram_of(decay), starts, WIDE, tolerance=1e-14, iterations=1)
    np.testing.assert_allclose(minima.values, [[5.0, 1e-3, 20.0]], rtol=1e-12)


def test_several_starts_end_as_each_alone_and_are_sorted_best_first() -> None:
    problem = pilot_problem()
    starts = draw_starts(MULTI, np.random.default_rng(4), 6)
    before = starts.copy()
    together = minimise(problem.gram, starts, MULTI)
    np.testing.assert_array_equal(starts, before)
    assert np.all(np.diff(together.cost) >= 0.0)
    alone = [minimise(problem.gram, start[None], MULTI) for start in starts]
    ends = sorted(float(end.cost[0]) for end in alone)
    np.testing.assert_allclose(together.cost, ends, rtol=1e-6)
    # Values, cost and Gram matrix of each row belong together.
    np.testing.assert_allclose(together.gram[:, -1, -1], together.cost, rtol=1e-12)
    for values, gram in zip(together.values, together.gram, strict=True):
        own = problem.gram(values[None])[0]
        scale = np.sqrt(np.outer(np.diag(own), np.diag(own)))
        np.testing.assert_allclose(gram / scale, own / scale, atol=1e-9)


def test_a_start_that_meets_an_optimum_is_left_out_and_one_of_no_use_given_up() -> None:
    def two_valleys(values: FloatArray) -> FloatArray:
        x = float(values[0])
        return np.array([[-2.0 * x, -0.1], [x * x - 1.0, 0.1 * (x - 1.0)]])

    gram, space = gram_of(two_valleys), Box(*np.array([[-3.0], [3.0]]), np.array([False]))
    ends = minimise(gram, np.array([[1.0], [1.6], [-1.2]]), space, merge=True)
    np.testing.assert_allclose(ends.values, [[1.0], [-0.995]], atol=1e-3)
    given_up = minimise(gram, np.array([[-0.99]]), space, above=0.0395)
    assert (given_up.iterations, given_up.converged.any()) == (1, False)
    hopeless = minimise(gram, np.array([[-1.5]]), space, above=1e-9, tolerance=1e-14)
    assert (hopeless.iterations, hopeless.converged.any()) == (5, False)
    start = np.array([[1.6]])
    assert not minimise(gram, start, space, is_known=lambda at, _: at[:, 0] < 1.1).cost.size


def test_iteration_limit_is_kept_and_reported() -> None:
    counted = []

    def gram(values: FloatArray) -> FloatArray:
        counted.append(len(values))
        return pilot_problem().gram(values)

    starts = draw_starts(MULTI, np.random.default_rng(6), 3)
    minima = minimise(gram, starts, MULTI, iterations=4, tolerance=1e-14)
    assert (len(counted), minima.iterations) == (4, 4)
    assert not minima.converged.any()


def test_search_turns_back_where_the_problem_is_not_a_number() -> None:
    rejected = []

    def rows(values: FloatArray) -> FloatArray:
        result = decay_or_nan(values)
        rejected.append(np.isnan(result).any())
        return result

    # From here the first steps lead where there is no number.
    starts = np.array([[1.0, 0.2, 0.02], [0.0, 5.0, 1.9]])
    minima = minimise(gram_of(rows), starts, WIDE, tolerance=1e-14)
    assert any(rejected)
    oracle = by_scipy(decay, START, WIDE.lower, WIDE.upper)
    assert_same_minimum(minima, oracle, 1e-6)
    assert minima.cost[1] == pytest.approx(minima.cost[0], rel=1e-9)


def test_start_that_is_not_a_number_comes_last_and_leaves_the_others_alone() -> None:
    # The second start is near enough not to reach for the region without numbers on its way.
    starts = np.array([[1.0, 1.0, 3.0], [0.4, 2.0, 1.5]])
    minima = minimise(gram_of(decay_or_nan), starts, WIDE, tolerance=1e-14)
    assert_same_minimum(minima, by_scipy(decay, START, WIDE.lower, WIDE.upper), 1e-6)
    assert np.isnan(minima.cost[1])
    assert not minima.converged[1]
    np.testing.assert_allclose(minima.values[1], starts[0], rtol=1e-12)


# ------------------------------------------------------------------ linear parameters


def random_rows(sets: int, parameters: int) -> FloatArray:
    return np.random.default_rng(9).standard_normal((sets, parameters + 1, 40))


@pytest.mark.parametrize("linear", [(0, 3), (1,), (0, 1, 2, 3)])
def test_solve_linear_gives_the_values_of_lstsq(linear: tuple[int, ...]) -> None:
    rows = random_rows(5, 4)
    values = np.random.default_rng(10).uniform(1.0, 2.0, (5, 4))
    index = list(linear)
    solved, cost = solve_linear(rows @ rows.transpose(0, 2, 1), values, linear, np.full(4, -np.inf))
    others = [i for i in range(4) if i not in linear]
    np.testing.assert_array_equal(solved[:, others], values[:, others])
    for i in range(5):
        jacobian, residual = rows[i, index].T, rows[i, -1]
        step, (left,), *_ = np.linalg.lstsq(jacobian, residual)
        np.testing.assert_allclose(solved[i, index], values[i, index] + step, rtol=1e-8)
        assert cost[i] == pytest.approx(left, rel=1e-9)


def test_solve_linear_keeps_a_parameter_that_would_cross_its_lower_bound_at_a_tenth() -> None:
    # One column: the residual is twice minus the column, so that the best value is 1 - 2 < 0.
    column = np.array([1.0, 2.0, 2.0])
    rows = np.array([[column, -2.0 * column]])
    solved, cost = solve_linear(
        rows @ rows.transpose(0, 2, 1), np.array([[1.0]]), (0,), np.array([1e-6])
    )
    assert solved[0, 0] == pytest.approx(0.1)
    assert cost[0] == pytest.approx(9.0 * (-2.0 + 0.9) ** 2)


# ------------------------------------------------------------------ search


@pytest.mark.parametrize("model", MODELS.values(), ids=lambda m: m.name)
def test_drawn_starts_lie_in_the_usual_ranges_and_fill_them(model: PilotModel) -> None:
    points = draw_starts(model, np.random.default_rng(12), 500)
    assert points.shape == (500, len(model.keys))
    for parameter, drawn in zip(model.parameters, points.T, strict=True):
        low, high = parameter.usual
        assert np.all((drawn >= low) & (drawn <= high))
        middle = np.sqrt(low * high) if parameter.positive else (low + high) / 2.0
        assert abs(np.mean(drawn < middle) - 0.5) < 0.1  # more than four standard errors


@pytest.mark.parametrize("name", ["nominal", "single"])
def test_search_finds_the_optimum_next_to_the_truth_from_a_poor_start(name: str) -> None:
    scenario = SCENARIOS[name]
    recording = simulate(scenario, np.random.default_rng(13))
    problem = Likelihood(predict(recording, scenario.model, 26.0))
    best = minimise(problem.gram, scenario.values[None], scenario.model)
    poor = scenario.model.with_start({"Kvis": 2.0, "tlead": 0.1, "tdvis": 0.8, "fnm": 30.0})
    found = search(problem.gram, poor, np.random.default_rng(14), refined=4)
    assert found.values.shape == (4, len(scenario.model.keys))
    end = minimise(problem.gram, found.values[:1], poor)
    assert end.cost[0] <= best.cost[0] * (1.0 + 1e-6)
    np.testing.assert_allclose(end.values[0], best.values[0], rtol=1e-3)


def test_record_counts_the_starts_that_agree_by_hand() -> None:
    cost = np.array([2.0, 2.0005, 2.1, 5.0])
    starts = starts_of(minima_at(np.zeros((4, 1)), cost))
    np.testing.assert_allclose(starts.cost, [1.0, 1.00025, 1.05, 2.5])
    assert starts.agreeing == 2
