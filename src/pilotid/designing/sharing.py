"""The optimum where the remnant's power is a share of the control's.

The information is then no longer affine in the powers p, but it is in q = c p / (w'p), with w'p
the control that they force and c a constant: only ratios of powers count.  Every limit
a'p <= b is a'q <= b t with t = c / (w'p) for one more variable, so that the problem in q and t
is convex, and its optimum and gap are those in p (Charnes and Cooper, Naval Research Logistics
Quarterly 9, 1962, for fractions of linear functions).  It holds for one pilot: each has a w of
its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pilotid.designing.goals import AnyGoal, Criterion
from pilotid.designing.solver import Limit, Optimum, minimised
from pilotid.types import FloatArray


@dataclass(frozen=True, eq=False)
class _Lifted(Limit):
    """A limit on q and t; t stands last."""

    def room(self, powers: FloatArray) -> float:
        return abs(float(self.gradient[-1] * powers[-1]))


def minimised_sharing(
    goal: AnyGoal, limits: Sequence[Limit], control: FloatArray, level: float
) -> Optimum:
    """The powers that minimise a goal within limits, the remnant growing with the control.

    Parameters
    ----------
    goal
        Of powers under which the remnant has the size that the goal's information holds for.
    limits
        On the powers.
    control
        Variance of the control for each unit of power, shape (lines,).
    level
        Variance of the control at which the remnant has that size.
    """
    rows: list[Limit] = [
        _Lifted(row.name, np.append(row.gradient, -row.bound), 0.0, row.equal) for row in limits
    ]
    rows.append(Limit("control", np.append(control / level, 0.0), 1.0, equal=True))
    wider = [_wider(criterion) for criterion in goal.criteria]
    found = minimised(replace(goal, criteria=wider), rows)
    return replace(found, powers=found.powers[:-1] / found.powers[-1])


def _wider(criterion: Criterion) -> Criterion:
    """The criterion with one more variable, which tells nothing."""
    return replace(criterion, factors=np.pad(criterion.factors, ((0, 1), (0, 0), (0, 0))))
