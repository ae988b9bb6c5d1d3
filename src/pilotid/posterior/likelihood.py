"""Priors, and the likelihood of pilot and remnant parameters for very many parameter sets.

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
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from pilotid.likelihood.band_likelihood import most_likely_regression
from pilotid.likelihood.likelihood import Likelihood
from pilotid.likelihood.optimum import Optimum
from pilotid.likelihood.remnant_models import NoiseModel
from pilotid.model.factors import Parameter
from pilotid.model.model import PilotModel
from pilotid.solve.least_squares import LogTransform
from pilotid.support.types import FloatArray, InputError

#: Standard deviations from the middle of a normal distribution that hold four fifths of it.
FOUR_FIFTHS = 1.2815515655446004


class Prior(Protocol):
    """What is asked of a prior; a frozen distribution of scipy.stats has it."""

    def logpdf(self, x: FloatArray) -> FloatArray:
        """Logarithm of the density."""
        ...


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
        logs = np.log(x)
        return Normal(math.log(self.median), self.spread).logpdf(logs) - logs


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


#: Priors that replace the defaults, by the key of their parameter.
Replacements = Sequence[tuple[str, Prior]]


def default_prior(parameter: Parameter, times: float = 1.0) -> Prior:
    """The prior of a pilot parameter, what is known of it before the recording, so much wider."""
    low, high = parameter.usual
    spread = 0.5 * times / FOUR_FIFTHS
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
    model: PilotModel, noise: NoiseModel, replaced: Replacements = (), times: float = 1.0
) -> tuple[Prior, ...]:
    """The priors of a model's parameters and, after them, of the remnant's where they are sampled.

    Parameters
    ----------
    model
        The pilot model.
    noise
        The remnant's model; autoregressive coefficients have none, see
        `pilotid.posterior.likelihood`.
    replaced
        Priors in the place of the defaults.
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


CACHE = 28_000  # bins of all sets that are evaluated at once: about what the cache holds
#: Standard deviations, on the inner scale, beyond which nobody looks for a parameter: they
#: keep the first guess of the covariance finite where the likelihood knows nothing.
BROAD_LOG, BROAD_LINEAR = 2.0, 0.5


