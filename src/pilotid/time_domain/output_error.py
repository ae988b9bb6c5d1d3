"""Residual and Jacobian of a prediction: the problem of output error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pilotid.chance import SELDOM, chi_squared_limit
from pilotid.pilot.model import PilotModel
from pilotid.recordings.recording import Recording
from pilotid.solve.least_squares import Problem
from pilotid.solve.smoothing import Penalty
from pilotid.time_domain.prediction import Prediction, predict
from pilotid.types import FloatArray


class OutputErrors(Problem):
    """Gram matrices of residual and Jacobian, nuisance terms projected out.

    Parameters
    ----------
    prediction
        The prepared prediction.
    taps
        Moving-average filter that whitens the residual, shape (taps,); None for a
        residual that is white already.
    """

    def __init__(self, prediction: Prediction, taps: FloatArray | None = None) -> None:
        self.prediction = prediction
        self.taps = taps
        self.block, self.penalty = prediction.block, prediction.penalty

    @property
    def residuals(self) -> int:
        """Number of residuals, see `Prediction.residuals`."""
        return self.prediction.residuals

    def penalised(self, penalty: Penalty | None) -> OutputErrors:
        """The same with a penalty, or without."""
        return OutputErrors(replace(self.prediction, penalty=penalty), self.taps)

    def rows(self, values: FloatArray) -> FloatArray:
        """Whitened Jacobian and residual, shape (sets, parameters + 1, runs, scored).

        Parameters
        ----------
        values
            Parameter sets, shape (sets, parameters).
        """
        return self.prediction.errors_of(self.prediction.row_spectra(values, self.taps))

    def products(self, values: FloatArray) -> FloatArray:
        """Inner products of `rows`, see `Problem.products`."""
        if self.block == 1:
            return super().products(values)
        prediction = self.prediction
        return prediction.products_of(
            prediction.samples_of(prediction.row_spectra(values, self.taps))
        )

    def residual(self, values: FloatArray) -> FloatArray:
        """Residual of one parameter set before whitening, shape (runs, scored).

        Parameters
        ----------
        values
            Parameters in model order, shape (parameters,).
        """
        return self.prediction.without_nuisance(self.prediction.residual(values))

    def noticeable_terms(self, values: FloatArray) -> tuple[float, ...]:
        """The nuisance terms that the residual of one parameter set shows.

        Fitting a term that is not there costs more than its degree of freedom: in a closed
        loop it biases the low-frequency parameters, since what is subtracted depends on
        the future of the recording (the same effect biases autoregressive coefficients
        when a mean is removed; Kendall 1954).  A term stays if its squared t-values, all
        runs together, exceed what chance gives once in 14,000.
        """
        poles = self.prediction.terms
        if not poles:
            return ()
        terms = self.prediction.nuisance_terms
        residual = self.prediction.residual(values, self.taps)
        weights = np.linalg.solve(terms.T @ terms, terms.T)
        amplitudes = residual @ weights.T
        left = residual - amplitudes @ terms.T
        variance = np.sum(left**2) / (left.size - amplitudes.size)
        squares = amplitudes**2 / np.sum(weights**2, axis=1)
        runs = self.prediction.runs
        limit = chi_squared_limit(runs, SELDOM)
        noticeable = np.sum(squares, axis=0) > limit * variance
        return tuple(p for p, n in zip(poles, noticeable, strict=True) if n)


def simulated_vaf(
    recording: Recording,
    model: PilotModel,
    values: FloatArray,
    prediction: Prediction | None = None,
) -> float:
    """Variance accounted for, max(0, 1 - var(u - u_hat)/var(u)) in %.

    u_hat is the simulated response at the full sampling rate to the recorded inputs,
    with offset and slow decays fitted; all runs count together.

    Parameters
    ----------
    recording, model, values
        What is simulated.
    prediction
        The full-rate prediction, where the caller has it already.
    """
    prediction = prediction or predict(recording, model)
    left = float(np.mean(np.var(OutputErrors(prediction).residual(values), axis=1)))
    spread = float(np.mean(np.var(prediction.control, axis=1)))
    return max(0.0, 100.0 * (1.0 - left / spread))
