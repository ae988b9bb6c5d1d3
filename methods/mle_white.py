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

from pilotid.estimates.estimate import Estimate, Outcome, failed, outcome_of, symmetric_intervals
from pilotid.pilot.model import PilotModel
from pilotid.recordings.recording import Recording
from pilotid.solve.covariance import covariance_of, sandwich
from pilotid.solve.least_squares import minimise
from pilotid.solve.search import record, search
from pilotid.time_domain.output_error import LeastSquares, simulated_vaf
from pilotid.time_domain.prediction import predict


@dataclass(frozen=True)
class MLEWhite:
    """Maximum likelihood under a white residual.

    Attributes
    ----------
    band
        Analysis band [rad/s]; None uses the full sampling rate, as the seed did.
    search_band
        Band of the search for the optimum, which the full rate then only polishes.
    candidates, refined
        Random starts screened, and starts minimised, see `pilotid.solve.search.search`.
    covariance
        ``claimed`` follows from the white residual; ``sandwich`` is measured on the
        residual as it is, see `pilotid.solve.covariance`.
    """

    band: float | None = None
    search_band: float = 26.0
    candidates: int = 6
    refined: int = 2
    covariance: Literal["claimed", "sandwich"] = "claimed"
    name: ClassVar[str] = "mle-white"

    def objection(self, recording: Recording, model: PilotModel) -> str | None:
        return None

    def fit(self, recording: Recording, model: PilotModel, rng: np.random.Generator) -> Estimate:
        coarse = LeastSquares(predict(recording, model, self.search_band))
        found = search(coarse.gram, model, rng, candidates=self.candidates, refined=self.refined)
        prediction = predict(recording, model, self.band)
        terms = LeastSquares(prediction).noticeable_terms(found.values[0])
        problem = LeastSquares(replace(prediction, terms=terms))
        end = minimise(problem.gram, found.values[:1], model, tolerance=1e-6)
        values, gram = end.values[0], end.gram[0]
        variance = gram[-1, -1] / (problem.residuals - len(values))
        covariance = covariance_of(gram[:-1, :-1], variance)
        if self.covariance == "sandwich":
            rows = problem.rows(values[None])[0]
            covariance = sandwich(problem.gram, rows, values, prediction.dt)
        if covariance is None:
            return failed(self.name, model, Outcome.SINGULAR)
        outcome, message = outcome_of(model, values, bool(end.converged[0]))
        return Estimate(
            self.name,
            model,
            outcome,
            values=values,
            covariance=covariance,
            intervals=symmetric_intervals(values, covariance),
            vaf=simulated_vaf(recording, model, values, prediction if self.band is None else None),
            message=message,
            iterations=found.iterations + end.iterations,
            starts=record(found),
        )
