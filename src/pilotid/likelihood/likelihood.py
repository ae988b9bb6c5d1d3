"""The likelihood of pilot and remnant, as sums of squares with their Jacobian.

The residual u - u_hat is the remnant.  Whitened by a filter that follows from a model
of the remnant's spectrum it is the prediction error, and the sum of its squares is the
likelihood of pilot and remnant parameters together (Ljung, System Identification, 2nd
ed., ch. 7).  In a closed loop whose delay keeps the remnant from reaching the inputs at
once this is consistent, and efficient, without any knowledge of the loop.

A remnant without parameters leaves the pilot's alone: `WHITE` is output error.
"""

from __future__ import annotations

import math
from functools import cached_property, reduce

import numpy as np

from pilotid.likelihood.prediction import Prediction
from pilotid.likelihood.remnant_models import WHITE, NoiseModel, are_invertible, bounds_of
from pilotid.solve.least_squares import Problem
from pilotid.support.types import ComplexArray, FloatArray


class Likelihood(Problem):
    """Prediction errors by pilot and remnant parameters, in this order.

    It has `Bounds` and is a `Problem`, so that `pilotid.solve.least_squares.minimise` searches it.

    Parameters
    ----------
    prediction
        The prepared prediction.
    noise
        Model of the remnant's spectrum.
    adjoint
        Whether Gram matrices have the exact last row and column alone, by the adjoint, and all
        else from binned spectra: for searches, see `Prediction.is_large`.
    invertible
        Whether autoregressions that are not invertible have no likelihood, for searches that begin
        far from an optimum, see `are_invertible`.
    """

    def __init__(
        self,
        prediction: Prediction,
        noise: NoiseModel = WHITE,
        *,
        adjoint: bool = False,
        invertible: bool = False,
    ) -> None:
        self.prediction, self.noise, self.adjoint = prediction, noise, adjoint
        self.invertible = invertible
        self.band, terms = prediction.window.band, prediction.band_terms
        self.band_terms = terms
        free = prediction.window.scored - len(prediction.nuisance_poles)
        directly = prediction.counted or prediction.runs * free
        #: Number of prediction errors, less the nuisance terms of each run; in a band of its bins.
        self.residuals = directly if terms is None else terms.residuals
        # What a cache holds, of few frequencies more; beyond any cache one at a time spares memory.
        at_once = min(8, max(1, (1 << 15) // prediction.control_spectrum.size))
        self.block = 12 if adjoint or prediction.weights is not None else at_once
        model = prediction.model
        self.pilot_count = len(model.parameters)
        bounds = bounds_of(noise)
        self.lower, self.upper = np.hstack([[model.lower, model.upper], bounds])
        self.positive = np.concatenate([model.positive, bounds[0] > 0.0])
        self._latest: tuple[FloatArray, tuple[FloatArray, FloatArray]] | None = None

    @cached_property
    def coarse(self) -> Likelihood:
        """The same of binned spectra."""
        return Likelihood(self.prediction.binned, self.noise)

    def taps(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Whitening filters of parameter sets, and their slopes, see `LowPass.taps`."""
        # Rows, what is outside and the log-determinant ask for those of one array in turn.
        if self._latest is None or self._latest[0] is not values:
            self._latest = values, self.noise.taps(values[:, self.pilot_count :], self.band)
        return self._latest[1]

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
        prediction = self.prediction
        taps, slopes = self.taps(values)
        spectra = prediction.row_spectra(values[:, : self.pilot_count], between=slopes.shape[1])
        if taps.shape[-1] > 1:
            residual = spectra[:, -1:]
            filters = prediction.filter_response(np.concatenate([slopes, taps[:, None]], axis=1))
            np.multiply(filters[:, :-1, None], -residual, out=spectra[:, self.pilot_count : -1])
            spectra[:, : self.pilot_count] *= filters[:, -1:, None]
            residual *= filters[:, -1:, None]
        return prediction.without_nuisance(prediction.samples_of(spectra))

    def products(self, values: FloatArray) -> FloatArray:
        """Inner products of `rows`, see `Problem.products`; in a band those of its likelihood."""
        grams = (self.coarse if self.adjoint else self).squares(values)
        if self.adjoint:
            lasts = np.array([self.last(each) for each in values])
            grams[:, -1] = grams[:, :, -1] = lasts + self.outside(values)[:, -1]
        if self.band_terms is not None:
            self._add_log_determinant(grams, values)
        if self.invertible:
            grams[~are_invertible(self.taps(values)[0])] = np.nan
        return grams

    def squares(self, values: FloatArray) -> FloatArray:
        """Inner products of `rows`, in a band weighted and with those outside, of its squares."""
        rows = self.prediction.weighted_rows(self.rows(values))
        return np.asarray(rows @ rows.transpose(0, 2, 1)) + self.outside(values)

    def outside(self, values: FloatArray) -> FloatArray:
        """What bins that do not count add to the Gram matrix, with a small weight.

        The shape is (sets, parameters + 1, parameters + 1), as that of `products`.
        """
        size = values.shape[1] + 1
        grams = np.zeros((len(values), size, size))
        if self.band_terms is not None:
            taps, slopes = self.taps(values)
            rows = np.concatenate([-slopes, taps[:, None]], axis=1)
            outside = self.band_terms.outside[: rows.shape[-1], : rows.shape[-1]]
            grams[:, -rows.shape[1] :, -rows.shape[1] :] = rows @ outside @ rows.transpose(0, 2, 1)
        return grams

    def _determined(self, values: FloatArray) -> tuple[ComplexArray, FloatArray, FloatArray]:
        """What `BandTerms.log_determinant` needs of parameter sets."""
        loop = self.prediction.loop.row_spectra(values[:, : self.pilot_count])[:, :, 0]
        return loop, *self.taps(values)

    def _add_log_determinant(self, grams: FloatArray, values: FloatArray) -> None:
        """Make inner products those whose last one, Q, has the likelihood of the band by n log Q.

        With squares Q0, n residuals and the log-determinant D that is Q = Q0 exp(2 D / n): what
        minimises sums of squares, and compares them by n log Q, needs to know nothing of D.

        Parameters
        ----------
        grams
            Weighted inner products of Jacobian and errors, those outside included, shape
            (sets, parameters + 1, parameters + 1).
        values
            Parameter sets, shape (sets, parameters).
        """
        assert self.band_terms is not None
        loop, taps, filter_slopes = self._determined(values)
        term, slope, information = self.band_terms.log_determinant(loop, taps, filter_slopes)
        size = float(self.residuals)
        variance = grams[:, -1, -1] / size
        information -= (2.0 / size) * slope[:, :, None] * slope[:, None, :]
        information *= variance[:, None, None]
        # Far from the optimum it may take more than the squares have: then it is left out.
        diagonal = np.diagonal(grams, axis1=1, axis2=2)[:, :-1]
        unsound = (np.diagonal(information, axis1=1, axis2=2) < (0.02 - 1.0) * diagonal).any(axis=1)
        information[unsound] = 0.0
        grams[:, :-1, :-1] += information
        slope *= variance[:, None]
        grams[:, -1, :-1] -= slope
        grams[:, :-1, -1] -= slope
        grams *= np.exp(2.0 * term / size)[:, None, None]
        grams[~self.band_terms.are_stable(loop[:, -1])] *= 1e3  # beyond all others

    def log_likelihood(self, values: FloatArray, variance: float | None = None) -> float:
        """Log-likelihood at one parameter set, shape (parameters,).

        `variance` is that of the prediction errors; None for the most likely one.
        """
        count = self.residuals
        squares = float(self.squares(values[None])[0, -1, -1])
        if variance is None:
            variance = squares / count
        scaled = 2.0 * math.pi * variance * self.scaling(values)
        return -0.5 * (count * math.log(scaled) + squares / variance)

    def scaling(self, values: FloatArray) -> float:
        """The factor of the likelihood on squares of prediction errors; 1 without a band.

        It has what the likelihood of the band has beside squares, at one set, (parameters,).
        """
        if self.band_terms is None:
            return 1.0
        term, _, _ = self.band_terms.log_determinant(*self._determined(values[None]))
        return math.exp(2.0 * float(term[0]) / self.residuals)

    def last(self, values: FloatArray) -> FloatArray:
        """Inner products of the prediction error with all rows, its own last, by the adjoint.

        Parameters
        ----------
        values
            Parameters of pilot and remnant, shape (parameters,).

        Returns
        -------
        FloatArray
            Shape (parameters + 1,).
        """
        prediction, window = self.prediction, self.prediction.window
        length, first = window.length, window.first
        evaluated = prediction.model.evaluated(prediction.s, values[None, : self.pilot_count])
        parts = prediction.parts(prediction.model.responses_of(evaluated))
        residual = prediction.control_spectrum - reduce(np.add, parts)[0]
        taps, slopes = self.taps(values[None])
        whitener = prediction.filter_response(taps[0])
        errors = plain = prediction.without_nuisance(prediction.samples_of(whitener * residual))
        if self.band_terms is not None:
            errors = prediction.without_nuisance(self.band_terms.filtered(errors))
        padded = np.zeros((prediction.runs, length))
        padded[:, first : first + window.scored] = errors
        # Bins stand for two, but for the first and the one at half the sampling rate.
        counted = np.full(length // 2 + 1, 2.0 / length)
        counted[[0] if length % 2 else [0, -1]] = 1.0 / length
        # What times a transform, summed over bins, is the product of its samples with the errors.
        adjoint = np.fft.rfft(padded).conj() * counted
        by_pilot, filtered = np.zeros(self.pilot_count), whitener * adjoint
        along = [np.sum(part[0] * filtered, axis=0) for part in parts]
        for index, slope, total in prediction.slopes(evaluated, along):
            by_pilot[index] += np.sum(slope * total).real
        by_lag = prediction.shifts(taps.shape[-1]) @ np.sum(residual * adjoint, axis=0)
        by_remnant = -slopes[0] @ by_lag.real
        return np.concatenate([by_pilot, by_remnant, [np.vdot(plain, errors)]])
