"""The posterior of pilot and remnant: priors, likelihood, and sampling with emcee.

Foreman-Mackey, Hogg, Lang and Goodman, emcee: The MCMC Hammer, PASP 125, 2013.  The shape is nearly
known beforehand: most moves are proposals that do not depend on the walkers, from a mixture of
Student-t distributions, of which half or more are accepted; the others go by differential evolution
(ter Braak, Statistics and Computing 16, 2006), which needs no such knowledge.

The first mixture is fitted to draws around the optimum, weighted by the density (importance
sampling: Cornuet, Marin, Mira and Robert, Scandinavian Journal of Statistics 39, 2012); walkers
start at some of them.  Where it is followed badly, one of several parts is fitted to the chains.

emcee's own `DESnookerMove` is not used: in version 3.1.6 it does not leave the density as it is
(the standard deviation of a standard normal one comes out at 0.8 in nine dimensions).

The prediction errors are Gaussian and white once the residual is whitened by the
remnant's spectrum.  Their variance is integrated out in closed form under Jeffreys' prior
1/variance, which leaves

    log p = -(N/2) log(sum of squares) + constant.

Where the remnant is autoregressive of order p, its coefficients enter as in a linear
regression of the residual on its own past.  They too are integrated out, under a flat
prior: with A the products of that past, and the sum of squares at its minimum,

    log p = -((N - p)/2) log(sum of squares) - (1/2) log det A + constant

(Zellner, An Introduction to Bayesian Inference in Econometrics, 1971, ch. 3 and 7).  In a band
(`pilotid.likelihood.band_likelihood`) the log-determinant D is subtracted from all of it; that of
an autoregression is no square, and its coefficients are integrated out about those that are most
likely (Laplace).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from pilotid.estimate.quantities import Draws
from pilotid.likelihood.band_likelihood import most_likely_regression
from pilotid.likelihood.likelihood import Likelihood
from pilotid.likelihood.optimum import Optimum
from pilotid.likelihood.remnant_models import NoiseModel
from pilotid.model.factors import Parameter
from pilotid.model.model import PilotModel
from pilotid.solve.least_squares import LogTransform
from pilotid.support.types import BoolArray, FloatArray, InputError

# --------------------------------------------------------------------------- priors and likelihood


class Prior(Protocol):
    """What is asked of a prior; a frozen distribution of scipy.stats has it."""

    def logpdf(self, x: FloatArray) -> FloatArray:
        """Logarithm of the density."""


@dataclass(frozen=True)
class LogNormal:
    """A positive parameter whose logarithm is normal.

    Attributes
    ----------
    median
        In the parameter's unit.
    spread
        Standard deviation of the natural logarithm.
    """

    median: float
    spread: float

    def logpdf(self, x: FloatArray) -> FloatArray:
        return Normal(math.log(self.median), self.spread).logpdf(np.log(x)) - np.log(x)


@dataclass(frozen=True)
class Normal:
    """A parameter that may be zero, such as a delay.

    Attributes
    ----------
    mean, spread
        Mean and standard deviation, in the parameter's unit.
    """

    mean: float
    spread: float

    def logpdf(self, x: FloatArray) -> FloatArray:
        offset = (x - self.mean) / self.spread
        constant = math.log(self.spread * math.sqrt(2.0 * math.pi))
        return np.asarray(-0.5 * offset * offset - constant)


@dataclass(frozen=True)
class HalfCauchy:
    """A gain: flat far below the scale, proportional to its inverse square far above.

    Attributes
    ----------
    scale
        The median, in the parameter's unit.
    """

    scale: float

    def logpdf(self, x: FloatArray) -> FloatArray:
        constant = math.log(2.0 / (math.pi * self.scale))
        return np.asarray(constant - np.log1p((x / self.scale) ** 2))


def default_prior(parameter: Parameter, times: float = 1.0) -> Prior:
    """The prior of a pilot parameter, what is known of it before the recording, so much wider."""
    low, high = parameter.usual
    # So many standard deviations about the middle hold four fifths of a normal distribution.
    spread = 0.5 * times / 1.2815515655446004
    if parameter.linear and parameter.positive:
        return HalfCauchy(times * high)
    if parameter.positive:
        return LogNormal(math.sqrt(low * high), spread * math.log(high / low))
    return Normal(0.5 * (low + high), spread * (high - low))


#: Four fifths of the remnants' break frequencies lie in 1 to 30 rad/s, of the dampings in
#: 0.2 to 1.5.
REMNANT: dict[str, Prior] = {
    "frequency": LogNormal(5.5, 1.33),
    "damping": LogNormal(0.55, 0.79),
    "corner": LogNormal(0.7, 1.0),
}


def priors_of(
    model: PilotModel,
    noise: NoiseModel,
    replaced: Sequence[tuple[str, Prior]] = (),
    times: float = 1.0,
) -> tuple[Prior, ...]:
    """The priors of a model's parameters and, after them, of the remnant's where they are sampled.

    Parameters
    ----------
    model
        The pilot model.
    noise
        The remnant's model; autoregressive coefficients have none, see
        `pilotid.likelihood.posterior`.
    replaced
        Priors in the place of the defaults, each with the key of its parameter.
    times
        How much wider those of the pilot are than the defaults.

    Raises
    ------
    InputError
        If one is given for a parameter that neither the model nor any remnant has.
    """
    given = dict(replaced)
    unknown = [key for key in given if key not in (*model.keys, *REMNANT)]
    if unknown:
        raise InputError(
            f"a prior is given for {', '.join(unknown)}, which model {model.name} lacks: "
            f"choose from {', '.join((*model.keys, *REMNANT))}"
        )
    pilot = [given.get(p.key) or default_prior(p, times) for p in model.parameters]
    keys = () if noise.regressive else noise.keys
    return (*pilot, *(given.get(key) or REMNANT[key] for key in keys))


class Posterior:
    """Log-density by the parameters of the pilot and those of the remnant that stay.

    Parameters
    ----------
    joint
        Prediction, model of the remnant and analysis band.
    priors
        One for each parameter that stays; the bounds truncate them.
    widened
        Factor on the variances that the likelihood stands for, see
        `pilotid.likelihood.optimum.Optimum`: the remnant's model was chosen from the
        same seconds, which integrating over its parameters does not tell.
    """

    def __init__(
        self, joint: Likelihood, priors: tuple[Prior, ...] = (), widened: float = 1.0
    ) -> None:
        self.joint, self.priors, self.widened = joint, priors, widened
        self._prediction, self._terms = joint.prediction, joint.prediction.band_terms
        #: Number of the remnant's parameters that are integrated out.
        self.integrated = len(joint.noise.keys) if joint.noise.regressive else 0
        #: Number of parameters that stay.
        self.count = joint.lower.size - self.integrated
        #: Names of the parameters, those of the remnant last.
        self.keys = (*joint.prediction.model.keys, *joint.noise.keys)[: self.count]
        #: Which are sampled by their logarithm, shape (parameters,).
        self.positive: BoolArray = joint.positive[: self.count]
        self._scale = LogTransform(self.positive)

    def values(self, points: FloatArray) -> FloatArray:
        """Parameters at points of the inner scale, shape (sets, parameters)."""
        return self._scale.leave(points)

    def log_density(self, points: FloatArray) -> FloatArray:
        """Up to a constant, by points on the inner scale, shape (sets,).

        It is -inf outside the bounds and where there is no number.  Of two pilots with one response
        only that counts which `PilotModel.ordered` gives.
        """
        values = self.values(points)
        lower, upper = self.joint.lower[: self.count], self.joint.upper[: self.count]
        inside = np.all((values > lower) & (values < upper), axis=1)
        pilots = values[:, : self.joint.pilot_count]
        inside &= np.all(self._prediction.model.ordered(pilots) == pilots, axis=1)
        result = np.full(len(points), -np.inf)
        if inside.any():
            sets = values[inside]
            columns = zip(self.priors, sets.T, strict=True)
            prior = np.sum([prior.logpdf(column) for prior, column in columns], axis=0)
            # d value / d log(value) = value
            slope = np.sum(points[inside][:, self.positive], axis=1)
            # About what the processor's cache holds.
            blocks = np.split(sets, range(16, len(sets), 16))
            result[inside] = np.concatenate([*map(self.log_likelihood, blocks)]) + prior + slope
        return np.where(np.isfinite(result), result, -np.inf)

    def log_likelihood(self, values: FloatArray) -> FloatArray:
        """Up to a constant, shape (sets,).

        Parameters
        ----------
        values
            Parameter sets inside the bounds, shape (sets, parameters).
        """
        joint, terms = self.joint, self._terms
        freedom, further = joint.residuals, np.zeros(len(values))
        if self.integrated:
            products = self.lagged_products(values)
            taps, further = most_likely_regression(products, terms)
            sums = np.einsum("si,sij,sj->s", taps, products, taps)
            freedom -= self.integrated if terms is None else 0
        else:
            taps = joint.noise.filters(values[:, joint.pilot_count :], joint.band)
            sums = self.sums_of_squares(values, taps)
        deviance = freedom * np.log(sums) + further
        if terms is not None:
            loop = self._prediction.loop.residual_spectra(values[:, : joint.pilot_count])
            deviance += 2.0 * (terms.of_loop(loop[:, 0]) + terms.of_whitener(taps))
            deviance[~terms.are_stable(loop[:, 0])] = np.inf  # the recorded loop was stable
        return np.asarray(-0.5 / self.widened * deviance)

    def sums_of_squares(self, values: FloatArray, taps: FloatArray) -> FloatArray:
        """Sums of squares of the prediction errors, shape (sets,).

        Parameters
        ----------
        values
            Parameter sets, of which the pilot's come first.
        taps
            The whitening filter of each, shape (sets, taps).
        """
        prediction = self._prediction
        pilots = values[:, : self.joint.pilot_count]
        errors = prediction.errors(pilots, taps if taps.shape[1] > 1 else None)
        errors = prediction.weighted_rows(errors)
        sums = np.asarray(np.vecdot(errors, errors))
        if self._terms is not None:
            count = taps.shape[1]
            sums += np.vecdot(taps @ self._terms.outside[:count, :count], taps)
        return sums

    def lagged_products(self, values: FloatArray) -> FloatArray:
        """Inner products of the residual with itself at all pairs of lags 0 to the order.

        Nuisance terms are projected out, and all runs count together; in a band products are
        weighted, and those of what lies outside are added.

        Returns
        -------
        Array of shape (sets, order + 1, order + 1).
        """
        prediction, order = self._prediction, self.integrated
        spectra = prediction.residual_spectra(values[:, : self.joint.pilot_count])
        signal = prediction.samples_before(spectra, order)
        if prediction.nuisance_poles:
            # Fitted to the scored samples and taken out of all: what is left of them at other
            # lags is then small beside the residual, whatever the offset was.
            amplitudes = signal[..., order:] @ np.linalg.pinv(prediction.nuisance_terms).T
            time = np.arange(-order, prediction.window.scored) * prediction.dt
            signal = signal - amplitudes @ np.exp(np.outer(prediction.nuisance_poles, time))
        if self._terms is not None:
            outside = self._terms.outside[: order + 1, : order + 1]
            return self._terms.lagged_products(signal, order) + outside
        lags = np.moveaxis(sliding_window_view(signal, prediction.window.scored, axis=-1), 2, 1)
        flat = prediction.without_nuisance(lags[:, ::-1]).reshape(len(values), order + 1, -1)
        return np.asarray(flat @ flat.transpose(0, 2, 1))

    def approximation(self, maximum: Optimum) -> tuple[FloatArray, FloatArray]:
        """Mode of the likelihood and covariance there, on the inner scale.

        Parameters
        ----------
        maximum
            The likelihood's maximum, all of the remnant's parameters included.
        """
        joint, end = maximum.joint, maximum.end
        scale = LogTransform(joint.positive)
        values = end.values[:1]
        variance = max(float(end.cost[0]), np.finfo(float).tiny) / joint.residuals
        information = scale.inner(end.gram[:1], values)[0, :-1, :-1] / variance
        # Beyond these standard deviations nobody looks for a parameter: the covariance is finite
        # where the likelihood knows nothing.
        broad = np.where(joint.positive, 2.0, 0.5) ** -2.0
        # At a bound the likelihood need not be a summit in every direction.
        sizes, along = np.linalg.eigh(information)
        information = (along * np.maximum(sizes, 0.0)) @ along.T
        covariance = np.asarray(np.linalg.inv(information + np.diag(broad)))
        return scale.enter(values)[0, : self.count], covariance[: self.count, : self.count]


# ---------------------------------------------------------------------------------------- sampling


#: Maps points (sets, dimensions) to log-densities (sets,), -inf outside the bounds.
LogDensity = Callable[[FloatArray], FloatArray]

FREEDOM = 10.0  # of the Student-t distributions: tails heavier than a likelihood's
#: Steps of a run after which another mixture is fitted if that is worth its time, by the mixtures
#: fitted before it, and the share of its moves that do not depend on the walkers: where these are
#: followed badly, the others are better.
RUNS = ((44, 0.9), (66, 0.9), (176, 0.6), (352, 0.6), (352, 0.6), (352, 0.6))
FIRST_LOOK = 44  # steps of a run before it is looked at
ENSEMBLES = 2  # independent ones
SETTLED = 2.0  # autocorrelation times that are thrown away at the start
LONG = 5.0  # autocorrelation times that a run has at least: a shorter one does not know them


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
        shares = np.append(0.95 * self.shares, 0.05 * self.shares)
        return Mixture(
            shares / shares.sum(),
            np.concatenate([self.centres, self.centres]),
            np.concatenate([self.scales, 4.0 * self.scales]),
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
    dimensions, least = points.shape[1], 0.5 * covariance
    # As much as so many effective draws weigh as there are dimensions.
    doubt = min(1.0, dimensions * float(np.sum(weights**2)))
    starts = points[rng.choice(len(points), parts, p=weights)]
    mixture = Mixture(np.full(parts, 1.0 / parts), starts, np.tile(least, (parts, 1, 1)))
    for _ in range(8):  # expectation and maximisation
        logs = mixture.by_part(points)
        part = np.exp(logs - np.logaddexp.reduce(logs, axis=0)) * weights
        pull = part * (FREEDOM + dimensions) / (FREEDOM + mixture.distances(points))
        total = pull.sum(axis=1, keepdims=True)
        # A part that no draw supports stays where it is.
        moved = (pull[:, None] @ points)[:, 0] / np.maximum(total, 1e-12)
        centres = np.where(total > 1e-12, moved, mixture.centres)
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
    from scipy.special import softmax

    proposals = [Mixture(np.ones(1), centre[None], covariance[None]).defended]
    points, target = np.zeros((0, centre.size)), np.zeros(0)
    # Weights that leave fewer effective draws, because few points have them all, are flattened.
    enough = 20.0 * centre.size
    for _ in range(8):
        more = proposals[-1].draw(rng, 400)
        points, target = np.concatenate([points, more]), np.append(target, log_density(more))
        # All draws count as of the mixture of all proposals.
        logs = target - np.logaddexp.reduce([p.log_density(points) for p in proposals], axis=0)
        if not np.isfinite(logs).any():
            return None
        weights, power = softmax(logs), 1.0
        unflattened = effective = 1.0 / np.sum(weights**2)
        while effective < enough and power > 1e-3:
            power *= 0.7
            weights = softmax(power * logs)
            effective = 1.0 / np.sum(weights**2)
        proposals.append(fitted(points, weights, covariance, 1, rng))
        if unflattened >= enough:
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

    first = explored(posterior.log_density, centre, covariance, rng)
    if first is None:
        return None
    proposal, points, weights = first

    def independent(
        walkers: FloatArray, rng: np.random.RandomState
    ) -> tuple[FloatArray, FloatArray]:
        drawn = proposal.draw(rng, len(walkers))
        return drawn, proposal.log_density(walkers) - proposal.log_density(drawn)

    count = max(24, 2 * centre.size + 2)

    def sampler_of(share: float) -> emcee.EnsembleSampler:
        moves = [
            (emcee.moves.MHMove(independent), share),
            (emcee.moves.DEMove(), 0.9 * (1.0 - share)),
            (emcee.moves.DEMove(gamma0=1.0), 0.1 * (1.0 - share)),  # from one mode to another
        ]
        return emcee.EnsembleSampler(
            count, centre.size, posterior.log_density, moves=moves, vectorize=True
        )

    states = []
    for _ in range(ENSEMBLES):
        start = points[rng.choice(len(points), count, p=weights)]
        seed = np.random.RandomState(int(rng.integers(2**32))).get_state()
        states.append(emcee.State(start, random_state=seed))
    refits, done = 0, 0
    while True:
        if not done:
            longest, share = RUNS[refits]
            samplers = [sampler_of(share) for _ in states]
        steps = min(max(FIRST_LOOK if not done else FIRST_LOOK // 2, done // 4), most - done)
        # emcee would refuse walkers that start close to a line; differential evolution
        # copes with the narrow valleys that pilots have.
        states = [
            sampler.run_mcmc(state, steps, skip_initial_state_check=True)
            for sampler, state in zip(samplers, states, strict=True)
        ]
        done += steps
        draws = _drawn(posterior, samplers, effective)
        if draws.converged or done >= most:
            return draws
        last = refits + 1 == len(RUNS)
        if not last and done >= longest and float(np.max(draws.autocorrelation)) > 12.0:
            # Another mixture is worth its time.
            chains = np.concatenate([sampler.get_chain(flat=True) for sampler in samplers])
            every = np.full(len(chains), 1.0 / len(chains))
            proposal = fitted(chains, every, np.cov(chains.T), 8, rng)
            refits, done = refits + 1, 0


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
    sums = 2.0 * np.cumsum(products / np.maximum(products[0], 1e-300), axis=0) - 1.0
    within = np.arange(steps)[:, None] >= 5.0 * sums  # the window of Sokal (1997)
    last = np.where(within.any(axis=0), np.argmax(within, axis=0), -1)
    return np.asarray(np.maximum(1.0, sums[last, np.arange(last.size)]))


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
