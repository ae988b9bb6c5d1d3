"""Groups of subjects compared, and curves over runs: against scipy, hand and simulation."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import curve_fit
from scipy.stats import f_oneway, linregress, ttest_ind, ttest_rel
from tidy_rows import row

from pilotid.analysis.groups import group_differences, group_effects
from pilotid.analysis.learning import fitted, learning
from pilotid.analysis.rows import Row
from pilotid.types import FloatArray

RNG = np.random.default_rng(4)
#: Three groups of 5, 4 and 6 subjects under two conditions.
SCORES = {
    g: RNG.normal(m, 1.0, (n, 2)) for g, m, n in (("a", 1.0, 5), ("b", 2.0, 4), ("c", 3.0, 6))
}


def grouped(scores: dict[str, FloatArray]) -> list[Row]:
    """Subjects numbered from 1 in each group."""
    return [
        replace(own, fields=(("group", group), *own.fields))
        for group, table in scores.items()
        for number, values in enumerate(table, start=1)
        for condition, value in zip(("C1", "C2"), values, strict=True)
        for own in [row(str(number), condition, float(value))]
    ]


def test_groups_are_compared_by_welch() -> None:
    found = group_differences(grouped(SCORES))
    assert len(found) == 6
    for one in found:
        column = ["C1", "C2"].index(one.condition)
        known = ttest_ind(
            SCORES[one.group_b][:, column], SCORES[one.group_a][:, column], equal_var=False
        )
        assert (one.t, one.p, one.freedom) == pytest.approx(
            (known.statistic, known.pvalue, known.df)
        )
        assert one.p <= one.p_holm
        low, high = known.confidence_interval()
        assert (one.lower, one.upper) == pytest.approx((low, high))


def test_effects_of_groups_are_analyses_of_variance_of_sums_and_differences() -> None:
    main, interaction = group_effects(grouped(SCORES))
    for effect, weights in ((main, (1.0, 1.0)), (interaction, (1.0, -1.0))):
        known = f_oneway(*(table @ weights for table in SCORES.values()))
        assert (effect.variance.f, effect.variance.p) == pytest.approx(tuple(known))
        assert (effect.variance.df1, effect.variance.df2) == (2.0, 12.0)
    assert [main.effect, interaction.effect] == ["group", "group:condition"]


def test_subjects_of_groups_are_not_mixed_up_and_few_give_no_test() -> None:
    scores = {"a": SCORES["a"], "b": SCORES["b"][:1]}
    (first, _) = group_differences(grouped(scores))
    assert (first.subjects_a, first.subjects_b) == (5, 1)
    assert first.difference == pytest.approx(SCORES["b"][0, 0] - SCORES["a"][:, 0].mean())
    assert math.isnan(first.p)
    assert math.isfinite(group_effects(grouped(scores))[0].variance.p)  # pooled over the groups


def over_runs(values: FloatArray) -> list[Row]:
    """Rows of subjects (rows) in runs (columns)."""
    return [
        row(str(s), "C", float(value), run=k, file=f"subj{s}.mat")
        for s, own in enumerate(values, start=1)
        for k, value in enumerate(own, start=1)
    ]


def curve(k: FloatArray, start: float, end: float, constant: float) -> FloatArray:
    return np.asarray(end + (start - end) * np.exp(-(k - 1.0) / constant))


def test_a_subject_s_curve_is_that_of_scipy() -> None:
    k = np.arange(1.0, 13.0)
    values = curve(k, 5.0, 2.0, 3.0) + 0.15 * np.random.default_rng(1).normal(size=k.size)
    (found,) = learning(over_runs(values[None]))
    known, covariance = curve_fit(curve, k, values, p0=(5.0, 2.0, 3.0))
    own = (found.curve.start, found.curve.end, found.curve.constant)
    errors = (found.errors.start, found.errors.end, found.errors.constant)
    np.testing.assert_allclose(own, known, rtol=1e-3)
    np.testing.assert_allclose(errors, np.sqrt(np.diag(covariance)), rtol=1e-2)
    assert found.p == pytest.approx(linregress(k, values).pvalue)


def test_the_common_curve_has_errors_by_the_subjects() -> None:
    rng = np.random.default_rng(2)
    k, truth, inside = np.arange(1.0, 11.0), (4.0, 2.0, 2.0), []
    for _ in range(40):
        ends = truth[1] + 0.5 * rng.normal(size=8)  # they differ in level, and learn alike
        values = np.array([curve(k, 2.0 + end, end, 2.0) for end in ends])
        rows = over_runs(values + 0.2 * rng.normal(size=values.shape))
        found = learning(rows)[-1]
        assert (found.subject, found.subjects, found.points) == ("", 8, 80)
        own = np.array([found.curve.start, found.curve.end, found.curve.constant])
        error = np.array([found.errors.start, found.errors.end, found.errors.constant])
        inside.append(np.abs(own - truth) <= 2.36 * error)  # t of 7 degrees of freedom
    assert 0.88 <= np.mean(inside) <= 0.995


def test_sessions_are_an_order_and_the_straight_line_is_tested_over_subjects() -> None:
    values = np.array([[9.0, 7.5, 6.2, 5.1, 4.4], [8.0, 7.8, 5.9, 5.6, 4.2]])
    rows = [
        replace(own, fields=(*own.fields, ("session", str(k))))
        for s, line in enumerate(values, start=1)
        for k, value in zip((1, 2, 3, 4, 10), line, strict=True)
        for own in [row(str(s), "C", float(value), file=f"{s}-{k}.mat")]
    ]
    *single, common = learning(rows)
    assert [own.subject for own in single] == ["1", "2"]
    slopes = np.array([np.polyfit(range(5), line, 1)[0] for line in values])
    assert common.curve.slope == pytest.approx(slopes.mean())
    assert common.p == pytest.approx(ttest_rel(slopes, np.zeros(2)).pvalue)
    assert math.isnan(common.errors.end)
    assert common.notes
    np.testing.assert_allclose(common.values[:, 1], values.mean(axis=0))
    assert learning([r for r in rows if r.field("session") != "3"]) == []  # too few


def test_missing_runs_do_not_bend_the_common_curve() -> None:
    k = np.arange(1.0, 9.0)
    high, low = (curve(k, 3.0 + end, end, 2.0) for end in (10.0, 0.0))
    tables = [np.stack([k, high], axis=1)[:6], np.stack([k, low], axis=1)]
    found = fitted(tables)
    assert (found.start, found.end, found.constant) == pytest.approx((8.0, 5.0, 2.0), rel=1e-4)
