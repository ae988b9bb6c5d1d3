"""Prediction errors of an estimate, whatever method it comes from, and how they are correlated.

What an estimate leaves of the control is its remnant; filtered by the inverse of the remnant's
spectrum it is the prediction error, white if pilot and remnant are modelled rightly and
uncorrelated with what the pilot saw before (Ljung, System Identification, 2nd ed., sec. 16.6).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pilotid.estimates.estimate import Estimate
from pilotid.estimates.parts import RemnantEstimate
from pilotid.recordings.recording import INPUTS, Recording
from pilotid.time_domain.band import Band, analysis_band
from pilotid.time_domain.output_error import OutputErrors
from pilotid.time_domain.prediction import predict
from pilotid.time_domain.prepare import decimation, lowpass, prepare
from pilotid.time_domain.remnant_choice import suiting
from pilotid.time_domain.whitening import prediction_error_filters
from pilotid.types import FloatArray

USUAL = 50.0  # rad/s, the analysis band where the method has no model of the remnant

NARROWEST = 20.0  # rad/s, of an analysis band: that of a pilot


@dataclass(frozen=True, eq=False)
class Whitened:
    """Prediction errors in an analysis band.

    Attributes
    ----------
    dt
        Sampling interval in the band [s].
    errors
        Prediction errors in the unit of the control, shape (runs, samples).
    inputs
        What the model's channels act on, by the signal's name, low-passed to the band and
        without its mean; each of shape (runs, samples).
    noise
        Name of the model of the remnant that whitened them.
    own
        Whether that is the estimate's own model of the remnant; else it was chosen here.
    """

    dt: float
    errors: FloatArray
    inputs: dict[str, FloatArray]
    noise: str
    own: bool


def prediction_errors(recording: Recording, estimate: Estimate) -> Whitened:
    """The prediction errors of an estimate.

    They are whitened by the estimate's model of the remnant, from its density; without one, by
    the model that suits best what the estimate leaves, see `suiting`.

    Parameters
    ----------
    recording
        What was fitted.
    estimate
        An estimate with values.
    """
    remnant = estimate.remnant
    band = analysis_band(recording.dt, USUAL) if remnant is None else _band(recording, remnant)
    rate = None if band.factor == 1 else math.pi / band.dt
    prediction = predict(recording, estimate.model, rate)
    residual = OutputErrors(prediction).residual(estimate.values)
    if remnant is not None:
        density = np.interp(band.omega, remnant.omega, remnant.density)
        name, taps = remnant.model, prediction_error_filters((density @ band.cosines)[None])[0]
    else:
        guess = suiting(residual, band)
        name, taps = guess.model.name, guess.whitener(band)
    errors = prediction.without_nuisance(prediction.residual(estimate.values, taps))
    prepared = prepare(recording, estimate.model, rate)
    scored = np.round(prepared.time[prepared.first :] / recording.dt).astype(int) + recording.run_in
    inputs = {}
    for key in dict.fromkeys(channel.input for channel in estimate.model.channels):
        own = _low_passed(recording.input(key), band)[:, scored]
        inputs[INPUTS[key]] = own - own.mean(axis=1, keepdims=True)
    return Whitened(band.dt, errors, inputs, name, remnant is not None)


def _band(recording: Recording, remnant: RemnantEstimate) -> Band:
    """The analysis band up to the last frequency at which a remnant's density is known."""
    factor = round(float(Band(recording.dt, 1).omega[-1] / remnant.omega[-1]))
    return Band(recording.dt, min(max(1, factor), decimation(recording.dt, NARROWEST)))


def _low_passed(signal: FloatArray, band: Band) -> FloatArray:
    """A signal (runs, samples) through the filter that keeps the band."""
    return np.array([np.convolve(run, lowpass(band.factor), "same") for run in signal])


def correlations(errors: FloatArray, signal: FloatArray, lags: range) -> FloatArray:
    """Correlation coefficients of errors with a signal some samples before, all runs together.

    Parameters
    ----------
    errors, signal
        Shape (runs, samples), both without a mean.
    lags
        Whole numbers of samples; negative ones for a signal after the error.

    Returns
    -------
    FloatArray
        Shape (lags,).
    """
    samples = errors.shape[1]
    scale = math.sqrt(float(np.sum(errors**2)) * float(np.sum(signal**2)))
    found = []
    for lag in lags:
        late, early = (errors, signal) if lag >= 0 else (signal, errors)
        gap = min(abs(lag), samples)
        found.append(float(np.sum(late[:, gap:] * early[:, : samples - gap])))
    return np.array(found) / scale
