"""Least squares from the model's start alone: a method in a package of its own."""

from dataclasses import dataclass
from typing import ClassVar

from pilotid.estimates.estimate import Outcome, failed
from pilotid.solve.covariance import covariance_of
from pilotid.solve.least_squares import minimise
from pilotid.time_domain.conclusion import concluded
from pilotid.time_domain.output_error import OutputErrors
from pilotid.time_domain.prediction import predict


@dataclass(frozen=True)
class OneStart:
    """Output error from one start."""

    band: float = 26.0
    name: ClassVar[str] = "one-start"

    def objection(self, recording, model):
        return None

    def fit(self, recording, model, rng):
        problem = OutputErrors(predict(recording, model, self.band))
        end = minimise(problem.gram, model.start[None], model)
        values, gram, converged = end.values[0], end.gram[0], bool(end.converged[0])
        covariance = covariance_of(gram[:-1, :-1], gram[-1, -1] / problem.residuals)
        if covariance is None:
            return failed(self.name, model, Outcome.SINGULAR)
        return concluded(self.name, recording, model, values, covariance, converged=converged)
