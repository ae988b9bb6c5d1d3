"""Contrasts of conditions over subjects."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import ttest_rel
from tidy_rows import row, table

from pilotid.analysis.contrasts import Contrast, contrasts, is_across
from pilotid.analysis.report_tables import is_significant
from pilotid.analysis.results import CONTRAST_COLUMNS, table_of
from pilotid.pilot.catalogue import MODELS
from pilotid.support.disk import table_bytes
from pilotid.support.types import InputError

A = (1.1, 1.4, 0.9, 2.0, 1.3)
B = (1.6, 1.5, 1.7, 2.1, 2.2)
C = (0.6, 1.2, 0.4, 1.9, 1.0)


def only(found: list[Contrast]) -> Contrast:
    (contrast,) = found
    return contrast


def test_a_contrast_is_the_paired_t_test() -> None:
    found = only(contrasts(table({"C1": A, "C2": B})))
    known = ttest_rel(B, A)
    low, high = known.confidence_interval(0.95)
    assert (found.condition_a, found.condition_b, found.subjects) == ("C1", "C2", 5)
    assert (found.mean_a, found.mean_b) == pytest.approx((np.mean(A), np.mean(B)))
    assert (found.t, found.freedom, found.p) == pytest.approx((known.statistic, 4, known.pvalue))
    assert (found.lower, found.upper) == pytest.approx((low, high))
    assert found.p_holm == found.p
    assert found.difference == pytest.approx(found.mean_b - found.mean_a)
    assert found.notes == ()


def test_all_pairs_with_holms_correction_and_given_pairs_in_their_order() -> None:
    rows = table({"C1": A, "C2": B, "C3": C})
    found = contrasts(rows)
    assert [(c.condition_a, c.condition_b) for c in found] == [
        ("C1", "C2"),
        ("C1", "C3"),
        ("C2", "C3"),
    ]
    least = min(c.p for c in found)
    assert min(c.p_holm for c in found) == pytest.approx(3.0 * least)
    given = only(contrasts(rows, [("C3", "C1")]))
    assert given.p_holm == given.p
    assert given.difference == pytest.approx(-found[1].difference)


def test_conditions_are_compared_within_each_axis() -> None:
    rows = [
        row(s, c, v * (1 + (axis == "roll")), axis=axis)
        for axis in ("pitch", "roll")
        for c, column in (("C1", A), ("C2", B))
        for s, v in zip("12345", column, strict=True)
    ]
    pitch, roll = contrasts(rows)
    assert (pitch.stratum, roll.stratum) == ((("axis", "pitch"),), (("axis", "roll"),))
    assert roll.difference == pytest.approx(2.0 * pitch.difference)
    assert pitch.p_holm == pitch.p


def test_who_is_left_out_is_named() -> None:
    rows = table({"C1": A, "C2": B})
    rows = [r for r in rows if (r.field("subject"), r.field("condition")) != ("4", "C2")]
    rows = [r for r in rows if (r.field("subject"), r.field("condition")) != ("2", "C1")]
    rows.append(row("2", "C1", 3.0, outcome="not-converged"))
    found = only(contrasts(rows))
    assert [pair.subject for pair in found.pairs] == ["1", "3", "5"]
    assert found.notes == (
        "left out: subject 2 (C1: not-converged); subject 4 (no recording in C2)",
    )
    assert len(found.left_out) == 2
    assert found.t == pytest.approx(ttest_rel([B[0], B[2], B[4]], [A[0], A[2], A[4]]).statistic)


def test_equal_differences_are_no_test() -> None:
    found = only(contrasts(table({"C1": (0.1, 0.2, 0.3), "C2": (0.4, 0.5, 0.6)})))
    assert found.difference == pytest.approx(0.3)
    assert found.std_error == 0.0
    assert all(math.isnan(x) for x in (found.t, found.p, found.lower))
    assert found.notes == ("all subjects have the same difference: no test",)


@pytest.mark.parametrize(("subjects", "word"), [(1, "1 subject"), (0, "no subject")])
def test_fewer_than_two_subjects_are_a_row_without_a_test(subjects: int, word: str) -> None:
    rows = [row("1", "C1", 1.0), row("1", "C2", 1.5, outcome="converged" if subjects else "died")]
    found = only(contrasts(rows))
    assert found.subjects == subjects
    assert math.isnan(found.p)
    assert found.notes[-1].startswith(word)
    assert found.difference == 0.5 if subjects else math.isnan(found.difference)


def test_two_recordings_of_a_subject_are_one() -> None:
    rows = [*table({"C1": A, "C2": B}), row("1", "C1", 2.1, file="again.mat")]
    found = only(contrasts(rows))
    assert found.pairs[0].a == pytest.approx(0.5 * (A[0] + 2.1))
    assert found.notes == ("subject 1 in C1: mean of 2 recordings",)


def test_a_fit_at_a_bound_counts_and_is_named() -> None:
    rows = table({"C1": A, "C2": B})
    rows[0] = row("1", "C1", A[0], outcome="at-bound")
    found = only(contrasts(rows))
    assert found.subjects == 5
    assert found.notes == ("subject 1 in C1: a parameter is at its bound",)


def test_single_runs_are_passed_over() -> None:
    rows = [*table({"C1": A, "C2": B}), row("1", "C1", 99.0, run=1)]
    assert only(contrasts(rows)).mean_a == pytest.approx(np.mean(A))


def test_each_condition_by_its_own_model() -> None:
    rows = [
        row(s, c, v, model=model, parameter=key)
        for model, keys in (("single", ("tlead",)), ("multi", ("tlead", "Kvest")))
        for key in keys
        for c, column in (("C3", A), ("C6", B))
        for s, v in zip("12345", column, strict=True)
    ]
    assert {(c.model_a, c.model_b) for c in contrasts(rows)} == {
        ("single", "single"),
        ("multi", "multi"),
    }
    found = only(contrasts(rows, [("C3", "C6")], {((), "C3"): "single", ((), "C6"): "multi"}))
    assert (found.model_a, found.model_b, found.parameter) == ("single", "multi", "tlead")
    assert found.t == pytest.approx(ttest_rel(B, A).statistic)


@pytest.mark.parametrize(
    ("models", "parameter", "across"),
    [
        (("single", "multi"), "Kvis", False),
        (("single", "multi"), "fnm", False),
        (("single", "lead-lag"), "tdvis", True),
        (("single", "lead-lag"), "Kvis*tlead", True),
        (("single", "lead-lag"), "target_crossover", False),
        (("lead-lag", "lead-lag-motion"), "tlag", False),
        (("rate", "multi"), "dnm", True),
    ],
)
def test_a_parameter_of_another_channel_is_across_models(
    models: tuple[str, str], parameter: str, across: bool
) -> None:
    assert is_across(parameter, [MODELS[name] for name in models]) is across
    rows = [
        row(s, c, v, model=model, parameter=parameter)
        for c, column, model in (("C1", A, models[0]), ("C2", B, models[1]))
        for s, v in zip("12345", column, strict=True)
    ]
    own = {((), "C1"): models[0], ((), "C2"): models[1]}
    found = only(contrasts(rows, chosen=own))
    assert found.across is across
    assert is_significant(replace(found, p_holm=0.001)) is not across
    assert ("across models" in found.notes) is across


def test_estimates_that_the_lines_contradict_are_named() -> None:
    rows = table({"C1": A, "C2": B})
    rows[2] = replace(rows[2], agrees=False)
    found = only(contrasts(rows))
    assert found.misspecified == ("subject 3 in C1",)
    assert found.subjects == 5
    assert found.doubt.startswith("1 fit")


@pytest.mark.parametrize(
    ("pair", "words"), [(("C1", "C7"), "C7, which no file has; the conditions are C1, C2"),
                        (("C1", "C1"), "names one condition twice")]
)  # fmt: skip
def test_senseless_pairs_are_refused(pair: tuple[str, str], words: str) -> None:
    with pytest.raises(InputError, match=words):
        contrasts(table({"C1": A, "C2": B}), [pair])


def test_different_units_are_not_compared() -> None:
    rows = [row(s, "C1", 1.0, unit="deg") for s in "12"] + [row(s, "C2", 1.0) for s in "12"]
    found = only(contrasts(rows))
    assert math.isnan(found.p)
    assert found.notes == ("the units differ (deg, s): no test",)


def test_the_table_restores_every_number() -> None:
    rows = [
        row(s, c, float(s) * k, axis="roll") for c, k in (("C1", 0.1), ("C2", 1.7)) for s in "12"
    ]
    found = contrasts(rows)
    head, lines = table_of(found, CONTRAST_COLUMNS)
    assert head == ["axis", *CONTRAST_COLUMNS]
    (read,) = csv.DictReader(io.StringIO(table_bytes(head, lines).decode()))
    assert read["axis"] == "roll"
    assert float(read["p"]) == found[0].p
    assert read["subjects"] == "2"
    assert read["effect_size"] == ""  # NaN
