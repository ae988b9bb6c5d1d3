"""Instruments: what the forcing functions alone make of a prediction's Jacobian.

The remnant, and what a recorder adds to e and x, are in the model's inputs too; the forcing
functions know of neither.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pilotid.checks.element_fit import closing_element
from pilotid.estimate.parts import Specification, score_test
from pilotid.likelihood.likelihood import Likelihood
from pilotid.likelihood.optimum import Optimum
from pilotid.likelihood.prediction import predict
from pilotid.likelihood.prepare import fast_length
from pilotid.likelihood.remnant_models import Whitener
from pilotid.model.element import ControlledElement
from pilotid.model.loops import is_stable, pilot_on
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.solve.least_squares import Problem
from pilotid.support.types import FloatArray

#: Seconds of zeros behind a recording, in which the loop comes to rest.
REST = 30.0
#: Bins over which the power of the prediction error is averaged.
SMOOTHED = 61


def references(
    recording: Recording, model: PilotModel, values: FloatArray, element: ControlledElement
) -> Recording:
    """A recording with the e and x that its forcing functions alone make in the loop."""
    target, disturbance = forcing_functions(recording)
    samples = target.shape[1]
    length = fast_length(samples + round(REST / recording.dt))
    omega = np.asarray(2.0 * np.pi * np.fft.rfftfreq(length, recording.dt), dtype=float)
    omega[0] = 1e-3 * omega[1]  # an integrator has no response at rest
    on_error, on_output = pilot_on(model, omega, values)
    plant = element.response(omega)
    closed = 1.0 + plant * (on_error + on_output)
    driven = on_error * np.fft.rfft(target, length) + np.fft.rfft(disturbance, length)
    output = np.fft.irfft(plant / closed * driven, length)[:, :samples]
    return replace(recording, e=target - output, x=output, ft=target)


def forcing_functions(recording: Recording) -> tuple[FloatArray, FloatArray]:
    """Target and disturbance, shape (runs, samples); zeros for one that there is not."""
    none = np.zeros_like(recording.e)
    target = recording.input("ft")
    if recording.ft is None and np.std(target) <= 1e-6 * np.std(recording.e):
        target = none
    return target, none if recording.fd is None else recording.fd


class Moments(Problem):
    """Products of instruments and prediction errors, standardised: their root is the estimate.

    Parameters
    ----------
    optimum
        The optimum of the likelihood: band, weights and whitening filter.
    reference
        The recording whose Jacobian the instruments are.
    values
        Parameters at which the prediction errors tell their power, shape (parameters,).
    """

    def __init__(self, optimum: Optimum, reference: Recording, values: FloatArray) -> None:
        self._prediction = prediction = optimum.joint.prediction
        self._taps, whitener = optimum.whitener, Whitener(optimum.whitener)
        self._whitened = Likelihood(replace(prediction, nuisance_poles=()), whitener)
        other = predict(reference, prediction.model, prediction.band.limit)
        other = replace(other, nuisance_poles=prediction.nuisance_poles)
        self._instruments = self._weighed(Likelihood(other, whitener).rows(optimum.pilot[None]))[
            0, :-1
        ]
        self.weigh_at(values)

    def weigh_at(self, values: FloatArray) -> None:
        """Standardise the moments by the power that the prediction errors of these values have."""
        errors = self._prediction.errors(values, self._taps)
        parts = self._weighed(errors[None, None]).reshape(-1, 2)
        power = np.pad(np.mean(parts**2, axis=1), SMOOTHED // 2, mode="reflect")
        smooth = np.convolve(power, np.ones(SMOOTHED) / SMOOTHED, "valid")
        scatter = (self._instruments * np.repeat(smooth, 2)) @ self._instruments.T
        self._standard = np.linalg.inv(np.linalg.cholesky(scatter))

    def _weighed(self, rows: FloatArray) -> FloatArray:
        """Rows (sets, n, runs, samples) as numbers whose products are weighted, (sets, n, m)."""
        return self._prediction.weighted_rows(rows).reshape(*rows.shape[:2], -1)

    @property
    def residuals(self) -> int:
        """Number of moments."""
        return len(self._instruments)

    def rows(self, values: FloatArray) -> FloatArray:
        """Jacobian and below it the moments, shape (sets, parameters + 1, parameters)."""
        products = self._weighed(self._whitened.rows(values)) @ self._instruments.T
        return np.asarray(products @ self._standard.T)


def specification_by_instruments(
    optimum: Optimum, recording: Recording, values: FloatArray, covariance: FloatArray, against: str
) -> Specification | None:
    """An efficient estimate tested against the moments of instruments, where no lines can test it.

    Durbin and Wu's test as a score: at an efficient estimate with covariance V the standardised
    moments have mean zero and covariance I - G V G', with G their Jacobian (Hausman, Econometrica
    46(6), 1978).  None without forcing functions, a controlled element or weights in a band.

    Parameters
    ----------
    optimum, recording
        The optimum of the likelihood, and what was fitted.
    values, covariance
        The estimate, shapes (parameters,) and (parameters, parameters).
    against
        The method whose moments they are.
    """
    prediction = optimum.joint.prediction
    model = prediction.model
    driven = any(np.ptp(s) > 0.0 for s in forcing_functions(recording))
    if model.changes or prediction.weighting is None or not driven:
        return None
    element, _ = closing_element(recording)
    if element is None or not is_stable(model, values, element):
        return None
    try:
        moments = Moments(optimum, references(recording, model, values, element), values)
    except np.linalg.LinAlgError:  # a parameter that no forcing function excites
        return None
    rows = moments.rows(values[None])[0]
    jacobian, score = rows[:-1].T, rows[-1]
    shares, along = np.linalg.eigh(np.eye(score.size) - jacobian @ covariance @ jacobian.T)
    return score_test(along.T @ score, shares, against)
