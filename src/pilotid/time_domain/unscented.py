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

from dataclasses import dataclass
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
    """What a filter found at each step.

    Attributes
    ----------
    errors
        Innovations over their standard deviations, shape (sets, steps, runs).
    mean, covariance
        After each measurement, shapes (sets, steps, n) and (sets, steps, n, n).
    predicted, predicted_covariance
        Before the measurement of the step that follows; one step fewer.
    cross
        Covariance of each step with the one that follows, before the measurement of that.
    """

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


def block_diagonal(variances: FloatArray, states: FloatArray, runs: int) -> FloatArray:
    """Covariances, shape (sets, n, n), of independent parameters and of equal runs.

    Parameters
    ----------
    variances
        Of the parameters, shape (sets, parameters).
    states
        Covariance of the states of a run, shape (sets, states, states).
    runs
        Number of runs.
    """
    count, every = variances.shape[1], np.kron(np.eye(runs)[None], states)
    whole = np.zeros((len(states), count + every.shape[1], count + every.shape[1]))
    whole[:, :count, :count] = variances[:, :, None] * np.eye(count)
    whole[:, count:, count:] = every
    return whole


def run_filter(
    system: System, levels: Levels, spread: float, keep: list[tuple[FloatArray, ...]] | None = None
) -> FloatArray:
    """Log-likelihood of each set of noise levels; minus infinity where a filter breaks down.

    Parameters
    ----------
    system, levels
        What is filtered.
    spread
        Distance of the sigma points, in standard deviations; squared at least the number of
        parameters, so that no weight is negative.
    keep
        Takes what each step found; see `passed`.
    """
    measured, count = system.measured, levels.walk.shape[1]
    steps, runs = measured.shape
    output = np.zeros((runs, levels.mean.shape[1]))
    output[:, count:] = np.kron(np.eye(runs), system.output)
    noise = block_diagonal(levels.walk, levels.states, runs)
    mean, covariance = levels.mean, levels.covariance
    alive, total = np.ones(len(mean), dtype=bool), np.zeros(len(mean))
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
            found: tuple[FloatArray, ...] = (scaled, mean, covariance)
            if k + 1 < steps:
                root, alive = _root(covariance, alive)
                mean, covariance, cross = _transform(system, spread, noise, k, mean, root, count)
                found = *found, mean, covariance, cross
            if keep is not None:
                keep.append(found)
    return np.where(alive & np.isfinite(total), total, -np.inf)


def passed(system: System, levels: Levels, spread: float) -> Filtered:
    """What the filter finds at each step."""
    steps: list[tuple[FloatArray, ...]] = []
    run_filter(system, levels, spread, steps)
    own = zip(*(step[:3] for step in steps), strict=True)
    ahead = zip(*(step[3:] for step in steps[:-1]), strict=True)
    return Filtered(*(np.stack(part, axis=1) for part in (*own, *ahead)))


def run_smoother(found: Filtered) -> Smoothed:
    """The smoother, from a filter whose steps were kept.

    Raises
    ------
    numpy.linalg.LinAlgError
        If a covariance is singular.
    """
    mean, covariance = found.mean.copy(), found.covariance.copy()
    gains = np.linalg.solve(found.predicted_covariance, found.cross.swapaxes(-1, -2))
    gains = gains.swapaxes(-1, -2)
    for k in range(mean.shape[1] - 2, -1, -1):
        gain = gains[:, k]
        mean[:, k] += (gain @ (mean[:, k + 1] - found.predicted[:, k])[..., None])[..., 0]
        change = covariance[:, k + 1] - found.predicted_covariance[:, k]
        covariance[:, k] += gain @ change @ gain.swapaxes(1, 2)
    return Smoothed(mean, covariance, np.asarray(gains, dtype=float))


def _transform(
    system: System,
    spread: float,
    noise: FloatArray,
    k: int,
    mean: FloatArray,
    root: FloatArray,
    count: int,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean and covariance after a step, and the covariance with those before it."""
    weight = 0.5 / spread**2
    centre = 1.0 - 2.0 * count * weight
    if centre < -1e-12:
        raise ValueError("the weight of the centre must not be negative")
    sets, size = mean.shape
    away = spread * root[:, :, :count].swapaxes(1, 2)
    middle = mean[:, None]
    points = np.concatenate([middle, middle + away, middle - away], axis=1)
    matrix, given = system.step(k, points[..., :count])
    states = points[..., count:].reshape(given.shape)
    moved = given + (matrix[:, :, None] @ states[..., None])[..., 0]
    points[..., count:] = moved.reshape(*points.shape[:2], -1)
    after = centre * points[:, 0] + weight * points[:, 1:].sum(axis=1)
    lower = root[:, count:, count:].reshape(sets, *given.shape[2:], size - count)
    columns = np.zeros((sets, size, size - count))
    columns[:, count:] = (matrix[:, :1] @ lower).reshape(sets, size - count, size - count)
    off = np.sqrt(weight) * (points - after[:, None])
    off[:, 0] *= np.sqrt(max(centre, 0.0) / weight)
    covariance = off.swapaxes(1, 2) @ off + columns @ columns.swapaxes(1, 2) + noise
    difference = points[:, 1 : 1 + count] - points[:, 1 + count :]
    cross = weight * (away.swapaxes(1, 2) @ difference)
    return after, covariance, cross + root[:, :, count:] @ columns.swapaxes(1, 2)


def _root(covariance: FloatArray, alive: BoolArray) -> tuple[FloatArray, BoolArray]:
    """Cholesky factors, and which sets still have one; a set that has none is out for good."""
    size = covariance.shape[-1]
    covariance = covariance * (1.0 + ROUNDING * np.eye(size))
    try:
        return np.asarray(np.linalg.cholesky(covariance), dtype=float), alive
    except np.linalg.LinAlgError:
        roots, good = np.empty_like(covariance), alive.copy()
        for i, own in enumerate(covariance):
            try:
                roots[i] = np.linalg.cholesky(own)
            except np.linalg.LinAlgError:
                good[i], roots[i] = False, np.eye(size)
        return roots, good
