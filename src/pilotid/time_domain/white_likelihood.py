"""The end of every search under a white residual: polished, with its covariance."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from pilotid.estimates.estimate import Estimate, Outcome, failed
from pilotid.pilot.frozen import unfrozen
from pilotid.pilot.model import PilotModel
from pilotid.recordings.recording import Recording
from pilotid.solve.covariance import covariance_of, sandwich
from pilotid.solve.least_squares import Minima, minimise
from pilotid.time_domain.conclusion import concluded
from pilotid.time_domain.output_error import OutputErrors
from pilotid.time_domain.prediction import predict
from pilotid.time_domain.smoothness import AGAINST_WHITE, smoothed

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
            The search in a narrower band, of the model that `searched` says.
        """
        prediction = predict(recording, model, self.band)
        start = unfrozen(model, found.values[0]) if model.curves else found.values[0]
        terms = OutputErrors(prediction).noticeable_terms(start)
        problem = OutputErrors(replace(prediction, terms=terms))
        if model.curves:
            problem, end = smoothed(problem, model, model, start, 1e-6)
        else:
            end = minimise(problem.gram, start[None], model, tolerance=1e-8)
        values, gram = end.values[0], end.gram[0]
        variance = gram[-1, -1] / (problem.residuals - len(values))
        covariance = covariance_of(gram[:-1, :-1], variance)
        if self.covariance == "sandwich":
            rows = problem.rows(values[None])[0]
            prior = None
            if problem.penalty is not None:
                prior = variance * problem.penalty.gram(values[None])[0, :-1, :-1]
            covariance = sandwich(problem.gram, rows, values, prediction.dt, prior=prior)
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
        return replace(
            estimate,
            iterations=found.iterations + end.iterations,
            remarks=(AGAINST_WHITE,) if model.curves else (),
        )
