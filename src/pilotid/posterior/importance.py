"""Importance sampling of a posterior whose shape is nearly known beforehand.

Draws come from a Student-t distribution around the optimum, and then from others with the
mean and covariance that the weights so far have shown.  All draws are weighted by the
mixture of all these distributions, so that none is lost (Cornuet, Marin, Mira and Robert,
Adaptive Multiple Importance Sampling, Scandinavian Journal of Statistics 39, 2012).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pilotid.types import FloatArray

FREEDOM = 6.0  # of the Student-t distributions: tails heavier than a likelihood's
SCOUTS = 0.25  # share of the draws that the first distribution gives
STAGES = 4  # distributions at most

#: Maps points (sets, dimensions) to log-densities (sets,), -inf outside the bounds.
LogDensity = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, eq=False)
class Weighted:
    """Weighted draws.

    Attributes
    ----------
    points
        The draws, shape (draws, dimensions).
    log_density
        Of the target, up to a constant, shape (draws,).
    weights
        They sum to 1, shape (draws,).
    """

    points: FloatArray
    log_density: FloatArray
    weights: FloatArray

    @property
    def effective(self) -> float:
        """Effective number of draws (Kish): that of equal weights as good as these."""
        return float(1.0 / np.sum(self.weights**2))

    def moments(self, centre: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean and covariance, drawn towards those known before where few draws count."""
        trust = self.effective / (self.effective + 2.0 * centre.size)
        mean = self.weights @ self.points
        offset = self.points - mean
        found = (self.weights[:, None] * offset).T @ offset
        return centre + trust * (mean - centre), covariance + trust * (found - covariance)


class StudentT:
    """A multivariate Student-t distribution.

    Parameters
    ----------
    centre
        Shape (dimensions,).
    scale
        Its scale matrix, positive definite; the covariance is larger by f/(f - 2).
    freedom
        Degrees of freedom f.
    """

    def __init__(self, centre: FloatArray, scale: FloatArray, freedom: float = FREEDOM) -> None:
        self.centre, self.freedom = centre, freedom
        self._root = np.linalg.cholesky(scale)
        self._inverse = np.linalg.inv(self._root)
        self._constant = -float(np.sum(np.log(np.diag(self._root))))

    def draw(self, rng: np.random.Generator | np.random.RandomState, count: int) -> FloatArray:
        """Random points, shape (count, dimensions)."""
        normal = rng.standard_normal((count, self.centre.size))
        stretch = np.sqrt(self.freedom / rng.chisquare(self.freedom, count))
        return np.asarray(self.centre + stretch[:, None] * (normal @ self._root.T))

    def log_density(self, points: FloatArray) -> FloatArray:
        """Up to a constant, the same for all with these dimensions and degrees of freedom."""
        distance = np.sum(((points - self.centre) @ self._inverse.T) ** 2, axis=1)
        power = -0.5 * (self.freedom + self.centre.size)
        return np.asarray(self._constant + power * np.log1p(distance / self.freedom))


def importance(
    log_density: LogDensity,
    centre: FloatArray,
    covariance: FloatArray,
    rng: np.random.Generator,
    *,
    count: int,
    wanted: float,
) -> Weighted:
    """Weighted draws of a density.

    Parameters
    ----------
    log_density
        The target, up to a constant.
    centre, covariance
        What is known of it: its mode and the covariance there.
    rng
        Draws.
    count
        Number of draws of the first two distributions; each further one gives as many.
    wanted
        Effective number of draws; more are made, from other distributions, until there are
        that many or the last distribution was tried.
    """
    scouts = max(1, round(SCOUTS * count))
    proposals = [StudentT(centre, covariance)]
    counts = [scouts]
    points = proposals[0].draw(rng, scouts)
    target = log_density(points)
    result = Weighted(points, target, _weights(points, target, proposals, counts))
    for stage in range(1, STAGES):
        proposals.append(StudentT(*result.moments(centre, covariance)))
        counts.append(count - scouts if stage == 1 else count)
        more = proposals[-1].draw(rng, counts[-1])
        points = np.concatenate([points, more])
        target = np.concatenate([target, log_density(more)])
        result = Weighted(points, target, _weights(points, target, proposals, counts))
        if result.effective >= wanted:
            break
    return result


def _weights(
    points: FloatArray, target: FloatArray, proposals: list[StudentT], counts: list[int]
) -> FloatArray:
    """Weights of draws from a mixture of proposals, which sum to 1."""
    logs = [p.log_density(points) + np.log(n) for p, n in zip(proposals, counts, strict=True)]
    weights = target - np.logaddexp.reduce(logs, axis=0)
    highest = np.max(weights)
    if not np.isfinite(highest):
        # None has any weight: one that has it all says that there is no second one.
        return np.asarray(np.eye(1, weights.size)[0])
    weights = np.exp(weights - highest)
    return np.asarray(weights / weights.sum())
