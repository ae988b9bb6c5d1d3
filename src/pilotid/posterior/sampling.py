"""Sampling of a posterior with emcee, whose shape is nearly known, and what follows from draws.

Foreman-Mackey, Hogg, Lang and Goodman, emcee: The MCMC Hammer, PASP 125, 2013.  Most moves are
proposals that do not depend on the walkers, from a Student-t distribution with a wider copy, of
which half or more are accepted; the others go by differential evolution (ter Braak, Statistics and
Computing 16, 2006), which needs no such knowledge.

The distribution is fitted to draws around the optimum, weighted by the density (importance
sampling with truncated weights: Ionides, Journal of Computational and Graphical Statistics 17(2),
2008); walkers start at some of them.  Where it follows badly, another is fitted to the chains.

emcee's own `DESnookerMove` is not used: in version 3.1.6 it does not leave the density as it is
(the standard deviation of a standard normal one comes out at 0.8 in nine dimensions).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from pilotid.estimate.quantities import TAILS, Draws, Quantity, sampled
from pilotid.model.model import PilotModel
from pilotid.posterior.likelihood import Posterior
from pilotid.support.types import FloatArray

#: Maps points (sets, dimensions) to log-densities (sets,), -inf outside the bounds.
LogDensity = Callable[[FloatArray], FloatArray]

FREEDOM = 10.0  # of the Student-t distribution: tails heavier than a likelihood's
WIDE, DEFENCE = 4.0, 0.05  # scale of a second copy over that of the first, and its share
NARROW = 0.5  # scale where draws know no better, over the covariance that is given
ITERATIONS = 8  # of expectation and maximisation
SCOUTS, STAGES = 200, 8  # draws of each proposal by importance, and proposals at the most
ENOUGH = 20.0  # effective draws by dimension that end the search for a proposal
REFITS = 3  # how often a distribution is fitted to the chains, at the most
GROWTH = 1.5  # of the steps before the next look, where another one is fitted
SLOW = 6.0  # autocorrelation time [steps] from which on another one is worth its time

ENSEMBLES, WALKERS = 2, 24  # independent ensembles, and walkers of each at least
INDEPENDENT = 0.9  # share of the moves that do not depend on the walkers
JUMPS = 0.1  # share of the differential moves that go from one mode to another
FIRST = 36  # steps before the first look at the run
SETTLED = 2.0  # autocorrelation times that are thrown away at the start
LONG = 5.0  # autocorrelation times that a run has at least: a shorter one does not know them
WINDOW = 5.0  # autocorrelation times over which correlations are summed (Sokal 1997)


class StudentT:
    """A multivariate Student-t distribution with a wider copy, which finds what it misses.

    Parameters
    ----------
    centre, scale
        Its centre, shape (dimensions,), and scale matrix, which is positive definite.
    """

    def __init__(self, centre: FloatArray, scale: FloatArray) -> None:
        self.centre, self._root = centre, np.linalg.cholesky(scale)
        self._inverse = np.linalg.inv(self._root)

    def draw(self, rng: np.random.Generator | np.random.RandomState, count: int) -> FloatArray:
        """Random points, shape (count, dimensions)."""
        normal = rng.standard_normal((count, self.centre.size))
        normal *= np.sqrt(FREEDOM / rng.chisquare(FREEDOM, (count, 1)))
        normal[rng.uniform(size=count) < DEFENCE] *= math.sqrt(WIDE)
        return self.centre + normal @ self._root.T

    def distances(self, points: FloatArray) -> FloatArray:
        """Squared distances from the centre in units of the scale, shape (points,)."""
        return np.asarray(np.sum(((points - self.centre) @ self._inverse.T) ** 2, axis=1))

    def log_density(self, points: FloatArray) -> FloatArray:
        """Up to a constant that depends on the dimensions alone, shape (points,)."""
        squares, dimensions = self.distances(points) / FREEDOM, self.centre.size
        power = -0.5 * (FREEDOM + dimensions)
        narrow = math.log(1.0 - DEFENCE) + power * np.log1p(squares)
        wide = math.log(DEFENCE / WIDE ** (0.5 * dimensions)) + power * np.log1p(squares / WIDE)
        return np.asarray(np.logaddexp(narrow, wide) + np.sum(np.log(np.diag(self._inverse))))


def fitted(points: FloatArray, weights: FloatArray, covariance: FloatArray) -> StudentT:
    """A distribution that follows weighted draws, by expectation and maximisation.

    Parameters
    ----------
    points, weights
        The draws, shape (draws, dimensions), and their weights, which sum to 1.
    covariance
        About that of the draws, towards which it is drawn where few of them support it.
    """
    dimensions = points.shape[1]
    # As much as so many effective draws weigh as there are dimensions.
    doubt = min(1.0, dimensions * float(np.sum(weights**2)))
    follows = StudentT(weights @ points, covariance)
    for _ in range(ITERATIONS):
        pull = weights * (FREEDOM + dimensions) / (FREEDOM + follows.distances(points))
        centre = pull @ points / pull.sum()
        offset = points - centre
        scale = (offset.T * pull) @ offset + doubt * NARROW * covariance
        follows = StudentT(centre, scale / (1.0 + doubt))
    return follows


def explored(
    log_density: LogDensity,
    centre: FloatArray,
    covariance: FloatArray,
    rng: np.random.Generator,
) -> tuple[StudentT, FloatArray, FloatArray] | None:
    """A distribution that follows a density, and the weighted draws that it was fitted to.

    Parameters
    ----------
    log_density
        The density.
    centre, covariance
        Its mode and the covariance there, about.
    rng
        Draws.

    Returns
    -------
    Distribution, draws (draws, dimensions) and weights (draws,); None where the density is zero all
    around the centre.
    """
    proposals = [StudentT(centre, covariance)]
    points, target = np.zeros((0, centre.size)), np.zeros(0)
    for _ in range(STAGES):
        more = proposals[-1].draw(rng, SCOUTS)
        points, target = np.concatenate([points, more]), np.append(target, log_density(more))
        # All draws count as of the mixture of all proposals.
        logs = target - np.logaddexp.reduce([p.log_density(points) for p in proposals], axis=0)
        if not np.isfinite(logs).any():
            return None
        weights = np.exp(logs - np.max(logs))
        found = np.sum(weights) ** 2 / np.sum(weights**2)
        weights = np.minimum(weights, np.mean(weights) * math.sqrt(weights.size))
        weights /= weights.sum()
        proposals.append(fitted(points, weights, covariance))
        if found >= ENOUGH * centre.size:
            break
    return proposals[-1], points, weights


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

    found = explored(posterior.log_density, centre, covariance, rng)
    if found is None:
        return None
    proposal, points, weights = found

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
        # emcee would refuse walkers that start close to a line; differential evolution copes with
        # the narrow valleys that pilots have.
        more = {"nsteps": target - done, "skip_initial_state_check": True}
        runs = [(sampler, sampler.run_mcmc(state, **more)) for sampler, state in runs]
        done = target
        draws = _drawn(posterior, [sampler for sampler, _ in runs], effective)
        if draws.converged or done >= most:
            return draws
        times = float(np.max(draws.autocorrelation))
        if refits < REFITS and times > SLOW:
            chains = np.concatenate([sampler.get_chain(flat=True) for sampler, _ in runs])
            every = np.full(len(chains), 1.0 / len(chains))
            proposal = fitted(chains, every, np.atleast_2d(np.cov(chains.T)))
            for sampler, _ in runs:
                sampler.reset()
            refits += 1
            done, target = 0, min(most, round(FIRST * GROWTH**refits))
        else:  # a short run underestimates its autocorrelation time
            kept = max(LONG, effective / (ENSEMBLES * count)) * times
            target = min(most, max(done + FIRST // 4, math.ceil(1.15 * kept + SETTLED * times)))


def _drawn(posterior: Posterior, samplers: list[Any], effective: float) -> Draws:
    """What ensembles gave, without the start."""
    points = np.array([sampler.get_chain() for sampler in samplers])
    steps = points.shape[1]
    longest = float(np.max(autocorrelation_times(points[:, steps // 4 :])))
    settled = min(steps // 2, math.ceil(SETTLED * longest))
    points = points[:, settled:]
    log_density = np.array([sampler.get_log_prob(discard=settled) for sampler in samplers])
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
    products /= np.arange(steps, 0, -1)[:, None] / steps
    products /= np.maximum(products[0], 1e-300)
    sums = 2.0 * np.cumsum(products, axis=0) - 1.0
    within = np.arange(steps)[:, None] >= WINDOW * sums
    within[-1] = True
    first = np.argmax(within, axis=0)
    return np.asarray(np.maximum(1.0, sums[first, np.arange(first.size)]))


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
    for own in (flat, np.abs(flat - np.median(flat, axis=(0, 1)))):
        ranks = own.reshape(-1, flat.shape[-1]).argsort(axis=0).argsort(axis=0)
        scores = ndtri((ranks + 0.625) / (len(ranks) + 0.25)).reshape(flat.shape)
        within = np.mean(np.var(scores, axis=1, ddof=1), axis=0)
        between = np.var(np.mean(scores, axis=1), axis=0, ddof=1)
        ratios.append(np.sqrt((draws - 1.0) / draws + between / within))
    return np.asarray(np.maximum(*ratios))


# -------------------------------------------------------------- what follows from draws

SIMULATED = 400  # recordings
SETTLE = 400  # samples in which the simulated remnant forgets where it started


@dataclass(frozen=True, eq=False)
class PredictiveBand:
    """95 % bands of the control of every run, in the analysis band.

    Attributes
    ----------
    time
        From the first scored sample [s], shape (samples,).
    control
        What was recorded, shape (runs, samples).
    model
        Band of the model's answer to the recorded inputs, which is as wide as the parameters
        are unknown, shape (2, runs, samples).
    with_remnant
        The same with a remnant of the spectrum and power that each draw has, in which 95 %
        of the recorded samples should lie, shape (2, runs, samples).
    """

    time: FloatArray
    control: FloatArray
    model: FloatArray
    with_remnant: FloatArray

    @property
    def inside(self) -> float:
        """Share of the recorded samples inside the band with remnant."""
        low, high = self.with_remnant
        return float(np.mean((low <= self.control) & (self.control <= high)))


def predictive_band(draws: Draws, posterior: Posterior, rng: np.random.Generator) -> PredictiveBand:
    """The band from equally weighted draws.

    Parameters
    ----------
    draws, posterior
        The draws, and the posterior that they come from.
    rng
        Draws the remnants.
    """
    from scipy.signal import lfilter

    joint = posterior.joint
    prediction, control = joint.prediction, joint.prediction.control
    answers, noisy = np.empty((2, SIMULATED, *control.shape))
    for i, own in enumerate(draws.thinned(SIMULATED)[:, None]):
        values = np.hstack([own, posterior.coefficients(own)]) if posterior.integrated else own
        pilot, remnant = np.split(values, [joint.pilot_count], axis=1)
        (taps,) = joint.noise.filters(remnant, joint.band)
        power = float(posterior.sums_of_squares(values)[0]) / rng.chisquare(joint.residuals)
        noise = rng.normal(0.0, power**0.5, (len(control), SETTLE + control.shape[1]))
        answers[i] = control - prediction.errors(pilot[0])
        noisy[i] = answers[i] + lfilter([1.0], taps, noise, axis=1)[:, SETTLE:]
    return PredictiveBand(
        prediction.time - prediction.time[0],
        control,
        np.quantile(answers, TAILS, axis=0),
        np.quantile(noisy, TAILS, axis=0),
    )


def sampled_parameters(draws: Draws, model: PilotModel) -> list[Quantity]:
    """The sampled parameters, the remnant's last."""
    units = {p.key: p.unit for p in model.parameters} | {"frequency": "rad/s"}
    return [
        sampled(
            key,
            units.get(key, ""),
            draws.values[:, i],
            effective=float(draws.effective[i]),
            r_hat=float(draws.r_hat[i]),
            positive=bool(draws.positive[i]),
        )
        for i, key in enumerate(draws.keys)
    ]
