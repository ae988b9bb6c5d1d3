"""Scores of segments: as large as claimed of constant pilots, larger of pilots who wander."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import NOMINAL, changing_half_way

from pilotid.estimate.method import identify
from pilotid.methods import method_named
from pilotid.solve.intervals import score_dispersion
from pilotid.support.numbers import chi_squared_limit
from pilotid.support.remarks import codes_of

pytestmark = pytest.mark.numerical


def rows_of(rng: np.random.Generator, wander: float = 0.0) -> np.ndarray:
    """Jacobian and least-squares residuals of three runs, the last parameter wandering."""
    jacobian = rng.standard_normal((4, 3, 2000))
    slow = np.repeat(rng.standard_normal((3, 20)), 100, axis=1)
    errors = rng.standard_normal((3, 2000)) + wander * slow * jacobian[2]
    table = jacobian.reshape(4, -1).T
    errors -= (table @ np.linalg.lstsq(table, errors.ravel())[0]).reshape(errors.shape)
    return np.concatenate([jacobian, errors[None]])


def test_it_is_chi_squared_of_constant_parameters() -> None:
    found = [score_dispersion(rows_of(np.random.default_rng(seed)), 3, 200) for seed in range(60)]
    statistics, freedom = np.array([s for s, _ in found]), found[0][1]
    assert {f for _, f in found} == {3 * 30 - 3}
    assert np.mean(statistics) == pytest.approx(freedom, abs=3.0 * (2.0 * freedom / 60) ** 0.5)
    assert np.std(statistics) == pytest.approx((2.0 * freedom) ** 0.5, rel=0.4)


def test_a_parameter_that_wanders_disperses_the_scores() -> None:
    statistic, freedom = score_dispersion(rows_of(np.random.default_rng(1), 0.3), 3, 100)
    assert statistic > chi_squared_limit(freedom, 1e-6)


def test_parameters_without_a_slope_and_single_segments_do_not_count() -> None:
    rows = rows_of(np.random.default_rng(2))
    rows[1] = 0.0
    assert score_dispersion(rows, 3, 200)[1] == 2 * 30 - 2
    assert score_dispersion(rows[:, :1], 3, 5000) == (0.0, 0)


def test_a_constant_pilot_is_not_dispersed_and_a_changing_one_has_wider_intervals() -> None:
    def fit(share: float) -> tuple[np.ndarray, list[str]]:
        shares = {"Kvest": share, "tdvis": share}
        recording = changing_half_way(replace(NOMINAL, runs=3), shares, 4)
        estimate = identify(method_named("mle"), recording, NOMINAL.model, np.random.default_rng(4))
        return estimate.std_error / estimate.values, codes_of(estimate.remarks)

    constant, nothing = fit(0.0)
    changing, said = fit(0.3)
    assert "pilot-changes" not in nothing
    assert "pilot-changes" in said
    assert np.median(changing / constant) > 1.2
