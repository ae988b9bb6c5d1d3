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
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar, Literal

import numpy as np

from pilotid.chance import Z95
from pilotid.estimates.estimate import Estimate, Outcome, failed
from pilotid.estimates.parts import Trajectory, times_of
from pilotid.pilot.model import PilotModel
from pilotid.pilot.timevarying import Sigmoid
from pilotid.recordings.recording import Recording
from pilotid.solve.search import search
from pilotid.time_domain.diagnostics import coloured, uneven
from pilotid.time_domain.output_error import OutputErrors
from pilotid.time_domain.over_time import estimated_over_time, no_reduction
from pilotid.time_domain.prediction import predict
from pilotid.time_domain.random_walk import WalkingPilot, unsuited, walking_pilot
from pilotid.time_domain.unscented import Filtered, Smoothed, run_filter, run_smoother
from pilotid.types import FloatArray, IntArray

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
SPREAD = 1.05  # distance of the sigma points over the root of the number of parameters
#: Least, largest and usual levels: standard deviation of a walk after a second, of logarithms; of
#: the remnant over that of the control; and its lag [s].
WALK, REMNANT, LAG = (1e-3, 0.7, 0.06), (0.003, 1.5), (0.02, 2.0, 0.2)
APART = (1.0, 0.15, 0.7)  # standard deviations of the logarithms of these in the first round
ELITE = 8  # sets of levels that the next round is drawn around
WIDER = 1.3  # by how much that round is wider than they are
LEAST = 0.01  # weight of a set that is kept


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

    band: float = 26.0
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
        pilot = walking_pilot(recording, plain, self.band)
        groups = np.eye(len(start))[3:]  # gains and leads have a level each, all others one
        if self.walking == "all":
            groups = np.vstack([groups, [*ALL, *np.zeros(len(start) - 3)]])
        noise = partial(pilot.with_levels, start, groups)
        spread = SPREAD * math.sqrt(len(start))
        size = len(pilot.time) * (len(start) + 5 * pilot.measured.shape[1]) ** 2
        found = self._likeliest(
            lambda levels, orders: run_filter(*noise(levels, orders), spread),
            np.array([*[WALK] * len(groups), (*REMNANT, remnant), LAG]),
            max(1, min(self.kept, int(MOST / size))),
            rng,
        )
        if found is None:
            return failed(self.name, model, Outcome.DIVERGED, "every filter broke down")
        steps: list[Filtered] = []
        run_filter(*noise(found.levels, found.orders), spread, steps)
        course = run_smoother(steps)
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
        ends = (pilot.from_walk(mean + reach * error).T for reach in (0.0, -Z95, Z95))
        trajectory = Trajectory(plain.keys, pilot.time, *ends).at(times_of(recording.duration))
        estimate = estimated_over_time(
            self.name,
            recording,
            model,
            trajectory,
            lambda weights: _covariance(pilot, course, found.weights, trajectory.time, weights),
        )
        if not np.isfinite(estimate.values).all():
            return estimate
        errors = np.array([step.errors[0] for step in steps[math.ceil(LEARN / pilot.dt) :]]).T
        remarks = (remark for remark in (coloured(errors), uneven(errors)) if remark)
        return replace(
            estimate,
            intervals=_open_rates(estimate),
            criterion=-2.0 * found.log_likelihood,
            remarks=(*estimate.remarks, *remarks),
        )

    def _likeliest(
        self,
        log_likelihood: Callable[[FloatArray, IntArray], FloatArray],
        ranges: FloatArray,
        kept: int,
        rng: np.random.Generator,
    ) -> _Levels | None:
        """Search the levels, and of several remnants the likeliest by the first round.

        The likely sets are those of the last round, weighted for where it drew them: to take the
        best one alone would be to know the levels.
        """
        low, high, middle = np.log(ranges).T
        orders = np.array(ORDERS[self.remnant])
        root = np.diag([*[APART[0]] * (len(low) - 2), *APART[1:]])
        tried, worth = np.zeros((0, len(low))), np.zeros(0)
        for _ in range(self.rounds):
            own = np.repeat(orders, self.candidates)  # of each candidate
            normal = rng.standard_normal((own.size, len(low)))
            normal[:: self.candidates] = 0.0
            drawn = np.clip(middle + normal @ root.T, low, high)
            last = log_likelihood(drawn, own)
            orders = own[[np.argmax(last)]]
            drawn, last, normal, own = (part[own == orders] for part in (drawn, last, normal, own))
            tried, worth = np.concatenate([tried, drawn]), np.concatenate([worth, last])
            best = np.argsort(-worth, kind="stable")[:ELITE]
            best = best[np.isfinite(worth[best])]
            if best.size > 1:
                middle = tried[best].mean(axis=0)
                own_only = np.diag(np.var(tried[best], axis=0) + 1e-3)
                root = WIDER * np.linalg.cholesky(0.5 * np.cov(tried[best].T) + 0.5 * own_only)
        if not np.isfinite(last).any():
            return None
        weights = last + 0.5 * np.sum(normal**2, axis=1)
        first = np.argsort(-weights, kind="stable")[:kept]
        weights = np.exp(weights[first] - weights[first[0]])
        likely = weights > LEAST * weights.sum()
        first, weights = first[likely], weights[likely] / weights[likely].sum()
        return _Levels(drawn[first], own[: len(first)], weights, float(worth.max()))


