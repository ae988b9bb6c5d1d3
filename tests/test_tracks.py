"""Scores of trajectories, worked out by hand, and how a study keeps them."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pilotid.datasets import SCENARIOS, experiments
from pilotid.estimates.parts import Trajectory, times_of
from pilotid.study.comparison import TRAJECTORIES, comparison_of
from pilotid.study.entries import Track
from pilotid.study.store import Store
from pilotid.study.study import Study
from pilotid.study.tracks import (
    THINNED,
    lag_of,
    periods_of,
    root_mean_square,
    share_inside,
    track_scores,
    tracks_of,
    truth_over_time,
)

SLOW, FAST = SCENARIOS["adapting-slow"], SCENARIOS["adapting-fast"]
TIME = times_of(81.92)


def late(scenario_name: str, seconds: float, factor: float = 1.0) -> Trajectory:
    """A trajectory that is the truth some seconds later, times a factor, with a band of 10 %."""
    scenario = SCENARIOS[scenario_name]
    values = factor * scenario.model.over_time(scenario.values, TIME - seconds)
    return Trajectory(scenario.model.constant.keys, TIME, values, 0.9 * values, 1.1 * values)


def test_root_mean_square_leaves_out_what_is_not_known() -> None:
    assert root_mean_square(np.array([3.0, np.nan, -4.0])) == pytest.approx(np.sqrt(12.5))
    assert np.isnan(root_mean_square(np.array([np.nan])))


def test_the_share_of_the_time_in_the_band_counts_known_times() -> None:
    band = np.array([[0.0, 1.0], [0.0, 1.0], [2.0, 3.0], [np.nan, 1.0]])
    assert share_inside(band, np.array([0.5, 1.0, 1.0, 1.0])) == pytest.approx(2 / 3)


def test_a_change_lasts_from_a_twentieth_to_the_last_and_ten_seconds_at_least() -> None:
    for scenario, reach in ((SLOW, np.log(19.0) / 0.5), (FAST, 5.0)):
        truth = scenario.model.over_time(scenario.values, TIME)
        before, during, after, whole = periods_of(TIME, truth)
        assert TIME[during][[0, -1]] == pytest.approx([41.92 - reach, 41.92 + reach], abs=0.5)
        assert (before ^ during ^ after).all()
        assert whole.all()


@pytest.mark.parametrize("name", ["adapting-slow", "adapting-fast"])
@pytest.mark.parametrize("seconds", [-2.0, 0.0, 3.5])
def test_a_lag_is_found_whatever_the_bias(name: str, seconds: float) -> None:
    tracks = {t.parameter: t for t in tracks_of(late(name, seconds, 1.3), SCENARIOS[name])}
    for key in ("Kvis", "tlead"):
        assert tracks[key].lag == pytest.approx(seconds, abs=0.5)
    assert tracks["tdvis"].lag is None  # it does not change
    assert tracks["tdvis"].rmse[3] == pytest.approx(0.3)
    assert tracks["tdvis"].coverage == 0.0


def test_the_lag_of_a_ramp_by_hand() -> None:
    beyond = np.arange(-20.0, 30.25, 0.25)
    around = np.clip(beyond, 2.0, 8.0)
    time = np.arange(0.0, 10.25, 0.25)
    assert lag_of(time, np.clip(time - 1.5, 2.0, 8.0), beyond, around) == pytest.approx(1.5)
    assert np.isnan(lag_of(time, np.full(time.size, np.nan), beyond, around))


def test_errors_are_told_by_period_and_relative_to_the_truth() -> None:
    half = late("adapting-fast", 0.0)
    values = half.values.copy()
    values[:, half.time > 60.0] *= 1.2
    tracks = tracks_of(replace(half, values=values), FAST)
    for track in tracks:
        assert track.rmse[:2] == pytest.approx((0.0, 0.0), abs=1e-9)
        share = np.mean(half.time[half.time > 41.92 + 5.0] > 60.0)
        assert track.rmse[2] == pytest.approx(0.2 * np.sqrt(share), rel=0.02)
        assert len(track.values) == THINNED
    assert tracks[1].values[0] == pytest.approx(0.4)


def test_scores_over_fits_by_hand() -> None:
    def track(size: float, lag: float | None) -> Track:
        return Track("K", (None, size, size, size), lag, 0.5 * size, (size, None))

    (found,) = track_scores([[track(0.3, 1.0)], [track(0.4, 3.0)], [track(1.2, None)]])
    assert found.n == 3
    assert np.isnan(found.rmse[0].value)
    assert found.rmse[3].value == pytest.approx(np.sqrt((0.09 + 0.16 + 1.44) / 3))
    assert (found.median, found.lag.value) == pytest.approx((0.4, 2.0))
    assert found.coverage.value == pytest.approx(0.95 / 3)
    assert found.coverage.error == pytest.approx(np.std([0.15, 0.2, 0.6], ddof=1) / np.sqrt(3))


def test_the_truth_over_time_is_that_of_pilots_who_change() -> None:
    assert truth_over_time(SCENARIOS["single"]) is None
    found = truth_over_time(SLOW)
    assert found is not None
    assert found.values[:, -1] == pytest.approx([0.07, 1.2, 0.28, 11.25, 0.35], rel=1e-3)


@pytest.mark.numerical
@pytest.mark.long
def test_a_study_keeps_tracks_and_writes_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Bounds are not what this is about; under its own name the scenario's are found anew.
    monkeypatch.setattr(experiments, "RECORDINGS", 2)
    changing = replace(SLOW, name="changing")
    study = Study([changing, "single"], ["mle-white", "rarx"], 2)
    whole = study.run_in(tmp_path, workers=1)
    with Store(tmp_path) as store:
        assert comparison_of(store).cells[0].results == whole.cells[0].results
        about = json.loads(store.about()["trajectory changing"])
    assert len(about["time"]) == len(about["tlead"]) == THINNED
    cell, still = whole.at("changing", "rarx"), whole.at("single", "rarx")
    assert cell is not None
    assert still is not None
    assert [t.parameter for t in cell.tracks] == ["Kvis", "tlead", "tdvis", "fnm", "dnm"]
    assert cell.paths("tlead").shape == (2, THINNED)
    assert still.tracks == ()
    whole.write_tables(tmp_path)
    with (tmp_path / TRAJECTORIES).open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 10
    assert float(rows[-1]["rmse_whole"]) == pytest.approx(cell.tracks[-1].rmse[3].value)
