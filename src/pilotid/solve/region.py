"""Intervals about all points that suit as well as the ends of an interval, wherever they lie.

A profile that sets out from the optimum ends at the foot of its hill.  Where the likelihood has
another summit that is nearly as high, one parameter's profile passes over to it and another's
does not; then the intervals contradict one another.  Every point that suits belongs to the
intervals of all its parameters.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pilotid.solve.least_squares import Gram, Space
from pilotid.solve.scale import Scale
from pilotid.solve.walk import walk
from pilotid.types import FloatArray

#: A point that lies beyond an end by more than this share of the interval's length, on the inner
#: scale, is walked on from.
BEYOND = 0.1
#: How often, over all parameters; each round goes on where the one before has come to.
ROUNDS = 3
#: Length of the first step, as a share of the interval's.
REACH = 0.1


class Suiting(NamedTuple):
    """Points whose cost does not exceed the one sought.

    Attributes
    ----------
    values
        Shape (points, parameters).
    costs
        Shape (points,).
    """

    values: FloatArray
    costs: FloatArray

    def joined(self, values: FloatArray, costs: FloatArray, target: float) -> Suiting:
        """These and, of others, those whose cost is not above the target."""
        kept = costs <= target
        return Suiting(
            np.concatenate([self.values, values[kept]]), np.concatenate([self.costs, costs[kept]])
        )


def spanned(
    gram: Gram,
    space: Space,
    suiting: Suiting,
    intervals: FloatArray,
    lowest: float,
    targets: FloatArray,
) -> tuple[FloatArray, Suiting]:
    """Intervals that hold all points that suit, and what of those lies farther out.

    Parameters
    ----------
    gram
        Gram matrices of residual and Jacobian.
    space
        Bounds, at which intervals end.
    suiting
        Points that suit.
    intervals
        What is known of the intervals, of the first parameters, shape (count, 2).
    lowest
        The least cost.
    targets
        The cost of the ends of each interval, shape (count,).

    Returns
    -------
    Intervals, shape (count, 2), and all points that suit, with those that were come upon.
    """
    count = len(intervals)
    scale = Scale(space.positive[:count])
    known = scale.enter(intervals.T).T
    for _ in range(ROUNDS):
        points = scale.enter(suiting.values[:, :count])
        # What suits one parameter may not suit another whose level is lower.
        points = np.where(suiting.costs[:, None] <= targets, points, np.nan)
        hull = np.stack([np.nanmin(points, axis=0), np.nanmax(points, axis=0)], axis=1)
        length = np.diff(known, axis=1)[:, 0]
        sides = np.array([-1.0, 1.0])
        beyond = (hull - known) * sides > BEYOND * length[:, None]
        known = np.stack(
            [np.minimum(known[:, 0], hull[:, 0]), np.maximum(known[:, 1], hull[:, 1])], axis=1
        )
        if not beyond.any():
            break
        for k, side in np.argwhere(beyond).tolist():
            at = int(np.nanargmax(sides[side] * points[:, k]))
            step = sides[side] * max(REACH * float(known[k, 1] - known[k, 0]), 1e-9)
            start = suiting.values[at], float(suiting.costs[at])
            point, cost = walk(gram, space, *start, lowest, float(targets[k]), k, step)
            known[k, side] = scale.enter(point[:count])[k]
            suiting = suiting.joined(point[None], np.array([cost]), float(np.max(targets)))
    ends = np.clip(scale.leave(known.T), space.lower[:count], space.upper[:count])
    return ends.T, suiting
