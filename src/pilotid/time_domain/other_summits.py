"""Other explanations of a recording: what suits it as well as the optimum, elsewhere.

The search may have come upon other summits of the likelihood that are nearly as high.  And where
the optimum lies at a bound of a parameter, the likelihood is far from a parabola and often has
another summit inside the bounds: a slow neuromuscular system with a short delay is not unlike a
fast one with a long delay.  So each parameter at a bound is held at usual values, and the others
are fitted.
"""

from __future__ import annotations

import numpy as np

from pilotid.estimates.estimate import is_at_bound
from pilotid.solve.least_squares import minimise
from pilotid.solve.walk import Held
from pilotid.time_domain.maximum_likelihood import Maximum
from pilotid.types import FloatArray

TOLERANCE, ITERATIONS = 1e-5, 20  # of the fits of all others


def rivals(found: Maximum) -> FloatArray:
    """Other summits, with the optimum's model of the remnant, shape (points, parameters).

    Parameters
    ----------
    found
        The optimum, with the pilots of other summits.
    """
    joint, optimum = found.joint, found.end.values[0]
    starts = [np.concatenate([pilot, optimum[joint.pilot :]]) for pilot in found.rivals]
    if not starts:
        return np.zeros((0, len(optimum)))
    return minimise(
        found.search.gram, np.array(starts), joint, tolerance=TOLERANCE, iterations=ITERATIONS
    ).values


def off_bounds(found: Maximum) -> FloatArray:
    """Optima with parameters held off their bounds, pilot and remnant, shape (points, parameters).

    Parameters
    ----------
    found
        The optimum; without a parameter at a bound there are none.
    """
    joint, optimum = found.joint, found.end.values[0]
    model = joint.prediction.model
    at_bound = np.flatnonzero(is_at_bound(model, found.pilot))
    low, high = np.array([p.usual for p in model.parameters]).T
    middle = np.where(model.positive, np.sqrt(np.abs(low * high)), 0.5 * (low + high))
    bases = [optimum.copy()]
    if found.known is not None:
        # What the lines show rests on no model of the remnant.
        bases.append(np.concatenate([found.known[0], optimum[joint.pilot :]]))
    bases[0][at_bound] = middle[at_bound]
    points = []
    for k in at_bound.tolist():
        for value in (low[k], middle[k], high[k]):
            starts = np.array(bases)
            starts[:, k] = value
            space = Held.at(joint, k, value)
            ends = minimise(
                found.search.gram, starts, space, tolerance=TOLERANCE, iterations=ITERATIONS
            )
            points.append(ends.values)
    return np.concatenate([np.zeros((0, len(optimum))), *points])
