"""What the prediction errors of a fit say against its assumptions, in words.

Under the model, prediction errors at the optimum are white, as large in one half of the
recording as in the other, and gains and leads are the same throughout, as any other parameter
is in both halves; the control does not drift, and where it moves it does not rest.  Each test
is at a chance of `ESTIMATE.seldom`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from pilotid.checks.plant import element_changes, is_gain
from pilotid.estimate.estimate import Estimate, is_at_bound
from pilotid.estimate.parts import Specification
from pilotid.likelihood.band_likelihood import BandTerms
from pilotid.likelihood.constancy import constancy, score_of_changes
from pilotid.likelihood.instruments import specification_by_instruments
from pilotid.likelihood.likelihood import Likelihood
from pilotid.likelihood.optimum import Optimum
from pilotid.likelihood.prediction import predict
from pilotid.likelihood.prepare import (
    analysis_band,
    lowpass,
    prepare,
)
from pilotid.likelihood.remnant_models import Whitener, best_noise_model, filter_of
from pilotid.likelihood.settings import LikelihoodSettings
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.recording.spectra import floors_of
from pilotid.spectral.equations import specification_of
from pilotid.support.limits import ESTIMATE, RECORDER
from pilotid.support.numbers import chi_squared_limit
from pilotid.support.remarks import Remark
from pilotid.support.types import FloatArray


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
    the model that suits best what the estimate leaves, see `best_noise_model`.

    Parameters
    ----------
    recording
        What was fitted.
    estimate
        An estimate with values.
    """
    remnant = estimate.remnant
    if remnant is not None:
        band, taps, _ = filter_of(remnant, recording.dt)
        name, prediction = remnant.model, predict(recording, estimate.model, band.limit)
    else:
        band = analysis_band(recording.dt, LikelihoodSettings.band)
        prediction = predict(recording, estimate.model, band.limit)
        guess = best_noise_model(prediction.errors(estimate.values), band)
        name, taps = guess.model.name, guess.whitener(band)
    errors = prediction.errors(estimate.values, taps)
    prepared = prepare(recording, estimate.model, band.limit)
    scored = np.round(prepared.scored_time / recording.dt).astype(int) + recording.run_in
    inputs = {}
    for key in dict.fromkeys(channel.on for channel in estimate.model.channels):
        taps, runs = lowpass(band.factor), recording.input(key)
        signal = np.array([np.convolve(run, taps, "same")[scored] for run in runs])
        inputs[key] = signal - signal.mean(axis=1, keepdims=True)
    return Whitened(band.dt, errors, inputs, name, remnant is not None)


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


def drift_left(joint: Likelihood, values: FloatArray) -> tuple[float, FloatArray]:
    """How well a straight line in the control of each run would be seen, beside the pilot.

    A fit takes a drift for slow remnant, and under that remnant it is hardly to be seen.  So the
    remnant's model is chosen again of what a line leaves of the residual, and the line is tested
    under it.

    Parameters
    ----------
    joint
        Pilot and remnant that were fitted.
    values
        Their parameters at the optimum, shape (parameters,).

    Returns
    -------
    statistic, drifts
        Chi-squared with a degree of freedom for each run if there is no drift; and what the
        control gains over the scored part of each run, shape (runs,).
    """
    pilot, band = values[: joint.pilot_count], joint.band
    terms = tuple(dict.fromkeys((0.0, *joint.prediction.nuisance_poles)))  # an offset is no drift
    prediction = replace(joint.prediction, nuisance_poles=terms)
    line = prediction.without_nuisance(np.linspace(-0.5, 0.5, prediction.scored))
    residual = prediction.without_nuisance(prediction.residual(pilot))
    flat = residual - np.outer(residual @ line, line) / (line @ line)
    taps = best_noise_model(flat, band).whitener(band)
    rows = Likelihood(prediction, Whitener(taps)).rows(pilot[None])[0]
    *jacobian, errors = rows.reshape(len(rows), -1)
    own = np.array([column / (np.linalg.norm(column) or 1.0) for column in jacobian])
    # What the pilot explains comes first; a line in each run then explains of the rest what it
    # may.  Lines of two runs share no sample, and meet only in what the pilot takes of both.
    basis = np.linalg.qr(own.T).Q
    rest = errors - basis @ (basis.T @ errors)
    across = line @ basis.reshape(prediction.runs, prediction.scored, -1)
    seen = (line @ line) * np.eye(prediction.runs) - across @ across.T
    along = rest.reshape(prediction.runs, prediction.scored) @ line
    found = np.linalg.solve(seen, along)
    explained = along @ found
    freedom = errors.size - len(own) - prediction.runs
    # Whitening makes a line of a line: it multiplies the slope by the sum of the taps.
    drifts = np.asarray(found / np.sum(taps))
    return float(explained * freedom / (rest @ rest - explained)), drifts


