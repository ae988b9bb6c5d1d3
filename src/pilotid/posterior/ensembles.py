"""Ensemble sampling with emcee: independent ensembles, run until they are long enough.

Foreman-Mackey, Hogg, Lang and Goodman, emcee: The MCMC Hammer, PASP 125, 2013.  Most moves are
by differential evolution (ter Braak, Statistics and Computing 16, 2006), which has a third of
the stretch move's autocorrelation time here; some are proposals that do not depend on the
walkers, from a Student-t distribution around the optimum, which shorten it several times more.

emcee's own `DESnookerMove` is not used: in version 3.1.6 it does not leave the density as it is
(the standard deviation of a standard normal one comes out at 0.8 in nine dimensions).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pilotid.posterior.importance import LogDensity, StudentT
from pilotid.support.types import FloatArray

OVERDISPERSED = 1.5  # start of the walkers: standard deviations over those expected
JUMPS = 0.1  # share of the differential moves that go from one summit to another
AGREEMENT = 1.01  # R-hat that ensembles must come below
#: A run that is forecast to need this many times the steps it may take ends at once.
GIVE_UP = 1.5
SETTLED = 5.0  # autocorrelation times that are thrown away at the start


@dataclass(frozen=True)
class Run:
    """How long an emcee run is.

    Attributes
    ----------
    ensembles, walkers
        Independent ensembles, and walkers in each.
    first
        Steps before the first look at the run.
    most
        Steps of each ensemble at the most.
    effective
        Effective number of draws that every parameter must have, all ensembles together.
    independent
        Share of the moves that do not depend on the walkers.
    """

    ensembles: int = 4
    walkers: int = 40
    first: int = 200
    most: int = 6000
    effective: float = 2000.0
    independent: float = 0.5


DEFAULT_RUN = Run()


@dataclass(frozen=True, eq=False)
class Chains:
    """What an emcee run gave.

    Attributes
    ----------
    points
        Steps kept, shape (ensembles, steps, walkers, dimensions).
    log_density
        Shape (ensembles, steps, walkers).
    autocorrelation, r_hat
        Shape (dimensions,).
    acceptance
        Share of the proposals accepted.
    steps
        Steps of each ensemble, those at the start that were thrown away included.
    converged
        Whether length and agreement are as asked.
    """

    points: FloatArray
    log_density: FloatArray
    autocorrelation: FloatArray
    r_hat: FloatArray
    acceptance: float
    steps: int
    converged: bool

    @property
    def effective(self) -> FloatArray:
        """Effective number of draws of each dimension, shape (dimensions,)."""
        return np.asarray(math.prod(self.points.shape[:3]) / self.autocorrelation)


def ensembles(
    log_density: LogDensity,
    centre: FloatArray,
    covariance: FloatArray,
    rng: np.random.Generator,
    run: Run,
    watch: Callable[[float], None] | None = None,
) -> Chains | None:
    """Draws of a density by several independent ensembles.

    Parameters
    ----------
    log_density
        The target, up to a constant.
    centre, covariance
        Where walkers start: around the mode, wider than the target.
    rng
        Seeds emcee, whose generator is of the legacy kind.
    run
        Length of the run.
    watch
        Is told, from time to time, the share of the run that is done.

    Returns
    -------
    The chains, or None where the density is zero all around the centre.
    """
    import emcee

    differential = 1.0 - run.independent
    moves = [
        (emcee.moves.DEMove(), (1.0 - JUMPS) * differential),
        (emcee.moves.DEMove(gamma0=1.0), JUMPS * differential),
        (emcee.moves.MHMove(_independent(StudentT(centre, covariance))), run.independent),
    ]
    samplers = []
    for _ in range(run.ensembles):
        start = _start(log_density, centre, covariance, rng, run.walkers)
        if start is None:
            return None
        sampler = emcee.EnsembleSampler(
            run.walkers, centre.size, log_density, moves=moves, vectorize=True
        )
        seed = int(rng.integers(2**32))
        state = emcee.State(start, random_state=np.random.RandomState(seed).get_state())
        samplers.append((sampler, state))
    done, target = 0, run.first
    while True:
        for i, (sampler, state) in enumerate(samplers):
            if watch:
                watch((done + i * (target - done) / run.ensembles) / target)
            # emcee would refuse walkers that start close to a line; differential evolution
            # copes with the narrow valleys that pilots have.
            end = sampler.run_mcmc(state, target - done, skip_initial_state_check=True)
            samplers[i] = (sampler, end)
        done = target
        chains = _judged([sampler for sampler, _ in samplers], run)
        if chains.converged or done >= run.most:
            return chains
        needed = _longer(chains, done, run)
        if needed > GIVE_UP * run.most:
            return chains
        target = min(run.most, needed)


def _independent(
    proposal: StudentT,
) -> Callable[[FloatArray, np.random.RandomState], tuple[FloatArray, FloatArray]]:
    """A proposal of emcee that draws from a distribution, wherever the walkers are."""

    def propose(points: FloatArray, rng: np.random.RandomState) -> tuple[FloatArray, FloatArray]:
        drawn = proposal.draw(rng, len(points))
        return drawn, proposal.log_density(points) - proposal.log_density(drawn)

    return propose


def _start(
    log_density: LogDensity,
    centre: FloatArray,
    covariance: FloatArray,
    rng: np.random.Generator,
    walkers: int,
) -> FloatArray | None:
    """Starting points of an ensemble, all where the density is not zero."""
    wide = StudentT(centre, OVERDISPERSED**2 * covariance)
    found: list[FloatArray] = []
    for _ in range(50):
        points = wide.draw(rng, walkers)
        found += list(points[np.isfinite(log_density(points))])
        if len(found) >= walkers:
            return np.array(found[:walkers])
    return None


def _judged(samplers: list, run: Run) -> Chains:  # type: ignore[type-arg]
    points = np.array([sampler.get_chain() for sampler in samplers])
    log_density = np.array([sampler.get_log_prob() for sampler in samplers])
    steps = points.shape[1]
    times = autocorrelation_times(points[:, steps // 4 :])
    settled = min(steps // 2, max(100, math.ceil(SETTLED * float(np.max(times)))))
    points, log_density = points[:, settled:], log_density[:, settled:]
    times, ratio = autocorrelation_times(points), r_hat(points)
    acceptance = float(np.mean([np.mean(sampler.acceptance_fraction) for sampler in samplers]))
    longest = float(np.max(times))
    # A run of few autocorrelation times does not know them.
    long_enough = points.shape[1] >= 10.0 * longest
    effective = math.prod(points.shape[:3]) / longest
    good = long_enough and effective >= run.effective and float(np.max(ratio)) <= AGREEMENT
    return Chains(points, log_density, times, ratio, acceptance, steps, good)


def _longer(chains: Chains, done: int, run: Run) -> int:
    """Steps after which to look again."""
    kept = int(chains.points.shape[1])
    missing = run.effective / float(np.min(chains.effective))
    # A short run underestimates its autocorrelation time.
    return done + max(run.first // 2, math.ceil(1.15 * kept * missing) - kept)


WINDOW = 5.0  # autocorrelation times over which correlations are summed (Sokal 1997)


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
    for i, own in enumerate(products.T):
        if own[0] > 0.0:
            sums = 2.0 * np.cumsum(own / own[0]) - 1.0
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
    half = chains.shape[1] // 2
    halves = np.concatenate([chains[:, :half], chains[:, half : 2 * half]])
    flat = halves.reshape(len(halves), -1, chains.shape[-1])
    folded = np.abs(flat - np.median(flat, axis=(0, 1)))
    return np.maximum(_split_r_hat(_normal_scores(flat)), _split_r_hat(_normal_scores(folded)))


def _normal_scores(flat: FloatArray) -> FloatArray:
    from scipy.special import ndtri

    chains, draws, count = flat.shape
    pooled = flat.reshape(-1, count)
    ranks = np.empty_like(pooled)
    order = np.argsort(pooled, axis=0)
    np.put_along_axis(ranks, order, np.arange(1.0, len(pooled) + 1.0)[:, None], axis=0)
    return np.asarray(ndtri((ranks - 0.375) / (len(pooled) + 0.25))).reshape(chains, draws, count)


def _split_r_hat(flat: FloatArray) -> FloatArray:
    draws = flat.shape[1]
    within = np.mean(np.var(flat, axis=1, ddof=1), axis=0)
    between = np.var(np.mean(flat, axis=1), axis=0, ddof=1)
    return np.asarray(np.sqrt((draws - 1.0) / draws + between / within))
