"""The end of a fit: from values and their covariance to an estimate."""

from __future__ import annotations

from pilotid.estimates.estimate import Estimate, outcome_of, symmetric_intervals
from pilotid.pilot.model import PilotModel
from pilotid.recordings.recording import Recording
from pilotid.time_domain.output_error import simulated_vaf
from pilotid.time_domain.prediction import Prediction
from pilotid.types import FloatArray


def concluded(
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