class Posterior:
    """Log-density by parameters of the pilot and those of the remnant that are sampled.

    Parameters
    ----------
    joint
        Prediction, model of the remnant and analysis band.
    priors
        One for each parameter; the bounds truncate them.
    widened
        Factor on the variances that the likelihood stands for, see
        `pilotid.likelihood.optimum.Optimum`: the remnant's model was chosen from the
        same seconds, which integrating over its parameters does not tell.
    """

    def __init__(
        self, joint: Likelihood, priors: tuple[Prior, ...] = (), widened: float = 1.0
    ) -> None:
        self.joint, self.priors, self.widened = joint, priors, widened
        regressive, keys = joint.noise.regressive, joint.noise.keys
        #: Number of the remnant's parameters that are integrated out, and of all that stay.
        self.integrated = len(keys) if regressive else 0
        self.count = joint.lower.size - self.integrated
        #: Names of the parameters, those of the remnant last.
        self.keys = (*joint.prediction.model.keys, *(() if regressive else keys))
        #: Bounds, and which parameters are sampled on a logarithmic scale.
        self.lower, self.upper, self.positive = (
            ends[: self.count] for ends in (joint.lower, joint.upper, joint.positive)
        )
        self._scale = LogTransform(self.positive)

    def values(self, points: FloatArray) -> FloatArray:
        """Parameters at points of the inner scale, shape (sets, parameters)."""
        return self._scale.leave(points)

    def log_density(self, points: FloatArray) -> FloatArray:
        """Up to a constant, -inf outside the bounds and where there is no number, (sets,).

        Of two pilots with one response only that counts which `PilotModel.ordered` gives.

        Parameters
        ----------
        points
            Parameters on the inner scale, shape (sets, parameters).
        """
        with np.errstate(over="ignore"):
            values = self.values(points)
        inside = np.all((values > self.lower) & (values < self.upper), axis=1)
        pilots = values[:, : self.joint.pilot_count]
        inside &= np.all(self.joint.prediction.model.ordered(pilots) == pilots, axis=1)
        result = np.full(len(points), -np.inf)
        within = np.flatnonzero(inside)
        share = self.joint.prediction.control_spectrum.size / CACHE
        pieces = min(within.size, math.ceil(within.size * share))
        for block in np.array_split(within, pieces) if pieces else ():
            own = values[block]
            columns = zip(self.priors, own.T, strict=True)
            prior = np.sum([prior.logpdf(column) for prior, column in columns], axis=0)
            # d value / d log(value) = value
            slope = np.sum(points[block][:, self.positive], axis=1)
            result[block] = self.log_likelihood(own) + prior + slope
        return np.where(np.isfinite(result), result, -np.inf)

    def log_likelihood(self, values: FloatArray) -> FloatArray:
        """Log-likelihood up to a constant, shape (sets,).

        Parameters
        ----------
        values
            Parameter sets inside the bounds, shape (sets, parameters).
        """
        joint, terms = self.joint, self.joint.band_terms
        freedom, further = joint.residuals, np.zeros(len(values))
        # What overflows is no number, which is no likelihood either.
        with np.errstate(all="ignore"):
            if self.integrated:
                products = self.lagged_products(values)
                taps, further = most_likely_regression(products, terms)
                squares = np.vecdot((products @ taps[..., None])[..., 0], taps)
                freedom -= self.integrated if terms is None else 0
            else:
                taps, squares = self._taps(values), self.sums_of_squares(values)
            deviance = freedom * np.log(squares) + further
            if terms is not None:
                loop = joint.prediction.loop.residual_spectra(values[:, : joint.pilot_count])
                deviance += 2.0 * (terms.of_loop(loop[:, 0]) + terms.of_whitener(taps))
            return np.asarray(-0.5 / self.widened * deviance)

    def sums_of_squares(self, values: FloatArray) -> FloatArray:
        """Sums of squares of the prediction errors, shape (sets,).

        Parameters
        ----------
        values
            Sets of pilot and, in any case, remnant parameters.
        """
        taps, prediction = self._taps(values), self.joint.prediction
        spectra = prediction.residual_spectra(values[:, : self.joint.pilot_count])
        if taps.shape[1] > 1:
            spectra *= prediction.filter_response(taps)[:, None, :]
        errors = prediction.without_nuisance(prediction.samples_of(spectra))
        errors = prediction.weighted_rows(errors).reshape(len(errors), -1)
        squares, terms, count = np.vecdot(errors, errors), self.joint.band_terms, taps.shape[1]
        if terms is not None:
            squares += np.vecdot(taps @ terms.outside[:count, :count], taps)
        return np.asarray(squares)

    def _taps(self, values: FloatArray) -> FloatArray:
        """Whitening filters of sets of pilot and remnant parameters."""
        return self.joint.noise.filters(values[:, self.joint.pilot_count :], self.joint.band)

    def lagged_products(self, values: FloatArray) -> FloatArray:
        """Inner products of the residual with itself at all pairs of lags 0 to the order.

        Nuisance terms are projected out, and all runs count together; in a band products are
        weighted, and those of what lies outside are added.

        Returns
        -------
        Array of shape (sets, order + 1, order + 1).
        """
        prediction, order, terms = self.joint.prediction, self.integrated, self.joint.band_terms
        spectra = prediction.residual_spectra(values[:, : self.joint.pilot_count])
        signal = prediction.samples_before(spectra, order)
        # Nuisance terms are fitted to the scored samples and taken out of all: what is left of them
        # at other lags is then small beside the residual, whatever the offset was.
        amplitudes = signal[..., order:] @ np.linalg.pinv(prediction.nuisance_terms).T
        time = np.arange(-order, prediction.scored) * prediction.dt
        signal = signal - amplitudes @ np.exp(np.outer(prediction.nuisance_poles, time))
        if terms is not None:
            lags = np.moveaxis(terms.lagged(signal, order), 0, 1)
        else:
            ends = range(order, -1, -1)
            each = [signal[..., first : first + prediction.scored] for first in ends]
            lags = prediction.without_nuisance(np.stack(each, axis=1))
        flat = lags.reshape(*lags.shape[:2], -1)
        products = flat @ flat.transpose(0, 2, 1)
        return products if terms is None else products + terms.outside[: order + 1, : order + 1]

    def coefficients(self, values: FloatArray) -> FloatArray:
        """Autoregressive coefficients that suit each parameter set best, (sets, order)."""
        products = self.lagged_products(values)
        return most_likely_regression(products, self.joint.band_terms)[0][:, 1:]

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
        broad = np.where(joint.positive, BROAD_LOG, BROAD_LINEAR) ** -2.0
        # What the loop's term takes may leave no information in some direction.
        sizes, axes = np.linalg.eigh(information + np.diag(broad))
        covariance = (axes / np.maximum(sizes, broad.min())) @ axes.T
        count = self.count
        return scale.enter(values)[0, :count], np.asarray(covariance[:count, :count])
