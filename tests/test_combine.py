"""Numbers put together: against scipy, statsmodels, and numbers worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import ttest_1samp

from pilotid.analysis.combine import effect_size, holm, plain_mean

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
