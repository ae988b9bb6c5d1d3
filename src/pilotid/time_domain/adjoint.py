"""Sums of squares of long recordings, with exact slopes and a Hessian of the reduced prediction.

A step of a search needs the sum of squares, its slopes and a Hessian, and where it ends depends
on the first two alone.  The slopes take no transform of each row of the Jacobian: they are the
products of all rows with one signal, the prediction error, and that is transformed once
(the adjoint; Giles & Pierce, Flow, Turbulence and Combustion 65, 2000).  The Hessian comes from
the reduced prediction, whose few frequencies stand for all bins and runs.
"""

from __future__ import annotations

from functools import cached_property, reduce

import numpy as np

from pilotid.time_domain.prediction import Prediction
from pilotid.time_domain.prediction_errors import PredictionErrors
from pilotid.time_domain.reduced import MANY, Reduced, reduced
from pilotid.types import ComplexArray, FloatArray

#: Bins of all runs but one from which on the reduced prediction and the adjoint take less time.
LARGE = 8000


def is_large(prediction: Prediction) -> bool:
    """Whether a search is faster by the adjoint."""
    return (prediction.runs - 1) * prediction.s.size >= LARGE


def for_search(joint: PredictionErrors, coarse: Prediction | None = None) -> PredictionErrors:
    """The problem for a search: as it is, or by its adjoint if it is large.

    Parameters
    ----------
    joint
        The problem.
    coarse
        Its prediction, reduced, if that is there already.
    """
    if not is_large(joint.prediction) or joint is not joint.exact:
        return joint
    coarse = reduced(joint.prediction) if coarse is None else coarse
    return AdjointErrors(joint, coarse) if isinstance(coarse, Reduced) else joint


class AdjointErrors(PredictionErrors):
    """Prediction errors for a search: their Gram matrices have the exact last row and column.

    Parameters
    ----------
    exact
        The prediction errors.
    coarse
        Their prediction, reduced.
    """

    def __init__(self, exact: PredictionErrors, coarse: Reduced) -> None:
        super().__init__(exact.prediction, exact.noise, exact.band)
        self._exact = exact
        self.coarse = PredictionErrors(coarse, exact.noise, exact.band)
        self.block = MANY

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
        found = model.evaluated(prediction.s, pilot, prediction.delayed)
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
