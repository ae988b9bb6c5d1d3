"""What an optimum becomes, and what an estimate says of recordings.

An optimum becomes an estimate with its outcome, intervals and VAF; that of a white residual (output
error) is polished here.  An estimate simulates, predicts and scores recordings, those it was not
fitted to as well.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np

from pilotid.estimate.estimate import (
    Estimate,
    Outcome,
    Starts,
    failed,
    outcome_of,
    symmetric_intervals,
)
from pilotid.likelihood.likelihood import Likelihood
from pilotid.likelihood.prediction import Prediction, predict
from pilotid.likelihood.remnant_models import best_noise_model, filter_of
from pilotid.likelihood.search import SEARCH_BAND, LikelihoodSettings
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.solve.intervals import REACH, score_products, with_information
from pilotid.solve.least_squares import Gram, Minima, minimise
from pilotid.support.numbers import covariance_of
from pilotid.support.remarks import Remark
from pilotid.support.types import FloatArray, InputError

if TYPE_CHECKING:
    from pandas import DataFrame


#: Numerics: what lies above [rad/s] changes the VAF by less than .1 % (simulations of 200 Hz to
#: 1 kHz), and costs a second and 410 MB for an hour at 1 kHz.
VAF_BAND = 300.0


def simulated_vaf(
    recording: Recording,
    model: PilotModel,
    values: FloatArray,
    prediction: Prediction | None = None,
) -> float:
    """Variance accounted for, max(0, 1 - var(u - u_hat)/var(u)) in %.

    u_hat is the simulated response to the recorded inputs in a band that holds all of a pilot, with
    offset and slow decays fitted; all runs count together.

    Parameters
    ----------
    recording, model, values
        What is simulated.
    prediction
        The prediction in that band, where the caller has it already.
    """
    prediction = (prediction or predict(recording, model, VAF_BAND)).with_decays(values)
    left = float(np.mean(np.var(prediction.errors(values), axis=1)))
    spread = float(np.mean(np.var(prediction.control, axis=1)))
    return max(0.0, 100.0 * (1.0 - left / spread))


def starts_of(minima: Minima, same: float = 3e-3) -> Starts:
    """How many starts ended in the best optimum, costs within the share `same` of it."""
    relative = minima.cost / minima.cost[0] if minima.cost[0] > 0.0 else np.ones(len(minima.cost))
    return Starts(cost=relative, agreeing=int(np.sum(relative <= 1.0 + same)))


def make_estimate(
    method: str,
    recording: Recording,
    model: PilotModel,
    values: FloatArray,
    covariance: FloatArray,
    *,
    converged: bool,
    optimum: FloatArray | None = None,
) -> Estimate:
    """The estimate with outcome, symmetric intervals and VAF.

    Intervals end at the model's bounds, or at the value of a method that knows no bounds.  A method
    that has better intervals, or more to tell, replaces them.

    Parameters
    ----------
    method
        Name of the method.
    recording, model
        What was fitted.
    values, covariance
        The estimate, shapes (parameters,) and (parameters, parameters).
    converged
        Whether the search ended as it should.
    optimum
        Where the search ended, if that is not the estimate, shape (parameters,); a parameter at a
        bound there is named in the message.
    """
    end = values if optimum is None else optimum
    outcome, message = outcome_of(model, end, converged)
    return Estimate(
        method,
        model,
        outcome,
        values=values,
        covariance=covariance,
        intervals=within_bounds(model, values, symmetric_intervals(values, covariance)),
        vaf=simulated_vaf(recording, model, values),
        message=message,
    )


def within_bounds(model: PilotModel, values: FloatArray, intervals: FloatArray) -> FloatArray:
    """Intervals (parameters, 2) that end at the model's bounds, or at the values beyond them."""
    lower, upper = np.minimum(model.lower, values), np.maximum(model.upper, values)
    return np.clip(intervals, lower[:, None], upper[:, None])


@dataclass(frozen=True)
class WhiteLikelihood:
    """Maximum likelihood under a white residual, from the best end of a search.

    Attributes
    ----------
    band
        Analysis band [rad/s]; None uses the full sampling rate, as AIAA 2008-7109 does.
    """

    band: float | None = None
    name: ClassVar[str]

    def objection(self, recording: Recording, model: PilotModel) -> str | None:
        """None: any recording and any model will do."""
        return None

    def search(self, gram: Gram, model: PilotModel, rng: np.random.Generator) -> Minima:
        """Minima of the residual in a narrow band, whose Gram matrices are given, best first."""
        raise NotImplementedError

    def fit(self, recording: Recording, model: PilotModel, rng: np.random.Generator) -> Estimate:
        """Minimise the sum of squares of the residual.

        Parameters
        ----------
        recording
            The recording; all its runs are fitted jointly.
        model
            The pilot model.
        rng
            Source of the random numbers of the search.
        """
        coarse = Likelihood(predict(recording, model, SEARCH_BAND))
        search = self.search(coarse.gram, model, rng)
        starts = starts_of(search) if len(search.cost) > 1 else None
        prediction, start = predict(recording, model, self.band), search.values[0]
        problem = Likelihood(prediction.with_noticeable_terms(start))
        end = minimise(problem.gram, start[None], model, tolerance=1e-8)
        end = with_information(end, problem.gram)
        values, gram = end.values[0], end.gram[0]
        variance = gram[-1, -1] / (problem.residuals - len(values))
        covariance = covariance_of(gram[:-1, :-1], variance)
        if covariance is None:
            return replace(failed(self.name, model, Outcome.SINGULAR), starts=starts)
        estimate = make_estimate(
            self.name, recording, model, values, covariance, converged=bool(end.converged[0])
        )
        return replace(
            estimate,
            iterations=search.iterations + end.iterations,
            starts=starts,
            remarks=too_short(problem, values),
        )


