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

from pilotid.posterior.mixtures import Proposal, StudentT, fitted
from pilotid.types import FloatArray

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
