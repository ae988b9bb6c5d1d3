"""The search for the best optimum: screened starts, then local minimisation."""

from __future__ import annotations

from typing import Any

import numpy as np

from pilotid.estimates.estimate import Starts
from pilotid.pilot.model import PilotModel
from pilotid.solve.least_squares import Gram, Minima, Scale, minimise, solve_linear
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


#: How far evolution looks: positive parameters are below and above their usual range by this
#: factor, the range of others is as many times as wide.
WIDER = 2.0


def evolve(
    gram: Gram,
    model: PilotModel,
    rng: np.random.Generator,
    *,
    population: int,
    generations: int,
    tolerance: float = 1e-3,
    linear_gram: Gram | None = None,
) -> Minima:
    """Minimise from the best point that differential evolution finds.

    It looks in the parameters' usual ranges and somewhat beyond, within the bounds.  Gains
    enter linearly: they are solved for, and evolution is left with the others, positive ones on
    a logarithmic scale.  The model's start plays no part.

    Parameters
    ----------
    gram
        Gram matrices of the residual to minimise and its Jacobian.
    model
        Gives the ranges, and the bounds of the last search.
    rng
        Draws the first population and its offspring.
    population
        Points for each parameter that evolves.
    generations
        Largest number of generations.
    tolerance
        Passed to `minimise`.
    linear_gram
        Gram matrices of the residual and its derivatives by the linear parameters alone, which
        evolution needs no more than; None to take them from `gram`.
    """
    scale = Scale(model.positive)
    low, high = (scale.enter(ends) for ends in _widened(model))
    linear = list(model.linear)
    wanted = [*linear, -1]

    def own_gram(values: FloatArray) -> FloatArray:
        return linear_gram(values) if linear_gram else gram(values)[:, wanted][:, :, wanted]

    free = [i for i in range(len(low)) if i not in model.linear]
    # Where a gain would have to be negative, a tenth of this is taken for it.
    base = np.where(model.positive, 10.0 * model.lower, 0.0)

    def solved(points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Whole parameter sets for evolving ones, shape (sets, free), and their costs."""
        values = np.tile(base, (len(points), 1))
        inner = np.tile(low, (len(points), 1))
        inner[:, free] = points
        values[:, free] = scale.leave(inner)[:, free]
        if not linear:
            return values, own_gram(values)[:, -1, -1]
        gains, costs = solve_linear(
            own_gram(values), values[:, linear], tuple(range(len(linear))), model.lower[linear]
        )
        values[:, linear] = gains
        return values, costs

    def cost(points: FloatArray, /) -> Any:  # one for each column: scipy's types do not know
        costs = solved(points.T)[1]
        return np.where(np.isnan(costs), np.inf, costs)

    best = np.zeros(0)
    if free:
        from scipy.optimize import Bounds, differential_evolution

        best = differential_evolution(
            cost,
            Bounds(low[free], high[free]),
            popsize=population,
            maxiter=generations,
            polish=False,
            updating="deferred",
            vectorized=True,
            seed=rng,
        ).x
    return minimise(gram, solved(best[None])[0], model, tolerance=tolerance)


def _widened(model: PilotModel) -> FloatArray:
    """Lower and upper ends of the usual ranges made wider, shape (2, parameters)."""
    low, high = np.array([p.usual for p in model.parameters]).T
    beyond = 0.5 * (WIDER - 1.0) * (high - low)
    low = np.where(model.positive, low / WIDER, low - beyond)
    high = np.where(model.positive, high * WIDER, high + beyond)
    return np.array([np.maximum(low, model.lower), np.minimum(high, model.upper)])