def tested_specification(
    found: Optimum, recording: Recording, estimate: Estimate, against: str
) -> Specification | None:
    """The estimate tested against a consistent one: the forcing lines, or else instruments.

    Parameters
    ----------
    found, recording, estimate
        The optimum, what was fitted, and the estimate that it became.
    against
        The method whose moments the instruments are.
    """
    enough = recording.runs * recording.duration >= ESTIMATE.tested_from
    model, values, covariance = estimate.model, estimate.values, estimate.covariance
    free = np.flatnonzero(~is_at_bound(model, values))
    if not enough or not free.size:
        return None
    bounded = free.size < len(values)
    if bounded:  # no score is zero there: the others are tested, with what is at its bound held
        information = np.linalg.inv(covariance)[np.ix_(free, free)]
        covariance = np.zeros_like(covariance)
        covariance[np.ix_(free, free)] = np.linalg.inv(information)
    tested = specification_of(recording, model, values, covariance, found.remnant)
    if tested or bounded:
        return tested
    return specification_by_instruments(found, recording, values, covariance, against)


def fit_remarks(
    found: Optimum, recording: Recording, *, asked_for_band: bool = True
) -> tuple[Remark, ...]:
    """What speaks against the fit of pilot and remnant, a sentence each; empty for nothing.

    Parameters
    ----------
    found, recording
        The optimum, and what was fitted.
    asked_for_band
        Whether the likelihood of a band was asked for.
    """
    errors = found.tested_rows[-1]
    remarks = [
        _not_closed(found, recording) if asked_for_band else None,
        _dispersed(found.dispersion),
        _held(recording),
        _changed(found) or _varying(found, recording),
        uneven(errors),
        _drifting(found),
        coloured(errors, found.joint.prediction.band_terms),
        _answered_at_once(recording, found.joint.prediction.model),
        _slow_lag(found),
        _competing(found),
    ]
    return tuple(remark for remark in remarks if remark)


def _not_closed(found: Optimum, recording: Recording) -> Remark | None:
    """What to say where the recording does not allow for the likelihood of a band."""
    weighting, model = found.joint.prediction.weighting, found.joint.prediction.model
    if weighting is not None and weighting.hidden:
        return Remark(
            "hidden-signal",
            "what the pilot acts on (e, x) hardly stands above the noise of the recorder at any "
            "frequency: the values mean little; record these signals with less noise or more bits",
        )
    # Without noise below where pilots end, direct prediction errors are as good.
    usable = floors_of(recording).usable(tuple({channel.on for channel in model.channels}))
    if weighting is not None or model.changes or usable >= 2.0 * math.pi * RECORDER.enough:
        return None
    why = "the controlled element is not known"
    cure = "name the element, for example --element 4/s^2"
    if model.extra:
        why = f"how the loop moves {', '.join(model.extra)} is not known"
        cure = "record e and x with less noise"
    elif element_changes(recording):
        why = "the controlled element changes during the recording"
        cure = "fit the parts with --span"
    return Remark(
        "element-unknown",
        f"{why}, so that noise of the recorder on e and x counts as signal: gains, leads and "
        f"delays may be far off; {cure}",
    )


def _dispersed(dispersion: float) -> Remark | None:
    if dispersion <= 1.0:
        return None
    return Remark(
        "overdispersed",
        f"estimates of segments of {ESTIMATE.segment:g} s scatter {dispersion**0.5:.2g} times as "
        "much as their errors say: the pilot wanders or the model lacks something; standard errors "
        "and intervals are widened by that factor",
    )


