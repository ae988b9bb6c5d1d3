"""Sampling of a posterior with emcee, whose shape is nearly known beforehand.

Foreman-Mackey, Hogg, Lang and Goodman, emcee: The MCMC Hammer, PASP 125, 2013.  Most moves are
proposals that do not depend on the walkers, from a mixture of Student-t distributions, of which
half or more are accepted; the others go by differential evolution (ter Braak, Statistics and
Computing 16, 2006), which needs no such knowledge.

The first mixture is fitted to draws around the optimum, weighted by the density (importance
sampling: Cornuet, Marin, Mira and Robert, Scandinavian Journal of Statistics 39, 2012); walkers
start at some of them.  Where it is followed badly, one of several parts is fitted to the chains.

emcee's own `DESnookerMove` is not used: in version 3.1.6 it does not leave the density as it is
(the standard deviation of a standard normal one comes out at 0.8 in nine dimensions).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from pilotid.estimate.quantities import Draws
from pilotid.posterior.likelihood import Posterior
from pilotid.support.types import FloatArray

#: Maps points (sets, dimensions) to log-densities (sets,), -inf outside the bounds.
LogDensity = Callable[[FloatArray], FloatArray]

FREEDOM = 10.0  # of the Student-t distributions: tails heavier than a likelihood's
WIDE, DEFENCE = 4.0, 0.05  # scale of a second copy of each over that of the first, and its share
NARROW = 0.5  # scale of a part where it knows no better, over that of all draws
ITERATIONS = 8  # of expectation and maximisation
EMPTY = 1e-12  # weight of the draws of a part that has none
SCOUTS, STAGES = 400, 8  # draws of each proposal, and proposals at the most
#: Effective draws by dimension that end the search for a proposal, and that one is fitted to:
#: weights that leave fewer, because few points have them all, are flattened.
ENOUGH = 20.0
PARTS, REFITS = 5, (66, 176, 352)  # of mixtures fitted to chains, and steps after each of these
SLOW = 12.0  # autocorrelation time [steps] from which on another mixture is worth its time

ENSEMBLES, WALKERS = 2, 24  # independent ensembles, and walkers of each at least
INDEPENDENT = 0.9  # share of the moves that do not depend on the walkers
JUMPS = 0.1  # share of the differential moves that go from one mode to another
FIRST = 44  # steps before the first look at the run
SETTLED = 2.0  # autocorrelation times that are thrown away at the start
LONG = 5.0  # autocorrelation times that a run has at least: a shorter one does not know them
WINDOW = 5.0  # autocorrelation times over which correlations are summed (Sokal 1997)


class Mixture:
    """A mixture of multivariate Student-t distributions.

    Parameters
    ----------
    shares
        They sum to 1, shape (parts,).
    centres
        Shape (parts, dimensions).
    scales
        Scale matrices, positive definite, shape (parts, dimensions, dimensions).
    """

    def __init__(self, shares: FloatArray, centres: FloatArray, scales: FloatArray) -> None:
        self.shares, self.centres, self.scales = shares, centres, scales
        self._roots = np.linalg.cholesky(scales)
        self._inverse = np.linalg.inv(self._roots).swapaxes(1, 2)
        self._volumes = np.sum(np.log(np.diagonal(self._roots, axis1=1, axis2=2)), axis=1)

    def draw(self, rng: np.random.Generator | np.random.RandomState, count: int) -> FloatArray:
        """Random points, shape (count, dimensions)."""
        normal = rng.standard_normal((count, self.centres.shape[1]))
        normal *= np.sqrt(FREEDOM / rng.chisquare(FREEDOM, (count, 1)))
        chosen = rng.choice(len(self.shares), count, p=self.shares)
        for i, (centre, root) in enumerate(zip(self.centres, self._roots, strict=True)):
            normal[chosen == i] = centre + normal[chosen == i] @ root.T
        return normal

    def distances(self, points: FloatArray) -> FloatArray:
        """Squared distances from each centre in units of its scale, shape (parts, points)."""
        offsets = points - self.centres[:, None]
        return np.asarray(np.sum((offsets @ self._inverse) ** 2, axis=2))

    def by_part(self, points: FloatArray) -> FloatArray:
        """Log-density of each part times its share, shape (parts, points)."""
        power = -0.5 * (FREEDOM + points.shape[1])
        logs = power * np.log1p(self.distances(points) / FREEDOM) - self._volumes[:, None]
        return np.asarray(logs + np.log(self.shares)[:, None])

    def log_density(self, points: FloatArray) -> FloatArray:
        """Up to a constant that depends on the dimensions alone, shape (points,)."""
        return np.asarray(np.logaddexp.reduce(self.by_part(points), axis=0))

    @property
    def defended(self) -> Mixture:
        """The same with a wider copy of each part, which finds what the narrow ones miss."""
        shares = np.append((1.0 - DEFENCE) * self.shares, DEFENCE * self.shares)
        return Mixture(
            shares / shares.sum(),
            np.concatenate([self.centres, self.centres]),
            np.concatenate([self.scales, WIDE * self.scales]),
        )


def fitted(
    points: FloatArray,
    weights: FloatArray,
    covariance: FloatArray,
    parts: int,
    rng: np.random.Generator,
) -> Mixture:
    """A mixture that follows weighted draws.

    Parameters
    ----------
    points, weights
        The draws, shape (draws, dimensions), and their weights, which sum to 1.
    covariance
        About that of the draws; parts that few of them support are drawn towards it.
    parts
        How many, without their wide copies.
    rng
        Chooses where parts start.
    """
    dimensions, least = points.shape[1], NARROW * covariance
    # As much as so many effective draws weigh as there are dimensions.
    doubt = min(1.0, dimensions * float(np.sum(weights**2)))
    starts = points[rng.choice(len(points), parts, p=weights)]
    mixture = Mixture(np.full(parts, 1.0 / parts), starts, np.tile(least, (parts, 1, 1)))
    for _ in range(ITERATIONS):
        logs = mixture.by_part(points)
        part = np.exp(logs - np.logaddexp.reduce(logs, axis=0)) * weights
        pull = part * (FREEDOM + dimensions) / (FREEDOM + mixture.distances(points))
        total = pull.sum(axis=1, keepdims=True)
        # A part that no draw supports stays where it is.
        moved = (pull[:, None] @ points)[:, 0] / np.maximum(total, EMPTY)
        centres = np.where(total > EMPTY, moved, mixture.centres)
        offsets = points - centres[:, None]
        scales = (offsets.swapaxes(1, 2) * pull[:, None]) @ offsets + doubt * least
        weight = part.sum(axis=1) + doubt
        shares = (part.sum(axis=1) + doubt / parts) / (1.0 + doubt)
        mixture = Mixture(shares, centres, scales / weight[:, None, None])
    return mixture.defended


def explored(
    log_density: LogDensity, centre: FloatArray, covariance: FloatArray, rng: np.random.Generator
) -> tuple[Mixture, FloatArray, FloatArray] | None:
    """A proposal that follows a density, and draws with weights that sum to 1.

    Parameters
    ----------
    log_density
        The target, up to a constant.
    centre, covariance
        What is known of it: its mode and the covariance there.
    rng
        Draws.

    Returns
    -------
    Mixture, draws (draws, dimensions) and weights (draws,); None where the density is zero all
    around the centre.
    """
    proposals = [Mixture(np.ones(1), centre[None], covariance[None]).defended]
    points, target = np.zeros((0, centre.size)), np.zeros(0)
    enough = ENOUGH * centre.size
    for _ in range(STAGES):
        more = proposals[-1].draw(rng, SCOUTS)
        points, target = np.concatenate([points, more]), np.append(target, log_density(more))
        # All draws count as of the mixture of all proposals.
        logs = target - np.logaddexp.reduce([p.log_density(points) for p in proposals], axis=0)
        if not np.isfinite(logs).any():
            return None
        weights, power = _weights(logs), 1.0
        unflattened = effective = 1.0 / np.sum(weights**2)
        while effective < enough and power > 1e-3:
            power *= 0.7
            weights = _weights(power * logs)
            effective = 1.0 / np.sum(weights**2)
        proposals.append(fitted(points, weights, covariance, 1, rng))
        if unflattened >= enough:
            break
    return proposals[-1], points, weights


def _weights(logs: FloatArray) -> FloatArray:
    """Weights that sum to 1 by their logarithms."""
    weights = np.exp(logs - np.max(logs))
    return np.asarray(weights / weights.sum())


def sample(
    posterior: Posterior,
    centre: FloatArray,
    covariance: FloatArray,
    rng: np.random.Generator,
    effective: float,
    most: int,
) -> Draws | None:
    """Draws by independent ensembles, until they are long enough and agree.

    Parameters
    ----------
    posterior
        The target.
    centre, covariance
        Its mode and the covariance there, on the scale of sampling.
    rng
        Draws, and seeds emcee, whose generators are of the legacy kind.
    effective
        Effective number of draws that every parameter must have.
    most
        Steps of each ensemble at the most.

    Returns
    -------
    The draws, or None where the density is zero all around the centre.
    """
    import emcee

    first = explored(posterior.log_density, centre, covariance, rng)
    if first is None:
        return None
    proposal, points, weights = first

    def independent(
        walkers: FloatArray, rng: np.random.RandomState
    ) -> tuple[FloatArray, FloatArray]:
        drawn = proposal.draw(rng, len(walkers))
        return drawn, proposal.log_density(walkers) - proposal.log_density(drawn)

    moves = [
        (emcee.moves.MHMove(independent), INDEPENDENT),
        (emcee.moves.DEMove(), (1.0 - JUMPS) * (1.0 - INDEPENDENT)),
        (emcee.moves.DEMove(gamma0=1.0), JUMPS * (1.0 - INDEPENDENT)),
    ]
    count = max(WALKERS, 2 * centre.size + 2)
    runs = []
    for _ in range(ENSEMBLES):
        sampler = emcee.EnsembleSampler(
            count, centre.size, posterior.log_density, moves=moves, vectorize=True
        )
        start = points[rng.choice(len(points), count, p=weights)]
        seed = np.random.RandomState(int(rng.integers(2**32))).get_state()
        runs.append((sampler, emcee.State(start, random_state=seed)))
    done, target, refits = 0, min(FIRST, most), 0
    while True:
        for i, (sampler, state) in enumerate(runs):
            # emcee would refuse walkers that start close to a line; differential evolution
            # copes with the narrow valleys that pilots have.
            end = sampler.run_mcmc(state, target - done, skip_initial_state_check=True)
            runs[i] = (sampler, end)
        done = target
        draws = _drawn(posterior, [sampler for sampler, _ in runs], effective)
        if draws.converged or done >= most:
            return draws
        times = float(np.max(draws.autocorrelation))
        if refits < len(REFITS) and times > SLOW:
            chains = np.concatenate([sampler.get_chain(flat=True) for sampler, _ in runs])
            every = np.full(len(chains), 1.0 / len(chains))
            proposal = fitted(chains, every, np.cov(chains.T), PARTS, rng)
            for sampler, _ in runs:
                sampler.reset()
            done, target, refits = 0, min(REFITS[refits], most), refits + 1
            continue
        # A short run underestimates its autocorrelation time.
        kept = max(LONG, effective / (ENSEMBLES * count)) * times
        target = min(most, max(done + FIRST // 2, math.ceil(1.15 * kept + SETTLED * times)))


def _drawn(posterior: Posterior, samplers: list, effective: float) -> Draws:  # type: ignore[type-arg]
    """What ensembles gave, without the start."""
    points = np.array([sampler.get_chain() for sampler in samplers])
    log_density = np.array([sampler.get_log_prob() for sampler in samplers])
    steps = points.shape[1]
    longest = float(np.max(autocorrelation_times(points[:, steps // 4 :])))
    settled = min(steps // 2, math.ceil(SETTLED * longest))
    points, log_density = points[:, settled:], log_density[:, settled:]
    times, ratio = autocorrelation_times(points), r_hat(points)
    shape, longest = points.shape[:3], float(np.max(times))
    least = math.prod(shape) / longest
    # So much more than 1.01 comes up by chance where draws are few.
    agree = float(np.max(ratio)) <= max(1.01, 1.0 + 12.0 / least)
    return Draws(
        posterior.keys,
        posterior.positive,
        posterior.values(points.reshape(-1, points.shape[-1])),
        log_density.ravel(),
        shape,
        np.asarray(math.prod(shape) / times),
        ratio,
        times,
        float(np.mean([np.mean(sampler.acceptance_fraction) for sampler in samplers])),
        bool(shape[1] >= LONG * longest and least >= effective and agree),
    )


def autocorrelation_times(chains: FloatArray) -> FloatArray:
    """Integrated autocorrelation times [steps], shape (parameters,).

    Correlations are averaged over all walkers (Goodman and Weare 2010), about the mean of
    all ensembles, so that ensembles which disagree have a long one.

    Parameters
    ----------
    chains
        Shape (ensembles, steps, walkers, parameters).
    """
    steps = chains.shape[1]
    offset = chains - chains.mean(axis=(0, 1, 2))
    length = 1 << (2 * steps - 1).bit_length()
    spectrum = np.fft.rfft(offset, n=length, axis=1)
    power = np.mean(spectrum.real**2 + spectrum.imag**2, axis=(0, 2))
    products = np.fft.irfft(power, n=length, axis=0)[:steps]
    products /= np.arange(steps, 0, -1)[:, None]
    times = np.ones(chains.shape[-1])
    for i, covariances in enumerate(products.T):
        if covariances[0] > 0.0:
            sums = 2.0 * np.cumsum(covariances / covariances[0]) - 1.0
            within = np.arange(steps) >= WINDOW * sums
            times[i] = max(1.0, sums[int(np.argmax(within)) if within.any() else -1])
    return times


def r_hat(chains: FloatArray) -> FloatArray:
    """Rank-normalised split R-hat across ensembles, shape (parameters,).

    The larger of that of the ranks and that of the ranks of distances from the median
    (Vehtari, Gelman, Simpson, Carpenter and Buerkner, Bayesian Analysis 16, 2021); each half
    of an ensemble's steps, with all its walkers, is a chain.

    Parameters
    ----------
    chains
        Shape (ensembles, steps, walkers, parameters).
    """
    from scipy.special import ndtri

    half = chains.shape[1] // 2
    halves = np.concatenate([chains[:, :half], chains[:, half : 2 * half]])
    flat = halves.reshape(len(halves), -1, chains.shape[-1])
    draws, ratios = flat.shape[1], []
    for measure in (flat, np.abs(flat - np.median(flat, axis=(0, 1)))):
        ranks = measure.reshape(-1, flat.shape[-1]).argsort(axis=0).argsort(axis=0)
        scores = ndtri((ranks + 0.625) / (len(ranks) + 0.25)).reshape(flat.shape)
        within = np.mean(np.var(scores, axis=1, ddof=1), axis=0)
        between = np.var(np.mean(scores, axis=1), axis=0, ddof=1)
        ratios.append(np.sqrt((draws - 1.0) / draws + between / within))
    return np.asarray(np.maximum(*ratios))
