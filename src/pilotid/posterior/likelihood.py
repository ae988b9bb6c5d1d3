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
from collections.abc import Iterator, Sequence
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
from pilotid.support.types import BoolArray, FloatArray, InputError

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
        offset = np.log(x / self.median) / self.spread
        constant = math.log(self.spread * math.sqrt(2.0 * math.pi))
        return np.asarray(-0.5 * offset * offset - np.log(x) - constant)


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
        `pilotid.posterior.likelihood`.
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


BLOCK = 16  # parameter sets evaluated at once: about what the processor's cache holds

#: Standard deviations, on the inner scale, beyond which nobody looks for a parameter: they
#: keep the first guess of the covariance finite where the likelihood knows nothing.
BROAD_LOG, BROAD_LINEAR = 2.0, 0.5


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
        with np.errstate(over="ignore"):
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
            result[inside] = self.log_likelihood(sets) + prior + slope
        return np.where(np.isfinite(result), result, -np.inf)

    def log_likelihood(self, values: FloatArray) -> FloatArray:
        """Up to a constant, shape (sets,).

        Parameters
        ----------
        values
            Parameter sets inside the bounds, shape (sets, parameters).
        """
        terms, freedom, further = self._terms, self.joint.residuals, np.zeros(len(values))
        # What overflows is no number, which is no likelihood either.
        with np.errstate(all="ignore"):
            if self.integrated:
                products = self.lagged_products(values)
                taps, further = self.regressed(products)
                sums = np.einsum("si,sij,sj->s", taps, products, taps)
                freedom -= self.integrated if terms is None else 0
            else:
                taps, sums = self._taps(values), self.sums_of_squares(values)
            deviance = freedom * np.log(sums) + further
            if terms is not None:
                loop = self._prediction.loop.residual_spectra(values[:, : self.joint.pilot_count])
                deviance += 2.0 * (terms.of_loop(loop[:, 0]) + terms.of_whitener(taps))
            return np.asarray(-0.5 / self.widened * deviance)

    def sums_of_squares(self, values: FloatArray) -> FloatArray:
        """Sums of squares of the prediction errors, shape (sets,).

        Parameters
        ----------
        values
            Sets of pilot and, in any case, remnant parameters.
        """
        taps, prediction = self._taps(values), self._prediction
        sums = np.empty(len(values))
        for block in _blocks(len(values)):
            spectra = prediction.residual_spectra(values[block, : self.joint.pilot_count])
            if taps.shape[1] > 1:
                spectra *= prediction.filter_response(taps[block])[:, None, :]
            errors = prediction.without_nuisance(prediction.samples_of(spectra))
            errors = prediction.weighted_rows(errors).reshape(len(errors), -1)
            sums[block] = np.vecdot(errors, errors)
        if self._terms is not None:
            count = taps.shape[1]
            sums += np.vecdot(taps @ self._terms.outside[:count, :count], taps)
        return sums

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
        prediction, order = self._prediction, self.integrated
        result = np.empty((len(values), order + 1, order + 1))
        for block in _blocks(len(values)):
            spectra = prediction.residual_spectra(values[block, : self.joint.pilot_count])
            signal = prediction.samples_before(spectra, order)
            if prediction.nuisance_poles:
                # Fitted to the scored samples and taken out of all: what is left of them at other
                # lags is then small beside the residual, whatever the offset was.
                amplitudes = signal[..., order:] @ np.linalg.pinv(prediction.nuisance_terms).T
                time = np.arange(-order, prediction.scored) * prediction.dt
                signal = signal - amplitudes @ np.exp(np.outer(prediction.nuisance_poles, time))
            if self._terms is not None:
                lags = np.moveaxis(self._terms.lagged(signal, order), 0, 1)
            else:
                windows = np.lib.stride_tricks.sliding_window_view(signal, prediction.scored, -1)
                lags = prediction.without_nuisance(np.moveaxis(windows[..., ::-1, :], -2, 1))
            flat = lags.reshape(*lags.shape[:2], -1)
            result[block] = flat @ flat.transpose(0, 2, 1)
        if self._terms is not None:
            result += self._terms.outside[: order + 1, : order + 1]
        return result

    def regressed(self, products: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Whitening filters that suit best, and log-determinants of what was integrated out."""
        if self._terms is not None:
            return most_likely_regression(products, self._terms)
        taps = np.ones(products.shape[:2])
        taps[:, 1:] = -np.linalg.solve(products[:, 1:, 1:], products[:, 1:, :1])[..., 0]
        sign, log_determinant = np.linalg.slogdet(products[:, 1:, 1:])
        return taps, np.where(sign > 0.0, log_determinant, np.nan)

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
        covariance = np.asarray(np.linalg.inv(information + np.diag(broad)))
        return scale.enter(values)[0, : self.count], covariance[: self.count, : self.count]


def _blocks(count: int) -> Iterator[slice]:
    """Slices of `BLOCK` parameter sets that cover so many."""
    return (slice(begin, begin + BLOCK) for begin in range(0, count, BLOCK))