def too_short(problem: Likelihood, values: FloatArray) -> tuple[Remark, ...]:
    """A remark where the residual is coloured, with what that does to errors claimed as if white.

    The scores' variance over what it would be of a white residual is that of the errors, see
    `pilotid.solve.intervals`.

    Parameters
    ----------
    problem, values
        The problem, and its optimum, shape (parameters,).
    """
    rows = problem.rows(values[None])[0]
    claimed = np.sum(rows[:-1] ** 2, axis=(1, 2)) * np.mean(rows[-1] ** 2)
    measured = np.diag(score_products(rows, max(1, round(REACH / problem.prediction.dt))))
    factor = float(np.sqrt(np.median(measured / np.maximum(claimed, 1e-300))))
    if not factor > 1.5:
        return ()
    return (
        Remark(
            "residual-not-white",
            f"the residual is coloured: standard errors and intervals are about {factor:.1f} times "
            "too short, and the estimate is biased in a closed loop; use mle or bayes",
        ),
    )


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


def simulated(estimate: Estimate, recording: Recording) -> DataFrame:
    """See `Estimate.simulate`."""
    _require_values(estimate)
    prediction = predict(recording, estimate.model).with_decays(estimate.values)
    return _frame(prediction, "simulated", prediction.errors(estimate.values))


def predicted(estimate: Estimate, recording: Recording, fitted_to: Recording | None) -> DataFrame:
    """See `Estimate.predict`."""
    prediction, errors, variance = prediction_errors(recording, estimate, fitted_to)
    return _frame(prediction, "predicted", errors).assign(std=math.sqrt(variance))


def scored(estimate: Estimate, recording: Recording, fitted_to: Recording | None) -> Score:
    """See `Estimate.score`."""
    _require_values(estimate)
    log_score = math.nan
    if estimate.remnant is not None or fitted_to is not None:
        _, errors, variance = prediction_errors(recording, estimate, fitted_to)
        squares = float(np.sum(errors**2)) / variance
        log_score = -0.5 * (errors.size * math.log(2.0 * math.pi * variance) + squares)
    return Score(simulated_vaf(recording, estimate.model, estimate.values), log_score)


def prediction_errors(
    recording: Recording, estimate: Estimate, fitted_to: Recording | None = None
) -> tuple[Prediction, FloatArray, float]:
    """The prediction errors of an estimate.

    They are whitened by the model of the remnant that suits best what the estimate leaves of what
    it was fitted to, see `best_noise_model`, or by the estimate's own.  Offsets alone are fitted to
    a run that is predicted.

    Parameters
    ----------
    recording
        What is predicted.
    estimate
        An estimate with values.
    fitted_to
        What it was fitted to; needed if the estimate has no model of the remnant.

    Returns
    -------
    prediction, errors, variance
        The recording in an analysis band, prediction errors in the unit of the control, shape
        (runs, samples), and their variance in what the estimate was fitted to.

    Raises
    ------
    InputError
        If the estimate has no values, or no model of the remnant is known.
    """
    _require_values(estimate)
    model, values, remnant = estimate.model, estimate.values, estimate.remnant

    def prepared(of: Recording, rate: float | None = LikelihoodSettings.band) -> Prediction:
        return replace(predict(of, model, rate), nuisance_poles=(0.0,))

    if fitted_to is not None:
        known, prediction = prepared(fitted_to), prepared(recording)
        taps = best_noise_model(known.errors(values), known.window.band).whitener(known.window.band)
        variance = float(np.mean(known.errors(values, taps) ** 2))
    elif remnant is not None:
        band, taps, variance = filter_of(remnant, recording.dt)
        prediction = prepared(recording, band.limit)
    else:
        raise InputError(
            f"the estimate by {estimate.method} has no model of the remnant; give the recording "
            "that it was fitted to as well, as in predict(recording, fitted_to)"
        )
    return prediction, prediction.errors(values, taps), variance


def _require_values(estimate: Estimate) -> None:
    if not np.isfinite(estimate.values).all():
        raise InputError(f"the estimate by {estimate.method} has no values: {estimate.sentence}")


def _frame(prediction: Prediction, name: str, errors: FloatArray) -> DataFrame:
    """A row for each run and scored sample."""
    from pandas import DataFrame

    control, runs = prediction.control, prediction.runs
    columns = {
        "run": np.repeat(np.arange(1, runs + 1), prediction.window.scored),
        "time": np.tile(prediction.time, runs),
        "control": control.ravel(),
        name: (control - errors).ravel(),
    }
    return DataFrame(columns)
