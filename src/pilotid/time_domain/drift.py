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
    rest = residual - np.outer(residual @ line, line) / (line @ line)
    taps = suiting(rest, band).whitener(band)
    rows = prediction.without_nuisance(prediction.rows(pilot[None], taps))[0]
    *jacobian, errors = rows.reshape(len(rows), -1)
    own = [column / (np.linalg.norm(column) or 1.0) for column in jacobian]
    # Whitening makes a line of a line: it multiplies the slope by the sum of the taps.
    lines = np.kron(np.eye(prediction.runs), line)
    table = np.column_stack([*own, *lines, errors])
    # The triangle of a regression: its last column tells what each column explains in turn.
    triangle: FloatArray = np.asarray(np.linalg.qr(table, mode="r"))
    explained, left = triangle[len(own) : -1, -1], triangle[-1, -1] ** 2
    freedom = errors.size - len(own) - len(lines)
    found = np.linalg.solve(triangle[len(own) : -1, len(own) : -1], explained)
    drifts = np.asarray(found / np.sum(taps))
    return float(explained @ explained * freedom / left), drifts
