"""The end of every search under a white residual: polished, with its covariance."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from pilotid.estimates.estimate import Estimate, Outcome, failed
from pilotid.pilot.model import PilotModel
from pilotid.recordings.recording import Recording
from pilotid.solve.covariance import covariance_of, sandwich
from pilotid.solve.least_squares import Minima, minimise
from pilotid.time_domain.conclusion import concluded
from pilotid.time_domain.output_error import OutputErrors
from pilotid.time_domain.prediction import predict

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
        terms = OutputErrors(prediction).noticeable_terms(found.values[0])
        problem = OutputErrors(replace(prediction, terms=terms))
        end = minimise(problem.gram, found.values[:1], model, tolerance=1e-6)
        values, gram = end.values[0], end.gram[0]
        variance = gram[-1, -1] / (problem.residuals - len(values))
        covariance = covariance_of(gram[:-1, :-1], variance)
        if self.covariance == "sandwich":
            rows = problem.rows(values[None])[0]
            covariance = sandwich(problem.gram, rows, values, prediction.dt)
        if covariance is None:
            return failed(method, model, Outcome.SINGULAR)
        estimate = concluded(
            method,
            recording,
            model,
            values,
            covariance,
            converged=bool(end.converged[0]),
            prediction=prediction if self.band is None else None,
        )
        return replace(estimate, iterations=found.iterations + end.iterations)
