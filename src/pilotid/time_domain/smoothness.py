"""The optimum of a model whose parameters go along splines, as smooth as the recording says."""

from __future__ import annotations

from typing import Protocol, Self, TypeVar

import numpy as np

from pilotid.pilot.courses import Curve
from pilotid.pilot.model import PilotModel
from pilotid.remarks import Remark
from pilotid.solve.least_squares import Gram, Minima, Space, minimise
from pilotid.solve.scale import Scale
from pilotid.solve.smoothing import Penalty, Restricted
from pilotid.types import FloatArray

#: What must be known of curves whose smoothness was judged by a white residual.
AGAINST_WHITE = Remark(
    "white-remnant",
    "how smooth the curves are was judged as if the remnant were white, so that they follow the "
    "remnant and their bands are far too narrow; use mle or bayes",
)

ROUNDS = 25  # of weights and optimum in turn, at the most
SETTLED = 0.05  # change of the logarithms of the weights that ends them
TOLERANCE = 1e-5  # of the optima between


class Penalisable(Protocol):
    """A sum of squares that can have a penalty."""

    @property
    def penalty(self) -> Penalty | None:
        """The penalty that it has."""
        ...

    @property
    def gram(self) -> Gram:
        """Gram matrices, see `pilotid.solve.least_squares.Problem`."""
        ...

    @property
    def residuals(self) -> int:
        """Number of residuals."""
        ...

    def penalised(self, penalty: Penalty | None) -> Self:
        """The same with a penalty, or without."""
        ...


P = TypeVar("P", bound=Penalisable)


def smoothed(
    problem: P, space: Space, model: PilotModel, values: FloatArray, tolerance: float
) -> tuple[P, Minima]:
    """The problem with the penalty that suits the recording best, and its optimum.

    Weights are those of the largest restricted likelihood of the problem made linear about the
    optimum, which is then sought anew, until both stay.

    Parameters
    ----------
    problem
        The sum of squares, by the pilot's parameters and any others behind them.
    space
        Their bounds.
    model
        The pilot model; its courses say what is penalised.
    values
        Where to begin, shape (parameters,).
    tolerance
        Of the last optimum.
    """
    free, curves = problem.penalised(None), model.curves
    point = values[None]
    logs: FloatArray | None = None
    for _ in range(ROUNDS):
        last, logs = logs, _restricted(free, space, point, curves).best(logs)
        problem = free.penalised(Penalty(curves, np.exp(logs)))
        end = minimise(problem.gram, point, space, tolerance=TOLERANCE)
        point = end.values[:1]
        if last is not None and np.max(np.abs(logs - last)) < SETTLED:
            break
    return problem, minimise(problem.gram, point, space, tolerance=tolerance)


def criterion_and_degrees(
    problem: Penalisable, space: Space, end: Minima
) -> tuple[float, FloatArray]:
    """How likely an optimum is, and how free its curves are.

    Parameters
    ----------
    problem, space
        The problem with its penalty.
    end
        Its optimum.

    Returns
    -------
    -2 log of the likelihood with the curves integrated out, up to a constant, and the effective
    degrees of freedom of each curve, shape (curves,): 2 of a straight line.
    """
    assert problem.penalty is not None
    free, curves = problem.penalised(None), problem.penalty.curves
    restricted = _restricted(free, space, end.values[:1], curves)
    logs = np.log(problem.penalty.weights)
    return restricted(logs)[0], restricted.degrees(logs)


def _restricted(
    free: Penalisable, space: Space, point: FloatArray, curves: tuple[Curve, ...]
) -> Restricted:
    scale = Scale(space.positive)
    gram = scale.inner(free.gram(point), point)[0]
    return Restricted(gram, scale.enter(point)[0], curves, free.residuals)
