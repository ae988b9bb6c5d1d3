"""The second step of a two-step method: a pilot model fitted to a frequency response.

Weighted least squares on complex responses with the full covariance of the first step,
analytic Jacobian, bounds and several starts.  A first step may know fewer combinations of
its responses than it lists (two channels interpolated between the lines of two forcing
functions, a black-box model of few parameters); only those are fitted, each with its own
weight.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pilotid.chance import chi_squared_limit
from pilotid.estimates.estimate import Estimate, Outcome, failed
from pilotid.estimates.parts import FrequencyResponse, real_parts
from pilotid.pilot.model import PilotModel
from pilotid.recordings.recording import Recording
from pilotid.solve.covariance import covariance_of
from pilotid.solve.intervals import profile_intervals
from pilotid.solve.least_squares import Problem, minimise
from pilotid.solve.search import search
from pilotid.time_domain.output_error import concluded, record
from pilotid.types import FloatArray

#: Combinations of responses whose variance is this far below the largest one are taken for
#: known by construction only, and left out.
NEGLIGIBLE = 1e-10


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
        self.whitener = _whitener(response)

    @property
    def residuals(self) -> int:
        """Number of independent residuals."""
        return len(self.whitener)

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


def _whitener(response: FrequencyResponse) -> FloatArray:
    """Rows that turn errors of the response into independent ones of variance 1."""
    # Relative errors are of one size where responses span decades.
    size = np.tile(np.abs(response.value).ravel(), 2)
    scaled = response.covariance / np.outer(size, size)
    variances, directions = np.linalg.eigh(scaled)
    known = variances > NEGLIGIBLE * variances[-1]
    return np.asarray((directions[:, known] / np.sqrt(variances[known])).T / size)


def second_step(
    name: str,
    recording: Recording,
    model: PilotModel,
    response: FrequencyResponse,
    rng: np.random.Generator,
    *,
    problem: Problem | None = None,
    known: FloatArray | None = None,
    candidates: int = 12,
    refined: int = 4,
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
        What to minimise, where the response's own covariance is not all that the first
        step knows.
    known
        An optimum found already, shape (1, parameters).
    candidates, refined
        Random starts screened, and starts minimised, see `pilotid.solve.search.search`.
    """
    problem = problem or ResponseFit(response, model)
    freedom = problem.residuals - len(model.parameters)
    if freedom < 0:
        return failed(
            name,
            model,
            Outcome.NOT_APPLICABLE,
            f"the frequency response gives {problem.residuals} independent numbers, too few for "
            f"the {len(model.parameters)} parameters of model {model.name}",
        )
    found = search(problem.gram, model, rng, known=known, candidates=candidates, refined=refined)
    end = minimise(problem.gram, found.values[:1], model)
    values = end.values[0]
    variance = _excess(float(end.cost[0]), freedom)
    covariance = covariance_of(end.gram[0, :-1, :-1], variance)
    if covariance is None:
        return failed(name, model, Outcome.SINGULAR)
    estimate = concluded(
        name, recording, model, values, covariance, converged=bool(end.converged[0])
    )
    return replace(
        estimate,
        intervals=profile_intervals(problem.gram, model, end, variance, len(values)).intervals,
        iterations=found.iterations + end.iterations,
        starts=record(found),
        frequency_response=response,
    )


def _excess(cost: float, freedom: int) -> float:
    """Variance of the standardised residuals where it is clearly above 1, else 1."""
    if freedom == 0:
        return 1.0
    return cost / freedom if cost > chi_squared_limit(freedom, 1e-3) else 1.0
