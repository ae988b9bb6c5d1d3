"""A method of one's own: least squares on smoothed spectra, the way of a first attempt."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pilotid.estimates.estimate import (
    Estimate,
    Outcome,
    failed,
    outcome_of,
    symmetric_intervals,
)
from pilotid.pilot.model import PilotModel
from pilotid.recordings.recording import Recording
from pilotid.support.types import FloatArray


@dataclass(frozen=True)
class Smoothed:
    """Fit a model to the transform of the control, bin by bin up to a frequency.

    The residual is taken for white over frequency and for the recording's own, so that it is
    biased where the remnant is coloured.

    Attributes
    ----------
    highest
        Highest frequency that is used [rad/s].
    """

    highest: float = 20.0
    name: ClassVar[str] = "smoothed"

    def objection(self, recording: Recording, model: PilotModel) -> str | None:
        """Why it cannot treat a recording: none."""
        return None

    def fit(self, recording: Recording, model: PilotModel, rng: np.random.Generator) -> Estimate:
        """Least squares from the model's own start."""
        from scipy.optimize import least_squares

        taper = np.hanning(recording.samples)

        def spectra(name: str) -> np.ndarray:
            own = recording.window(recording.input(name))
            return np.fft.rfft(taper * (own - own.mean(axis=1, keepdims=True)), axis=1)

        omega = 2.0 * np.pi * np.fft.rfftfreq(recording.samples, recording.dt)
        used = (omega > 0.0) & (omega <= self.highest)
        control = spectra("u")[:, used]
        signals = np.array([c.sign * spectra(c.on)[:, used] for c in model.channels])

        def residual(scaled: FloatArray) -> FloatArray:
            response = model.response(omega[used], scaled * start)
            left = control - np.einsum("cn,crn->rn", response, signals)
            return np.concatenate([left.real.ravel(), left.imag.ravel()])

        start = np.array(model.start)
        found = least_squares(
            residual, np.ones(start.size), bounds=(model.lower / start, model.upper / start)
        )
        if not found.success:
            return failed(self.name, model, Outcome.NOT_CONVERGED)
        values = found.x * start
        information = found.jac.T @ found.jac
        if np.linalg.cond(information) > 1e12:
            return failed(self.name, model, Outcome.SINGULAR)
        variance = float(found.fun @ found.fun) / (found.fun.size - values.size)
        covariance = variance * np.linalg.inv(information) * np.outer(start, start)
        covariance = 0.5 * (covariance + covariance.T)
        outcome, message = outcome_of(model, values, converged=True)
        return Estimate(
            self.name,
            model,
            outcome,
            values,
            covariance,
            symmetric_intervals(values, covariance),
            message=message,
        )
