"""Residual and Jacobian of a prediction: the problem of output error."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import reduce
from typing import Literal

import numpy as np

from pilotid.estimates.estimate import (
    Estimate,
    Outcome,
    Starts,
    failed,
    outcome_of,
    symmetric_intervals,
)
from pilotid.pilot.model import PilotModel
from pilotid.recordings.recording import Recording
from pilotid.solve.covariance import REACH, covariance_of, sandwich, score_products
from pilotid.solve.least_squares import Minima, Problem, minimise
from pilotid.support.limits import ESTIMATE
from pilotid.support.numbers import chi_squared_limit
from pilotid.support.remarks import Remark
from pilotid.support.types import ComplexArray, FloatArray
from pilotid.time_domain.prediction import Prediction, predict


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
        self.block = prediction.block

    @property
    def residuals(self) -> int:
        """Number of residuals, see `Prediction.samples`."""
        return self.prediction.samples

    def rows(self, values: FloatArray) -> FloatArray:
        """Whitened Jacobian and residual, shape (sets, parameters + 1, runs, scored).

        Parameters
        ----------
        values
            Parameter sets, shape (sets, parameters).
        """
        return self.prediction.errors_of(self.prediction.row_spectra(values, self.taps))

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
        runs together, exceed what chance gives once in 14,000.  The least noticeable goes first,
        since decays that are alike hide one another.  Those of the estimate's own slow poles
        always stay: left out, they bias what moves the pole by many claimed errors long before
        they are noticeable.
        """
        prediction = self.prediction.with_decays(values)
        slow = prediction.terms[len(self.prediction.terms) :]
        poles, every = prediction.terms, prediction.nuisance_terms
        residual = self.prediction.residual(values, self.taps)
        limit = chi_squared_limit(prediction.runs, ESTIMATE.seldom)
        kept = list(range(len(poles)))
        while kept:
            terms = every[:, kept]
            weights = np.linalg.solve(terms.T @ terms, terms.T)
            amplitudes = residual @ weights.T
            left = residual - amplitudes @ terms.T
            variance = np.sum(left**2) / (left.size - amplitudes.size)
            squares = np.sum(amplitudes**2 / np.sum(weights**2, axis=1), axis=0) / variance
            squares[[poles[place] in slow for place in kept]] = np.inf
            least = int(np.argmin(squares))
            if squares[least] > limit:
                break
            del kept[least]
        return tuple(poles[place] for place in kept)


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
    prediction = (prediction or predict(recording, model)).with_decays(values)
    left = float(np.mean(np.var(OutputErrors(prediction).residual(values), axis=1)))
    spread = float(np.mean(np.var(prediction.control, axis=1)))
    return max(0.0, 100.0 * (1.0 - left / spread))


def residual_spectra(prediction: Prediction, values: FloatArray) -> ComplexArray:
    """Transforms of the residual u - u_hat, before whitening, shape (sets, runs, bins).

    The same numbers as those of `Prediction.row_spectra`, without derivatives.

    Parameters
    ----------
    prediction
        The prepared prediction.
    values
        Parameter sets, shape (sets, parameters).
    """
    responses = prediction.model.moving_responses(prediction.s, values)
    answers = [
        response[:, None, :] * spectrum * (1.0 if varying is None else varying)
        for response, spectrum, varying in zip(
            responses, prediction.inputs, prediction.varying(values), strict=True
        )
    ]
    return np.asarray(prediction.control_spectrum - reduce(np.add, answers))


def record(minima: Minima, same: float = 3e-3) -> Starts:
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
    prediction: Prediction | None = None,
) -> Estimate:
    """The estimate with outcome, symmetric intervals and VAF.

    A method that has better intervals, or more to tell, replaces them.

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
    prediction
        The full-rate prediction, where the method has it already.
    """
    end = values if optimum is None else optimum
    outcome, message = outcome_of(model, end, converged)
    return Estimate(
        method,
        model,
        outcome,
        values=values,
        covariance=covariance,
        intervals=symmetric_intervals(values, covariance),
        vaf=simulated_vaf(recording, model, values, prediction),
        message=message,
    )


Covariance = Literal["claimed", "sandwich"]


@dataclass(frozen=True)
class WhiteLikelihood:
    """How a search under a white residual ends.

    Attributes
    ----------
    band
        Analysis band [rad/s]; None uses the full sampling rate, as AIAA 2008-7109 does.
    covariance
        ``claimed`` follows from the white residual; ``sandwich`` is measured on the
        residual as it is, see `pilotid.solve.covariance`.
    """

    band: float | None = None
    covariance: Covariance = "claimed"

    def polished(
        self, method: str, recording: Recording, model: PilotModel, found: Minima
    ) -> Estimate:
        """The estimate that the best end of a search leads to.

        Parameters
        ----------
        method
            Name of the method.
        recording, model
            What is fitted.
        found
            The search in a narrower band.
        """
        prediction = predict(recording, model, self.band)
        start = found.values[0]
        terms = OutputErrors(prediction).noticeable_terms(start)
        problem = OutputErrors(replace(prediction, terms=terms))
        end = minimise(problem.gram, start[None], model, tolerance=1e-8)
        values, gram = end.values[0], end.gram[0]
        variance = gram[-1, -1] / (problem.residuals - len(values))
        covariance = covariance_of(gram[:-1, :-1], variance)
        if self.covariance == "sandwich":
            rows = problem.rows(values[None])[0]
            covariance = sandwich(problem.gram, rows, values, prediction.dt)
        if covariance is None:
            return failed(method, model, Outcome.SINGULAR)
        estimate = make_estimate(
            method,
            recording,
            model,
            values,
            covariance,
            converged=bool(end.converged[0]),
            prediction=prediction if self.band is None else None,
        )
        remarks = () if self.covariance == "sandwich" else too_short(problem, values)
        return replace(estimate, iterations=found.iterations + end.iterations, remarks=remarks)


#: Standard errors that are too short by this factor are worth a word.
TOO_SHORT = 1.5


def too_short(problem: OutputErrors, values: FloatArray) -> tuple[Remark, ...]:
    """A remark where the residual is coloured, with what that does to errors claimed as if white.

    The scores' variance over what it would be of a white residual is that of the errors, as in
    `pilotid.solve.covariance.sandwich`.

    Parameters
    ----------
    problem, values
        The problem, and its optimum, shape (parameters,).
    """
    rows = problem.rows(values[None])[0]
    claimed = np.sum(rows[:-1] ** 2, axis=(1, 2)) * np.mean(rows[-1] ** 2)
    found = np.diag(score_products(rows, max(1, round(REACH / problem.prediction.dt))))
    factor = float(np.sqrt(np.median(found / np.maximum(claimed, 1e-300))))
    if not factor > TOO_SHORT:
        return ()
    return (
        Remark(
            "residual-not-white",
            f"the residual is coloured: standard errors and intervals are about {factor:.1f} times "
            "too short, and the estimate is biased in a closed loop; use mle or bayes",
        ),
    )
