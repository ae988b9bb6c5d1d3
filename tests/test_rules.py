"""The rules of a report call hardly anything wrong that is right, and say what they cannot."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from checks.verdict_rules import KINDS, called, numbers, score, seen

from pilotid.report.rules import Rules, matters

KVIS, KVEST = KINDS[0], KINDS[3]
DRAWN = np.random.default_rng(1).standard_normal(200)


def test_the_level_is_that_of_all_comparisons_together() -> None:
    assert Rules(1).level == pytest.approx(0.05)
    assert (1.0 - Rules(2576).level) ** 2576 == pytest.approx(0.95)
    assert Rules(0).level == pytest.approx(0.05)


@pytest.mark.parametrize("recordings", [50, 200])
def test_right_methods_are_called_wrong_in_one_report_of_twenty_at_most(recordings: int) -> None:
    # Of 60 reports with 3 that chance allows, 9 or more would come once in 500 times.
    counts = called(1, 60, recordings, scenarios=4, methods=4)
    assert counts["either"] <= 8
    assert max(counts["biased"], counts["narrow"]) <= counts["either"]


def test_rules_without_regard_to_their_number_would_not_do() -> None:
    assert called(1, 60, 50, scenarios=4, methods=4)["three errors"] > 8


@pytest.mark.parametrize("kind", [KVIS, KVEST], ids=["Kvis", "Kvest"])
def test_a_bias_that_matters_is_seen_or_left_open(kind: tuple[str, float, bool]) -> None:
    biased, settled, unsettled = seen(2, 200, kind, 0.5)
    assert biased > 0.95
    biased, settled, unsettled = seen(2, 50, kind, 0.5)
    assert settled < 0.01
    assert unsettled > 0.5
    # As large as what matters: overlooked in one cell of 20, within the errors of 2000.
    assert seen(2, 200, kind, 0.26)[1] < 0.05 + 3.0 * math.sqrt(0.05 * 0.95 / 2000)


@pytest.mark.parametrize("kind", [KVIS, KVEST], ids=["Kvis", "Kvest"])
def test_the_recordings_asked_for_settle_it(kind: tuple[str, float, bool]) -> None:
    found = score(*kind, DRAWN[:50])
    typical = replace(found, bias=0.1 * found.bound, std=found.bound, bias_se=found.bound / 50**0.5)
    wanted = Rules(2576).needed(typical)
    assert wanted == 200  # (1.64 + 1.28)**2 / 0.25**2 = 137
    assert seen(3, wanted, kind, 0.0)[1] > 0.85
    # A bias of that size would take (4.27 + 1.28)**2 / 0.4**2 = 193 at the level of 2576 tests.
    assert Rules(2576).needed(replace(typical, bias=0.4 * found.bound)) == 200
    assert Rules(2576).needed(replace(typical, bias=0.3 * found.bound)) == 400
    # Those that did not do are doubled at least.
    assert Rules(2576).needed(replace(typical, n=180, bias=0.2 * found.bound)) == 400


def test_what_matters_is_one_percent_and_a_quarter_of_the_bound() -> None:
    found = score(*KVEST, DRAWN)
    assert matters(found) == pytest.approx(0.25 * 4.6)
    assert matters(replace(found, bound=2.0)) == 1.0
    assert matters(replace(found, bound=math.nan)) == 1.0


def test_a_bias_counts_if_it_matters_and_is_none_of_chance() -> None:
    rules = Rules(1)
    found = replace(score(*KVEST, DRAWN), bias=3.0, bias_t=3.0)
    assert rules.biased(found)
    assert rules.biased(replace(found, bias=-3.0, bias_t=-3.0))
    assert not rules.biased(replace(found, bias=1.1))  # a quarter of the bound is 1.15
    assert not rules.biased(replace(found, bias_t=1.9))
    assert not Rules(2576).biased(found)
    assert not rules.biased(replace(found, bias=math.nan, bias_t=math.nan))


def test_intervals_are_narrow_if_honest_ones_would_hardly_be() -> None:
    # Of 50 honest intervals 43 or fewer hold the truth in 1 % of all cases, 39 or fewer in 2e-5.
    found = replace(score(*KVEST, DRAWN[:50]), coverage=0.86)
    assert Rules(1).narrow(found)
    assert not Rules(2576).narrow(found)
    assert Rules(2576).narrow(replace(found, coverage=0.76))
    assert not Rules(1).narrow(replace(found, coverage=0.9))
    assert not Rules(1).narrow(replace(found, coverage=math.nan))


def test_coverage_alone_can_leave_it_open() -> None:
    sure = replace(score(*KVEST, DRAWN[:50]), bias=0.0, bias_se=0.1, coverage=1.0)
    assert Rules(1).needed(sure) == 0
    # 46 or more of 50 intervals that hold in 85 % come in 11 % of all cases, 47 in 4.6 %.
    assert Rules(1).needed(replace(sure, coverage=0.94)) == 0
    assert Rules(1).needed(replace(sure, coverage=0.92)) == 100
    assert Rules(1).needed(replace(sure, coverage=math.nan)) == 0


def test_simulated_intervals_are_honest() -> None:
    drawn = np.random.default_rng(4).standard_normal(20_000)
    for _, spread, skewed in (KVIS, KVEST):
        values, _, low, high = numbers(spread, skewed, drawn).T
        assert abs(np.mean(values) - 1.0) < 4.0 * np.std(values) / math.sqrt(drawn.size)
        assert np.mean((low <= 1.0) & (high >= 1.0)) == pytest.approx(0.95, abs=0.006)
