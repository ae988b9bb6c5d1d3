"""Intervals where a change in time may have been elsewhere.

The likelihood has one optimum beside the other in when a change was and how fast; a profile that
sets out from the best one ends at the foot of that hill.  So other times and rates are held, one
after the other, and all that suits the recording as well as the ends of an interval lies inside
the intervals, of whatever parameter.
"""

from __future__ import annotations

import numpy as np

from pilotid.chance import CHI_SQUARED_95, CHI_SQUARED_95_OF_TWO
from pilotid.solve.least_squares import minimise
from pilotid.solve.walk import Held
from pilotid.time_domain.maximum_likelihood import Maximum
from pilotid.types import FloatArray

#: How far beyond the ends of its interval the middle of a change is tried [s].
BEYOND = (0.25, 0.75, 1.5, 2.5, 4.0, 6.0)
#: Rates at which it is tried there, and that are tried themselves [1/s].
SHAPES: tuple[float, ...] = (0.4, 20.0)
RATES = (0.1, 0.2, 0.4, 0.8, 2.0, 6.0, 20.0, 100.0)
#: Shifts of the middle at which a rate is tried [s].
AROUND = (-2.0, -1.0, 0.0, 1.0, 2.0)
TOLERANCE, ITERATIONS = 1e-3, 10  # of the fits of all others


def deviances(found: Maximum) -> FloatArray:
    """Deviance that the intervals of the pilot's parameters go to, shape (parameters,).

    When a change was and how fast are one event with many optima, and the likeliest of these
    exceeds the truth by more than a single parameter's share: intervals of both are the shadows of
    their joint region, that of two degrees of freedom (docs/adapting.md has what was measured).

    Parameters
    ----------
    found
        The optimum.
    """
    sought = np.full(found.joint.pilot, CHI_SQUARED_95)
    for when in found.joint.prediction.model.whens:
        sought[list(when)] = CHI_SQUARED_95_OF_TWO
    return np.asarray(found.widened * found.by_element * sought)


def over_changes(found: Maximum, intervals: FloatArray, sought: FloatArray | float) -> FloatArray:
    """Intervals (parameters, 2) that hold the optima of other changes, too.

    Parameters
    ----------
    found
        The optimum.
    intervals
        Those of the profile about it.
    sought
        Deviance that an interval goes to, one or that of each parameter.
    """
    joint, end = found.joint, found.end
    optimum, pilot = end.values[0], joint.pilot
    share = np.broadcast_to(sought, pilot) / (joint.residuals - len(optimum))
    target = float(end.cost[0]) * np.exp(share)
    result = intervals.copy()
    for when in dict.fromkeys(joint.prediction.model.whens):
        if not when:
            continue
        middle, rate = when
        ends = intervals[middle]
        beyond = [*(ends[0] - far for far in BEYOND), *(ends[1] + far for far in BEYOND)]
        tried = [(middle, float(value), rate, SHAPES) for value in beyond]
        near = tuple(float(optimum[middle]) + shift for shift in AROUND)
        tried += [
            (rate, value, middle, near) for value in RATES if not _inside(value, intervals[rate])
        ]
        for held, value, other, starts in tried:
            if not joint.lower[held] <= value <= joint.upper[held]:
                continue
            points = np.tile(optimum, (len(starts), 1))
            points[:, held], points[:, other] = value, starts
            points = np.clip(points, joint.lower, joint.upper)
            fits = minimise(
                joint.gram,
                points,
                Held.at(joint, held, value),
                tolerance=TOLERANCE,
                iterations=ITERATIONS,
            )
            for cost, own in zip(fits.cost, fits.values[:, :pilot], strict=True):
                suits = cost <= target
                result[suits, 0] = np.minimum(result[suits, 0], own[suits])
                result[suits, 1] = np.maximum(result[suits, 1], own[suits])
    return result


def _inside(value: float, interval: FloatArray) -> bool:
    return bool(interval[0] <= value <= interval[1])
