"""What the prediction errors of a fit say against its assumptions, in words.

Under the model, prediction errors at the optimum are white, as large in one half of the
recording as in the other, and gains and leads are the same throughout, as any other parameter
is in both halves; the control does not drift, and where it moves it does not rest.  Each test
is at a chance of `ESTIMATE.seldom`.

Instruments are what the forcing functions alone make of a prediction's Jacobian: the remnant, and
what a recorder adds to e and x, are in the model's inputs too; the forcing functions know of
neither.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from pilotid.checks.detectors import band_end, is_resampled, step_of
from pilotid.checks.plant import element_changes, is_gain
from pilotid.estimate.estimate import Estimate, Outcome, is_at_bound
from pilotid.estimate.quantities import Specification, score_test
from pilotid.likelihood.band_likelihood import BandTerms
from pilotid.likelihood.likelihood import Likelihood
from pilotid.likelihood.optimum import Optimum
from pilotid.likelihood.prediction import predict
from pilotid.likelihood.remnant_models import NOISE_MODELS, Whitener, best_noise_model
from pilotid.model.element import ControlledElement
from pilotid.model.factors import Gain, Lead
from pilotid.model.loops import is_stable, pilot_on
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.recording.spectra import floors_of
from pilotid.solve.least_squares import Problem
from pilotid.spectral.equations import specification_of
from pilotid.support.limits import ESTIMATE, RECORDER
from pilotid.support.numbers import chi_squared_limit, chi_squared_tail, covariance_of
from pilotid.support.remarks import Remark
from pilotid.support.types import FloatArray, IntArray

# ------------------------------------------------------------------------------------- instruments

#: Bins over which the power of the prediction error is averaged.
SMOOTHED = 61


def references(
    recording: Recording, model: PilotModel, values: FloatArray, element: ControlledElement
) -> Recording:
    """A recording with the e and x that its forcing functions alone make in the loop."""
    from scipy.fft import next_fast_len  # when it is needed

    target, disturbance = forcing_functions(recording)
    samples = target.shape[1]
    # In 30 s of zeros behind the recording the loop comes to rest.
    length = next_fast_len(samples + round(30.0 / recording.dt), real=True)
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
    recording, element
        What was fitted, and the element that closes the loop of its `references`.
    values
        Parameters of that loop, at which the prediction errors tell their power, shape
        (parameters,).
    """

    def __init__(
        self,
        optimum: Optimum,
        recording: Recording,
        element: ControlledElement,
        values: FloatArray,
    ) -> None:
        fitted = optimum.joint.prediction
        reference = references(recording, fitted.model, values, element)
        # In whole periods what a forcing function leaves at its own lines is zero.
        whole, other = (
            predict(each, fitted.model, fitted.window.band.limit) for each in (recording, reference)
        )
        self._taps, whitener = optimum.whitener, Whitener(optimum.whitener)
        poles, weighting = fitted.nuisance_poles, fitted.weighting
        self._prediction = replace(whole, nuisance_poles=poles, weighting=weighting)
        self._whitened = Likelihood(replace(self._prediction, nuisance_poles=()), whitener)
        alike = Likelihood(replace(self._prediction, spectra=other.spectra), whitener)
        self._instruments = self._prediction.weighted_rows(alike.rows(optimum.pilot[None])[0, :-1])
        self.weigh_at(values)

    def weigh_at(self, values: FloatArray) -> None:
        """Standardise the moments by the power that the prediction errors of these values have."""
        errors = self._prediction.errors(values, self._taps)
        parts = self._prediction.weighted_rows(errors).reshape(-1, 2)
        power = np.pad(np.mean(parts**2, axis=1), SMOOTHED // 2, mode="reflect")
        smooth = np.convolve(power, np.ones(SMOOTHED) / SMOOTHED, "valid")
        scatter = (self._instruments * np.repeat(smooth, 2)) @ self._instruments.T
        self._standard = np.linalg.inv(np.linalg.cholesky(scatter))

    def rows(self, values: FloatArray) -> FloatArray:
        """Jacobian and below it the moments, shape (sets, parameters + 1, parameters)."""
        rows = self._prediction.weighted_rows(self._whitened.rows(values))
        return np.asarray(rows @ self._instruments.T @ self._standard.T)


def specification_by_instruments(
    optimum: Optimum, recording: Recording, values: FloatArray, covariance: FloatArray
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
    """
    weighting, model = optimum.joint.prediction.weighting, optimum.joint.prediction.model
    driven = any(np.ptp(s) > 0.0 for s in forcing_functions(recording))
    if weighting is None or not driven or not is_stable(model, values, weighting.element):
        return None
    try:
        moments = Moments(optimum, recording, weighting.element, values)
    except np.linalg.LinAlgError:  # a parameter that no forcing function excites
        return None
    rows = moments.rows(values[None])[0]
    jacobian, score = rows[:-1].T, rows[-1]
    left = np.eye(score.size) - jacobian @ covariance @ jacobian.T
    tested = score_test(score, left, ESTIMATE.least_by_instruments, "mle-reference")
    moved = np.abs(np.linalg.lstsq(jacobian, score)[0]) / np.sqrt(np.diag(covariance))
    return tested and replace(tested, moved=float(moved.max()))


# ---------------------------------------------------------------------- tests of prediction errors


#: Shares of the scored time at which a change may be.
PLACES = np.linspace(0.1, 0.9, 21).tolist()


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
    prediction = replace(joint.prediction, nuisance_poles=terms, weighting=None)  # rows alone count
    line = prediction.without_nuisance(np.linspace(-0.5, 0.5, prediction.window.scored))
    residual = prediction.errors(pilot)
    flat = residual - np.outer(residual @ line, line) / (line @ line)
    taps = best_noise_model(flat, band).whitener(band)
    rows = Likelihood(prediction, Whitener(taps)).rows(pilot[None])[0].reshape(pilot.size + 1, -1)
    # What the pilot explains comes first; a line in each run then explains what it may.
    runs, errors = prediction.runs, rows[-1]
    basis, triangle = np.linalg.qr(np.vstack([rows[:-1], np.kron(np.eye(runs), line)]).T)
    along = basis.T @ errors
    explained, left = along[-runs:] @ along[-runs:], errors @ errors - along @ along
    # Whitening makes a line of a line: it multiplies the slope by the sum of the taps.
    drifts = np.linalg.lstsq(triangle, along)[0][-runs:] / np.sum(taps)
    return float(explained * (errors.size - along.size) / left), drifts


#: What is said where no optimum passes `pilotid.likelihood.optimum.PilotCheck`.
NO_PILOT = "no optimum is a pilot in a stable loop, or explains the control where none is known"


def with_verdict(
    estimate: Estimate,
    optimum: Optimum,
    recording: Recording,
    covariance: FloatArray | None,
    remarks: Sequence[Remark],
) -> Estimate:
    """The estimate with what its likelihood rests on, and what speaks against it.

    Parameters
    ----------
    estimate, optimum, recording
        The estimate, the optimum of the likelihood that it is of, and what was fitted.
    covariance
        Covariance of the optimum, shape (parameters, parameters); None where it is not tested.
    remarks
        What is said besides, see `fit_remarks`.
    """
    tested = None
    if optimum.rank == 0:
        estimate = replace(estimate, outcome=Outcome.CONTRADICTED, message=NO_PILOT)
        remarks = (Remark("misspecified", f"{NO_PILOT}; the values mean nothing"), *remarks)
    elif covariance is not None:
        tested = specification(optimum, recording, covariance)
    said = tested.remarks if tested else ()
    if recording.ft is None or recording.fd is None:  # scores scatter more (5 of 300 sound fits)
        said = tuple(Remark(r.code, r, "doubt") if r.grade == "wrong" else r for r in said)
    return replace(
        estimate,
        specification=tested,
        iterations=optimum.iterations,
        starts=optimum.starts,
        remnant=optimum.remnant,
        band=optimum.band_of(recording),
        remarks=(*said, *remarks),
    )


def specification(
    optimum: Optimum, recording: Recording, covariance: FloatArray
) -> Specification | None:
    """The optimum tested against a consistent estimate: the forcing lines, or else instruments.

    Parameters
    ----------
    optimum, recording, covariance
        As for `with_verdict`.
    """
    enough = recording.runs * recording.duration >= ESTIMATE.tested_from
    model, values = optimum.joint.prediction.model, optimum.pilot
    free = np.flatnonzero(~is_at_bound(model, values))
    if not enough or not free.size:
        return None
    bounded = free.size < len(values)
    if bounded:  # no score is zero there: the others are tested, with what is at its bound held
        information = np.linalg.inv(covariance)[np.ix_(free, free)]
        covariance = np.zeros_like(covariance)
        covariance[np.ix_(free, free)] = np.linalg.inv(information)
    tested = specification_of(
        recording, model, values, covariance, optimum.remnant, band_end(recording)
    )
    if tested or bounded:
        return tested
    return specification_by_instruments(optimum, recording, values, covariance)


def fit_remarks(
    optimum: Optimum, recording: Recording, *, asked_for_band: bool = True
) -> tuple[Remark, ...]:
    """What speaks against the fit of pilot and remnant, a sentence each; empty for nothing.

    Parameters
    ----------
    optimum, recording
        The optimum, and what was fitted.
    asked_for_band
        Whether the likelihood of a band was asked for.
    """
    errors, prediction = optimum.tested_rows[-1], optimum.joint.prediction
    remarks = [
        _not_closed(optimum, recording) if asked_for_band else None,
        _held(recording),
        _changed(optimum) or gains_change(optimum),
        _dispersed(optimum.dispersion),
        _drifting(optimum),
        coloured(errors, prediction.dt, prediction.band_terms),
        _answered_at_once(optimum, recording),
        _slow_lag(optimum),
        _competing(optimum),
    ]
    return tuple(remark for remark in remarks if remark)


def _not_closed(optimum: Optimum, recording: Recording) -> Remark | None:
    """What to say where the recording does not allow for the likelihood of a band."""
    weighting, model = optimum.joint.prediction.weighting, optimum.joint.prediction.model
    if weighting is not None and weighting.hidden:
        return Remark(
            "motionless",
            "what the pilot acts on (e, x) hardly stands above the noise of the recorder at any "
            "frequency: the values mean little; record these signals with less noise or more bits",
        )
    # Without noise below where pilots end, direct prediction errors are as good.
    usable = floors_of(recording).usable(channel.on for channel in model.channels)
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
        "pilot-changes",
        f"estimates of segments of {ESTIMATE.segment:g} s scatter {dispersion**0.5:.2g} times as "
        "much as their errors say: the pilot wanders or the model lacks something; standard errors "
        "and intervals are widened by that factor",
        "note",
    )


def _held(recording: Recording) -> Remark | None:
    moves = np.abs(np.diff(recording.window(recording.u), axis=1))
    share = np.mean(moves == 0.0)
    # A converter holds what moves by less than its steps, a recorder what it took more seldom.
    step, rms = step_of(recording, "u"), float(np.std(recording.window(recording.u)))
    converted = share * np.mean(moves) < step <= 0.5 * RECORDER.coarse * rms
    if share < ESTIMATE.held or converted or is_resampled(recording, "u"):
        return None
    return Remark(
        "held-control",
        f"u keeps its value at {100.0 * share:.3g} % of the samples: a stick with a breakout "
        "force, levels or stops, or lost samples; the gains are those of pilot and stick together",
    )


def _answered_at_once(optimum: Optimum, recording: Recording) -> Remark | None:
    """A word on position control, see docs/measurements.md for what it does to intervals."""
    if optimum.joint.prediction.model.is_open or not is_gain(recording):
        return None
    # Of 57 fits in populations five took the longest autoregression: four are off, and no other.
    unsuited = optimum.joint.noise == NOISE_MODELS[-1]
    return Remark(
        "gain-element",
        "the controlled element is a gain, so that the values rest on the model of the remnant, "
        f"{'which none suits' if unsuited else 'and intervals may be too short'}; compare with "
        "fourier, which uses the forcing frequencies alone",
        "doubt" if unsuited else "note",
    )


def _competing(optimum: Optimum) -> Remark | None:
    covariance = optimum.covariance
    if covariance is None or not len(optimum.competing):
        return None
    model = optimum.joint.prediction.model
    apart = np.abs(np.array(optimum.competing) - optimum.pilot) / np.sqrt(np.diag(covariance))
    if apart.max() < ESTIMATE.other_optimum:
        return None
    other = optimum.competing[int(np.argmax(apart.max(axis=1)))]
    words = ", ".join(f"{key} {value:.3g}" for key, value in zip(model.keys, other, strict=True))
    return Remark(
        "inseparable",
        f"another optimum is as likely: {words}; the intervals hold both; fix a parameter (--fix), "
        "or choose a simpler model",
    )


def _slow_lag(optimum: Optimum) -> Remark | None:
    prediction = optimum.joint.prediction
    lag = prediction.outlasting_lag(optimum.pilot)
    if not lag:
        return None
    return Remark(
        "slow-lag",
        f"a lag of {lag:.2g} s is long beside the {prediction.pre_history:.2g} s before the scored "
        "window: its free decay is fitted too, which takes information on gain and lag; record a "
        "run-in of four times the lag",
    )


def gains_change(optimum: Optimum) -> Remark | None:
    """A remark that gains and leads change, where that is certain and large.

    Of score tests at many times the largest counts (Andrews, Econometrica 61(4), 1993).  A constant
    pilot has no time of change, so that it is not chi-squared (Davies, Biometrika 74(1), 1987): the
    p-value is that of one time, times the number of times (Bonferroni).  A slower change is seen as
    a step in its middle, and what a wrong model leaves as far as it looks like one of gain and
    lead.  People do vary: in several runs of 80 s together changes of a fifth of a gain, which no
    fit need mind, are certain.
    """
    prediction = optimum.joint.prediction
    model = prediction.model
    varying = [] if model.changes else model.indices_of(Gain | Lead)
    changes = score_of_changes(optimum.tested_rows, varying, PLACES) if varying else []
    if not changes:
        return None
    largest = int(np.argmax([statistic for statistic, _, _ in changes]))
    statistic, freedom, at_once = changes[largest]
    chance = len(changes) * chi_squared_tail(freedom, statistic)
    shares = at_once / optimum.pilot[varying]
    if chance >= ESTIMATE.seldom or np.abs(shares).max() < ESTIMATE.changes_by:
        return None
    time = prediction.time[0] + PLACES[largest] * prediction.window.scored * prediction.dt
    keys = [model.keys[i] for i in varying]
    steps = [f"{key} by {100.0 * share:+.0f} %" for key, share in zip(keys, shares, strict=True)]
    return Remark(
        "pilot-changes",
        f"{' and '.join(keys)} change during the recording, mainly about t = {time:.0f} "
        f"s ({', '.join(steps)}; score test, chi-square {statistic:.0f} on {len(keys)} df), "
        "or the model lacks a channel or a lag; fit segments (--span), or --model adapting",
    )


def _changed(optimum: Optimum) -> Remark | None:
    rows, pilot, model = optimum.tested_rows, optimum.pilot, optimum.joint.prediction.model
    halves = score_of_changes(rows, range(pilot.size), [0.5])
    if not halves:
        return None
    statistic, freedom, steps = halves[0]
    if not freedom or statistic <= chi_squared_limit(freedom, ESTIMATE.seldom):
        return None
    # The control is proportional to the gains: with their slopes it is all that is predicted.
    gains = np.where(np.isin(np.arange(pilot.size), model.linear), pilot, 0.0)
    change, control = np.tensordot([steps, gains], rows[: pilot.size], 1)
    share = float(np.linalg.norm(change) / np.linalg.norm(control))
    remedy = "fit each half (--span), or --model adapting"
    if model.changes:
        remedy = "the pilot changes in another way than the model says"
    return Remark(
        "pilot-changes",
        f"the two halves of the recording differ by about {100.0 * share:.0f} % of the control "
        f"(score test, chi-square {statistic:.0f} on {freedom} df): the pilot or the recorder "
        f"changed, and the estimates are averages; {remedy}",
        "note" if share < ESTIMATE.changes_by else "doubt",
    )


def _drifting(optimum: Optimum) -> Remark | None:
    statistic, drifts = drift_left(optimum.joint, optimum.values)
    if statistic <= chi_squared_limit(drifts.size, ESTIMATE.seldom):
        return None
    run = int(np.argmax(np.abs(drifts)))
    return Remark(
        "drift",
        f"u drifts by about {drifts[run]:.2g} over run {run + 1} (chi-square "
        f"{statistic:.0f} on {drifts.size} df), which biases gain and lead: take it out with "
        "--detrend",
    )


def coloured(errors: FloatArray, dt: float, terms: BandTerms | None = None) -> Remark | None:
    """A remark that prediction errors (runs, samples) are not white, weighted as in a band.

    In bands wider than the default one that is asked of the default band: far above what people
    do no model of few parameters whitens a remnant, and no estimate is the worse for it.
    """
    # Of direct prediction errors all frequencies count but the mean, which may be projected out.
    every = np.sign(np.arange(errors.shape[1] // 2 + 1.0))
    weights = every if terms is None else terms.weights
    omega = 2.0 * np.pi / (errors.shape[1] * dt) * np.arange(weights.size)
    weights = np.where(omega <= ESTIMATE.whitened_to, weights, 0.0)
    apart = max(1, round(np.pi / (ESTIMATE.whitened_to * dt)))
    statistic, freedom = portmanteau(errors, weights, apart * np.arange(1, ESTIMATE.lags + 1))
    if statistic <= chi_squared_limit(freedom, ESTIMATE.seldom):
        return None
    return Remark(
        "residual-not-white",
        f"the prediction errors are not white (portmanteau over {ESTIMATE.lags} lags, chi-square "
        f"{statistic:.0f} on {freedom} df): pilot and remnant leave something unexplained, "
        "and errors may be larger than claimed; try another model",
    )


def portmanteau(errors: FloatArray, weights: FloatArray, lags: IntArray) -> tuple[float, int]:
    """A statistic of prediction errors that is chi-squared if they are white in a band.

    Parameters
    ----------
    errors
        Prediction errors, shape (runs, samples).
    weights
        Weights of the bins of their transform from rest on, shape (bins,).
    lags
        Lags of the weighted autocovariance [samples], shape (lags,).

    Returns
    -------
    The statistic and its degrees of freedom: of fewer frequencies fewer lags are independent.
    """
    runs, samples = errors.shape
    power = np.sum(np.abs(np.fft.rfft(errors)[:, : weights.size]) ** 2, axis=0)
    excess = power / float(weights @ power) * float(weights.sum()) * runs - runs
    turn = 2.0 * np.pi / samples * np.arange(weights.size)
    cosines = np.cos(np.outer(lags, turn))
    cosines -= (cosines @ weights / weights.sum())[:, None]  # the power was estimated
    cosines *= weights
    size, directions = np.linalg.eigh(runs * (cosines @ cosines.T))
    kept = size > ESTIMATE.independent * size[-1]
    along = directions[:, kept].T @ (cosines @ excess)
    return float(np.sum(along**2 / size[kept])), int(np.count_nonzero(kept))


def score_of_changes(
    rows: FloatArray, varying: Sequence[int], places: Sequence[float]
) -> list[tuple[float, int, FloatArray]]:
    """The score tests of changes in some parameters, one for each time.

    The score after a time has the covariance I2 - I2 I^-1 I2, with I2 the information after it
    and I that of the whole (Andrews, Econometrica 61(4), 1993).

    Parameters
    ----------
    rows
        Jacobian by pilot and remnant, and last the prediction error, all whitened, shape
        (parameters + 1, runs, samples).
    varying
        Which rows of the Jacobian are of parameters that may change.
    places
        When they may, as shares of the samples.

    Returns
    -------
    statistic, freedom, steps
        For each time chi-squared, with so many degrees of freedom under constant parameters, and
        by how much each parameter that may change is larger from then on, to first order.  The
        list is empty where the information is singular.
    """
    jacobian, errors = rows[:-1].reshape(len(rows) - 1, -1), rows[-1].ravel()
    inverse = covariance_of(jacobian @ jacobian.T, 1.0)
    if inverse is None:
        return []
    variance = float(errors @ errors) / (errors.size - len(jacobian))
    # Directions that one part of the recording alone tells of cannot be tested, and are dropped.
    root = np.linalg.cholesky(inverse[np.ix_(varying, varying)])
    edges = [*(math.floor(place * rows.shape[-1] + 0.5) for place in places), rows.shape[-1]]
    parts = (rows[..., begin:end] for begin, end in pairwise(edges))
    products = [np.tensordot(part[varying], part, ((1, 2), (1, 2))) for part in parts]
    changes = []
    for tail in np.cumsum(products[::-1], axis=0)[::-1]:  # from each place to the end
        # What constant parameters, estimated along with it, make of a change is no sign of one.
        across, within = tail[:, :-1], tail[:, varying]
        score = tail[:, -1] - across @ (inverse @ (jacobian @ errors))
        covariance = root.T @ (within - across @ inverse @ across.T) @ root
        sizes, directions = np.linalg.eigh(0.5 * (covariance + covariance.T))
        tested = sizes > ESTIMATE.shared_by_halves
        along = directions[:, tested].T @ root.T @ score
        statistic = float(np.sum(along**2 / sizes[tested])) / variance
        steps = root @ directions[:, tested] @ (along / sizes[tested])
        changes.append((statistic, along.size, steps))
    return changes