def _held(recording: Recording) -> Remark | None:
    moves = np.abs(np.diff(recording.window(recording.u), axis=1))
    share = np.mean(moves == 0.0)
    least = np.min(moves, where=moves > 0.0, initial=np.inf)
    if share < ESTIMATE.held or np.mean((moves > 0.0) & (moves < 1.9 * least)) > share:
        return None  # the steps of a converter, taken at every other sample
    return Remark(
        "held-control",
        f"u keeps its value at {100.0 * share:.2g} % of the samples: a stick with a breakout "
        "force, levels or stops, or lost samples; the gains are those of pilot and stick together",
    )


def _answered_at_once(recording: Recording, model: PilotModel) -> Remark | None:
    """A word on position control, see docs/measurements.md for what it does to intervals."""
    outside = all(channel.on == "ft" for channel in model.channels)  # of any loop
    if outside or not is_gain(recording):
        return None
    return Remark(
        "gain-element",
        "the controlled element is a gain, so that the values rest on the model of the remnant, "
        "and intervals may be too short; compare with fourier, which uses the forcing frequencies "
        "alone",
    )


def _competing(found: Optimum) -> Remark | None:
    covariance = found.covariance
    if covariance is None or not len(found.competing):
        return None
    model = found.joint.prediction.model
    apart = np.abs(np.array(found.competing) - found.pilot) / np.sqrt(np.diag(covariance))
    if apart.max() < ESTIMATE.other_optimum:
        return None
    other = found.competing[int(np.argmax(apart.max(axis=1)))]
    told = ", ".join(f"{key} {value:.3g}" for key, value in zip(model.keys, other, strict=True))
    return Remark(
        "competing-optimum",
        f"another optimum is as likely: {told}; the intervals hold both; fix a parameter (--fix), "
        "or choose a simpler model",
    )


def _slow_lag(found: Optimum) -> Remark | None:
    prediction = found.joint.prediction
    lag = prediction.outlasting_lag(found.pilot)
    if not lag:
        return None
    return Remark(
        "slow-lag",
        f"a lag of {lag:.2g} s is long beside the {prediction.pre_history:.2g} s before the scored "
        "window: its free decay is fitted too, which takes information on gain and lag; record a "
        "run-in of four times the lag",
    )


def _varying(found: Optimum, recording: Recording) -> Remark | None:
    test = constancy(found, recording)
    if test is None or test.p >= ESTIMATE.seldom or test.size < ESTIMATE.changes_by:
        return None
    return Remark(
        "gains-change",
        f"{' and '.join(test.keys)} change during the recording, mainly about t = {test.time:.0f} "
        f"s ({test}; score test, chi-square {test.statistic:.0f} on {len(test.keys)} df), or the "
        "model lacks a channel or a lag; fit segments (--span), or --model adapting",
    )


def _changed(found: Optimum) -> Remark | None:
    rows, pilot, model = found.tested_rows, found.pilot, found.joint.prediction.model
    halves = score_of_changes(rows, range(pilot.size), [0.5])
    if not halves or not halves[0].freedom:
        return None
    _, statistic, freedom, steps = halves[0]
    if statistic <= chi_squared_limit(freedom, ESTIMATE.seldom):
        return None
    # The control is proportional to the gains: with their slopes it is all that is predicted.
    gains = np.where(np.isin(np.arange(pilot.size), model.linear), pilot, 0.0)
    change, control = np.tensordot([steps, gains], rows[: pilot.size], 1)
    share = float(np.linalg.norm(change) / np.linalg.norm(control))
    remedy = "fit each half (--span), or --model adapting"
    if model.changes:
        remedy = "the pilot changes in another way than the model says"
    return Remark(
        "halves-differ",
        f"the two halves of the recording differ by about {100.0 * share:.0f} % of the control "
        f"(score test, chi-square {statistic:.0f} on {freedom} df): the pilot or the recorder "
        f"changed, and the estimates are averages; {remedy}",
        "note" if share < ESTIMATE.changes_by else "doubt",
    )


def uneven(errors: FloatArray) -> Remark | None:
    """A remark that the variance of prediction errors (runs, samples) changes."""
    ratio, deviations = ratio_of_halves(errors)
    if deviations**2 <= chi_squared_limit(1, ESTIMATE.seldom):
        return None
    return Remark(
        "residual-variance-changes",
        f"the prediction errors of the second half have {ratio:.2g} times the variance of those of "
        "the first: the remnant or the pilot changed; fit each half (--span)",
    )


