"""Numbers put together: against scipy, statsmodels, and numbers worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import ttest_1samp

from pilotid.analysis.combine import effect_size, holm, plain_mean, random_effects

VALUES = np.array([0.31, 0.72, 0.18, 0.95, 0.44, 0.60])
ERRORS = np.array([0.10, 0.20, 0.08, 0.30, 0.12, 0.15])


def test_a_plain_mean_is_students() -> None:
    found, known = plain_mean(VALUES), ttest_1samp(VALUES, 0.0)
    low, high = known.confidence_interval(0.95)
    assert found.freedom == known.df
    assert (found.t, found.p, found.lower, found.upper) == pytest.approx(
        (known.statistic, known.pvalue, low, high), rel=1e-10
    )


def test_a_mean_of_one_or_none_has_no_error() -> None:
    assert plain_mean(np.array([2.0])).value == 2.0
    assert math.isnan(plain_mean(np.array([2.0])).std_error)
    assert math.isnan(plain_mean(np.array([])).value)


def test_rounding_is_no_scatter() -> None:
    values = np.array([1.3 - 1.2, 100.3 - 100.2, 7.3 - 7.2])
    found = plain_mean(values, 100.3)
    assert found.std_error == 0.0
    assert math.isnan(found.p)
    assert math.isnan(found.lower)


@pytest.mark.parametrize("scale", [0.1, 1.0, 5.0])
def test_random_effects_are_those_of_statsmodels(scale: float) -> None:
    from statsmodels.stats.meta_analysis import combine_effects

    known = combine_effects(VALUES, (scale * ERRORS) ** 2, method_re="pm", atol=1e-12)
    found = random_effects(VALUES, scale * ERRORS)
    assert found.between**2 == pytest.approx(max(known.tau2, 0.0), abs=1e-9)
    error = known.sd_eff_w_re_hksj if scale < 5.0 else known.sd_eff_w_fe_hksj
    mean = known.mean_effect_re if scale < 5.0 else known.mean_effect_fe
    assert found.mean.value == pytest.approx(mean, rel=1e-6)
    assert found.mean.std_error == pytest.approx(error, rel=1e-6)
    assert (found.between == 0.0) == (scale == 5.0)  # errors that explain all of the scatter


def test_equal_errors_change_nothing() -> None:
    found, plain = random_effects(VALUES, np.full(6, 0.05)).mean, plain_mean(VALUES)
    assert (found.value, found.std_error, found.p) == pytest.approx(
        (plain.value, plain.std_error, plain.p), rel=1e-9
    )


def test_the_spread_by_hand() -> None:
    # Two numbers with equal errors: the variance of the two, 2, less that of the errors, 1.
    found = random_effects(np.array([1.0, 3.0]), np.array([1.0, 1.0]))
    assert found.mean.value == pytest.approx(2.0)
    assert found.between == pytest.approx(1.0)
    assert found.between_lower == 0.0


def test_nearly_exact_numbers_scatter_by_their_spread() -> None:
    found = random_effects(VALUES, np.full(6, 1e-9))
    assert found.between == pytest.approx(np.std(VALUES, ddof=1))


@pytest.mark.numerical
@pytest.mark.long
@pytest.mark.parametrize("between", [0.0, 0.5, 1.0, 3.0])
def test_intervals_of_six_subjects_cover(between: float) -> None:
    # 2000 experiments; the binomial error of a coverage of .95 is .005.
    rng = np.random.default_rng(6)
    inside = spread_inside = 0
    for _ in range(2000):
        errors = rng.uniform(0.5, 1.5, 6)
        found = random_effects(0.7 + rng.normal(size=6) * np.hypot(between, errors), errors)
        inside += found.mean.lower <= 0.7 <= found.mean.upper
        spread_inside += found.between_lower <= between <= found.between_upper
    assert 0.93 <= inside / 2000 <= 0.97
    # An interval that starts at 0 cannot miss a spread of 0 from above.
    assert 0.93 <= spread_inside / 2000 <= (0.99 if between == 0.0 else 0.97)


def test_holm_by_hand() -> None:
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.6, 0.9]) == [1.0, 1.0]
    corrected = holm([0.02, math.nan, 0.01])
    assert corrected[0::2] == pytest.approx([0.02, 0.02])
    assert math.isnan(corrected[1])


def test_effect_size_by_hand() -> None:
    # Hedges' J(2) = gamma(1) / (1 * gamma(.5)); approximately 1 - 3/(4 m - 1) for larger m.
    assert effect_size(2.0, 4.0, 3) == pytest.approx(0.5 / math.sqrt(math.pi))
    assert effect_size(1.0, 1.0, 31) == pytest.approx(1.0 - 3.0 / (4.0 * 30.0 - 1.0), abs=1e-4)
    assert math.isnan(effect_size(1.0, 1.0, 2))
    assert math.isnan(effect_size(1.0, 0.0, 9))
