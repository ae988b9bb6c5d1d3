"""Unscented Kalman filter and smoother, many noise levels at once.

The state is a vector of parameters that walk at random, and for each run states that are linear
for whoever knows the parameters:

    theta(k+1) = theta(k) + w(k),   x(k+1) = Phi(theta) x(k) + g(k, theta) + v(k),
    y(k) = h'x(k) + n(k).

With the parameters first, a Cholesky factor of the covariance has the sigma points of the states
at the mean of the parameters, where the step is linear: their columns go through it as they are.
What is computed is the unscented transform with all its points, from those of the parameters.
As the measurement is linear, its update is that of Kalman.  The smoother is that of Rauch, Tung and
Striebel with the unscented cross-covariance (Särkkä, IEEE Trans. AC 53(3), 2008).

E. A. Wan and R. van der Merwe, *The unscented Kalman filter for nonlinear estimation*, 2000.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from pilotid.types import BoolArray, FloatArray

#: Share of a variance that is added to it before its square root is taken, for rounding.
ROUNDING = 1e-12


class System(Protocol):
    """What the filter asks of a system."""

    @property
    def measured(self) -> FloatArray:
        """Measurements, shape (steps, runs)."""
        ...

    @property
    def output(self) -> FloatArray:
        """What a measurement is of the states of its run, h, shape (states,)."""
        ...

    def step(self, k: int, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Transition to step k + 1.

        Parameters
        ----------
        k
            The step.
        parameters
            Shape (sets, points, parameters).

        Returns
        -------
        Phi, shape (sets, points, states, states), and g, shape (sets, points, runs, states).
        """
        ...


@dataclass(frozen=True, eq=False)
class Levels:
    """Noise of each set in a step, as variances, and where the filter starts.

    Attributes
    ----------
    walk
        Of the parameters, shape (sets, parameters).
    states
        Covariance of the states of a run, shape (sets, states, states).
    error
        Of a measurement, shape (sets,).
    mean, covariance
        Of parameters and states at the first step before its measurement, shapes (sets, n) and
        (sets, n, n) with n = parameters + runs * states.
    """

    walk: FloatArray
    states: FloatArray
    error: FloatArray
    mean: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, eq=False)
class Filtered:
    """What a filter found.

    Attributes
    ----------
    log_likelihood
        Of the measurements, shape (sets,); minus infinity for a filter that broke down.
    errors
        Innovations over their standard deviations, shape (sets, steps, runs); empty unless
        kept, as all below.
    mean, covariance
        After each measurement, shapes (sets, steps, n) and (sets, steps, n, n).
    predicted, predicted_covariance
        Before the measurement of the step that follows.
    cross
        Covariance of each step with the one that follows, before the measurement of that.
    """

    log_likelihood: FloatArray
    errors: FloatArray
    mean: FloatArray
    covariance: FloatArray
    predicted: FloatArray
    predicted_covariance: FloatArray
    cross: FloatArray


@dataclass(frozen=True, eq=False)
class Smoothed:
    """Means and covariances of all steps, given all measurements, and the smoother's gains.

    Attributes
    ----------
    mean, covariance
        Shapes (sets, steps, n) and (sets, steps, n, n).
    gains
        The covariance of step k with any later one is gains[k] times that of step k + 1 with
        it, shape (sets, steps - 1, n, n).
    """

    mean: FloatArray
    covariance: FloatArray
    gains: FloatArray

    def covariance_of(self, weights: FloatArray) -> FloatArray:
        """Covariance of weighted sums over all steps, shape (sets, sums, sums).

        Parameters
        ----------
        weights
            Of each step and each of the first states, shape (sums, m, steps).
        """
        sums, first, steps = weights.shape
        sets, _, size = self.mean.shape
        own = np.zeros((steps, sums, size))
        own[..., :first] = weights.transpose(2, 0, 1)
        before = np.zeros((sets, sums, size))
        total = np.zeros((sets, sums, sums))
        for k in range(steps):
            part = self.covariance[:, k] @ own[k].T
            with_before = before @ part
            total += own[k] @ part + with_before + with_before.swapaxes(1, 2)
            if k + 1 < steps:
                before = (before + own[k]) @ self.gains[:, k]
        return total


def run_filter(system: System, levels: Levels, spread: float, *, keep: bool = False) -> Filtered:
    """Run the filter for many sets of noise levels at once.

    Parameters
    ----------
    system, levels
        What is filtered.
    spread
        Distance of the sigma points, in standard deviations; squared at least the number of
        parameters, so that no weight is negative.
    keep
        Whether to keep what a smoother needs.
    """
    measured, count = system.measured, levels.walk.shape[1]
    steps, runs = measured.shape
    output = np.zeros((runs, levels.mean.shape[1]))
    for run in range(runs):
        first = count + run * len(system.output)
        output[run, first : first + len(system.output)] = system.output
    transform = _Transform(system, levels, spread, runs)
    mean, covariance = levels.mean, levels.covariance
    alive = np.ones(len(mean), dtype=bool)
    sets, size = mean.shape
    total = np.zeros(sets)
    kept = _room(sets, steps if keep else 0, size, runs)
    error = levels.error[:, None, None] * np.eye(runs)
    constant = 0.5 * runs * np.log(2.0 * np.pi)
    with np.errstate(all="ignore"):
        for k in range(steps):
            reach = covariance @ output.T
            root, alive = _root(output @ reach + error, alive)
            inverse = 1.0 / root if runs == 1 else np.linalg.inv(root)
            half = reach @ inverse.swapaxes(-1, -2)
            scaled = (inverse @ (measured[k] - mean @ output.T)[..., None])[..., 0]
            total -= constant + 0.5 * np.sum(scaled**2, axis=-1)
            total -= np.sum(np.log(np.diagonal(root, axis1=-2, axis2=-1)), axis=-1)
            mean = mean + (half @ scaled[..., None])[..., 0]
            covariance = covariance - half @ half.swapaxes(-1, -2)
            if keep:
                kept.errors[:, k], kept.mean[:, k] = scaled, mean
                kept.covariance[:, k] = covariance
            if k + 1 < steps:
                root, alive = _root(covariance, alive)
                mean, covariance, cross = transform.through(k, mean, root, cross=keep)
                if keep:
                    kept.predicted[:, k], kept.predicted_covariance[:, k] = mean, covariance
                    kept.cross[:, k] = cross
    total = np.where(alive & np.isfinite(total), total, -np.inf)
    return replace(kept, log_likelihood=total)


