"""Ends of profile-likelihood intervals, step by step: slow, and sure where Newton's way fails.

The profiled parameter is held at one value after another, and the others are searched anew
each time, within their bounds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pilotid.solve.least_squares import Gram, Space, minimise
from pilotid.solve.scale import Scale
from pilotid.types import BoolArray, FloatArray

#: How often the others are searched, at the most, and how close to the end is close enough, as
#: a share of the distance.
LOOKS, CLOSE = 14, 0.04


@dataclass(frozen=True, eq=False)
class Held:
    """A space in which one parameter keeps its value.

    Attributes
    ----------
    lower, upper, positive
        As in `Space`.
    """

    lower: FloatArray
    upper: FloatArray
    positive: BoolArray

    @classmethod
    def at(cls, space: Space, which: int, value: float) -> Held:
        """A space in which one parameter, by its index, keeps a value."""
        lower, upper = space.lower.copy(), space.upper.copy()
        lower[which] = upper[which] = value
        return cls(lower, upper, space.positive)


def walk(
    gram: Gram,
    space: Space,
    start: FloatArray,
    cost: float,
    lowest: float,
    target: float,
    which: int,
    reach: float,
) -> tuple[FloatArray, float]:
    """Where the least cost at a value of one parameter reaches the target.

    Parameters
    ----------
    gram
        Gram matrices of residual and Jacobian.
    space
        Bounds; the walk ends at them.
    start, cost
        The optimum, or another point that suits, shape (parameters,), and its cost.
    lowest, target
        The cost of the optimum, and the one sought.
    which
        Index of the parameter.
    reach
        Length of the first step, on the inner scale; its sign is the way to go.

    Returns
    -------
    The point, shape (parameters,), and the cost there, which is below the lowest one where the
    walk came upon a better optimum.
    """
    scale = Scale(space.positive)
    bound = float(scale.enter(space.lower if reach < 0.0 else space.upper)[which])
    origin = float(scale.enter(start[None])[0, which])
    allowed = abs(bound - origin)
    inside, outside = 0.0, math.inf
    # The root of the deviance, as a share of that sought, grows about in proportion.
    root_inside, root_outside = math.sqrt(max(cost - lowest, 0.0) / (target - lowest)), math.inf
    distance = min(abs(reach), allowed)
    point = start
    for _ in range(LOOKS):
        trial, trial_cost = _conditional(
            gram, space, point, which, origin + math.copysign(distance, reach), scale
        )
        share = (trial_cost - lowest) / (target - lowest)
        if not share > 1.0:
            point, cost = trial, trial_cost
            inside, root_inside = distance, math.sqrt(max(share, 0.0))
            if share < 0.0 or distance >= allowed or root_inside > 1.0 - CLOSE:
                break
        else:
            outside, root_outside = distance, math.sqrt(share)
        if math.isinf(outside):
            longer = distance / max(root_inside, 1.0 / 3.0) if inside else 2.0 * distance
            distance = min(max(longer, 1.2 * distance), allowed)
            continue
        if outside - inside < CLOSE * outside:
            break
        rise = (1.0 - root_inside) / (root_outside - root_inside) if root_outside < 3.0 else 0.5
        distance = inside + (outside - inside) * min(max(rise, 0.1), 0.9)
    return point, cost


def _conditional(
    gram: Gram, space: Space, start: FloatArray, which: int, place: float, scale: Scale
) -> tuple[FloatArray, float]:
    """The optimum with one parameter held at a place of the inner scale, and its cost."""
    inner = scale.enter(start[None])
    inner[0, which] = place
    values = np.clip(scale.leave(inner)[0], space.lower, space.upper)
    held = Held.at(space, which, float(values[which]))
    end = minimise(gram, values[None], held, tolerance=1e-5)
    cost = float(end.cost[0])
    return end.values[0], cost if math.isfinite(cost) else math.inf