@dataclass(frozen=True, eq=False)
class _Levels:
    """Logarithms of likely levels (sets, levels), their remnants, weights and best likelihood."""

    levels: FloatArray
    orders: IntArray
    weights: FloatArray
    log_likelihood: float


def _constant(
    recording: Recording, plain: PilotModel, rng: np.random.Generator
) -> tuple[FloatArray, float]:
    """The constant pilot of best fit, and what it leaves of the control as a standard deviation."""
    errors = OutputErrors(predict(recording, plain, SEARCH_BAND))
    found = search(errors.gram, plain, rng)
    left = found.cost[0] / errors.residuals
    return found.values[0], float(np.sqrt(left / np.mean(np.var(errors.prediction.control, 1))))


def _mixed(course: Smoothed, weights: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    """Mean and standard error of the parameters at each step, of all likely levels together."""
    means = course.mean[..., :count]
    mean = np.einsum("s,skp->kp", weights, means)
    own = np.diagonal(course.covariance, axis1=2, axis2=3)[..., :count]
    variance = np.einsum("s,skp->kp", weights, own + (means - mean) ** 2)
    return mean, np.sqrt(np.maximum(variance, 0.0))


def _covariance(
    pilot: WalkingPilot,
    course: Smoothed,
    shares: FloatArray,
    time: FloatArray,
    weights: FloatArray,
) -> FloatArray:
    """Covariance of sums over the course with weights (sums, keys, times), of all likely levels."""
    places = np.clip(np.searchsorted(pilot.time, time), 0, len(pilot.time) - 1)
    steps = weights[:, pilot.order] @ (places[:, None] == np.arange(len(pilot.time)))
    sums = np.einsum("pqt,stq->sp", steps, course.mean[..., : len(pilot.order)])
    off = sums - shares @ sums
    within = np.einsum("s,spq->pq", shares, course.covariance_of(steps))
    return np.asarray(within + np.einsum("s,sp,sq->pq", shares, off, off))


def _open_rates(estimate: Estimate) -> FloatArray:
    """The intervals, a rate's without an upper end: a walk rounds a change, however fast."""
    model, intervals = estimate.model, estimate.intervals.copy()
    for changing in (c.changing for c in model.channels):
        if changing is not None and isinstance(changing.course, Sigmoid):
            rate = model.keys.index(changing.course.rate_key)
            intervals[rate, 1] = model.upper[rate]
    return intervals
