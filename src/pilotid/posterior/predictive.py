"""Posterior predictive band of the control."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pilotid.estimates.draws import SHARE, Draws
from pilotid.posterior.likelihood import Likelihood
from pilotid.types import FloatArray

COUNT = 400  # simulated recordings
SETTLE = 400  # samples in which the simulated remnant forgets where it started


@dataclass(frozen=True, eq=False)
class PredictiveBand:
    """95 % bands of the control of every run, in the analysis band.

    Attributes
    ----------
    time
        From the first scored sample [s], shape (samples,).
    control
        What was recorded, shape (runs, samples).
    model
        Band of the model's answer to the recorded inputs, which is as wide as the parameters
        are unknown, shape (2, runs, samples).
    with_remnant
        The same with a remnant of the spectrum and power that each draw has, in which 95 %
        of the recorded samples should lie, shape (2, runs, samples).
    """

    time: FloatArray
    control: FloatArray
    model: FloatArray
    with_remnant: FloatArray

    @property
    def inside(self) -> float:
        """Share of the recorded samples inside the band with remnant."""
        low, high = self.with_remnant
        return float(np.mean((low <= self.control) & (self.control <= high)))


def predictive_band(
    draws: Draws, likelihood: Likelihood, rng: np.random.Generator
) -> PredictiveBand:
    """The band from equally weighted draws.

    Parameters
    ----------
    draws, likelihood
        The posterior's draws, and the likelihood that they come from.
    rng
        Draws the remnants.
    """
    from scipy.signal import lfilter

    joint = likelihood.joint
    prediction, pilot = joint.prediction, joint.pilot
    values = draws.equally_weighted(COUNT)
    if likelihood.integrated:
        shapes = likelihood.coefficients(values)
        values = np.concatenate([values, shapes], axis=1)
    taps = joint.noise.filters(values[:, pilot:], joint.band)
    squares = likelihood.sums_of_squares(values)
    deviations = np.sqrt(squares / rng.chisquare(joint.residuals, len(squares)))
    control = prediction.control
    shape = (len(values), *control.shape)
    answers, remnants = np.empty(shape), np.empty(shape)
    for i, own in enumerate(values):
        spectra = likelihood.residuals.spectra(own[None, :pilot])
        residual = prediction.without_nuisance(prediction.samples_of(spectra))[0]
        answers[i] = control - residual
        noise = deviations[i] * rng.standard_normal((len(control), SETTLE + control.shape[1]))
        remnants[i] = lfilter([1.0], taps[i], noise, axis=1)[:, SETTLE:]
    tails = (0.5 * (1.0 - SHARE), 0.5 * (1.0 + SHARE))
    return PredictiveBand(
        np.arange(prediction.scored, dtype=float) * prediction.dt,
        control,
        np.quantile(answers, tails, axis=0),
        np.quantile(answers + remnants, tails, axis=0),
    )
