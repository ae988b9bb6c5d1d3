"""Whether the recording bears out an estimate that black-box models have led to.

Such a model is biased where its lags do not hold the pilot, or where its denominator serves
the remnant as well, and the errors claimed for it do not know.  The recording does: one more
fit, of prediction errors whitened by the estimate's own residual (generalised least squares;
Clarke, IFAC symposium Prague 1967), moves a biased estimate away and leaves a sound one where
it is.  Hausman (Econometrica 46, 1978) tests specifications by such a difference.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pilotid.chance import Z95
from pilotid.estimates.estimate import Estimate, Outcome, outcome_of
from pilotid.recordings.recording import Recording
from pilotid.solve.least_squares import minimise
from pilotid.solve.search import search
from pilotid.time_domain.output_error import OutputErrors
from pilotid.time_domain.prediction import Prediction
from pilotid.types import FloatArray

#: Order of the autoregression that whitens the residual.
ORDER = 8
#: How often the residual is whitened anew.
ROUNDS = 2
#: Claimed errors by which prediction errors may move an estimate that is still one.
FARTHEST = 5.0
#: Correlation of control and output from which the controlled element is taken for a gain.
AT_ONCE = 0.98


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
    end = moved(estimate.values, prediction, rng)
    bias = end - estimate.values
    errors = np.abs(bias) / estimate.std_error
    worst = int(np.argmax(errors))
    _, bounds = outcome_of(estimate.model, end, converged=True)
    message = ""
    if errors[worst] > FARTHEST:
        key = estimate.model.keys[worst]
        message = f"prediction errors move {key} by {errors[worst]:.1f} claimed errors"
    elif bounds and estimate.outcome is Outcome.CONVERGED:
        message = f"prediction errors end with {bounds}"
    if message:
        return replace(estimate, outcome=Outcome.CONTRADICTED, message=message)
    reach = np.abs(estimate.intervals - estimate.values[:, None])
    wider = np.hypot(reach, Z95 * np.abs(bias)[:, None]) * [-1.0, 1.0]
    return replace(
        estimate,
        covariance=estimate.covariance + np.outer(bias, bias),
        intervals=np.clip(
            estimate.values[:, None] + wider,
            np.minimum(estimate.model.lower, estimate.values)[:, None],
            np.maximum(estimate.model.upper, estimate.values)[:, None],
        ),
    )


def output_at_once(recording: Recording) -> str | None:
    """Why lags tell nothing of the pilot: the output follows the control at once."""
    if not np.ptp(recording.x):  # not recorded, or still
        return None
    control = recording.u if recording.fd is None else recording.u + recording.fd
    joint = np.corrcoef(control.ravel(), recording.x.ravel())[0, 1]
    if abs(joint) < AT_ONCE:
        return None
    return (
        "the output follows the control at once (the controlled element is a gain), so that a "
        "black box finds the control in its own inputs"
    )


def moved(values: FloatArray, prediction: Prediction, rng: np.random.Generator) -> FloatArray:
    """Where prediction errors move an estimate to, shape (parameters,)."""
    model = prediction.model
    for _ in range(ROUNDS):
        errors = OutputErrors(prediction)
        errors = OutputErrors(prediction, whitener(errors.residual(values), ORDER))
        prediction = replace(prediction, terms=errors.noticeable_terms(values))
        errors = OutputErrors(prediction, errors.taps)
        values = minimise(errors.gram, values[None], model, tolerance=1e-5, iterations=20).values[0]
    # An optimum of both steps may be a local one.
    best = search(errors.gram, model, rng, known=values[None], candidates=12, refined=3)
    # Starts that end in one optimum end at one point, whichever comes first.
    return np.asarray(minimise(errors.gram, best.values[:1], model).values[0])


def whitener(residual: FloatArray, order: int) -> FloatArray:
    """Moving average that makes a residual white, by least squares.

    Parameters
    ----------
    residual
        Shape (runs, samples).
    order
        Order of the autoregression.

    Returns
    -------
    Array of shape (order + 1,), which begins with 1.
    """
    windows = np.lib.stride_tricks.sliding_window_view(residual, order + 1, axis=1)
    rows = windows.reshape(-1, order + 1)[:, ::-1]
    past = np.linalg.lstsq(rows[:, 1:], rows[:, 0], rcond=None)[0]
    return np.concatenate([[1.0], -past])
