"""How much runs differ, against what their errors claim."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import chi2, norm, t
from tidy_rows import row

from pilotid.analysis.combine import ratio_of
from pilotid.analysis.results import SPREAD_COLUMNS, table_of
from pilotid.analysis.rows import Row
from pilotid.analysis.spread import (
    RunSpread,
    condition_spreads,
    run_spreads,
    spread_sentence,
    with_variation,
)

VALUES = (1.0, 1.3, 0.8, 1.5, 0.9)


def runs(values: tuple[float, ...], error: float = 0.1, subject: str = "1") -> list[Row]:
    """Rows of the runs of one recording, and of all of them together."""
    single = [row(subject, "C3", v, error, run=i) for i, v in enumerate(values, 1)]
    return [*single, row(subject, "C3", float(np.mean(values)), error / math.sqrt(len(values)))]


def only(rows: list[Row]) -> RunSpread:
    (found,) = run_spreads(rows)
    return found


def test_the_ratio_by_hand() -> None:
    found = only(runs(VALUES))
    scatter = np.std(VALUES, ddof=1)
    assert found.ratio.value == pytest.approx(scatter / 0.1)
    assert found.between_runs == pytest.approx(math.sqrt(scatter**2 - 0.01))
    # Claimed error .1/sqrt(5) and variance between runs over 5: the standard error of the mean.
    assert found.std_error == pytest.approx(scatter / math.sqrt(5))
    reach = t.ppf(0.975, 4) * scatter / math.sqrt(5)
    assert (found.lower, found.upper) == pytest.approx((1.1 - reach, 1.1 + reach))
    assert found.claimed_error == pytest.approx(0.1 / math.sqrt(5))


def test_the_ratios_interval_is_that_of_a_variance() -> None:
    found = ratio_of(20.0, 8)
    assert found.lower == pytest.approx(math.sqrt(20.0 / chi2.ppf(0.975, 8)))
    assert found.upper == pytest.approx(math.sqrt(20.0 / chi2.ppf(0.025, 8)))
    assert found.p == pytest.approx(chi2.sf(20.0, 8))


def test_runs_that_differ_as_claimed_leave_the_claim() -> None:
    found = only(runs(VALUES, 0.5))
    pooled = row("1", "C3", 1.1, 0.5 / math.sqrt(5))
    assert found.ratio.value < 1.0
    assert found.between_runs == 0.0
    assert (found.lower, found.upper) == pytest.approx((pooled.lower, pooled.upper))


def test_a_longer_side_stays_longer() -> None:
    rows = runs(VALUES)
    pooled = rows[-1]
    lopsided = Row(**{**vars(pooled), "upper": pooled.value + 3.0 * (pooled.value - pooled.lower)})
    found = only([*rows[:-1], lopsided])
    assert found.upper - found.value == pytest.approx(3.0 * (found.value - found.lower))


def test_a_run_that_is_far_off_is_left_out_and_named() -> None:
    found = only(runs((*VALUES, 40.0)))
    assert found.runs == (1, 2, 3, 4, 5)
    assert found.notes == ("run 6 left out: its tlead, 40, is far off",)
    assert found.ratio.value == pytest.approx(np.std(VALUES, ddof=1) / 0.1)


def test_a_run_whose_fit_failed_is_left_out_and_named() -> None:
    rows = runs(VALUES)
    rows[1] = row("1", "C3", 1.3, run=2, outcome="not-converged")
    rows[3] = row("1", "C3", 1.5, math.nan, run=4)
    found = only(rows)
    assert found.runs == (1, 3, 5)
    assert found.notes == ("run 2 left out: not-converged", "run 4 left out: no error")


def test_a_sound_run_is_hardly_ever_left_out() -> None:
    rng = np.random.default_rng(4)
    count = sum(bool(only(runs(tuple(rng.normal(size=5)), 0.5)).notes) for _ in range(600))
    assert count <= 18  # one in a hundred, and three standard deviations of 600 trials, is 13


def test_one_run_says_nothing() -> None:
    found = only(runs((1.0,)))
    assert math.isnan(found.ratio.value)
    assert math.isnan(found.std_error)
    (over,) = condition_spreads([found])
    assert spread_sentence([over]) == ""


def test_without_a_fit_of_all_runs_there_is_a_ratio_alone() -> None:
    found = only(runs(VALUES)[:-1])
    assert found.ratio.value > 1.0
    assert math.isnan(found.value)


def test_errors_that_include_the_variation() -> None:
    rows = [*runs(VALUES), row("2", "C3", 1.0)]
    found = run_spreads(rows)
    wider = with_variation(rows, found)
    assert wider[:5] == rows[:5]  # single runs
    assert (wider[5].std_error, wider[5].lower) == (found[0].std_error, found[0].lower)
    assert wider[5].value == rows[5].value
    assert wider[6] == rows[6]  # no runs that were fitted one by one


def test_a_condition_is_pooled_over_its_subjects() -> None:
    others = (2.0, 2.1, 1.9, 2.2)
    found = run_spreads([*runs(VALUES), *runs(others, subject="2")])
    (over,) = condition_spreads(found)
    squares = 4 * np.var(VALUES, ddof=1) + 3 * np.var(others, ddof=1)
    assert over.ratio.value == pytest.approx(math.sqrt(squares / 7) / 0.1)
    assert (len(over.spreads), over.runs) == (2, 9)
    words = spread_sentence([over])
    assert words.startswith(f"in C3, between-run scatter is {over.ratio.value:.1f} (tlead)")
    assert "significant for tlead" in words


@pytest.mark.numerical
@pytest.mark.long
@pytest.mark.parametrize("between", [0.0, 0.5, 1.0, 3.0])
def test_intervals_with_the_variation_hold(between: float) -> None:
    # Binomial error of 1000 trials: .007.
    rng = np.random.default_rng(8)
    inside = claimed = 0
    for _ in range(1000):
        found = only(runs(tuple(rng.normal(scale=math.hypot(1.0, between), size=5)), 1.0))
        inside += found.lower <= 0.0 <= found.upper
        claimed += abs(found.value) <= 1.96 * found.claimed_error
    assert 0.92 <= inside / 1000 <= 0.99
    # The claim alone: sqrt(1 + between^2) times too short.
    expected = 1.0 - 2.0 * norm.sf(1.96 / math.hypot(1.0, between))
    assert claimed / 1000 == pytest.approx(expected, abs=0.05)


def test_its_table() -> None:
    head, (line,) = table_of(run_spreads(runs(VALUES)), SPREAD_COLUMNS)
    assert head == list(SPREAD_COLUMNS)
    assert dict(zip(head, line, strict=True))["runs"] == 5
