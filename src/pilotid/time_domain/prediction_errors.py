"""Pilot and remnant estimated together: the prediction-error method.

The residual u - u_hat is the remnant.  Whitened by a filter that follows from a model
of the remnant's spectrum it is the prediction error, and the sum of its squares is the
likelihood of pilot and remnant parameters together (Ljung, System Identification, 2nd
ed., ch. 7).  In a closed loop whose delay keeps the remnant from reaching the inputs at
once this is consistent, and efficient, without any knowledge of the loop.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from pilotid.solve.least_squares import Problem
from pilotid.solve.smoothing import Penalty
from pilotid.time_domain.band import Band
from pilotid.time_domain.prediction import Prediction
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
        """Number of prediction errors, see `Prediction.residuals`."""
        return self.prediction.residuals

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
        """Inner products of `rows`, see `Problem.products`."""
        if self.block > 1:
            return self.prediction.products_of(self._samples(values))
        return super().products(values)

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
        return rows
