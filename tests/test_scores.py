"""Scores on numbers that can be worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pilotid.study import scores
from pilotid.study.entries import ParameterTruth
from pilotid.study.score import Score, scored

VALUES = np.array([1.0, 2.0, 3.0, 6.0])  # mean 3; deviations -2, -1, 0, 3, squares sum to 14


def test_bias_is_the_mean_error_with_its_sign() -> None:
    assert scores.bias(VALUES, 4.0) == -1.0
    assert scores.bias(VALUES, 2.0) == 1.0


def test_spread_divides_by_n_minus_one() -> None:
    assert scores.spread(VALUES) == pytest.approx(math.sqrt(14.0 / 3.0))


def test_bias_std_error_is_the_spread_over_root_n() -> None:
    assert scores.bias_std_error(VALUES) == pytest.approx(math.sqrt(14.0 / 3.0) / 2.0)


def test_skewness_by_hand() -> None:
    # deviations -1, -1, -1, 3: second moment 3, third (27 - 3)/4 = 6
    assert scores.skewness(np.array([0.0, 0.0, 0.0, 4.0])) == pytest.approx(6.0 / 3.0**1.5)
    assert scores.skewness(VALUES[:3]) == pytest.approx(0.0, abs=1e-12)
    assert scores.skewness(np.ones(3)) == 0.0
    assert math.isnan(scores.skewness(np.zeros(0)))


def test_t_is_student_s_without_skewness_and_hall_s_with_it() -> None:
    assert scores.skewed_t(1.0, 1.0, 0.0, 3) == pytest.approx(math.sqrt(3.0))
    # share 1/2, skew 1.2: 2 (.5 + 1.2/12 + 1.44/216 + 1.2/24)
    assert scores.skewed_t(1.0, 2.0, 1.2, 4) == pytest.approx(2.0 * (0.65 + 1.44 / 216.0))
    assert scores.skewed_t(-1.0, 0.0, 0.0, 3) == -math.inf
    assert scores.skewed_t(0.0, 0.0, 0.0, 3) == 0.0


def test_rmse_holds_bias_and_scatter() -> None:
    # errors -3, -2, -1, 2: squares sum to 18
    assert scores.rmse(VALUES, 4.0) == pytest.approx(math.sqrt(18.0 / 4.0))


def test_coverage_counts_the_ends_and_leaves_out_what_is_not_a_number() -> None:
    intervals = np.array([[0.0, 1.0], [1.0, 2.0], [1.1, 2.0], [math.nan, 3.0], [-1.0, 5.0]])
    assert scores.coverage(intervals, 1.0) == 0.75


def test_mean_leaves_out_what_is_not_a_number() -> None:
    assert scores.mean(np.array([1.0, math.nan, 2.0, math.inf])) == 1.5


def test_too_few_estimates_give_nan() -> None:
    none = np.zeros(0)
    for score in (
        scores.bias(none, 1.0),
        scores.bias_std_error(none),
        scores.spread(none),
        scores.spread(np.ones(1)),
        scores.rmse(none, 1.0),
        scores.mean(none),
        scores.coverage(np.zeros((0, 2)), 1.0),
    ):
        assert math.isnan(score)


def test_coverage_limits_hold_95_percent_of_the_binomial() -> None:
    # 20 intervals at 95 %: P(<= 16) = .0159, P(<= 17) = .0755, P(<= 19) = .6415
    assert scores.coverage_limits(0.95, 20) == (17 / 20, 20 / 20)
    low, high = scores.coverage_limits(0.5, 10)  # P(<= 1) = .0107, P(<= 2) = .0547
    assert (low, high) == (0.2, 0.8)


def test_coverage_interval_is_wilson_s() -> None:
    # 19 of 20: centre (.95 + z2/40) / (1 + z2/20), z2 = 3.8415
    low, high = scores.coverage_interval(0.95, 20)
    assert (low, high) == (pytest.approx(0.7639, abs=1e-4), pytest.approx(0.9911, abs=1e-4))
    assert scores.coverage_interval(1.0, 20)[0] == pytest.approx(1.0 - 3.8415 / 23.8415, abs=1e-4)
    assert all(math.isnan(x) for x in scores.coverage_interval(math.nan, 0))


def test_rmse_std_error_is_that_of_simulated_estimates() -> None:
    rng = np.random.default_rng(1)
    draws = rng.normal(0.3, 1.0, (4000, 100))
    found = [scores.rmse(d, 0.0) for d in draws]
    claimed = np.mean([scores.rmse_std_error(d, 0.0) for d in draws])
    assert claimed == pytest.approx(np.std(found), rel=0.05)
    assert math.isnan(scores.rmse_std_error(np.ones(1), 0.0))


def test_spread_std_error_uses_the_fourth_moment() -> None:
    # deviations -1, -1, -1, 3: variance 12/3 = 4, fourth moment (1 + 1 + 1 + 81)/4 = 21
    expected = math.sqrt((21.0 - 16.0) / 4.0) / (2.0 * 2.0)
    assert scores.spread_std_error(np.array([0.0, 0.0, 0.0, 4.0])) == pytest.approx(expected)
    rng = np.random.default_rng(2)
    draws = rng.standard_t(8.0, (4000, 100))
    claimed = np.mean([scores.spread_std_error(d) for d in draws])
    assert claimed == pytest.approx(np.std([scores.spread(d) for d in draws]), rel=0.1)
    assert math.isnan(scores.spread_std_error(np.ones(1)))
    assert math.isnan(scores.spread_std_error(np.ones(3)))


def test_held_counts_the_intervals_that_hold_the_truth_and_no_others() -> None:
    intervals = np.array([[0.0, 1.0], [1.0, 2.0], [1.1, 2.0], [math.nan, 3.0], [-1.0, 5.0]])
    assert scores.held(intervals, 1.0) == 3
    assert scores.held(np.zeros((0, 2)), 1.0) == 0


def score_of(truth: float, bound: float | None = 0.2) -> Score:
    """Scores of `VALUES` times a truth over its size, the last of which failed."""
    sign = math.copysign(1.0, truth)
    ends = np.stack([VALUES - 1.5, VALUES + 1.5], axis=1) * sign
    numbers = np.column_stack([sign * VALUES, np.full(4, 0.5), np.sort(ends, axis=1)])
    counted = np.array([True, True, True, False])
    return scored(ParameterTruth("k", "s", truth, bound), numbers, counted, 4)


def test_scores_of_a_parameter_count_failures_apart() -> None:
    score = score_of(4.0)
    assert (score.n, score.failures, score.tried, score.n_all) == (3, 1, 4, 4)
    assert (score.bias, score.bias_all) == (-2.0, -1.0)
    assert score.std == 1.0
    # errors -3, -2, -1: squares sum to 14
    assert score.ratio == pytest.approx(math.sqrt(14.0 / 3.0) / 0.2)
    # 1.5 to 4.5 holds 4; a failure is a miss of all tried
    assert (score.coverage, score.coverage_all) == (pytest.approx(1 / 3), 0.25)
    assert math.isnan(score.posterior)


def test_percentages_are_of_the_truth_whatever_its_sign() -> None:
    score, mirrored = score_of(4.0).percent, score_of(-4.0).percent
    assert (score.bias, score.bias_all, score.std) == (-50.0, -25.0, 25.0)
    assert (score.bound, score.claimed) == (5.0, 12.5)
    assert score.ratio == pytest.approx(score_of(4.0).ratio)
    assert (mirrored.bias, mirrored.bias_all, mirrored.std) == (-50.0, -25.0, 25.0)
    assert mirrored.skew == pytest.approx(score.skew, abs=1e-12)
    assert math.isnan(score_of(0.0).percent.bias)


def test_without_a_bound_there_is_no_ratio() -> None:
    assert math.isnan(score_of(4.0, None).ratio)
