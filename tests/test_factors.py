"""Factors of conditions: analysis of variance, and what is refused."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import f as f_test
from scipy.stats import ttest_rel, wilcoxon
from tidy_rows import row, table

from pilotid.analysis.combine import signed_ranks
from pilotid.analysis.contrasts import contrasts
from pilotid.analysis.factors import Effect, effects, factors_of
from pilotid.analysis.results import FACTOR_COLUMNS, table_of
from pilotid.support.types import FloatArray, InputError

TEXT = "dynamics=C1,C4:gain;C2,C5:single;C3,C6:double;motion=C1,C2,C3:off;C4,C5,C6:on"
CONDITIONS = ("C1", "C2", "C3", "C4", "C5", "C6")
FACTORS = factors_of(TEXT, CONDITIONS)


def scores(subjects: int = 7) -> FloatArray:
    rng = np.random.default_rng(2)
    effect = np.array([0.0, 0.5, 1.5, 0.2, 1.2, 2.9])
    return (
        effect
        + rng.normal(size=(subjects, 1))
        + rng.normal(size=(subjects, 6)) * [1, 2, 1, 1, 3, 1]
    )


def by_effect(values: FloatArray) -> dict[str, Effect]:
    rows = table({c: tuple(values[:, i].tolist()) for i, c in enumerate(CONDITIONS)})
    return {effect.effect: effect for effect in effects(rows, FACTORS)}


def test_effects_of_two_levels_are_those_of_paired_tests() -> None:
    values = scores()
    off, on = values[:, :3], values[:, 3:]
    found = by_effect(values)
    assert list(found) == ["dynamics", "motion", "dynamics:motion"]
    known = ttest_rel(on.mean(axis=1), off.mean(axis=1))
    own = found["motion"]
    assert (own.f, own.df1, own.df2) == pytest.approx((known.statistic**2, 1.0, 6.0))
    assert (own.p, own.p_corrected) == pytest.approx((known.pvalue, known.pvalue))
    for effect in found.values():
        own, e = effect, effect.epsilon
        assert own.eta_squared == pytest.approx(own.f * own.df1 / (own.f * own.df1 + own.df2))
        assert own.p_corrected == pytest.approx(f_test.sf(own.f, e * own.df1, e * own.df2))
    assert found["motion"].epsilon == pytest.approx(1.0)


def test_what_does_not_scatter_has_no_test() -> None:
    (first, *_) = effects(table(dict.fromkeys(CONDITIONS, (1.0, 2.0, 3.0))), FACTORS)
    assert math.isnan(first.f)
    assert first.notes == ("no test: nothing scatters",)


def test_the_correction_of_an_interaction_is_boxs() -> None:
    """Box's epsilon by the double-centred covariance of the difference between on and off."""
    values = scores()
    difference = values[:, 3:] - values[:, :3]
    covariance = np.cov(difference, rowvar=False)
    mean = covariance.mean()
    centred = covariance - covariance.mean(axis=0) - covariance.mean(axis=1)[:, None] + mean
    box = np.trace(centred) ** 2 / (2.0 * np.sum(centred**2))
    own = by_effect(values)["dynamics:motion"]
    assert own.epsilon == pytest.approx(box)
    assert 0.5 <= own.epsilon < 1.0


def test_the_greenhouse_geisser_correction_of_a_published_table() -> None:
    """Five subjects under four conditions; F, epsilon and eta squared worked out by sums."""
    values = np.array([[30, 28, 16, 34], [14, 18, 10, 22], [24, 20, 18, 30], [38, 34, 20, 44],
                       [26, 28, 14, 30.0]])  # fmt: skip
    # Winer, Statistical Principles in Experimental Design (1962), the drugs of table 4.3-1.
    rows = table({f"D{i}": tuple(values[:, i].tolist()) for i in range(4)})
    factor = {"drug": {f"D{i}": str(i) for i in range(4)}}
    (own,) = effects(rows, factor)
    assert own.f == pytest.approx(24.76, abs=0.005)
    assert (own.df1, own.df2) == (3.0, 12.0)


def test_a_subject_who_is_not_complete_is_left_out_and_named() -> None:
    values = scores()
    rows = table({c: tuple(values[:, i].tolist()) for i, c in enumerate(CONDITIONS)})
    rows = [r for r in rows if (r.field("subject"), r.field("condition")) != ("3", "C5")]
    found = effects(rows, FACTORS)
    assert {effect.subjects for effect in found} == {tuple("124567")}
    assert all("subject 3" in effect.notes[0] for effect in found)
    head, (line, *_) = table_of(found, FACTOR_COLUMNS)
    assert head == list(FACTOR_COLUMNS)
    assert dict(zip(head, line, strict=True))["F"] == found[0].f


def test_a_parameter_that_a_condition_lacks_has_no_effects() -> None:
    assert effects([row(s, "C1", 1.0) for s in "123"], FACTORS) == []


def test_a_file_says_the_same(tmp_path: Path) -> None:
    lines = [f"{c},{FACTORS['dynamics'][c]},{FACTORS['motion'][c]}" for c in CONDITIONS]
    path = tmp_path / "factors.csv"
    path.write_text("\n".join(["condition,dynamics,motion", *lines]) + "\n")
    assert factors_of(str(path), CONDITIONS) == FACTORS
    path.write_text("condition,motion\nC1,\nC2,on\n")
    with pytest.raises(InputError, match="a level in every cell"):
        factors_of(str(path), CONDITIONS)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "names no factor"),
        ("motion", "must be FACTOR"),
        ("motion=C1,C2", "must be FACTOR"),
        ("motion=:off;C2:on", "must be FACTOR"),
        ("motion=C1:off;C9:on", "C9, which no file has"),
        ("motion=C1,C2:off", "one level only"),
        ("motion=C1:off;C1:on", "two levels"),
        ("motion=C1,C2:off;C3:on", "the same levels"),
        ("motion=C1:off;C2:on;gain=C1:low", "one level only"),
        ("motion=C1,C3:off;C2:on;gain=C1,C2:low;C3:high", "no condition has the levels on, high"),
        ("motion=C1,C3:off;C2,C4:on;gain=C1,C2:low;C3:high", "C4 has no level of gain"),
        ("missing.csv", "there is no such file"),
    ],
)
def test_factors_that_make_no_sense_are_refused(text: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        factors_of(text, CONDITIONS)


def test_signed_ranks_bear_one_bad_fit() -> None:
    values = np.array([0.9, 1.1, 1.0, 1.2, 0.8, 30.0])
    robust, p = signed_ranks(values)
    assert 0.9 < robust < 1.3
    assert p == wilcoxon(values).pvalue == pytest.approx(2.0 / 2.0**6)
    assert all(math.isnan(number) for number in signed_ranks(values[:1]))


def test_an_interval_holds_zero_where_holms_p_is_above_5_percent() -> None:
    rng = np.random.default_rng(0)
    columns = {f"C{i}": tuple((rng.normal(size=6) + 0.8 * i).tolist()) for i in range(4)}
    found = contrasts(table(columns))
    for c in found:
        assert (c.lower_holm <= 0.0 <= c.upper_holm) is (c.p_holm >= 0.05)
        assert c.lower_holm <= c.lower < c.upper <= c.upper_holm
    assert {c.p_holm < 0.05 for c in found} == {True, False}
    single = contrasts(table(columns), [("C0", "C3")])[0]
    assert (single.lower_holm, single.upper_holm) == pytest.approx((single.lower, single.upper))
