"""Pilot and remnant estimated together: the prediction-error method.

The residual u - u_hat is the remnant.  Whitened by a filter that follows from a model
of the remnant's spectrum it is the prediction error, and the sum of its squares is the
likelihood of pilot and remnant parameters together (Ljung, System Identification, 2nd
ed., ch. 7).  In a closed loop whose delay keeps the remnant from reaching the inputs at
once this is consistent, and efficient, without any knowledge of the loop.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property

import numpy as np

from pilotid.solve.least_squares import Problem
from pilotid.solve.smoothing import Penalty
from pilotid.time_domain.band import Band
from pilotid.time_domain.prediction import Prediction
from pilotid.time_domain.reduced import Reduced
from pilotid.time_domain.remnant_models import NoiseModel
from pilotid.types import BoolArray, ComplexArray, FloatArray


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
        self.block, self.penalty = prediction.block, prediction.penalty
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
        """Number of prediction errors, see `Prediction.residuals`; in a band that of its bins."""
        terms = self.prediction.band_terms
        return self.prediction.residuals if terms is None else terms.residuals

    @property
    def exact(self) -> PredictionErrors:
        """The problem whose Gram matrices are exact: this one."""
        return self

    def penalised(self, penalty: Penalty | None) -> PredictionErrors:
        """The same with a penalty, or without."""
        return PredictionErrors(replace(self.prediction, penalty=penalty), self.noise, self.band)

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
        if self.block > 1:
            return self.prediction.without_nuisance(self._samples(values))
        return self.prediction.errors_of(self._spectra(values))

    def products(self, values: FloatArray) -> FloatArray:
        """Inner products of `rows`, see `Problem.products`; in a band those of its likelihood."""
        if self.prediction.band_terms is not None:
            return self.closed(self.in_band(values), values)
        if self.block > 1:
            return self.prediction.products_of(self._samples(values))
        return super().products(values)

    def in_band(self, values: FloatArray) -> FloatArray:
        """Weighted inner products of `rows` in the band, and of the remnant's model outside it."""
        prediction = self.prediction
        regressed = self.noise.regressive and prediction.block > 1 and not any(prediction.terms)
        if regressed and not isinstance(prediction, Reduced):
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

    def _samples(self, values: FloatArray) -> FloatArray:
        """`rows` before nuisance terms are projected out."""
        prediction = self.prediction
        if not self.noise.regressive:
            return prediction.samples_of(self._spectra(values))
        # The prediction error's derivatives by coefficients are the residual's own past, which
        # takes one transform for all of them.
        pilot, remnant = values[:, : self.pilot], values[:, self.pilot :]
        spectra = prediction.row_spectra(pilot)
        past = prediction.delayed_samples(spectra[:, -1], remnant.shape[1])
        taps = self.noise.filters(remnant, self.band)
        spectra *= prediction.filter_response(taps)[:, None, None]
        own = prediction.samples_of(spectra)
        rows = np.empty((len(own), values.shape[1] + 1, *own.shape[2:]))
        rows[:, : self.pilot], rows[:, -1] = own[:, :-1], own[:, -1]
        np.negative(past, out=rows[:, self.pilot : -1])
        return np.asarray(rows)
