"""The second step of a two-step method: a pilot model fitted to a frequency response.

Weighted least squares on complex responses with the full covariance of the first step,
analytic Jacobian, bounds and several starts.  A first step may know fewer combinations of
its responses than it lists (two channels interpolated between the lines of two forcing
functions, a black-box model of few parameters); only those are fitted, each with its own
weight.

A black-box model is biased where its lags do not hold the pilot, or where its denominator serves
the remnant as well, and the errors claimed for it do not know.  The recording does: one more
fit, of prediction errors whitened by the estimate's own residual (generalised least squares;
Clarke, IFAC symposium Prague 1967), moves a biased estimate away and leaves a sound one where
it is.  Hausman (Econometrica 46, 1978) tests specifications by such a difference.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pilotid.estimate.estimate import Estimate, Outcome, failed, outcome_of
from pilotid.estimate.quantities import FrequencyResponse, misfit_remark, real_parts
from pilotid.estimate.warnings import lines_objection, motionless_input
from pilotid.likelihood.estimates import make_estimate, starts_of, within_bounds
from pilotid.likelihood.likelihood import Likelihood
from pilotid.likelihood.prediction import Prediction
from pilotid.likelihood.remnant_models import Autoregressive, Whitener, lagged_products
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.solve.intervals import errors_from, profile_intervals, with_information
from pilotid.solve.least_squares import Problem, minimise, search
from pilotid.spectral.coefficients import NEIGHBOURS, TREND, coefficients_of
from pilotid.support.limits import ESTIMATE
from pilotid.support.numbers import Z95, chi_squared_limit, covariance_of
from pilotid.support.types import FloatArray


def first_step_of(recording: Recording, model: PilotModel) -> FrequencyResponse | None:
    """The channels' responses at the forcing lines, None where lines cannot tell them."""
    if motionless_input(recording, model) or lines_objection(recording, model):
        return None
    return coefficients_of(recording, model, NEIGHBOURS, TREND).answered()


class ResponseFit(Problem):
    """Standardised residuals of a frequency response.

    Parameters
    ----------
    response
        What the model is fitted to.
    model
        The pilot model.
    """

    def __init__(self, response: FrequencyResponse, model: PilotModel) -> None:
        self.response = response
        self._at = model.at(response.omega)
        # Relative errors are of one size where responses span decades.
        size = np.tile(np.abs(response.value).ravel(), 2)
        variances, directions = np.linalg.eigh(response.covariance / np.outer(size, size))
        # Combinations whose variance is far below the largest one are known by construction only.
        known = variances > 1e-10 * variances[-1]
        #: Rows that turn errors of the response into independent ones of variance 1.
        self.whitener: FloatArray = (directions[:, known] / np.sqrt(variances[known])).T / size

    def rows(self, values: FloatArray) -> FloatArray:
        """Jacobian and below it the residual, both whitened.

        Parameters
        ----------
        values
            Parameter sets, shape (sets, parameters).

        Returns
        -------
        Array of shape (sets, parameters + 1, residuals).
        """
        rows = self._at(values)
        np.subtract(self.response.value, rows[:, :, -1], out=rows[:, :, -1])
        return real_parts(rows.swapaxes(1, 2)) @ self.whitener.T


