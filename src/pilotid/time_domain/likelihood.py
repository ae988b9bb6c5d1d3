"""Pilot and remnant estimated together: the prediction-error method.

The residual u - u_hat is the remnant.  Whitened by a filter that follows from a model
of the remnant's spectrum it is the prediction error, and the sum of its squares is the
likelihood of pilot and remnant parameters together (Ljung, System Identification, 2nd
ed., ch. 7).  In a closed loop whose delay keeps the remnant from reaching the inputs at
once this is consistent, and efficient, without any knowledge of the loop.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from functools import cached_property, reduce

import numpy as np

from pilotid.solve.least_squares import Problem
from pilotid.support.types import BoolArray, ComplexArray, FloatArray
from pilotid.time_domain.band_likelihood import group_begins
from pilotid.time_domain.prediction import Prediction
from pilotid.time_domain.prepare import Band
from pilotid.time_domain.remnant_models import NoiseModel
from pilotid.time_domain.settings import SEARCH


@dataclass(frozen=True)
class BinnedPrediction(Prediction):
    """A prediction whose samples are weighted spectra at few frequencies.

    Attributes
    ----------
    counted
        Scored samples of all runs of the prediction that it stands for.
    weights
        Of the spectra at each frequency, shape (groups,).
    """

    counted: int
    weights: FloatArray

    @property
    def samples(self) -> int:
        return self.counted

    @property
    def block(self) -> int:
        return SEARCH.sets_at_once

    def samples_of(self, spectrum: ComplexArray) -> FloatArray:
        weighted = np.ascontiguousarray(spectrum * self.weights)
        return weighted.view(float)

    def weighed(self, rows: FloatArray) -> FloatArray:
        """The rows: `weights` are those of the band already."""
        return rows

    def below(self, band: float) -> BinnedPrediction:
        """The same with what lies above a frequency [rad/s] left out."""
        return self._with(self.s.imag < band)

    def _with(self, chosen: BoolArray) -> BinnedPrediction:
        return replace(
            self,
            s=self.s[chosen],
            spectra=tuple(spectrum[:, chosen] for spectrum in self.spectra),
            control_spectrum=self.control_spectrum[:, chosen],
            weights=self.weights[chosen],
        )


def binned(prediction: Prediction) -> Prediction:
    """The prediction at few frequencies; the mean and what the window makes of it are left out.

    One whose inputs vary in time has no such form, and stays as it is.
    """
    if prediction.model.changes:
        return prediction
    scored = prediction.scored
    window = np.sqrt(8.0 / 3.0) * np.sin(np.pi * (np.arange(scored) + 0.5) / scored) ** 2
    given = np.array([*prediction.spectra, prediction.control_spectrum])
    signals = np.fft.rfft(prediction.samples_of(given) * window)
    omega = np.asarray(2.0 * np.pi * np.fft.rfftfreq(scored, prediction.dt), dtype=float)
    groups = group_begins(
        omega, SEARCH.binned_share, SEARCH.max_binned_width, 2
    )  # the mean and what the window makes of it go
    sizes = np.sqrt(np.mean(np.abs(signals) ** 2, axis=(1, 2)))
    sizes[sizes == 0.0] = 1.0
    signals = signals / sizes[:, None, None]
    products = np.einsum("irk,jrk->kij", signals, signals.conj())
    summed = np.add.reduceat(products, groups, axis=0)
    size, vectors = np.linalg.eigh(summed)
    factor = vectors * np.sqrt(np.maximum(size, 0.0))[:, None, :]
    spectra = np.transpose(factor, (1, 2, 0)) * sizes[:, None, None]  # (signal, part, group)
    counts = np.diff([*groups, omega.size])
    middle = np.add.reduceat(omega, groups) / counts
    held = {field.name: getattr(prediction, field.name) for field in fields(Prediction)}
    held |= {
        "s": 1j * middle,
        "spectra": tuple(spectra[:-1]),
        "control_spectrum": spectra[-1],
        "terms": (),
    }
    # Parseval: bins stand for two, but for the one at half the sampling rate.
    weights = np.full(len(counts), np.sqrt(2.0 / scored))
    if prediction.weighting is None or prediction.band_terms is None:
        return BinnedPrediction(**held, counted=prediction.runs * scored, weights=weights)
    weights = weights * np.sqrt(prediction.weighting.weights(middle))
    counted = prediction.band_terms.residuals
    return BinnedPrediction(**held, counted=counted, weights=weights)._with(weights > 0.0)


class PredictionErrors(Problem):
    """Prediction errors by pilot and remnant parameters, in this order.

    It is a space, and has Gram matrices, for `pilotid.solve.least_squares.minimise`.

    Parameters
    ----------
    prediction
        The prepared prediction.
    noise
        Model of the remnant's spectrum.
    band
        The analysis band that the prediction was prepared in.
    """

    def __init__(self, prediction: Prediction, noise: NoiseModel, band: Band) -> None:
        self.prediction, self.noise, self.band = prediction, noise, band
        self.block = prediction.block
        self.pilot = len(prediction.model.parameters)

    @cached_property
    def lower(self) -> FloatArray:
        """Lower bounds."""
        return np.concatenate([self.prediction.model.lower, self.noise.lower])

    @cached_property
    def upper(self) -> FloatArray:
        """Upper bounds."""
        return np.concatenate([self.prediction.model.upper, self.noise.upper])

    @cached_property
    def positive(self) -> BoolArray:
        """Which parameters are searched on a logarithmic scale."""
        return np.concatenate([self.prediction.model.positive, self.noise.positive])

    @property
    def residuals(self) -> int:
        """Number of prediction errors, see `Prediction.samples`; in a band that of its bins."""
        terms = self.prediction.band_terms
        return self.prediction.samples if terms is None else terms.residuals

    @property
    def exact(self) -> PredictionErrors:
        """The problem whose Gram matrices are exact: this one."""
        return self

    def whitener(self, values: FloatArray) -> FloatArray:
        """Whitening filter at one parameter set, shape (taps,)."""
        return np.asarray(self.noise.taps(values[None, self.pilot :], self.band)[0][0])

    def rows(self, values: FloatArray) -> FloatArray:
        """Jacobian of the prediction, and below it the prediction error.

        Parameters
        ----------
        values
            Parameter sets, shape (sets, parameters).

        Returns
        -------
        Array of shape (sets, parameters + 1, runs, scored).
        """
        return self.prediction.errors_of(self._spectra(values))

    def products(self, values: FloatArray) -> FloatArray:
        """Inner products of `rows`, see `Problem.products`; in a band those of its likelihood."""
        if self.prediction.band_terms is not None:
            return self.closed(self.in_band(values), values)
        return super().products(values)

    def in_band(self, values: FloatArray) -> FloatArray:
        """Weighted inner products of `rows` in the band, and of the remnant's model outside it."""
        prediction = self.prediction
        regressed = self.noise.regressive and prediction.block > 1 and not any(prediction.terms)
        if regressed and not isinstance(prediction, BinnedPrediction):
            rows = self._regressed_in_band(values)
        else:
            rows = prediction.weighed(self.rows(values))
        flat = rows.reshape(*rows.shape[:2], -1)
        return np.asarray(flat @ flat.transpose(0, 2, 1)) + self.outside(values)

    def _regressed_in_band(self, values: FloatArray) -> FloatArray:
        """Weighted `rows` with an autoregression: the residual's past takes one transform."""
        prediction, terms = self.prediction, self.prediction.band_terms
        assert terms is not None
        coefficients = values[:, self.pilot :]
        spectra = prediction.row_spectra(values[:, : self.pilot])
        signal = prediction.samples_before(spectra[:, -1], coefficients.shape[1])
        lags = np.moveaxis(terms.lagged(signal, coefficients.shape[1]), 0, 1)
        taps = self.noise.filters(coefficients, self.band)
        pilot = spectra[:, :-1] * prediction.filter_response(taps)[:, None, None]
        rows = np.empty((len(values), values.shape[1] + 1, *lags.shape[2:]))
        rows[:, : self.pilot] = terms.weighted(prediction.samples_of(pilot))
        np.negative(lags[:, 1:], out=rows[:, self.pilot : -1])
        flat = lags.reshape(*lags.shape[:2], -1)
        rows[:, -1] = (taps[:, None] @ flat).reshape(rows[:, -1].shape)
        return np.asarray(rows)

    def outside(self, values: FloatArray) -> FloatArray:
        """Inner products of what the whitening filter and its slopes make of what does not count.

        The shape is (sets, parameters + 1, parameters + 1), as that of `products`.
        """
        terms = self.prediction.band_terms
        assert terms is not None
        taps, slopes = self.noise.taps(values[:, self.pilot :], self.band)
        rows = np.concatenate([-slopes, taps[:, None]], axis=1)
        count = rows.shape[-1]
        found = np.zeros((len(values), values.shape[1] + 1, values.shape[1] + 1))
        found[:, self.pilot :, self.pilot :] = (
            rows @ terms.outside[:count, :count] @ rows.transpose(0, 2, 1)
        )
        return found

    def _determined(self, values: FloatArray) -> tuple[ComplexArray, FloatArray, FloatArray]:
        """What `BandTerms.log_determinant` needs of parameter sets."""
        loop = self.prediction.loop.row_spectra(values[:, : self.pilot])[:, :, 0]
        return loop, *self.noise.taps(values[:, self.pilot :], self.band)

    def log_determinant(self, values: FloatArray) -> float:
        """What the likelihood of the band has beside squares, at one set, (parameters,)."""
        terms = self.prediction.band_terms
        if terms is None:
            return 0.0
        return float(terms.log_determinant(*self._determined(values[None]))[0][0])

    def closed(self, products: FloatArray, values: FloatArray) -> FloatArray:
        """Inner products with the log-determinant of the band, see `BandTerms.closed`."""
        prediction = self.prediction
        assert prediction.band_terms is not None
        return prediction.band_terms.closed(products, *self._determined(values))

    def log_likelihood(self, values: FloatArray, variance: float | None = None) -> float:
        """Log-likelihood at one parameter set, shape (parameters,).

        `variance` is that of the prediction errors; None for the most likely one.
        """
        count, sets = self.residuals, values[None]
        banded = self.prediction.band_terms is not None
        products = self.in_band(sets) if banded else self.products(sets)
        squares = float(products[0, -1, -1])
        if variance is None:
            variance = squares / count
        return -0.5 * (count * math.log(2.0 * math.pi * variance) + squares / variance) - (
            self.log_determinant(values)
        )

    def tested_rows(self, values: FloatArray) -> FloatArray:
        """`rows` at one parameter set, whose products with the errors are those of the fit.

        In a band the Jacobian by the pilot is filtered by the weights, and the errors are not.
        """
        rows, terms = self.rows(values[None])[0], self.prediction.band_terms
        if terms is not None:
            rows = np.concatenate([terms.filtered(rows[: self.pilot]), rows[self.pilot :]])
        return np.asarray(rows)

    def scaling(self, values: FloatArray) -> float:
        """The factor of `closed` on squares of prediction errors at one set; 1 without a band."""
        return math.exp(2.0 * self.log_determinant(values) / self.residuals)

    def _spectra(self, values: FloatArray) -> ComplexArray:
        """The transforms of `rows` before nuisance terms are projected out."""
        prediction = self.prediction
        pilot, remnant = values[:, : self.pilot], values[:, self.pilot :]
        taps, slopes = self.noise.taps(remnant, self.band)
        spectra = prediction.row_spectra(pilot, between=slopes.shape[1])
        residual = spectra[:, -1:]
        filters = prediction.filter_response(np.concatenate([slopes, taps[:, None]], axis=1))
        np.multiply(filters[:, :-1, None], -residual, out=spectra[:, self.pilot : -1])
        spectra[:, : self.pilot] *= filters[:, -1:, None]
        residual *= filters[:, -1:, None]
        return spectra


