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

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from pilotid.types import FloatArray

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
    """Noise of each set in a step, and where the filter starts; n = parameters + runs * states.

    Attributes
    ----------
    noise
        Covariance of what parameters and states take up in a step, shape (sets, n, n).
    error
        Variance of a measurement, shape (sets,).
    mean, covariance
        Of parameters and states at the first step before its measurement, shapes (sets, n) and
        (sets, n, n).
    """

    noise: FloatArray
    error: FloatArray
    mean: FloatArray
    covariance: FloatArray


class Filtered(NamedTuple):
    """What a filter found at each step.

    Attributes
    ----------
    errors
        Innovations over their standard deviations, shape (sets, steps, runs).
    mean, covariance
        After each measurement, shapes (sets, steps, n) and (sets, steps, n, n).
    predicted, predicted_covariance
        Before each measurement.
    cross
        Covariance of the step before, after its measurement, with each step before its own.
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


def block_diagonal(*blocks: FloatArray) -> FloatArray:
    """Matrices with these along the diagonal, each of shape (sets, its size, its size)."""
    ends = np.cumsum([0, *(block.shape[1] for block in blocks)])
    whole = np.zeros((len(blocks[0]), ends[-1], ends[-1]))
    for block, begin, end in zip(blocks, ends, ends[1:], strict=False):
        whole[:, begin:end, begin:end] = block
    return whole


def run_filter(
    system: System, levels: Levels, spread: float, keep: list[Filtered] | None = None
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
        Takes what each step found, without the axis of steps; see `run_smoother`.
    """
    measured, runs = system.measured, system.measured.shape[1]
    count = levels.mean.shape[1] - runs * len(system.output)
    if spread**2 < count * (1.0 - 1e-12):
        raise ValueError("the weight of the centre must not be negative")
    output = np.zeros((runs, levels.mean.shape[1]))
    output[:, count:] = np.kron(np.eye(runs), system.output)
    error = levels.error[:, None, None] * np.eye(runs)
    total = np.full(len(levels.mean), -0.5 * measured.size * np.log(2.0 * np.pi))
    mean, covariance = levels.mean, levels.covariance
    cross = np.zeros_like(covariance)
    with np.errstate(all="ignore"):
        for k, control in enumerate(measured):
            if k:
                root = _root(covariance)
                mean, covariance, moved = _transform(system, spread, k - 1, mean, root, count)
                covariance += levels.noise
                cross = moved if keep is None else root @ moved.swapaxes(1, 2)
            ahead = mean, covariance, cross
            reach = covariance @ output.T
            root = _root(output @ reach + error)
            inverse = np.linalg.inv(root)
            half = reach @ inverse.swapaxes(1, 2)
            scaled = inverse @ (control - mean @ output.T)[..., None]
            total -= 0.5 * np.sum(scaled**2, axis=(1, 2))
            total -= np.sum(np.log(np.diagonal(root, axis1=1, axis2=2)), axis=1)
            mean = mean + (half @ scaled)[..., 0]
            covariance = covariance - half @ half.swapaxes(1, 2)
            if keep is not None:
                keep.append(Filtered(scaled[..., 0], mean, covariance, *ahead))
    return np.where(np.isfinite(total), total, -np.inf)


def run_smoother(steps: Sequence[Filtered]) -> Smoothed:
    """The smoother, from a filter whose steps were kept.

    Raises
    ------
    numpy.linalg.LinAlgError
        If a covariance is singular.
    """
    found = Filtered(*(np.stack(part, axis=1) for part in zip(*steps, strict=True)))
    mean, covariance = found.mean, found.covariance
    gains = np.linalg.solve(found.predicted_covariance[:, 1:], found.cross[:, 1:].swapaxes(-1, -2))
    gains = gains.swapaxes(-1, -2)
    for k in range(len(steps) - 2, -1, -1):
        gain = gains[:, k]
        mean[:, k] += (gain @ (mean[:, k + 1] - found.predicted[:, k + 1])[..., None])[..., 0]
        change = covariance[:, k + 1] - found.predicted_covariance[:, k + 1]
        covariance[:, k] += gain @ change @ gain.swapaxes(1, 2)
    return Smoothed(mean, covariance, np.asarray(gains, dtype=float))


def _transform(
    system: System, spread: float, k: int, mean: FloatArray, root: FloatArray, count: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean and covariance after a step, and what becomes of the columns of the root."""
    sets, size = mean.shape
    weight = 0.5 / spread**2
    centre = max(1.0 - 2.0 * count * weight, 0.0)
    away = spread * root[:, :, :count].swapaxes(1, 2)
    points = np.concatenate([mean[:, None], mean[:, None] + away, mean[:, None] - away], axis=1)
    matrix, given = system.step(k, points[..., :count])
    states = points[..., count:].reshape(given.shape)
    moved = given + np.einsum("spij,sprj->spri", matrix, states)
    points[..., count:] = moved.reshape(sets, -1, size - count)
    after = centre * points[:, 0] + weight * points[:, 1:].sum(axis=1)
    off = np.sqrt(weight) * (points - after[:, None])
    off[:, 0] *= np.sqrt(centre / weight)
    # The columns of the states alone, for which the step is linear.
    lower = root[:, count:, count:].reshape(sets, *given.shape[2:], size - count)
    columns = np.zeros_like(root)
    columns[:, count:, count:] = (matrix[:, :1] @ lower).reshape(sets, size - count, size - count)
    covariance = off.swapaxes(1, 2) @ off + columns @ columns.swapaxes(1, 2)
    difference = off[:, 1 : 1 + count] - off[:, 1 + count :]
    columns[:, :, :count] = np.sqrt(0.5) * difference.swapaxes(1, 2)
    return after, covariance, columns


def _root(covariance: FloatArray) -> FloatArray:
    """Cholesky factors; not a number where there is none."""
    try:
        root = np.linalg.cholesky(covariance * (1.0 + ROUNDING * np.eye(covariance.shape[-1])))
        return np.asarray(root, dtype=float)
    except np.linalg.LinAlgError:
        if len(covariance) == 1:
            return np.full_like(covariance, np.nan)
        return np.concatenate([_root(own[None]) for own in covariance])
