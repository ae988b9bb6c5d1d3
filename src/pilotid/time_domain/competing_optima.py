"""Competing optima: parameter sets with nearly the same likelihood as the best fit.

The search may have come upon other local optima that are nearly as high.  Where the optimum lies
at a bound, the likelihood is far from a parabola and often has another optimum inside the bounds:
a slow neuromuscular system with a short delay resembles a fast one with a long delay.  So each
parameter at a bound is fixed at usual values, and the others are fitted.  When a change in time
was, and how fast, has many local optima too: other times and rates are fixed, one after the
other.  Whatever is as likely as the ends of an interval belongs into the intervals.
"""

from __future__ import annotations

import numpy as np

from pilotid.chance import CHI_SQUARED_95, CHI_SQUARED_95_OF_TWO
from pilotid.estimates.estimate import is_at_bound
from pilotid.solve.intervals import FixedParameter
from pilotid.solve.least_squares import minimise
from pilotid.time_domain.maximum_likelihood import Maximum
from pilotid.types import FloatArray

#: Tolerance and iterations of the fits with one parameter fixed, and the same where that is the
#: time or the rate of a change.
TOLERANCE, ITERATIONS = 1e-5, 20
CHANGE_TOLERANCE, CHANGE_ITERATIONS = 1e-3, 10


def competing_optima(found: Maximum) -> FloatArray:
    """Other summits, with the optimum's model of the remnant, shape (points, parameters).

    Parameters
    ----------
    found
        The optimum, with the pilots of other summits.
    """
    joint, optimum = found.joint, found.end.values[0]
    starts = [np.concatenate([pilot, optimum[joint.pilot :]]) for pilot in found.competing]
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
    low, high = model.usual
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
            space = FixedParameter.at(joint, k, value)
            ends = minimise(
                found.search.gram, starts, space, tolerance=TOLERANCE, iterations=ITERATIONS
            )
            points.append(ends.values)
    return np.concatenate([np.zeros((0, len(optimum))), *points])


#: How far beyond the ends of its interval the middle of a change is tried [s].
SHIFTS_BEYOND = (0.25, 0.75, 1.5, 2.5, 4.0, 6.0)
#: Rates at which it is tried there, and that are tried themselves [1/s].
RATES_BEYOND: tuple[float, ...] = (0.4, 20.0)
RATES = (0.1, 0.2, 0.4, 0.8, 2.0, 6.0, 20.0, 100.0)
#: Shifts of the middle at which a rate is tried [s].
SHIFTS_AROUND = (-2.0, -1.0, 0.0, 1.0, 2.0)


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
        beyond = [
            *(ends[0] - far for far in SHIFTS_BEYOND),
            *(ends[1] + far for far in SHIFTS_BEYOND),
        ]
        tried = [(middle, float(value), rate, RATES_BEYOND) for value in beyond]
        near = tuple(float(optimum[middle]) + shift for shift in SHIFTS_AROUND)
        tried += [
            (rate, value, middle, near) for value in RATES if not _inside(value, intervals[rate])
        ]
        for fixed, value, other, starts in tried:
            if not joint.lower[fixed] <= value <= joint.upper[fixed]:
                continue
            points = np.tile(optimum, (len(starts), 1))
            points[:, fixed], points[:, other] = value, starts
            points = np.clip(points, joint.lower, joint.upper)
            fits = minimise(
                joint.gram,
                points,
                FixedParameter.at(joint, fixed, value),
                tolerance=CHANGE_TOLERANCE,
                iterations=CHANGE_ITERATIONS,
            )
            for cost, own in zip(fits.cost, fits.values[:, :pilot], strict=True):
                suits = cost <= target
                result[suits, 0] = np.minimum(result[suits, 0], own[suits])
                result[suits, 1] = np.maximum(result[suits, 1], own[suits])
    return result


def _inside(value: float, interval: FloatArray) -> bool:
    return bool(interval[0] <= value <= interval[1])
