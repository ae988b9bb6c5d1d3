"""From parameters over time to those of a model: what recursive methods end with.

A trajectory's values at two times share what the method remembers, so that they count for less
than as many independent ones; and they are fitted as they come, a lag included.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product

import numpy as np

from pilotid.chance import Z95
from pilotid.estimates.estimate import Estimate, Outcome, failed
from pilotid.estimates.parts import Trajectory
from pilotid.pilot.model import PilotModel
from pilotid.pilot.timevarying import Fading, Sigmoid
from pilotid.recordings.recording import Recording
from pilotid.solve.covariance import sandwich_of
from pilotid.solve.least_squares import LogTransform, Problem, minimise
from pilotid.time_domain.output_error import make_estimate
from pilotid.types import BoolArray, FloatArray

#: A time is weighted as if its band had at least this share of the band's median width: where an
#: estimate happens to be small it claims to be accurate.
NARROWEST = 0.5
#: Relative steps of the differences.
DIFFERENCE = 1e-6
#: Rates [1/s] and numbers of times from which a change is searched, and starts that are refined.
RATES, MIDDLES, REFINED = (0.3, 1.0, 10.0), 15, 5
#: Times that must be known.
FEWEST = 8


class TrajectoryFit(Problem):
    """The sum of squares of what a model's parameters leave of a trajectory.

    Positive parameters count by their logarithm.

    Parameters
    ----------
    model
        The model whose parameters are fitted.
    trajectory
        Its constant model's parameters over time.

    Attributes
    ----------
    known
        Where the trajectory has values and a band, shape (keys, times).
    error
        Standard errors there, on the logarithm of positive parameters, shape (keys, times).
    """

    block = 64

    def __init__(self, model: PilotModel, trajectory: Trajectory) -> None:
        self.model, self.trajectory = model, trajectory
        plain = model.constant
        self._logs = np.array([p.positive for p in plain.parameters])[:, None]
        lower, upper = np.array([(p.lower, p.upper) for p in plain.parameters]).T[..., None]
        with np.errstate(invalid="ignore"):
            # Beyond their bounds values mean no more than the bound does.
            parts = [
                self._scaled(np.clip(part, lower, upper))
                for part in (trajectory.values, trajectory.lower, trajectory.upper)
            ]
        self._data, low, high = parts
        error = (high - low) / (2.0 * Z95)
        self.known: BoolArray = np.isfinite(self._data) & np.isfinite(error) & (error > 0.0)
        floor = np.array(
            [
                NARROWEST * np.median(e[k]) if k.any() else 1.0
                for e, k in zip(error, self.known, strict=True)
            ]
        )
        self.error: FloatArray = np.where(self.known, np.maximum(error, floor[:, None]), np.inf)

    @property
    def residuals(self) -> int:
        """Values of the trajectory that are known."""
        return int(self.known.sum())

    def rows(self, values: FloatArray) -> FloatArray:
        """Jacobian and residual over their standard errors, (sets, parameters + 1, keys, times)."""
        count = values.shape[1]
        steps = DIFFERENCE * np.maximum(np.abs(values), 1e-3)
        moved = values[:, None] + steps[:, :, None] * np.eye(count)
        found = self._predicted(np.concatenate([values[:, None], moved], axis=1))
        jacobian = (found[:, 1:] - found[:, :1]) / steps[:, :, None, None]
        residual = np.where(self.known, self._data - found[:, :1], 0.0)
        return np.asarray(np.concatenate([jacobian, residual], axis=1) / self.error)

    def _predicted(self, values: FloatArray) -> FloatArray:
        return self._scaled(self.model.over_time(values, self.trajectory.time))

    def _scaled(self, values: FloatArray) -> FloatArray:
        logs = np.log(np.where(self._logs, np.maximum(values, 1e-12), 1.0))
        return np.asarray(np.where(self._logs, logs, values))

    def starts(self) -> FloatArray:
        """Where searches begin, shape (starts, parameters).

        Parameters before and after a change are the trajectory's means on either side of it.
        """
        model, time = self.model, self.trajectory.time
        every = np.ones(time.size, dtype=bool)
        whole = self._means(every)
        if not model.changes:
            return whole[None]
        before, after = model.ends
        found = []
        for middle, rate in product(np.linspace(time[0], time[-1], MIDDLES + 2)[1:-1], RATES):
            start = model.start.copy()
            start[before], start[after] = self._means(time < middle), self._means(time >= middle)
            start[before[before == after]] = whole[before == after]
            for when in model.whens:
                start[list(when)] = [middle, rate][: len(when)]
            found.append(start)
        return np.clip(np.array(found), model.lower, model.upper)

    def _means(self, chosen: BoolArray) -> FloatArray:
        """Weighted means over some times, those of all times for what is not known there."""
        weights = 1.0 / self.error**2
        data = np.where(self.known, self._data, 0.0)
        some = np.where(chosen, weights, 0.0)
        enough = some.sum(axis=1) > 0.0
        some = np.where(enough[:, None], some, weights)
        mean = np.sum(some * data, axis=1) / np.maximum(some.sum(axis=1), 1e-300)
        return np.asarray(np.where(self._logs[:, 0], np.exp(mean), mean))


def estimated_over_time(
    method: str,
    recording: Recording,
    model: PilotModel,
    trajectory: Trajectory,
    memory: float | Callable[[FloatArray], FloatArray],
) -> Estimate:
    """The estimate of a model's parameters that a trajectory leads to.

    Parameters are fitted to the trajectory by least squares, each value with the weight of its
    band; those of a constant model are weighted means over time.  Positive ones count by their
    logarithm.  Their covariance is that of errors which are correlated over the method's memory
    and across parameters as the residuals are, and larger than the band says where the
    residuals are.

    Parameters
    ----------
    method
        Name of the method.
    recording, model
        What was fitted.
    trajectory
        Parameters of the constant pilot over time, with their band.
    memory
        Time [s] over which the correlation of the trajectory's errors falls to 1/e, or the
        covariance (sums, sums) of sums over the trajectory, given their weights (sums, keys,
        times).
    """
    problem = TrajectoryFit(model, trajectory)
    fewest = int(problem.known.sum(axis=1).min())
    if fewest < FEWEST:
        return failed(
            method, model, Outcome.UNSTABLE_MODEL, f"it knows the pilot at {fewest} times only"
        )
    starts = problem.starts()
    cost = problem.gram(starts)[:, -1, -1]
    best = np.argsort(cost, kind="stable")[:REFINED]
    end = minimise(problem.gram, starts[best], model, tolerance=1e-8)
    values = end.values[0]
    covariance, scaled = _covariance(problem, values, memory)
    if covariance is None or scaled is None:
        return failed(method, model, Outcome.SINGULAR)
    estimate = make_estimate(
        method, recording, model, values, covariance, converged=bool(end.converged[0])
    )
    error = np.sqrt(np.diag(scaled))
    ends = LogTransform(model.positive).interval(values, error, model.lower, model.upper)
    intervals = np.stack(ends, axis=1)
    return replace(estimate, intervals=intervals, trajectory=trajectory, iterations=end.iterations)


def _covariance(
    problem: TrajectoryFit, values: FloatArray, memory: float | Callable[[FloatArray], FloatArray]
) -> tuple[FloatArray | None, FloatArray | None]:
    """Covariance of the values, and that on the scale of the search; None if it is singular."""
    model = problem.model
    rows = problem.rows(values[None])[0]
    scale = LogTransform(model.positive)
    slope = scale.slope(values)
    jacobian, residual = rows[:-1] * slope[:, None, None], rows[-1]
    if callable(memory):
        scores = memory(jacobian / problem.error)
    else:
        scores = _remembered(problem, jacobian, residual, memory)
    # What says nothing, such as the rate of a step, is known to lie within its bounds.
    prior = np.diag(1.0 / scale.unknown(model.lower, model.upper) ** 2)
    flat = jacobian.reshape(len(values), -1)
    scaled = sandwich_of(flat @ flat.T + prior, scores + prior)
    if scaled is None or not np.isfinite(scaled).all():
        return None, None
    return scaled * np.outer(slope, slope), scaled


def _remembered(
    problem: TrajectoryFit, jacobian: FloatArray, residual: FloatArray, memory: float
) -> FloatArray:
    """Covariance of the scores where errors at two times share what the method remembers."""
    time = problem.trajectory.time
    own = np.sum(residual**2, axis=1) / problem.known.sum(axis=1)
    size = np.sqrt(np.maximum(own, 1.0))
    spread = np.sqrt(np.maximum(own, 1e-12))
    together = problem.known.astype(float) @ problem.known.T.astype(float)
    alike = (residual @ residual.T) / np.maximum(together, 1.0) / np.outer(spread, spread)
    np.fill_diagonal(alike, 1.0)
    shares, vectors = np.linalg.eigh(alike)  # of unequal times: not quite a correlation matrix
    alike = (vectors * np.maximum(shares, 0.0)) @ vectors.T
    kernel = np.exp(-np.abs(time[:, None] - time) / max(memory, 1e-9))
    carried = np.einsum("pks,st->pkt", jacobian, kernel)
    scores = np.einsum("pkt,qlt,kl->pq", carried, jacobian, alike * np.outer(size, size))
    return np.asarray(scores)


def no_reduction(model: PilotModel) -> str | None:
    """Why a trajectory does not lead to a model's parameters: they change in another way."""
    changings = [c.changing for c in model.channels if c.changing is not None]
    if all(isinstance(c.course, Sigmoid) and not isinstance(c, Fading) for c in changings):
        return None
    return (
        f"the parameters of model {model.name} do not follow from what they are at each time; fit "
        "a model that changes along a sigmoid, such as adapting, or a constant one, and take the "
        "trajectory"
    )
