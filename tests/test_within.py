"""Differences between parameters of the same fits, on numbers worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import ttest_rel
from tidy_rows import row

from pilotid.analysis.contrasts import split_pairs, within_fits
from pilotid.analysis.rows import Row
from pilotid.support.types import InputError

BEFORE, AFTER = (0.4, 0.5, 0.7), (0.9, 1.3, 1.2)
PAIR = ("tlead1", "tlead2")


def fits(condition: str, before: tuple[float, ...], after: tuple[float, ...]) -> list[Row]:
    return [
        row(str(subject), condition, value, parameter=key, model="adapting")
        for key, values in zip(PAIR, (before, after), strict=True)
        for subject, value in enumerate(values, start=1)
    ]


def test_the_difference_is_paired_over_subjects() -> None:
    (found,) = within_fits(fits("C5", BEFORE, AFTER), [PAIR])
    expected = ttest_rel(AFTER, BEFORE)
    assert found.within
    assert (found.condition_a, found.parameter, found.unit) == ("C5", "tlead2 - tlead1", "s")
    assert (found.mean_a, found.mean_b) == pytest.approx((np.mean(BEFORE), np.mean(AFTER)))
    assert found.difference == pytest.approx(0.6)
    assert (found.t, found.p) == pytest.approx((expected.statistic, expected.pvalue))
    assert found.p_holm == found.p


def test_conditions_are_counted_in_the_correction() -> None:
    rows = fits("C5", BEFORE, AFTER) + fits("C6", BEFORE, (0.5, 0.4, 0.8))
    first, second = within_fits(rows, [PAIR])
    assert (first.condition_a, second.condition_a) == ("C5", "C6")
    assert first.p_holm == pytest.approx(2.0 * first.p)
    assert second.p_holm == pytest.approx(second.p)


def test_only_models_with_both_parameters_are_compared() -> None:
    rows = fits("C5", BEFORE, AFTER)
    assert within_fits(rows, [("tlead1", "Kvis1")]) == []
    few = [*fits("C5", (0.4,), (0.9,))]
    (found,) = within_fits(few, [PAIR])
    assert found.notes == ("1 subject in the condition: a test takes two",)
    assert math.isnan(found.p)


def test_a_fit_that_failed_is_left_out_by_name() -> None:
    rows = fits("C5", BEFORE, AFTER)
    rows += [row("4", "C5", 1.0, parameter=key, model="adapting", outcome="died") for key in PAIR]
    (found,) = within_fits(rows, [PAIR])
    assert found.subjects == 3
    assert "left out: subject 4 (C5: died)" in found.notes


def test_different_units_are_not_compared() -> None:
    rows = fits("C5", BEFORE, AFTER)
    rows += [row(str(s), "C5", 0.1, parameter="Kvis1", unit="", model="adapting") for s in (1, 2)]
    (found,) = within_fits(rows, [("tlead1", "Kvis1")])
    assert math.isnan(found.p)
    assert "the units differ" in found.notes[-1]


def test_pairs_are_of_conditions_or_of_parameters() -> None:
    rows = fits("C5", BEFORE, AFTER) + fits("C6", BEFORE, AFTER)
    assert split_pairs(rows, [("C5", "C6"), PAIR]) == ([("C5", "C6")], [PAIR])
    # What is neither is for the comparison of conditions to refuse.
    assert split_pairs(rows, [("tlead1", "C9")]) == ([("tlead1", "C9")], [])
    with pytest.raises(InputError, match="names one parameter twice"):
        split_pairs(rows, [("tlead1", "tlead1")])
