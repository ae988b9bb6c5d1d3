"""Mixtures of Student-t distributions, fitted to weighted draws.

Some posteriors are bent, have two summits, or narrow to one side like a funnel: a gain that may
be nil leaves the delay of its channel open.  Several distributions follow such a shape where
none does alone (Cappe, Douc, Guillin, Marin and Robert, Adaptive Importance Sampling in General
Mixture Classes, Statistics and Computing 18, 2008).
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from pilotid.types import FloatArray

FREEDOM = 6.0  # of the Student-t distributions: tails heavier than a likelihood's
PARTS = 6  # distributions in a mixture
ROUNDS = 15  # of expectation and maximisation
DRAWS = 3000  # that a mixture is fitted to
NARROW = 0.5  # scale of a part where it knows no better, over that of all draws
WIDE = 4.0  # scale of the second copy of each part, over that of the first
EMPTY = 1e-12  # weight of the draws of a part that has none
DEFENCE = 0.1  # share of the wide copies, which find what the narrow ones miss

#: What draws random numbers here; emcee has one of the legacy kind.
Generator = np.random.Generator | np.random.RandomState


class Proposal(Protocol):
    """A distribution that can be drawn from."""

    def draw(self, rng: Generator, count: int) -> FloatArray:
        """Random points, shape (count, dimensions)."""
        ...

    def log_density(self, points: FloatArray) -> FloatArray:
        """Up to a constant that all proposals share."""
        ...


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

    def draw(self, rng: Generator, count: int) -> FloatArray:
        """Random points, shape (count, dimensions)."""
        normal = rng.standard_normal((count, self.centre.size))
        stretch = np.sqrt(self.freedom / rng.chisquare(self.freedom, count))
        return np.asarray(self.centre + stretch[:, None] * (normal @ self._root.T))

    def distances(self, points: FloatArray) -> FloatArray:
        """Squared distances from the centre in units of the scale, shape (points,)."""
        return np.asarray(np.sum(((points - self.centre) @ self._inverse.T) ** 2, axis=1))

    def log_density(self, points: FloatArray) -> FloatArray:
        """Up to a constant, the same for all with these dimensions and degrees of freedom."""
        power = -0.5 * (self.freedom + self.centre.size)
        return np.asarray(self._constant + power * np.log1p(self.distances(points) / self.freedom))


class Mixture:
    """A mixture of Student-t distributions.

    Parameters
    ----------
    shares
        They sum to 1, shape (parts,).
    parts
        The distributions.
    """

    def __init__(self, shares: FloatArray, parts: list[StudentT]) -> None:
        self.shares, self.parts = shares, parts

    def draw(self, rng: Generator, count: int) -> FloatArray:
        """Random points, shape (count, dimensions), those of a part together."""
        counts = rng.multinomial(count, self.shares)
        drawn = [part.draw(rng, own) for part, own in zip(self.parts, counts, strict=True)]
        return np.concatenate(drawn)

    def log_density(self, points: FloatArray) -> FloatArray:
        """Up to a constant, the same as for one Student-t distribution."""
        return np.asarray(np.logaddexp.reduce(self.by_part(points), axis=0))

    def by_part(self, points: FloatArray) -> FloatArray:
        """Log-density of each part times its share, shape (parts, points)."""
        logs = [part.log_density(points) for part in self.parts]
        return np.array(logs) + np.log(self.shares)[:, None]


def fitted(
    points: FloatArray,
    weights: FloatArray,
    covariance: FloatArray,
    rng: np.random.Generator,
) -> Mixture:
    """A mixture that follows weighted draws, and wider copies of its parts.

    Parameters
    ----------
    points, weights
        The draws, shape (draws, dimensions), and their weights, which sum to 1.
    covariance
        Of the draws; parts that few of them support are drawn towards it.
    rng
        Chooses the draws that count, and where parts start.
    """
    dimensions = points.shape[1]
    # Draws of no weight cost time and tell nothing.
    times = rng.multinomial(DRAWS, weights)
    kept = times > 0
    points, repeats = points[kept], times[kept] / DRAWS
    least = NARROW * covariance
    # As much as so many effective draws weigh as there are dimensions.
    doubt = min(1.0, dimensions * float(np.sum(weights**2)))
    starts = points[rng.choice(len(points), PARTS, p=repeats)]
    shares = np.full(PARTS, 1.0 / PARTS)
    parts = [StudentT(start, least) for start in starts]
    scales = [least] * PARTS
    for _ in range(ROUNDS):
        logs = Mixture(shares, parts).by_part(points)
        own = np.exp(logs - np.logaddexp.reduce(logs, axis=0)) * repeats
        for i, part in enumerate(parts):
            pull = own[i] * (FREEDOM + dimensions) / (FREEDOM + part.distances(points))
            # A part that no draw supports stays where it is.
            centre = pull @ points / pull.sum() if pull.sum() > EMPTY else part.centre
            offset = points - centre
            scales[i] = (offset.T * pull) @ offset + doubt * least
            scales[i] /= own[i].sum() + doubt
            parts[i] = StudentT(centre, scales[i])
        shares = (own.sum(axis=1) + doubt / PARTS) / (1.0 + doubt)
    wide = [StudentT(part.centre, WIDE * scale) for part, scale in zip(parts, scales, strict=True)]
    shares = np.concatenate([(1.0 - DEFENCE) * shares, DEFENCE * shares])
    return Mixture(shares / shares.sum(), parts + wide)
