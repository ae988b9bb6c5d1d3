"""Time-domain maximum likelihood with a white residual.

The likelihood of AIAA 2008-7109 (output error, residual assumed white), without that
route's approximations: exact delays, bounds, several starts, transients handled, runs
fitted jointly.

Assumes that the remnant is white.  For a coloured remnant the estimate is biased in a
closed loop, however long the recording, and its standard errors are far too small; use
`mle` then.  The sandwich covariance mends the standard errors, not the bias: intervals
are then honest about where the biased estimate lies.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from pilotid.estimates.estimate import Estimate, Outcome, failed
from pilotid.pilot.model import PilotModel
from pilotid.recordings.recording import Recording
from pilotid.solve.covariance import covariance_of, sandwich
from pilotid.solve.least_squares import minimise
from pilotid.solve.search import record, search
from pilotid.time_domain.conclusion import concluded
from pilotid.time_domain.output_error import OutputErrors
from pilotid.time_domain.prediction import predict
from pilotid.time_domain.settings import SearchSettings


@dataclass(frozen=True)
class MLEWhite(SearchSettings):
    """Maximum likelihood under a white residual.

    Attributes
    ----------
    search_band, candidates, refined
        See `pilotid.time_domain.settings.SearchSettings`; what the search finds is only
        polished in the analysis band.
    band
        Analysis band [rad/s]; None uses the full sampling rate, as the paper does.
    covariance
        ``claimed`` follows from the white residual; ``sandwich`` is measured on the
        residual as it is, see `pilotid.solve.covariance`.
    """

    band: float | None = None
    covariance: Literal["claimed", "sandwich"] = "claimed"
    name: ClassVar[str] = "mle-white"

    def objection(self, recording: Recording, model: PilotModel) -> str | None:
        """None: any recording and any model will do."""
        return None

    def fit(self, recording: Recording, model: PilotModel, rng: np.random.Generator) -> Estimate:
        """Minimise the sum of squares of the residual.

        Parameters
        ----------
        recording
            The recording; all its runs are fitted jointly.
        model
            The pilot model, whose start is one of the starts of the search.
        rng
            Draws the other starts.
        """
        coarse = OutputErrors(predict(recording, model, self.search_band))
        found = search(coarse.gram, model, rng, candidates=self.candidates, refined=self.refined)
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
            return failed(self.name, model, Outcome.SINGULAR)
        estimate = concluded(
            self.name,
            recording,
            model,
            values,
            covariance,
            converged=bool(end.converged[0]),
            prediction=prediction if self.band is None else None,
        )
        return replace(estimate, iterations=found.iterations + end.iterations, starts=record(found))
