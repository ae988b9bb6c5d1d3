"""Scores of trajectories, parameters over time against the truth's, as free functions.

Errors are relative to the true value at the time.  A change begins and ends where a twentieth
of it is left, and lasts ten seconds at least: after a step as well a method takes some time.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pilotid.datasets import Scenario
from pilotid.estimates.parts import Trajectory, times_of
from pilotid.study import scores
from pilotid.study.entries import Track, number
from pilotid.study.scores import Mean
from pilotid.types import BoolArray, FloatArray

THINNED = 42  # times that a study keeps of a trajectory, for figures
AT_LEAST = 5.0  # seconds on either side of the middle that belong to a change
FARTHEST = 20.0  # seconds by which a trajectory may lag or lead
FINE = 0.25  # seconds between lags that are tried
PERIODS = ("before", "during", "after", "whole")


class TrackScore(NamedTuple):
    """One parameter's trajectories by one method in one scenario, over the fits that count.

    Attributes
    ----------
    parameter, n
        The parameter of the constant pilot, and the number of trajectories.
    rmse
        Root mean square of relative errors before, during and after the change and over all of
        the window, each with its Monte Carlo standard error.
    median
        Median over the fits of the root mean square over all of the window.
    lag
        Median of the lag [s], NaN for a parameter that does not change.
    coverage
        Mean share of the time at which the band holds the true value.
    """

    parameter: str
    n: int
    rmse: tuple[Mean, ...]
    median: float
    lag: Mean
    coverage: Mean


def truth_over_time(scenario: Scenario) -> Trajectory | None:
    """The true parameters at the times that a study keeps; None for a pilot who stays."""
    if not scenario.model.changes:
        return None
    time = np.linspace(0.0, scenario.duration, THINNED)
    values = scenario.model.over(scenario.duration).over_time(scenario.values, time)
    return Trajectory(scenario.model.constant.keys, time, values, values, values)


def tracks_of(trajectory: Trajectory, scenario: Scenario) -> tuple[Track, ...]:
    """What a study keeps of a trajectory: its scores against the truth, and few of its values.

    Parameters
    ----------
    trajectory
        The estimate's.
    scenario
        The scenario with its truth.
    """
    fine = times_of(scenario.duration)
    beyond = np.arange(-FARTHEST, scenario.duration + FARTHEST + FINE, FINE)
    model = scenario.model.over(scenario.duration)
    truth = model.over_time(scenario.values, fine)
    around = model.over_time(scenario.values, beyond)
    found = trajectory.at(fine)
    thinned = trajectory.at(np.linspace(0.0, scenario.duration, THINNED)).values
    periods = periods_of(fine, truth)
    tracks = []
    for i, key in enumerate(found.keys):
        relative = found.values[i] / truth[i] - 1.0
        band = np.stack([found.lower[i], found.upper[i]], axis=1)
        errors = tuple(number(root_mean_square(relative[chosen])) for chosen in periods)
        lag = math.nan
        if np.ptp(truth[i]) > 1e-9 * np.max(np.abs(truth[i])):
            lag = lag_of(fine, found.values[i], beyond, around[i])
        kept = tuple(number(round_off(value)) for value in thinned[i])
        share = number(share_inside(band, truth[i]))
        tracks.append(Track(key, errors, number(lag), share, kept))
    return tuple(tracks)


def periods_of(time: FloatArray, truth: FloatArray) -> list[BoolArray]:
    """Times before, during and after a change, and all of them; see `PERIODS`.

    Parameters
    ----------
    time
        Rising times [s], shape (n,).
    truth
        Parameters over time, shape (keys, n), of which at least one changes.
    """
    span = np.ptp(truth, axis=1) / np.max(np.abs(truth), axis=1)
    leading = truth[int(np.argmax(span))]
    progress = (leading - leading[0]) / (leading[-1] - leading[0])
    middle = time[int(np.argmax(progress >= 0.5))]
    begin = min(time[int(np.argmax(progress > 0.05))], middle - AT_LEAST)
    end = max(time[int(np.argmax(progress >= 0.95))], middle + AT_LEAST)
    return [time < begin, (begin <= time) & (time <= end), time > end, np.ones(time.size, bool)]


def root_mean_square(errors: FloatArray) -> float:
    """Root mean square of the finite entries."""
    finite = errors[np.isfinite(errors)]
    return float(np.sqrt(np.mean(finite**2))) if finite.size else math.nan


def share_inside(band: FloatArray, truth: FloatArray) -> float:
    """Share of the times, of those with a band, at which it holds the truth.

    Parameters
    ----------
    band
        Lower and upper ends, shape (n, 2).
    truth
        Shape (n,).
    """
    known = np.isfinite(band).all(axis=1)
    inside = (band[:, 0] <= truth) & (truth <= band[:, 1])
    return float(np.mean(inside[known])) if known.any() else math.nan


def lag_of(time: FloatArray, values: FloatArray, beyond: FloatArray, around: FloatArray) -> float:
    """By how much later than the truth a trajectory is [s]; negative if it is ahead.

    The shift of the truth that fits best, within `FARTHEST`.  What is too low or too high
    throughout is taken off first.

    Parameters
    ----------
    time, values
        The trajectory, shape (n,).
    beyond, around
        The truth at times that reach `FARTHEST` beyond, shape (m,).
    """
    known = np.isfinite(values)
    if known.sum() < 2:
        return math.nan
    shifts = np.arange(-FARTHEST, FARTHEST + FINE / 2, FINE)
    moved = np.array([np.interp(time[known] - shift, beyond, around) for shift in shifts])
    left = values[known] - moved
    cost = np.sum((left - left.mean(axis=1, keepdims=True)) ** 2, axis=1)
    return float(shifts[int(np.argmin(cost))])


def round_off(value: float) -> float:
    """A value with four digits, which a figure needs."""
    return float(f"{value:.4g}")


def track_scores(fits: Sequence[Sequence[Track]]) -> tuple[TrackScore, ...]:
    """Scores of each parameter over fits.

    Parameters
    ----------
    fits
        The tracks of each fit that counts.
    """
    found = []
    for key in dict.fromkeys(track.parameter for tracks in fits for track in tracks):
        own = [track for tracks in fits for track in tracks if track.parameter == key]
        columns = np.array([[*t.rmse, t.lag, t.coverage] for t in own], dtype=float).T
        *periods, lags, shares = (column[np.isfinite(column)] for column in columns)
        rmse = (Mean(root_mean_square(own), scores.rmse(own, 0.0).error) for own in periods)
        lag_error = math.nan
        if lags.size > 1:  # of a median of values that are nearly normal
            quarter, three = np.quantile(lags, (0.25, 0.75))
            lag_error = float(1.2533 * (three - quarter) / 1.349 / math.sqrt(lags.size))
        middle, lag = (float(np.median(x)) if x.size else math.nan for x in (periods[3], lags))
        coverage = Mean(scores.mean(shares), scores.bias(shares, 0.0).error)
        found.append(TrackScore(key, len(own), tuple(rmse), middle, Mean(lag, lag_error), coverage))
    return tuple(found)
