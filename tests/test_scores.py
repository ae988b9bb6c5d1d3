"""Scores on numbers that can be worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pilotid.study import scores
from pilotid.study.scores import Mean

VALUES = np.array([1.0, 2.0, 3.0, 6.0])  # mean 3; deviations -2, -1, 0, 3, squares sum to 14
ONE = np.array([3, 3, 5, 5])  # recordings of four values


def test_bias_is_the_mean_error_with_its_sign() -> None:
    assert scores.bias(VALUES, 4.0) == (-1.0, pytest.approx(math.sqrt(14.0 / 3.0) / 2.0))
    assert scores.bias(VALUES, 2.0).value == 1.0


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


def test_rmse_holds_bias_and_scatter() -> None:
    # errors -3, -2, -1, 2: squares sum to 18
    assert scores.rmse(VALUES, 4.0) == pytest.approx(math.sqrt(18.0 / 4.0))


def test_spread_divides_by_n_minus_one() -> None:
    assert scores.spread(VALUES) == pytest.approx(math.sqrt(14.0 / 3.0))


def test_mean_leaves_out_what_is_not_a_number() -> None:
    assert scores.mean(np.array([1.0, math.nan, 2.0, math.inf])) == 1.5


def test_too_few_estimates_give_nan() -> None:
    none = np.zeros(0)
    for found in (
        *scores.bias(none, 1.0),
        scores.spread(none),
        scores.spread(np.ones(1)),
        scores.rmse(none, 1.0),
        scores.mean(none),
        scores.typical(none),
        *scores.trimmed(none, none.astype(int)),
    ):
        assert math.isnan(found)


def test_coverage_interval_is_wilson_s() -> None:
    # 19 of 20: centre (.95 + z2/40) / (1 + z2/20), z2 = 3.8415
    low, high = scores.coverage_interval(0.95, 20)
    assert (low, high) == (pytest.approx(0.7639, abs=1e-4), pytest.approx(0.9911, abs=1e-4))
    assert scores.coverage_interval(1.0, 20)[0] == pytest.approx(1.0 - 3.8415 / 23.8415, abs=1e-4)


def test_a_mean_s_error_is_that_of_recordings() -> None:
    values = np.array([1.0, 3.0, 2.0, 6.0])
    # Mean 3; sums of deviations -2 and 2: their squares, 8, times 2/1, rooted, over 4.
    assert scores.clustered_mean(values, ONE) == Mean(3.0, 1.0)
    # Each value for itself: deviations -2, 0, -1, 3: the usual standard error.
    alone = scores.clustered_mean(values, np.arange(4))
    assert alone.error == pytest.approx(np.std(values, ddof=1) / 2.0)
    assert math.isnan(scores.clustered_mean(values[:2], ONE[:2]).error)
    assert math.isnan(scores.clustered_mean(values[:0], ONE[:0]).value)


def test_root_mean_squares() -> None:
    z = np.array([1.0, -1.0, 2.0, -2.0])
    # Squares 1, 1, 4, 4: mean 2.5; sums of deviations -3 and 3: 6/4 = 1.5; over 2 sqrt(2.5).
    found = scores.root_mean_square(z, ONE)
    assert found.value == pytest.approx(math.sqrt(2.5))
    assert found.error == pytest.approx(1.5 / (2.0 * math.sqrt(2.5)))
    assert scores.typical(z) == pytest.approx(1.5 / 0.674490)
    assert scores.beyond(np.array([3.1, -3.1, 3.0, 0.0]), ONE).value == 0.5


def test_the_trimmed_score_leaves_out_the_farthest() -> None:
    z = np.concatenate([np.tile([1.0, -1.0], 100), [50.0, -60.0]])
    clusters = np.arange(z.size)
    assert scores.trimmed(z, clusters).value == pytest.approx(1.0)  # 2 of 202 are left out
    few = np.array([1.0, 7.0])
    assert scores.trimmed(few, np.arange(2)).value == pytest.approx(5.0)  # none is left out
    normal = np.random.default_rng(1).normal(size=200_000)
    # 1 - 2 q phi(q) / 0.99 for the quantile q = 2.5758, rooted.
    assert scores.trimmed(normal, np.arange(normal.size)).value == pytest.approx(0.9616, abs=0.004)


def test_coverage_has_an_interval_of_as_many_as_the_recordings_are_worth() -> None:
    hits = np.array([True, True, False, False])
    share, (low, high), worth = scores.coverage(hits, ONE)
    # Sums of deviations 1 and -1: sqrt(2 * 2) / 4; a quarter over its square is worth one.
    assert (share, worth) == (Mean(0.5, 0.5), 1)
    assert (low, high) == pytest.approx((0.0547, 0.9453), abs=1e-3)  # Wilson's for 1/2 of 1
    every, (low, high), worth = scores.coverage(np.ones(4, dtype=bool), ONE)
    assert (every, worth) == (Mean(1.0, 0.0), 2)
    assert (low, high) == pytest.approx((0.3424, 1.0), abs=1e-3)  # Wilson's for 2 of 2
    none, interval, _ = scores.coverage(np.zeros(0, dtype=bool), ONE[:0])
    assert all(map(math.isnan, (none.value, *interval)))