def second_step(
    name: str,
    recording: Recording,
    model: PilotModel,
    response: FrequencyResponse,
    rng: np.random.Generator,
    *,
    problem: Problem | None = None,
    known: FloatArray | None = None,
) -> Estimate:
    """Fit a pilot model to a frequency response.

    Where the residuals exceed their errors by more than chance allows, the model cannot
    follow the response, and the claimed variances grow by their ratio.

    Parameters
    ----------
    name
        Name of the method.
    recording
        The recording that the response was estimated from; it gives the VAF.
    model
        The pilot model.
    response
        First step.
    rng
        Draws the random starts.
    problem
        What to minimise, where the response's own covariance is not all that the first step
        knows; a misfit that chance does not make is then told.
    known
        An optimum found already, shape (1, parameters).
    """
    is_tested = problem is not None and recording.runs * recording.duration >= ESTIMATE.tested_from
    problem = problem or ResponseFit(response, model)
    residuals = problem.rows(model.start[None]).shape[-1]
    freedom = residuals - len(model.parameters)
    if freedom < 0:
        return failed(
            name,
            model,
            Outcome.NOT_APPLICABLE,
            f"the frequency response gives {residuals} independent numbers, too few for "
            f"the {len(model.parameters)} parameters of model {model.name}",
        )
    minima = search(problem.gram, model, rng, known=known, candidates=12, refined=4)
    better = minima.values[:1]
    for _ in range(3):
        end = with_information(minimise(problem.gram, better, model), problem.gram)
        cost = float(end.cost[0])
        # The standardised residuals' variance is 1 unless it is larger than chance allows.
        clear = freedom > 0 and cost > chi_squared_limit(freedom, 1e-3)
        variance = cost / freedom if clear else 1.0
        covariance = covariance_of(end.gram[0, :-1, :-1], variance)
        if covariance is None:
            return failed(name, model, Outcome.SINGULAR)
        # Other ends of the search may be as likely.
        profile = profile_intervals(
            problem.gram, model, end, variance, len(covariance), others=minima.values
        )
        if profile.better is None:
            break
        better = profile.better[None]
    assert covariance is not None
    estimate = make_estimate(
        name, recording, model, end.values[0], covariance, converged=bool(end.converged[0])
    )
    remark = misfit_remark(variance**0.5, "; the errors of parameters are wider by as much")
    return replace(
        estimate,
        remarks=(remark,) if clear and is_tested else (),
        intervals=profile.intervals,
        errors=errors_from(end.values[0], profile.intervals, model),
        iterations=minima.iterations + end.iterations,
        starts=starts_of(minima),
        frequency_response=response,
    )


#: Claimed errors by which prediction errors may move an estimate that is still one.
MAX_MOVE = 5.0


def against_recording(
    estimate: Estimate, prediction: Prediction, rng: np.random.Generator
) -> Estimate:
    """The estimate with errors that hold its bias, or refused if that is all it is.

    Variances grow by the squares of how far prediction errors move the estimate, intervals
    with them.

    Parameters
    ----------
    estimate
        An estimate from the responses of a black-box model.
    prediction
        The recording, in the band of that model.
    rng
        Draws the starts of a search for a better optimum.
    """
    if not estimate.outcome.usable:
        return estimate
    values = estimate.values
    end = moved(values, prediction, rng)
    bias = end - values
    errors = np.abs(bias) / np.sqrt(np.diag(estimate.covariance))
    worst = int(np.argmax(errors))
    _, bounds = outcome_of(estimate.model, end, converged=True)
    message = ""
    if errors[worst] > MAX_MOVE:
        key = estimate.model.keys[worst]
        message = f"prediction errors move {key} by {errors[worst]:.1f} claimed errors"
    elif bounds and estimate.outcome is Outcome.CONVERGED:
        message = f"prediction errors end with {bounds}"
    if message:
        return replace(estimate, outcome=Outcome.CONTRADICTED, message=message)
    reach = np.abs(estimate.intervals - values[:, None])
    wider = np.hypot(reach, Z95 * np.abs(bias)[:, None]) * [-1.0, 1.0]
    return replace(
        estimate,
        covariance=estimate.covariance + np.outer(bias, bias),
        errors=np.hypot(estimate.std_error, bias),
        intervals=within_bounds(estimate.model, values, values[:, None] + wider),
    )


def moved(values: FloatArray, prediction: Prediction, rng: np.random.Generator) -> FloatArray:
    """Where prediction errors move an estimate to, shape (parameters,)."""
    model = prediction.model
    for _ in range(2):
        residual = prediction.errors(values)
        guess, _ = Autoregressive(8).guess(lagged_products(residual), prediction.window.band)
        taps = np.append(1.0, guess)
        prediction = prediction.with_noticeable_terms(values, taps)
        errors = Likelihood(prediction, Whitener(taps))
        values = minimise(errors.gram, values[None], model, tolerance=1e-5, iterations=20).values[0]
    # An optimum of both steps may be a local one.
    best = search(errors.gram, model, rng, known=values[None], candidates=12, refined=3)
    # Starts that end in one optimum end at one point, whichever comes first.
    return np.asarray(minimise(errors.gram, best.values[:1], model).values[0])
