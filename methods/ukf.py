"""Unscented Kalman filter and smoother on parameters that walk at random.

The pilot's parameters are states: gains and leads whose logarithms walk at random, and delay and
neuromuscular parameters that do not, beside the two states of the neuromuscular system and those
of the remnant.  The filter goes through the recording once, the smoother back, and what they find
is the course of the parameters with a band; the model's own parameters are fitted to that course
(`pilotid.time_domain.over_time`).  Published filters are tuned on simulations and
take the remnant for white; here the levels are those under which the recording is likeliest, and
the remnant has one lag or two, whichever is likelier.  The band is of all likely levels together.

References: A. Popovici, P. M. T. Zaal and D. M. Pool, *Dual extended Kalman filter for the
identification of time-varying human manual control behavior*, AIAA 2017-3666; J. Rojer, D. M. Pool,
M. M. van Paassen and M. Mulder, *UKF-based identification of time-varying manual control
behaviour*, IFAC-PapersOnLine 52(19), 2019.

A delay asks for the recorded error a while ago, between its samples as well: no Pade approximant,
no states for it.  Several runs share their parameters at each time, each with states of its own.

A walk is no sigmoid: before and after a change it wanders, and a step it rounds over seconds, so
that the interval of a rate has no upper end.
Where the filter starts far from the pilot it may diverge; by default it starts at the constant
pilot of best fit, and a course that describes the control worse than that one is called diverged.

Assumes one channel on the error, without lags.

Use it to follow a pilot over time without saying how he changes.

Do not use it for fast changes; where the form of the change is known, use `mle` with a model that
has it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from pilotid.chance import Z95, chi_squared_limit
from pilotid.estimates.estimate import Estimate, Outcome, failed
from pilotid.estimates.parts import Trajectory, times_of
from pilotid.limits import ESTIMATE
from pilotid.pilot.model import PilotModel
from pilotid.pilot.timevarying import Sigmoid
from pilotid.recordings.recording import Recording
from pilotid.remarks import Remark
from pilotid.solve.least_squares import LogTransform
from pilotid.solve.search import search
from pilotid.time_domain.diagnostics import portmanteau, ratio_of_halves
from pilotid.time_domain.output_error import OutputErrors
from pilotid.time_domain.over_time import TrajectoryFit, estimated_over_time, no_reduction
from pilotid.time_domain.prediction import predict
from pilotid.time_domain.random_walk import (
    Found,
    WalkingPilot,
    Walks,
    likeliest,
    unsuited,
    walking_pilot,
)
from pilotid.time_domain.unscented import Smoothed, run_smoother
from pilotid.types import FloatArray

SEARCH_BAND = 26.0  # rad/s, of the constant pilot that the filter starts at
#: By how much [% of the control's variance] a course may describe the control worse than the
#: constant pilot.
WORSE = 2.0
#: Numbers that the covariances of all steps may take up, for all sets of noise levels.
MOST = 6e6
ORDERS = {"white": (0,), "lag": (1,), "lags": (2,), "likelier": (1, 2)}
#: How far delay and neuromuscular parameters go with a level, where all walk.
ALL = (1.0, 1.0, 0.1)
LEARN = 5.0  # s, after which innovations are tested
MEMORY = 5.0  # s, of a walk; weighs nothing but the first guess of an error


@dataclass(frozen=True)
class UKF:
    """Unscented Kalman filter and smoother.

    Attributes
    ----------
    band
        Analysis band [rad/s], which sets the length of a step.
    remnant
        White, white noise behind one lag, behind two equal ones, or the likelier of these two.
    walking
        What walks: ``gains`` for gains and leads, ``all`` for delay and neuromuscular
        parameters as well.
    start
        Where the filter starts: the constant pilot of best ``fit``, or the start of the ``model``.
    rounds, candidates
        Of the search for the noise levels.
    kept
        Most sets of noise levels that the band is of.
    """

    band: float = 50.0
    remnant: Literal["white", "lag", "lags", "likelier"] = "likelier"
    walking: Literal["gains", "all"] = "gains"
    start: Literal["fit", "model"] = "fit"
    rounds: int = 3
    candidates: int = 24
    kept: int = 8
    name: ClassVar[str] = "ukf"
    follows: ClassVar[bool] = True
    libraries: ClassVar[tuple[str, ...]] = ("scipy.interpolate",)

    def objection(self, recording: Recording, model: PilotModel) -> str | None:
        """Why it cannot treat a model: other channels or dynamics than it knows."""
        return unsuited(model) or no_reduction(model)

    def fit(self, recording: Recording, model: PilotModel, rng: np.random.Generator) -> Estimate:
        """Filter, smooth, and fit the model to the course of the parameters.

        Parameters
        ----------
        recording
            The recording; its runs share the parameters at each time.
        model
            The pilot model, with parameters that change or without.
        rng
            Draws starts of the constant pilot, and noise levels.
        """
        plain = model.constant
        constant, remnant = _constant(recording, plain, rng)
        start = constant if self.start == "fit" else plain.start
        orders = ORDERS[self.remnant]
        pilot = walking_pilot(recording, plain, self.band, white=orders == (0,))
        groups = self._groups(pilot)
        choices = [Walks(pilot, start, groups, remnant, order) for order in orders]
        size = pilot.numbers(max(orders))
        kept = max(1, min(self.kept, int(MOST / size)))
        found = likeliest(choices, rng, self.rounds, self.candidates, kept)
        if not np.isfinite(found.log_likelihood):
            return failed(self.name, model, Outcome.DIVERGED, "every filter broke down")
        passed = found.walks.passed(found.levels)
        course = run_smoother(passed)
        mean, error = _mixed(course, found.weights, len(start))
        if not (np.isfinite(mean).all() and (error > 0.0).all()):
            return failed(self.name, model, Outcome.DIVERGED, "the smoother broke down")
        left = pilot.left(pilot.from_walk(mean)), pilot.left(constant)
        if left[0] > left[1] + WORSE / 100.0:
            words = (
                f"the course leaves {100.0 * left[0]:.0f} % of the control's variance, the "
                f"constant pilot {100.0 * left[1]:.0f} %"
            )
            return failed(self.name, model, Outcome.DIVERGED, words)
        trajectory = _trajectory(pilot, mean, error, times_of(recording.duration))
        estimate = estimated_over_time(self.name, recording, model, trajectory, MEMORY)
        if not np.isfinite(estimate.values).all():
            return estimate
        estimate = _with_errors(estimate, trajectory, pilot, course, found)
        remarks = (*estimate.remarks, *_remarks(passed.errors[0, math.ceil(LEARN / pilot.dt) :].T))
        return replace(estimate, criterion=-2.0 * found.log_likelihood, remarks=remarks)

    def _groups(self, pilot: WalkingPilot) -> FloatArray:
        """See `Walks`: gains and leads have a level each, all others one together."""
        own = np.eye(len(pilot.order))
        if self.walking == "gains":
            return own[3:]
        return np.concatenate([own[3:], [[*ALL, *np.zeros(len(own) - 3)]]])


def _constant(
    recording: Recording, plain: PilotModel, rng: np.random.Generator
) -> tuple[FloatArray, float]:
    """The constant pilot of best fit, and what it leaves of the control as a standard deviation."""
    errors = OutputErrors(predict(recording, plain, SEARCH_BAND))
    found = search(errors.gram, plain, rng)
    left = found.cost[0] / errors.residuals
    return found.values[0], float(np.sqrt(left / np.mean(np.var(errors.prediction.control, 1))))


def _remarks(errors: FloatArray) -> tuple[str, ...]:
    """What the innovations (runs, steps) say against the filter, a sentence each."""
    found = []
    statistic = portmanteau(errors, ESTIMATE.lags)
    if statistic > chi_squared_limit(ESTIMATE.lags, ESTIMATE.seldom):
        found.append(
            Remark(
                "residual-not-white",
                f"the innovations are not white (Ljung-Box over {ESTIMATE.lags} lags: "
                f"{statistic:.0f}, where chance gives {ESTIMATE.lags}): the remnant is another "
                "than the filter knows, or the pilot changes faster than it follows, and the band "
                "may be too narrow",
            )
        )
    ratio, deviations = ratio_of_halves(errors)
    if deviations**2 > chi_squared_limit(1, ESTIMATE.seldom):
        found.append(
            Remark(
                "residual-variance-changes",
                f"the innovations of the second half have {ratio:.2g} times the variance of those "
                "of the first: the remnant changes, which the filter takes for constant",
            )
        )
    return tuple(found)


def _mixed(course: Smoothed, weights: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    """Mean and standard error of the parameters at each step, of all likely levels together."""
    means = course.mean[..., :count]
    mean = np.einsum("s,skp->kp", weights, means)
    own = np.diagonal(course.covariance, axis1=2, axis2=3)[..., :count]
    variance = np.einsum("s,skp->kp", weights, own + (means - mean) ** 2)
    return mean, np.sqrt(np.maximum(variance, 0.0))


def _trajectory(
    pilot: WalkingPilot, mean: FloatArray, error: FloatArray, time: FloatArray
) -> Trajectory:
    """The course at the times of trajectories, NaN before the filter starts."""
    value, low, high = (pilot.from_walk(mean + reach * error).T for reach in (0.0, -Z95, Z95))
    return Trajectory(pilot.model.keys, pilot.time, value, low, high).at(time)


def _with_errors(
    estimate: Estimate, trajectory: Trajectory, pilot: WalkingPilot, course: Smoothed, found: Found
) -> Estimate:
    """The estimate with the errors that the course has, correlated over time as the smoother says.

    To first order the values are sums of the course at all times.
    """
    model, values = estimate.model, estimate.values
    problem = TrajectoryFit(model, trajectory)
    rows = problem.rows(values[None])[0, :-1]
    scale = LogTransform(model.positive)
    slope = scale.slope(values)
    jacobian = rows * slope[:, None, None]
    flat = jacobian.reshape(len(values), -1)
    prior = np.diag(1.0 / scale.unknown(model.lower, model.upper) ** 2)
    inverse = np.linalg.inv(flat @ flat.T + prior)
    by_time = np.einsum("pq,qkt->pkt", inverse, jacobian / problem.error)
    known = np.flatnonzero(problem.known.all(axis=0))
    weights = np.zeros((len(values), len(pilot.order), len(pilot.time)))
    places = np.searchsorted(pilot.time, trajectory.time[known])
    places = np.clip(places, 0, len(pilot.time) - 1)
    for place, k in zip(places, known, strict=True):
        weights[:, :, place] += by_time[:, pilot.order, k]
    sums = np.einsum("pqt,stq->sp", weights, course.mean[..., : len(pilot.order)])
    off = sums - found.weights @ sums
    scaled = np.einsum("s,spq->pq", found.weights, course.covariance_of(weights))
    scaled += np.einsum("s,sp,sq->pq", found.weights, off, off)
    # What the course does not tell, such as the rate of a step, is known to lie in its bounds.
    scaled += inverse @ prior @ inverse
    error = np.sqrt(np.diag(scaled))
    intervals = np.stack(scale.interval(values, error, model.lower, model.upper), axis=1)
    for changing in (c.changing for c in model.channels):
        if changing is not None and isinstance(changing.course, Sigmoid):
            rate = model.keys.index(changing.course.rate_key)
            intervals[rate, 1] = model.upper[rate]  # a walk rounds a change, however fast it is
    return replace(estimate, covariance=scaled * np.outer(slope, slope), intervals=intervals)