def _drifting(found: Optimum) -> Remark | None:
    statistic, drifts = drift_left(found.joint, found.values)
    if statistic <= chi_squared_limit(drifts.size, ESTIMATE.seldom):
        return None
    run = int(np.argmax(np.abs(drifts)))
    return Remark(
        "residual-drift",
        f"u drifts by about {drifts[run]:.2g} over run {run + 1} (chi-square "
        f"{statistic:.0f} on {drifts.size} df), which biases gain and lead: take it out with "
        "--detrend",
    )


def coloured(errors: FloatArray, terms: BandTerms | None = None) -> Remark | None:
    """A remark that prediction errors (runs, samples) are not white, weighted as in a band."""
    if terms is None:
        statistic, freedom = portmanteau(errors, ESTIMATE.lags), ESTIMATE.lags
    else:
        statistic, freedom = portmanteau_in_band(errors, terms.weights, ESTIMATE.lags)
    if statistic <= chi_squared_limit(freedom, ESTIMATE.seldom):
        return None
    return Remark(
        "residual-not-white",
        f"the prediction errors are not white (portmanteau over {ESTIMATE.lags} lags, chi-square "
        f"{statistic:.0f} on {freedom} df): pilot and remnant leave something unexplained, "
        "and errors may be larger than claimed; try another model",
    )


def portmanteau(errors: FloatArray, lags: int) -> float:
    """Ljung and Box's statistic of prediction errors, all runs together.

    Chi-squared with `lags` degrees of freedom if they are white, or less, since parameters
    were estimated (Ljung and Box, Biometrika 65(2), 1978).

    Parameters
    ----------
    errors
        Prediction errors, shape (runs, samples).
    lags
        Number of lags, from 1 on.
    """
    runs, samples = errors.shape
    power = float(np.sum(errors**2))
    total = 0.0
    for lag in range(1, min(lags, samples - 1) + 1):
        correlation = float(np.sum(errors[:, lag:] * errors[:, :-lag])) / power
        total += correlation**2 / (samples - lag)
    return float(runs * samples * (samples + 2.0) * total)


def portmanteau_in_band(errors: FloatArray, weights: FloatArray, lags: int) -> tuple[float, int]:
    """A statistic of prediction errors that is chi-squared if they are white in a band.

    Parameters
    ----------
    errors
        Prediction errors, shape (runs, samples).
    weights
        Weights of the bins of their transform from rest on, shape (bins,).
    lags
        Number of lags of the weighted autocovariance, from 1 on.

    Returns
    -------
    The statistic and its degrees of freedom: of fewer frequencies fewer lags are independent.
    """
    runs, samples = errors.shape
    power = np.sum(np.abs(np.fft.rfft(errors)[:, : weights.size]) ** 2, axis=0)
    excess = power / float(weights @ power) * float(weights.sum()) * runs - runs
    turn = 2.0 * np.pi / samples * np.arange(weights.size)
    cosines = np.cos(np.outer(np.arange(1, lags + 1), turn))
    cosines -= (cosines @ weights / weights.sum())[:, None]  # the power was estimated
    cosines *= weights
    size, directions = np.linalg.eigh(runs * (cosines @ cosines.T))
    kept = size > ESTIMATE.independent * size[-1]
    along = directions[:, kept].T @ (cosines @ excess)
    return float(np.sum(along**2 / size[kept])), int(np.count_nonzero(kept))


def ratio_of_halves(errors: FloatArray) -> tuple[float, float]:
    """How much larger the variance of prediction errors is in the second half.

    Parameters
    ----------
    errors
        Prediction errors, shape (runs, samples).

    Returns
    -------
    ratio, deviations
        Variance of the second half over that of the first, and its logarithm in standard
        deviations, which the errors' own kurtosis gives.
    """
    half = errors.shape[1] // 2
    first, second = errors[:, :half] ** 2, errors[:, half:] ** 2
    ratio = float(np.mean(second) / np.mean(first))
    square = errors**2
    spread = float(np.var(square) / np.mean(square) ** 2)  # 2 for a normal distribution
    deviation = math.sqrt(spread * (1.0 / first.size + 1.0 / second.size))
    return ratio, math.log(ratio) / deviation
