"""The rules of a report call hardly anything wrong that is right, and say what they cannot."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

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
@pytest.mark.parametrize("off", [False, True], ids=["no bias", "biases that nearly matter"])
def test_right_methods_are_called_wrong_in_one_report_of_twenty_at_most(
    recordings: int, off: bool
) -> None:
    # Of 40 reports with 2 that chance allows, 7 or more would come once in 300 times.
    counts = called(1, 40, recordings, scenarios=4, methods=4, off=off)
    assert counts["either"] <= 6
    assert max(counts["biased"], counts["narrow"]) <= counts["either"]


def test_rules_without_regard_to_their_number_would_not_do() -> None:
    assert called(1, 40, 50, scenarios=4, methods=4)["three errors"] > 6


@pytest.mark.parametrize("kind", [KVIS, KVEST], ids=["Kvis", "Kvest"])
def test_a_bias_that_matters_is_seen_or_left_open(kind: tuple[str, float, bool]) -> None:
    assert seen(2, 200, kind, 1.0)[0] > 0.95
    _, settled, unsettled = seen(2, 50, kind, 0.5)
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
    # A bias of that size would take (4.11 + 1.28)**2 / (0.5 - 0.25)**2 = 465 at the level of
    # 2576 tests; one at the limit four times as many as show that there is none.
    assert Rules(2576).needed(replace(typical, bias=0.5 * found.bound)) == 500
    assert Rules(2576).needed(replace(typical, bias=0.251 * found.bound)) == 600
    # Those that did not do are doubled at least.
    assert Rules(2576).needed(replace(typical, n=180, bias=0.2 * found.bound)) == 400


def test_what_matters_is_one_percent_and_a_quarter_of_the_bound() -> None:
    found = score(*KVEST, DRAWN)
    assert matters(found) == pytest.approx(0.25 * 4.6)
    assert matters(replace(found, bound=2.0)) == 1.0
    assert matters(replace(found, bound=math.nan)) == 1.0


def test_a_bias_counts_if_it_is_certain_to_matter() -> None:
    rules = Rules(1)
    # A quarter of the bound is 1.15; 200 fits with a spread of 10 have an error of .707.
    found = replace(score(*KVEST, DRAWN), bias=2.5, std=10.0, skew=0.0)
    assert rules.biased(found)  # 1.91 errors beyond
    assert rules.biased(replace(found, bias=-2.5))
    assert not rules.biased(replace(found, bias=2.2))  # 1.48 errors
    assert not rules.biased(replace(found, bias=1.1, std=0.0))
    assert rules.biased(replace(found, std=0.0))
    assert not Rules(2576).biased(found)
    assert not rules.biased(replace(found, bias=math.nan))
    # Where estimates are skewed upwards their mean is rather too low than too high.
    assert rules.biased(replace(found, bias=-2.4))
    assert not rules.biased(replace(found, bias=-2.4, skew=2.0))
    # An order of magnitude has no mean error.
    assert not rules.biased(replace(found, parameter="rate"))


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


def test_the_rules_of_entry_ask_for_as_many_recordings_as_verdicts_take() -> None:
    said = (Path(__file__).parent.parent / "results" / "README.md").read_text(encoding="utf-8")
    assert "**Recordings.** 200 of each scenario" in said
    drawn = score(*KVIS, DRAWN)
    usual = replace(drawn, parameter="Kvis", bound=10.0, bias=0.0, skew=0.0, coverage=0.95)
    efficient = [replace(usual, n=n, std=10.0, bias_se=10.0 / math.sqrt(n)) for n in (25, 200)]
    wasteful = replace(usual, n=200, std=20.0, bias_se=20.0 / math.sqrt(200))
    rules = Rules(4000)
    assert [rules.needed(s) for s in (*efficient, wasteful)] == [200, 0, 0]
