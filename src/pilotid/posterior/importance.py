"""Importance sampling of a posterior whose shape is nearly known beforehand.

Draws come from a Student-t distribution around the optimum, and then from others with the
mean and covariance that the weights so far have shown.  All draws are weighted by the
mixture of all these distributions, so that none is lost (Cornuet, Marin, Mira and Robert,
Adaptive Multiple Importance Sampling, Scandinavian Journal of Statistics 39, 2012).  Where
one Student-t distribution does not follow the posterior's shape, mixtures of them do.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from pilotid.support.types import FloatArray

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


Proposal = StudentT | Mixture

SCOUTS = 0.25  # share of the draws that the first distribution gives
STAGES = 4  # single distributions at most
MIXTURES = 16  # mixtures at most, after those
#: Effective draws by dimension that a mixture is fitted to: weights that leave fewer, because
#: few points have them all, are flattened for the fit, and for that alone.
FIT_TO = 40.0

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
        Effective number of draws; more are made, from other distributions and then from
        mixtures of them, until there are that many or the last mixture was tried.  What a
        mixture reaches, the next one must confirm: a shape that is not followed shows by a
        few draws of great weight, which may be late to come.
    """
    scouts = max(1, round(SCOUTS * count))
    proposals: list[Proposal] = [StudentT(centre, covariance)]
    counts = [scouts]
    points = proposals[0].draw(rng, scouts)
    target = log_density(points)
    logs = proposals[0].log_density(points)[None]
    result = Weighted(points, target, _weights(target, logs, counts))
    confirmed = False
    for stage in range(1, STAGES + MIXTURES):
        single = stage < STAGES
        proposals.append(_next(result, centre, covariance, rng, single=single))
        counts.append(count - scouts if stage == 1 else count)
        more = proposals[-1].draw(rng, counts[-1])
        # Earlier distributions at the new points, and the new one at all points.
        new = np.array([proposal.log_density(more) for proposal in proposals[:-1]])
        points = np.concatenate([points, more])
        logs = np.concatenate([logs, new], axis=1)
        logs = np.concatenate([logs, proposals[-1].log_density(points)[None]])
        target = np.concatenate([target, log_density(more)])
        result = Weighted(points, target, _weights(target, logs, counts))
        enough = result.effective >= wanted
        if enough and (single or confirmed):
            break
        confirmed = enough
    return result


def _next(
    found: Weighted,
    centre: FloatArray,
    covariance: FloatArray,
    rng: np.random.Generator,
    *,
    single: bool,
) -> Proposal:
    """The next distribution to draw from, by what the weights show."""
    if single:
        return StudentT(*found.moments(centre, covariance))
    flat = replace(found, weights=_flattened(found.weights, FIT_TO * centre.size))
    return fitted(flat.points, flat.weights, flat.moments(centre, covariance)[1], rng)


def _flattened(weights: FloatArray, effective: float) -> FloatArray:
    """A power of the weights, at most the first, that leaves so many effective draws."""
    # Lowered step by step until they suffice: it only guides a fit.
    logs = np.log(weights[weights > 0.0])
    flat, power = weights.copy(), 1.0
    while 1.0 / np.sum(flat**2) < min(effective, 0.5 * logs.size) and power > 1e-3:
        power *= 0.7
        own = np.exp(power * (logs - logs.max()))
        flat[weights > 0.0] = own / own.sum()
    return flat


def _weights(target: FloatArray, proposed: FloatArray, counts: list[int]) -> FloatArray:
    """Weights of draws from several proposals, which sum to 1.

    Parameters
    ----------
    target
        Log-densities of the target, shape (draws,).
    proposed
        Those of the proposals, shape (proposals, draws).
    counts
        Draws of each proposal.
    """
    weights = target - np.logaddexp.reduce(proposed + np.log(counts)[:, None], axis=0)
    highest = np.max(weights)
    if not np.isfinite(highest):
        # None has any weight: one that has it all says that there is no second one.
        return np.asarray(np.eye(1, weights.size)[0])
    weights = np.exp(weights - highest)
    return np.asarray(weights / weights.sum())
