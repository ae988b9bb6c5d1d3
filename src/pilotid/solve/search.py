"""The search for the best optimum: screened starts, then local minimisation."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from pilotid.solve.least_squares import Bounds, Gram, LogTransform, Minima, minimise, solve_linear
from pilotid.support.types import FloatArray


class SearchSpace(Bounds, Protocol):
    """Bounds, and where in them to begin."""

    @property
    def start(self) -> FloatArray:
        """Default start, shape (parameters,)."""

    @property
    def usual(self) -> FloatArray:
        """Ends of the ranges that random starts are drawn from, shape (2, parameters)."""

    @property
    def linear(self) -> tuple[int, ...]:
        """Indices of the parameters that the residual is linear in."""


def search(
    gram: Gram,
    space: SearchSpace,
    rng: np.random.Generator,
    *,
    known: FloatArray | None = None,
    candidates: int = 8,
    refined: int = 2,
    tolerance: float = 1e-3,
    iterations: int = 16,
) -> Minima:
    """Minimise from the best of several starts.

    The space's own start competes with random ones.  Gains enter linearly, so that each
    is judged, and started, with the best gains for its other parameters.

    Parameters
    ----------
    gram
        Gram matrices of the residual to minimise and its Jacobian.
    space
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
    own = space.start[None] if known is None else known
    points = np.concatenate([own, draw_starts(space, rng, candidates)])
    if space.linear:
        points, cost = solve_linear(gram(points), points, space.linear, space.lower)
    else:
        cost = gram(points)[:, -1, -1]
    if known is not None:
        cost[0] = -np.inf
    # A start that gives no number comes last.
    best = np.argsort(np.where(np.isnan(cost), np.inf, cost), kind="stable")[:refined]
    return minimise(gram, points[best], space, tolerance=tolerance, iterations=iterations)


def draw_starts(space: SearchSpace, rng: np.random.Generator, count: int) -> FloatArray:
    """Random points in the parameters' usual ranges, shape (count, parameters).

    Positive parameters are drawn on a logarithmic scale.
    """
    low, high = space.usual
    share = rng.uniform(size=(count, len(low)))
    drawn = np.where(space.positive, low * (high / low) ** share, low + share * (high - low))
    return np.asarray(drawn)


def evolve(
    gram: Gram,
    space: SearchSpace,
    rng: np.random.Generator,
    *,
    population: int,
    generations: int,
    tolerance: float = 1e-3,
) -> Minima:
    """Minimise from the best point that differential evolution finds.

    It looks in the parameters' usual ranges and somewhat beyond, within the bounds.  Gains
    enter linearly: they are solved for, and evolution is left with the others, positive ones on
    a logarithmic scale.  The space's start plays no part.

    Parameters
    ----------
    gram
        Gram matrices of the residual to minimise and its Jacobian.
    space
        Gives the ranges, and the bounds of the last search.
    rng
        Draws the first population and its offspring.
    population
        Points for each parameter that evolves.
    generations
        Largest number of generations.
    tolerance
        Passed to `minimise`.
    """
    free = [i for i in range(len(space.start)) if i not in space.linear]
    scale = LogTransform(space.positive[free])
    low, high = space.usual
    # Below and above their usual range by a factor of 2; the range of others is twice as wide.
    beyond = 0.5 * (high - low)
    low = np.maximum(np.where(space.positive, low / 2.0, low - beyond), space.lower)
    high = np.minimum(np.where(space.positive, high * 2.0, high + beyond), space.upper)
    # Where a gain would have to be negative, a tenth of this is taken for it.
    base = np.where(space.positive, 10.0 * space.lower, 0.0)

    def solved(points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Whole parameter sets for evolving ones, shape (sets, free), and their costs."""
        values = np.tile(base, (len(points), 1))
        values[:, free] = scale.leave(points)
        grams = gram(values)
        if not space.linear:
            return values, grams[:, -1, -1]
        return solve_linear(grams, values, space.linear, space.lower)

    def cost(points: FloatArray, /) -> Any:  # one for each column: scipy's types do not know
        costs = solved(points.T)[1]
        return np.where(np.isnan(costs), np.inf, costs)

    best = np.zeros(0)
    if free:
        from scipy.optimize import Bounds as Box
        from scipy.optimize import differential_evolution

        best = differential_evolution(
            cost,
            Box(scale.enter(low[free]), scale.enter(high[free])),
            popsize=population,
            maxiter=generations,
            polish=False,
            updating="deferred",
            vectorized=True,
            seed=rng,
        ).x
    return minimise(gram, solved(best[None])[0], space, tolerance=tolerance)
