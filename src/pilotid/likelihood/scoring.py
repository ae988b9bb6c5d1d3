"""What an estimate says of recordings, those it was not fitted to as well."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from pandas import DataFrame

from pilotid.estimate.estimate import Estimate
from pilotid.likelihood.estimates import simulated_vaf
from pilotid.likelihood.prediction import Prediction, predict
from pilotid.likelihood.prepare import analysis_band, prepare
from pilotid.likelihood.remnant_models import best_noise_model, filter_of
from pilotid.recording.recording import Recording
from pilotid.support.types import FloatArray, InputError

BAND = 50.0  # of a remnant that the estimate does not know [rad/s], that of `mle`


class Score(NamedTuple):
    """How well an estimate predicts a recording.

    Attributes
    ----------
    vaf
        Variance accounted for by the response to the recorded inputs [%].
    log_score
        Log-likelihood of the control under pilot and remnant, of all runs; NaN if the remnant is
        not known.
    """

    vaf: float
    log_score: float


class _Predicted(NamedTuple):
    """A recording prepared in the remnant's band, a whitening filter, and the errors' variance."""

    prediction: Prediction
    rate: float | None
    taps: FloatArray
    variance: float


def simulated(estimate: Estimate, recording: Recording) -> DataFrame:
    """See `Estimate.simulate`."""
    _require_values(estimate)
    prediction = predict(recording, estimate.model).with_decays(estimate.values)
    errors = prediction.errors(estimate.values)
    return _frame(recording, estimate, None, prediction.control, "simulated", errors)


def predicted(estimate: Estimate, recording: Recording, fitted_to: Recording | None) -> DataFrame:
    """See `Estimate.predict`."""
    found = _known_remnant(estimate, recording, fitted_to)
    if found is None:
        raise InputError(
            f"the estimate by {estimate.method} has no model of the remnant; give the recording "
            "that it was fitted to as well, as in predict(recording, fitted_to)"
        )
    errors = found.prediction.errors(estimate.values, found.taps)
    control = found.prediction.control
    return _frame(recording, estimate, found.rate, control, "predicted", errors).assign(
        std=math.sqrt(found.variance)
    )


def scored(estimate: Estimate, recording: Recording, fitted_to: Recording | None) -> Score:
    """See `Estimate.score`."""
    _require_values(estimate)
    found, log_score = _known_remnant(estimate, recording, fitted_to), math.nan
    if found is not None:
        errors, variance = found.prediction.errors(estimate.values, found.taps), found.variance
        squares = float(np.sum(errors**2)) / variance
        log_score = -0.5 * (errors.size * math.log(2.0 * math.pi * variance) + squares)
    return Score(simulated_vaf(recording, estimate.model, estimate.values), log_score)


def _require_values(estimate: Estimate) -> None:
    if not np.isfinite(estimate.values).all():
        raise InputError(f"the estimate by {estimate.method} has no values: {estimate.sentence}")


def _known_remnant(
    estimate: Estimate, recording: Recording, fitted_to: Recording | None
) -> _Predicted | None:
    """The remnant that the estimate leaves of what it was fitted to, or says itself; None of none.

    Offsets alone are fitted to a run that is predicted.
    """
    _require_values(estimate)
    model, values, remnant = estimate.model, estimate.values, estimate.remnant

    def prepared(of: Recording, rate: float | None) -> Prediction:
        return replace(predict(of, model, rate), nuisance_poles=(0.0,))

    if fitted_to is not None:
        band = analysis_band(fitted_to.dt, BAND)
        known = prepared(fitted_to, BAND)
        taps = best_noise_model(known.errors(values), band).whitener(band)
        variance = float(np.mean(known.errors(values, taps) ** 2))
        return _Predicted(prepared(recording, BAND), BAND, taps, variance)
    if remnant is None:
        return None
    band, taps, variance = filter_of(remnant, recording.dt)
    return _Predicted(prepared(recording, band.limit), band.limit, taps, variance)


def _frame(
    recording: Recording,
    estimate: Estimate,
    rate: float | None,
    control: FloatArray,
    name: str,
    errors: FloatArray,
) -> DataFrame:
    """A row for each run and scored sample."""
    time = prepare(recording, estimate.model, rate).scored_time
    runs = np.repeat(np.arange(1, len(control) + 1), time.size)
    columns = {"run": runs, "time": np.tile(time, len(control)), "control": control.ravel()}
    return DataFrame({**columns, name: (control - errors).ravel()})
