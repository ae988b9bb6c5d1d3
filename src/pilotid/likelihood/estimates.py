"""What an optimum becomes: an estimate with its outcome, intervals and VAF."""

from __future__ import annotations

import numpy as np

from pilotid.estimate.estimate import Estimate, Starts, outcome_of, symmetric_intervals
from pilotid.likelihood.prediction import Prediction, predict
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.solve.least_squares import Minima
from pilotid.support.types import FloatArray


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
