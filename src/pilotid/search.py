"""The search for the best optimum: screened starts, then local minimisation."""

from __future__ import annotations

import numpy as np

from pilotid.estimate import Starts
from pilotid.minimise import Minima, minimise, solve_linear
from pilotid.model import PilotModel
from pilotid.prediction import LeastSquares
from pilotid.types import FloatArray


def search(
    problem: LeastSquares,
    model: PilotModel,
    rng: np.random.Generator,
    *,
    first: FloatArray | None = None,
    candidates: int = 24,
    refined: int = 2,
    tolerance: float = 1e-3,
    iterations: int = 16,
) -> Minima:
    """Minimise from a first point and from the best of random candidates.

    Gains enter linearly, so that each candidate is judged, and started, with the best
    gains for its other parameters.

    Parameters
    ----------
    problem
        What to minimise.
    model
        Gives start and bounds.
    rng
        Draws the candidates.
    first
        Minimised in any case, shape (1, parameters); None is the model's own start.
    candidates
        Number of random points in the usual ranges that are screened.
    refined
        Number of starts that are minimised, the the first included.
    tolerance, iterations
        Passed to `minimise`; a start that needs more iterations is a bad one.
    """
    first = model.start[None] if first is None else first
    points = np.concatenate([first, draw_starts(model, rng, candidates)])
    if model.linear:
        points, cost = solve_linear(problem.gram(points), points, model.linear, model.lower)
    else:
        cost = problem.gram(points)[:, -1, -1]
    best = np.argsort(cost[1:], kind="stable")[: refined - 1] + 1
    starts = points[np.concatenate([[0], best])]
    return minimise(problem.gram, starts, model, tolerance=tolerance, iterations=iterations)


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