def _room(sets: int, steps: int, size: int, runs: int) -> Filtered:
    """Room for what a filter keeps."""
    means, square = (sets, steps, size), (sets, steps, size, size)
    shapes = ((sets,), (sets, steps, runs), means, square, means, square, square)
    return Filtered(*(np.zeros(shape) for shape in shapes))


def run_smoother(found: Filtered) -> Smoothed:
    """The smoother, from a filter whose steps were kept.

    Raises
    ------
    numpy.linalg.LinAlgError
        If a covariance is singular.
    """
    mean, covariance = found.mean.copy(), found.covariance.copy()
    gains = np.linalg.solve(
        found.predicted_covariance[:, :-1], found.cross[:, :-1].swapaxes(-1, -2)
    ).swapaxes(-1, -2)
    for k in range(mean.shape[1] - 2, -1, -1):
        gain = gains[:, k]
        mean[:, k] += (gain @ (mean[:, k + 1] - found.predicted[:, k])[..., None])[..., 0]
        change = covariance[:, k + 1] - found.predicted_covariance[:, k]
        covariance[:, k] += gain @ change @ gain.swapaxes(1, 2)
    return Smoothed(mean, covariance, np.asarray(gains, dtype=float))


class _Transform:
    """The unscented transform of a step."""

    def __init__(self, system: System, levels: Levels, spread: float, runs: int) -> None:
        self.system, self.runs = system, runs
        self.count, self.states = levels.walk.shape[1], levels.states.shape[1]
        self.spread = spread
        self.weight = 0.5 / spread**2
        self.centre = 1.0 - 2.0 * self.count * self.weight
        if self.centre < -1e-12:
            raise ValueError("the weight of the centre must not be negative")
        size = self.count + runs * self.states
        self.noise = np.zeros((len(levels.walk), size, size))
        self.noise[:, : self.count, : self.count] = levels.walk[:, :, None] * np.eye(self.count)
        for first in range(self.count, size, self.states):
            own = slice(first, first + self.states)
            self.noise[:, own, own] = levels.states

    def through(
        self, k: int, mean: FloatArray, root: FloatArray, *, cross: bool
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Mean and covariance after a step, and the covariance with those before it."""
        count, sets, size = self.count, *mean.shape
        away = self.spread * root[:, :, :count].swapaxes(1, 2)
        centre = mean[:, None]
        points = np.concatenate([centre, centre + away, centre - away], axis=1)
        matrix, given = self.system.step(k, points[..., :count])
        states = points[..., count:].reshape(*points.shape[:2], self.runs, self.states)
        moved = given + (matrix[:, :, None] @ states[..., None])[..., 0]
        points[..., count:] = moved.reshape(*points.shape[:2], -1)
        after = self.centre * points[:, 0] + self.weight * points[:, 1:].sum(axis=1)
        lower = root[:, count:, count:].reshape(sets, self.runs, self.states, size - count)
        columns = np.zeros((sets, size, size - count))
        columns[:, count:] = (matrix[:, :1] @ lower).reshape(sets, size - count, size - count)
        off = np.sqrt(self.weight) * (points - after[:, None])
        off[:, 0] *= np.sqrt(max(self.centre, 0.0) / self.weight)
        covariance = off.swapaxes(1, 2) @ off + columns @ columns.swapaxes(1, 2) + self.noise
        if not cross:
            return after, covariance, covariance
        difference = points[:, 1 : 1 + count] - points[:, 1 + count :]
        between = self.weight * (away.swapaxes(1, 2) @ difference)
        between += root[:, :, count:] @ columns.swapaxes(1, 2)
        return after, covariance, between


def _root(covariance: FloatArray, alive: BoolArray) -> tuple[FloatArray, BoolArray]:
    """Cholesky factors, and which sets still have one; a set that has none is out for good."""
    if covariance.shape[-1] == 1:
        good = np.asarray(covariance[:, 0, 0] > 0.0)
        root = np.sqrt(np.where(good[:, None, None], covariance, 1.0))
        return root, alive & good
    size = covariance.shape[-1]
    diagonal = np.arange(size)
    covariance = covariance.copy()
    covariance[:, diagonal, diagonal] *= 1.0 + ROUNDING
    try:
        return np.asarray(np.linalg.cholesky(covariance), dtype=float), alive
    except np.linalg.LinAlgError:
        roots = np.empty_like(covariance)
        good = alive.copy()
        for i, own in enumerate(covariance):
            try:
                roots[i] = np.linalg.cholesky(own)
            except np.linalg.LinAlgError:
                good[i], roots[i] = False, np.eye(size)
        return roots, good