def is_large(prediction: Prediction) -> bool:
    """Whether a search is faster by the adjoint."""
    return (prediction.runs - 1) * prediction.s.size >= SEARCH.adjoint_bins


def for_search(joint: PredictionErrors, coarse: Prediction | None = None) -> PredictionErrors:
    """The problem for a search: as it is, or by its adjoint if it is large.

    Parameters
    ----------
    joint
        The problem.
    coarse
        Its prediction with binned spectra, if that is there already.
    """
    if not is_large(joint.prediction) or joint is not joint.exact:
        return joint
    coarse = binned(joint.prediction) if coarse is None else coarse
    return AdjointErrors(joint, coarse) if isinstance(coarse, BinnedPrediction) else joint


class AdjointErrors(PredictionErrors):
    """Prediction errors for a search: their Gram matrices have the exact last row and column.

    Parameters
    ----------
    exact
        The prediction errors.
    coarse
        Their prediction with binned spectra.
    """

    def __init__(self, exact: PredictionErrors, coarse: BinnedPrediction) -> None:
        super().__init__(exact.prediction, exact.noise, exact.band)
        self._exact = exact
        self.coarse = PredictionErrors(coarse, exact.noise, exact.band)
        self.block = SEARCH.sets_at_once

    @property
    def exact(self) -> PredictionErrors:
        """The problem whose Gram matrices are exact."""
        return self._exact

    def products(self, values: FloatArray) -> FloatArray:
        """Inner products of the rows, see `Problem.products`; of the Jacobian's approximately."""
        banded = self.prediction.band_terms is not None
        found = self.coarse.in_band(values) if banded else self.coarse.products(values)
        lasts = np.array([self.last(each) for each in values])
        if banded:
            lasts += self.outside(values)[:, -1]
        found[:, -1] = found[:, :, -1] = lasts
        return self.closed(found, values) if banded else found

    def last(self, values: FloatArray) -> FloatArray:
        """Inner products of the prediction error with all rows, its own last.

        Parameters
        ----------
        values
            Parameters of pilot and remnant, shape (parameters,).

        Returns
        -------
        FloatArray
            Shape (parameters + 1,).
        """
        prediction, model = self.prediction, self.prediction.model
        pilot, remnant = values[None, : self.pilot], values[None, self.pilot :]
        found = model.evaluated(prediction.s, pilot)
        responses = [response[0] for response in model.responses_of(found)]
        taps, slopes = (each[0] for each in self.noise.taps(remnant, self.band))
        filters = prediction.filter_response(taps)
        residual = reduce(
            np.subtract,
            map(np.multiply, responses, prediction.inputs),
            prediction.control_spectrum,
        )
        errors = prediction.without_nuisance(prediction.samples_of(filters * residual))
        plain, terms = errors, prediction.band_terms
        if terms is not None:
            errors = prediction.without_nuisance(terms.filtered(errors))
        adjoint = self._adjoint(errors)
        by_channel = [
            filters * response * (adjoint * signal).sum(axis=0)
            for response, signal in zip(responses, prediction.inputs, strict=True)
        ]
        last = np.empty(len(values) + 1)
        for (_, by), (_, indices), channels in zip(found, model.moving, model.sharing, strict=True):
            total = reduce(np.add, [by_channel[c] for c in channels])
            for index, slope in zip(indices, by, strict=True):
                last[index] = np.sum(slope * total).real
        by_lag = (prediction.shifts(slopes.shape[-1]) @ (adjoint * residual).sum(axis=0)).real
        last[self.pilot : -1] = -(slopes @ by_lag)
        last[-1] = np.vdot(plain, errors)
        return last

    def _adjoint(self, errors: FloatArray) -> ComplexArray:
        """What times a transform, summed over bins, is the product of its samples with `errors`."""
        prediction = self.prediction
        padded = np.zeros((prediction.runs, prediction.length))
        padded[:, prediction.first : prediction.first + prediction.scored] = errors
        return np.asarray(np.fft.rfft(padded).conj() * self._counted)

    @cached_property
    def _counted(self) -> FloatArray:
        """Bins stand for two, but for the first and the one at half the sampling rate."""
        length = self.prediction.length
        counted = np.full(length // 2 + 1, 2.0 / length)
        counted[0] = 1.0 / length
        if length % 2 == 0:
            counted[-1] = 1.0 / length
        return counted
