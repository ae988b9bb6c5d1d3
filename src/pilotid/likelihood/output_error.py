"""Estimates under a white residual: output error."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from pilotid.estimate.estimate import Estimate, Outcome, failed
from pilotid.likelihood.estimates import make_estimate
from pilotid.likelihood.likelihood import Likelihood
from pilotid.likelihood.prediction import predict
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.solve.covariance import (
    REACH,
    covariance_of,
    hessian,
    sandwich_of,
    score_products,
)
from pilotid.solve.least_squares import Minima, minimise
from pilotid.support.remarks import Remark
from pilotid.support.types import FloatArray

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
        terms = prediction.noticeable_terms(start)
        problem = Likelihood(replace(prediction, nuisance_poles=terms))
        end = minimise(problem.gram, start[None], model, tolerance=1e-8)
        values, gram = end.values[0], end.gram[0]
        variance = gram[-1, -1] / (problem.residuals - len(values))
        covariance = covariance_of(gram[:-1, :-1], variance)
        if self.covariance == "sandwich":
            scores = score_products(*_scored(problem, values))
            covariance = sandwich_of(hessian(problem.gram, values), scores)
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


def _scored(problem: Likelihood, values: FloatArray) -> tuple[FloatArray, int]:
    """Jacobian and residual at one parameter set, and samples over which scores are correlated."""
    return problem.rows(values[None])[0], max(1, round(REACH / problem.prediction.dt))


def too_short(problem: Likelihood, values: FloatArray) -> tuple[Remark, ...]:
    """A remark where the residual is coloured, with what that does to errors claimed as if white.

    The scores' variance over what it would be of a white residual is that of the errors, as in
    `pilotid.solve.covariance.sandwich_of`.

    Parameters
    ----------
    problem, values
        The problem, and its optimum, shape (parameters,).
    """
    rows, reach = _scored(problem, values)
    claimed = np.sum(rows[:-1] ** 2, axis=(1, 2)) * np.mean(rows[-1] ** 2)
    found = np.diag(score_products(rows, reach))
    factor = float(np.sqrt(np.median(found / np.maximum(claimed, 1e-300))))
    if not factor > 1.5:
        return ()
    return (
        Remark(
            "residual-not-white",
            f"the residual is coloured: standard errors and intervals are about {factor:.1f} times "
            "too short, and the estimate is biased in a closed loop; use mle or bayes",
        ),
    )
