"""Analyses of all conditions: against statsmodels, a textbook's numbers, and closed forms."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.stats import ttest_rel
from tidy_rows import row, table

from pilotid.analysis.factors import contrasts_of, variance_of
from pilotid.analysis.repeated import Repeated, random_intercept, repeated
from pilotid.analysis.results import REPEATED_COLUMNS, table_of
from pilotid.types import FloatArray

#: Six subjects under three conditions, with sums of squares worked out below.
SCORES = {
    "C1": (1.0, 3.0, 2.0, 4.0, 3.0, 5.0),
    "C2": (2.0, 4.0, 5.0, 4.0, 6.0, 7.0),
    "C3": (4.0, 4.0, 6.0, 8.0, 7.0, 9.0),
}


def only(found: list[Repeated]) -> Repeated:
    (analysis,) = found
    return analysis


def test_the_analysis_of_variance_by_hand() -> None:
    scores = np.column_stack(list(SCORES.values()))
    grand = scores.mean()
    conditions = 6 * np.sum((scores.mean(axis=0) - grand) ** 2)
    subjects = 3 * np.sum((scores.mean(axis=1) - grand) ** 2)
    error = np.sum((scores - grand) ** 2) - conditions - subjects
    found = only(repeated(table(SCORES)))
    assert (found.df1, found.df2) == (2.0, 10.0)
    assert found.f == pytest.approx((conditions / 2) / (error / 10))
    assert 0.5 <= found.epsilon <= 1.0
    assert found.p < found.p_corrected < 0.01
    # Balanced, with more spread between subjects than by chance: variances in closed form.
    assert found.residual == pytest.approx(math.sqrt(error / 10), rel=1e-5)
    between = (subjects / 5 - error / 10) / 3
    assert found.between_subjects == pytest.approx(math.sqrt(between), rel=1e-5)
    assert found.subjects == tuple("123456")
    assert found.notes == ()


def test_two_conditions_are_the_paired_t_test() -> None:
    found = only(repeated(table({c: SCORES[c] for c in ("C1", "C2")})))
    known = ttest_rel(SCORES["C1"], SCORES["C2"])
    assert (found.f, found.p) == pytest.approx((known.statistic**2, known.pvalue))
    assert found.epsilon == pytest.approx(1.0)
    assert found.p_corrected == pytest.approx(found.p)


def test_sphericity_at_its_ends() -> None:
    # Contrasts of three conditions that scatter alike, and all in one direction.
    alike = np.array([[1, -1, 0], [-1, 1, 0], [1, 1, -2], [-1, -1, 2.0]]) * [1, 1, 1]
    alike[:2] *= math.sqrt(3.0)
    assert variance_of(alike, contrasts_of(3)).epsilon == pytest.approx(1.0)
    one_way = np.outer([1.0, 2.0, 4.0], [1.0, 0.0, -1.0])
    assert variance_of(one_way, contrasts_of(3)).epsilon == pytest.approx(0.5)


def test_who_is_left_out_of_which_analysis() -> None:
    rows = [r for r in table(SCORES) if (r.field("subject"), r.field("condition")) != ("2", "C3")]
    found = only(repeated(rows))
    assert found.subjects == tuple("13456")
    assert found.notes == ("not in the analysis of variance: subject 2 (no recording in C3)",)
    assert found.estimates == 17
    complete = only(repeated([r for r in rows if r.field("subject") != "2"]))
    assert (found.f, found.p_corrected) == (complete.f, complete.p_corrected)
    assert found.likelihood_ratio != complete.likelihood_ratio


def test_a_condition_without_estimates_is_left_out() -> None:
    rows = table(SCORES) + [row(s, "C4", 1.0, outcome="diverged") for s in "123456"]
    found = only(repeated(rows))
    assert found.conditions == ("C1", "C2", "C3")
    assert found.notes == ("left out: C4 (no usable estimate)",)


def test_nothing_left_to_chance_is_no_analysis() -> None:
    found = only(repeated(table({"C1": (1.1, 2.2, 3.3), "C2": (1.4, 2.5, 3.6)})))
    assert math.isnan(found.p)
    assert math.isnan(found.mixed_p)
    assert [note.split(":")[0] for note in found.notes] == [
        "no analysis of variance",
        "no mixed model",
    ]


@pytest.mark.parametrize("subjects", [0, 1])
def test_too_few_subjects_are_said(subjects: int) -> None:
    rows = [row("1", "C1", 1.0), row("1", "C2", 1.5, outcome="converged" if subjects else "died")]
    found = only(repeated(rows))
    assert len(found.subjects) == 1
    assert math.isnan(found.p)
    assert math.isnan(found.mixed_p)
    assert found.notes


def unbalanced(seed: int, spread: float) -> tuple[FloatArray, FloatArray, Any]:
    """Values, design and groups of eight subjects under three conditions, some missing."""
    rng = np.random.default_rng(seed)
    groups, conditions = np.repeat(np.arange(8), 3), np.tile(np.arange(3), 8)
    values = rng.normal(size=24) + spread * rng.normal(size=8)[groups] + 0.5 * conditions
    design = np.column_stack([np.ones(24), conditions == 1, conditions == 2]).astype(float)
    kept = np.arange(24) % 7 != 5
    return values[kept], design[kept], groups[kept]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("restricted", [True, False])
def test_the_mixed_model_is_that_of_statsmodels(seed: int, restricted: bool) -> None:
    from statsmodels.regression.mixed_linear_model import MixedLM

    values, design, groups = unbalanced(seed, 1.5)
    known = MixedLM(values, design, groups=groups).fit(reml=restricted)
    found = random_intercept(values, design, groups, restricted=restricted)
    assert found.log_likelihood == pytest.approx(known.llf, abs=1e-6)
    assert found.between == pytest.approx(math.sqrt(known.cov_re[0, 0]), rel=1e-3)
    assert found.within == pytest.approx(math.sqrt(known.scale), rel=1e-3)


def test_no_spread_between_subjects_is_the_linear_model() -> None:
    # Subjects differ by less than chance makes them: MixedLM warns or fails there.
    values, design, groups = unbalanced(0, 0.0)
    values = values - np.array([values[groups == g].mean() for g in range(8)])[groups]
    found = random_intercept(values, design, groups, restricted=False)
    assert found.between == 0.0
    rest = values - design @ np.linalg.lstsq(design, values)[0]
    variance = np.mean(rest**2)
    known = -0.5 * len(values) * (math.log(2.0 * math.pi * variance) + 1.0)
    assert found.log_likelihood == pytest.approx(known)


def test_units_change_nothing_but_standard_deviations() -> None:
    plain = only(repeated(table(SCORES)))
    small = {c: tuple(1e-3 * v for v in vs) for c, vs in SCORES.items()}
    scaled = only(repeated(table(small)))
    assert scaled.likelihood_ratio == pytest.approx(plain.likelihood_ratio)
    assert scaled.residual == pytest.approx(1e-3 * plain.residual)


def test_its_table() -> None:
    head, (line,) = table_of(repeated(table(SCORES)), REPEATED_COLUMNS)
    assert head == list(REPEATED_COLUMNS)
    assert dict(zip(head, line, strict=True))["conditions"] == "C1 C2 C3"
