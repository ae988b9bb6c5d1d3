"""The search for the best optimum: screened starts, then local minimisation."""

from __future__ import annotations

import numpy as np

from pilotid.estimates.estimate import Starts
from pilotid.pilot.model import PilotModel
from pilotid.solve.least_squares import Gram, Minima, minimise, solve_linear
from pilotid.types import FloatArray


def search(
    gram: Gram,
    model: PilotModel,
    rng: np.random.Generator,
    *,
    known: FloatArray | None = None,
    candidates: int = 8,
    refined: int = 2,
    tolerance: float = 1e-3,
    iterations: int = 16,
) -> Minima:
    """Minimise from the best of several starts.

    The model's own start competes with random ones.  Gains enter linearly, so that each
    is judged, and started, with the best gains for its other parameters.

    Parameters
    ----------
    gram
        Gram matrices of the residual to minimise and its Jacobian.
    model
        Gives the first start, and the ranges of the others.
    rng
        Draws the random starts.
    known
        An optimum known already, shape (1, parameters), which is minimised in any case.
    candidates
        Number of random points in the usual ranges that are screened.
    refined
        Number of starts that are minimised, the known optimum included.
    tolerance, iterations
        Passed to `minimise`; a start that needs more iterations is a bad one.
    """
    own = model.start[None] if known is None else known
    points = np.concatenate([own, draw_starts(model, rng, candidates)])
    if model.linear:
        points, cost = solve_linear(gram(points), points, model.linear, model.lower)
    else:
        cost = gram(points)[:, -1, -1]
    if known is not None:
        cost[0] = -np.inf
    # A start that gives no number comes last.
    best = np.argsort(np.where(np.isnan(cost), np.inf, cost), kind="stable")[:refined]
    return minimise(gram, points[best], model, tolerance=tolerance, iterations=iterations)


def draw_starts(model: PilotModel, rng: np.random.Generator, count: int) -> FloatArray:
    """Random points in the parameters' usual ranges, shape (count, parameters).

    Positive parameters are drawn on a logarithmic scale.
    """
    share = rng.uniform(size=(count, len(model.parameters)))
    low, high = np.array([p.usual for p in model.parameters]).T
    drawn = np.where(model.positive, low * (high / low) ** share, low + share * (high - low))
    return np.asarray(drawn)


def record(minima: Minima, same: float = 3e-3) -> Starts:
    """How many starts ended in the best optimum, costs within the share `same` of it."""
    relative = minima.cost / minima.cost[0] if minima.cost[0] > 0.0 else np.ones(len(minima.cost))
    return Starts(cost=relative, agreeing=int(np.sum(relative <= 1.0 + same)))
