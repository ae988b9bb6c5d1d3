"""Differences of scores between two versions, on numbers worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pilotid.study import differences
from pilotid.types import FloatArray

FIRST = np.array([1.0, -1.0, 2.0, 0.0])
SECOND = np.array([2.0, 1.0, 2.0, 1.0])  # differences 1, 2, 0, 1


def test_bias_of_pairs_is_the_mean_of_their_differences() -> None:
    found = differences.bias(FIRST, SECOND, paired=True)
    assert (found.first, found.second, found.change) == (0.5, 1.5, 1.0)
    assert found.error == pytest.approx(math.sqrt(2.0 / 3.0 / 4.0))
    # Symmetric differences: Student's t of 1 / .408 on 3 degrees of freedom.
    assert found.p == pytest.approx(0.0917, abs=1e-4)


def test_bias_of_different_recordings_adds_their_errors() -> None:
    found = differences.bias(FIRST, SECOND, paired=False)
    assert found.change == 1.0
    assert found.error == pytest.approx(math.sqrt((5.0 / 3.0 + 1.0 / 3.0) / 4.0))
    longer = differences.bias(FIRST, np.tile(SECOND, 3), paired=False)
    assert longer.change == 1.0
    assert longer.error < found.error


def test_rmse_is_tested_by_its_squares() -> None:
    found = differences.rmse(FIRST, SECOND, paired=True)
    assert found.first == pytest.approx(math.sqrt(6.0 / 4.0))
    assert found.second == pytest.approx(math.sqrt(10.0 / 4.0))
    assert found.change == pytest.approx(found.second - found.first)
    # Errors that only change their signs have the same root mean square.
    flipped = differences.rmse(FIRST, -FIRST, paired=True)
    assert (flipped.change, flipped.error, flipped.p) == (0.0, 0.0, 1.0)


def test_shares_of_pairs_are_judged_by_those_that_changed() -> None:
    first = np.array([True] * 90 + [False] * 10)
    second = first.copy()
    second[:8] = False  # eight lost, none gained
    found = differences.share(first, second, paired=True)
    assert found[:3] == pytest.approx((0.9, 0.82, -0.08))
    assert found.p == pytest.approx(2.0 * 0.5**8)
    assert found.error == pytest.approx(math.sqrt(8.0 - 0.64) / 100.0)
    assert differences.share(first, first, paired=True).p == 1.0
    apart = differences.share(first, second, paired=False)
    assert apart.p > 0.1 > found.p


def test_times_count_from_a_factor_on() -> None:
    seconds = np.array([0.1, 0.2, 0.4])
    found = differences.times(seconds, 3.0 * seconds, 1.25, paired=True)
    assert (found.first, found.second) == pytest.approx((0.2, 0.6))
    assert found.change == pytest.approx(3.0)
    assert found.p < 1e-12
    assert differences.times(seconds, 1.2 * seconds, 1.25, paired=True).p == 1.0
    slower = differences.times(seconds, seconds / 3.0, 1.25, paired=True)
    assert slower.change == pytest.approx(1.0 / 3.0)


@pytest.mark.parametrize("paired", [True, False])
def test_one_fit_tells_nothing(paired: bool) -> None:
    one = np.array([1.0])
    for compare in (differences.bias, differences.rmse):
        assert math.isnan(compare(one, one + 1.0, paired=paired).p)


def rejected(first: FloatArray, second: FloatArray, *, paired: bool) -> float:
    """Share of comparisons of the rows below one in a hundred."""
    tests = (differences.bias, differences.rmse)
    return float(
        np.mean([
            compare(a, b, paired=paired).p < 0.01
            for a, b in zip(first, second, strict=True)
            for compare in tests
        ])
    )  # fmt: skip


@pytest.mark.parametrize("paired", [True, False])
def test_what_is_the_same_is_hardly_called_different(paired: bool) -> None:
    # Skewed errors, as those of gains are, that two versions of a method share in part.
    rng = np.random.default_rng(3)
    common, *own = rng.exponential(size=(3, 400, 25)) - 1.0
    first, second = (common + 0.3 * noise if paired else noise for noise in own)
    assert rejected(first, second, paired=paired) < 0.025
    assert rejected(first, second + 1.5, paired=paired) > 0.4
