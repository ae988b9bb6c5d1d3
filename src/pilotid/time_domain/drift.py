"""A drift of the control that no pilot makes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pilotid.time_domain.prediction_errors import PredictionErrors
from pilotid.time_domain.remnant_choice import suiting
from pilotid.types import FloatArray


def drift_left(joint: PredictionErrors, values: FloatArray) -> tuple[float, FloatArray]:
    """How well a straight line in the control of each run would be seen, beside the pilot.

    A fit takes a drift for slow remnant, and under that remnant it is hardly to be seen.  So the
    remnant's model is chosen again of what a line leaves of the residual, and the line is tested
    under it.

    Parameters
    ----------
    joint
        Pilot and remnant that were fitted.
    values
        Their parameters at the optimum, shape (parameters,).

    Returns
    -------
    statistic, drifts
        Chi-squared with a degree of freedom for each run if there is no drift; and what the
        control gains over the scored part of each run, shape (runs,).
    """
    pilot, band = values[: joint.pilot], joint.band
    terms = tuple(dict.fromkeys((0.0, *joint.prediction.terms)))  # an offset is no drift
    prediction = replace(joint.prediction, terms=terms)
    line = prediction.without_nuisance(np.linspace(-0.5, 0.5, prediction.scored))
    residual = prediction.without_nuisance(prediction.residual(pilot))
    flat = residual - np.outer(residual @ line, line) / (line @ line)
    taps = suiting(flat, band).whitener(band)
    rows = prediction.without_nuisance(prediction.rows(pilot[None], taps))[0]
    *jacobian, errors = rows.reshape(len(rows), -1)
    own = np.array([column / (np.linalg.norm(column) or 1.0) for column in jacobian])
    # What the pilot explains comes first; a line in each run then explains of the rest what it
    # may.  Lines of two runs share no sample, and meet only in what the pilot takes of both.
    basis = np.linalg.qr(own.T).Q
    rest = errors - basis @ (basis.T @ errors)
    across = line @ basis.reshape(prediction.runs, prediction.scored, -1)
    seen = (line @ line) * np.eye(prediction.runs) - across @ across.T
    along = rest.reshape(prediction.runs, prediction.scored) @ line
    found = np.linalg.solve(seen, along)
    explained = along @ found
    freedom = errors.size - len(own) - prediction.runs
    # Whitening makes a line of a line: it multiplies the slope by the sum of the taps.
    drifts = np.asarray(found / np.sum(taps))
    return float(explained * freedom / (rest @ rest - explained)), drifts
