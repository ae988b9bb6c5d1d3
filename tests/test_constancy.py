"""Pilots who change: the test for gains and leads, and the scores of segments that disperse."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from helpers import NOMINAL, SINGLE_LOOP, changing_half_way, recording_of

from pilotid.datasets import SCENARIOS, Scenario
from pilotid.estimate.method import identify
from pilotid.likelihood.diagnostics import PLACES, gains_change, score_of_changes
from pilotid.likelihood.search import LikelihoodSettings, maximise_likelihood
from pilotid.methods import method_named
from pilotid.model.catalogue import SINGLE
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.solve.intervals import score_dispersion
from pilotid.support.numbers import chi_squared_limit, chi_squared_tail
from pilotid.support.remarks import codes_of
from pilotid.support.types import FloatArray

pytestmark = pytest.mark.numerical


def left_by(jacobian: FloatArray, y: FloatArray) -> FloatArray:
    """Jacobian, shape (parameters, runs, samples), and what a regression on it leaves."""
    table = jacobian.reshape(len(jacobian), -1)
    found = np.linalg.lstsq(table.T, y.ravel())[0]
    return np.concatenate([jacobian, (y.ravel() - found @ table).reshape(1, *y.shape)])


def regression(rng: np.random.Generator, *, change: float = 0.0) -> FloatArray:
    """Jacobian and residual of a straight regression, which may change after two thirds."""
    jacobian, y = rng.normal(size=(4, 2, 150)), rng.normal(size=(2, 150))
    y[:, 100:] += change * jacobian[1, :, 100:]
    return left_by(jacobian, y)


def wandering(rng: np.random.Generator, size: float = 0.0) -> FloatArray:
    """The same of three long runs, in which the last parameter wanders."""
    jacobian = rng.standard_normal((4, 3, 2000))
    slow = np.repeat(rng.standard_normal((3, 20)), 100, axis=1)
    return left_by(jacobian, rng.standard_normal((3, 2000)) + size * slow * jacobian[2])


def left(columns: FloatArray, y: FloatArray) -> float:
    found = np.linalg.lstsq(columns.T, y)[0]
    return float(np.sum((y - found @ columns) ** 2))


def test_statistics_are_what_regressions_with_a_change_explain() -> None:
    rows = regression(np.random.default_rng(1), change=0.2)
    table, errors = rows[:-1].reshape(4, -1), rows[-1].ravel()
    changes = zip((0.3, 0.5), score_of_changes(rows, [0, 2], [0.3, 0.5]), strict=True)
    for place, (statistic, freedom, found) in changes:
        after = np.tile(np.arange(150) >= place * 150, 2)
        more = np.concatenate([table, table[[0, 2]] * after])
        explained = errors @ errors - left(more, errors)
        assert freedom == 2
        assert statistic == pytest.approx(explained / (errors @ errors / (errors.size - 4)))
        assert found == pytest.approx(np.linalg.lstsq(more.T, errors)[0][4:])


def test_a_constant_pilot_gives_chi_squared_and_a_change_is_found() -> None:
    rng = np.random.default_rng(5)
    sound = [score_of_changes(regression(rng), range(3), [0.5])[0][0] for _ in range(400)]
    # Chi-squared with 3 degrees of freedom has the mean 3 and the deviation 6^(1/2).
    assert np.mean(sound) == pytest.approx(3.0, abs=4.0 * np.sqrt(6.0 / 400.0))
    assert np.mean(np.array(sound) > chi_squared_limit(3, 0.05)) < 0.10
    changed = score_of_changes(regression(rng, change=0.9), [0, 1], PLACES)
    place, (statistic, _, steps) = max(zip(PLACES, changed, strict=True), key=lambda at: at[1][0])
    assert chi_squared_tail(2, statistic) < 1e-6
    assert place == pytest.approx(2.0 / 3.0, abs=0.1)
    assert steps[1] == pytest.approx(0.9, abs=0.3)


def test_nothing_is_told_of_parameters_that_cannot_be_told_apart() -> None:
    rows = regression(np.random.default_rng(4))
    rows[1] = rows[0]
    assert score_of_changes(rows, [0, 1], PLACES) == []
    rows[1] = 0.0
    assert score_of_changes(rows, [0, 1], PLACES) == []


def told(recording: Recording, model: PilotModel) -> str:
    rng = np.random.default_rng(1)
    found = maximise_likelihood(recording, model, rng, LikelihoodSettings(wide=()))
    return gains_change(found) or ""


@pytest.mark.parametrize("name", ["adapting-slow", "adapting-fast"])
def test_a_pilot_who_changes_is_seen(name: str) -> None:
    words = told(recording_of(SCENARIOS[name]), SINGLE)
    pattern = r"t = (.*?) s \(Kvis by (.*?) %, tlead by (.*?) %; score test, chi-square (\d*)"
    ((time, gain, lead, statistic),) = re.findall(pattern, words)
    assert float(time) == pytest.approx(41.92, abs=10.0)
    assert float(gain) < 0.0 < float(lead)
    assert len(PLACES) * chi_squared_tail(2, float(statistic)) < 1e-6


@pytest.mark.parametrize("scenario", [SINGLE_LOOP, NOMINAL, replace(SINGLE_LOOP, runs=3)])
def test_constant_pilots_are_not_said_to_change(scenario: Scenario) -> None:
    for replication in range(3):
        recording = recording_of(scenario, replication)
        assert told(recording, scenario.model) == ""


# ------------------------------------------------------------------ scores of segments


def test_it_is_chi_squared_of_constant_parameters() -> None:
    found = [score_dispersion(wandering(np.random.default_rng(seed)), 3, 200) for seed in range(60)]
    statistics, freedom = np.transpose(found)
    # Segments that know more than others count more: that is less than the freedom of all.
    assert freedom == pytest.approx(np.full(60, 3.0 * 30.0 - 3.0), rel=0.1)
    assert np.mean(statistics / freedom) == pytest.approx(1.0, abs=3.0 * (2.0 / 87.0 / 60) ** 0.5)
    assert np.std(statistics / freedom) == pytest.approx((2.0 / 87.0) ** 0.5, rel=0.4)


def test_a_parameter_that_wanders_disperses_the_scores() -> None:
    statistic, freedom = score_dispersion(wandering(np.random.default_rng(1), 0.3), 3, 100)
    assert statistic > chi_squared_limit(freedom, 1e-6)


def test_parameters_without_a_slope_and_single_segments_do_not_count() -> None:
    rows = wandering(np.random.default_rng(2))
    rows[1] = 0.0
    assert score_dispersion(rows, 3, 200)[1] == pytest.approx(2.0 * 30.0 - 2.0, rel=0.1)
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
