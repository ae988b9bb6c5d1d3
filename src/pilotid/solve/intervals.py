"""Profile-likelihood intervals.

The interval of a parameter holds the values at which the likelihood, maximised over
all other parameters, falls short of its maximum by less than the 95 % quantile of
chi-squared allows.  Unlike value +- 1.96 standard errors it follows the likelihood
where it is skewed, as in gain and lead time.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pilotid.chance import CHI_SQUARED_95
from pilotid.solve.least_squares import Gram, Minima, Space
from pilotid.solve.scale import Scale
from pilotid.solve.walk import walk
from pilotid.types import BoolArray, FloatArray, IntArray

LONGEST_STEP = 1.0  # standard errors an iteration may move the profiled parameter
FIRST_STEP = 1.5  # the same of the first one, in lengths of the quadratic interval
BETTER = 0.2  # deviance by which a point must be lower than the minimum to take its place


class Profile(NamedTuple):
    """Profile-likelihood intervals, and a better optimum if the search came upon one.

    Attributes
    ----------
    intervals
        Lower and upper ends, shape (count, 2).
    better
        A point whose deviance is lower than the minimum's, shape (parameters,), or None.
    """

    intervals: FloatArray
    better: FloatArray | None


def profile_intervals(
    gram: Gram,
    space: Space,
    minimum: Minima,
    variance: float,
    count: int,
    *,
    estimated: int | None = None,
    widened: float | FloatArray = 1.0,
    iterations: int = 8,
    tolerance: float = 0.3,
) -> Profile:
    """95 % profile-likelihood intervals of the first `count` parameters.

    All end points are sought at once by Newton steps (Venzon & Moolgavkar, Applied
    Statistics 37, 1988): along the profiled parameter to the sought level, in all
    others to their conditional optimum.  Ends that are not found that way are sought by `walk`.

    Parameters
    ----------
    gram
        Gram matrices of residual and Jacobian.
    space
        Bounds; an interval ends at them.
    minimum
        The optimum, whose first entry counts.
    variance
        Variance of the residuals, 1 where they are standardised.
    count
        How many parameters.
    estimated
        Number of residuals less parameters, if the variance was estimated from them.
    widened
        Factor on the deviance sought, for small samples; one, or one of each parameter, shape
        (count,).
    iterations, tolerance
        Largest number of evaluations, and how far from the sought deviance, of 3.84, the
        last Newton step may begin.
    """
    scale = Scale(space.positive)
    lower, upper = scale.enter(space.lower), scale.enter(space.upper)
    best = scale.enter(minimum.values[:1])
    lowest = float(minimum.cost[0])
    which = np.tile(np.arange(count), 2)
    side = np.repeat([-1.0, 1.0], count)
    sought = np.broadcast_to(CHI_SQUARED_95 * np.asarray(widened), count)[which]
    target = lowest + sought * variance
    if estimated is not None:
        # The variance is then one more parameter, maximised over as well.
        target = lowest * np.exp(sought / estimated)

    gram_there = scale.inner(minimum.gram[:1], minimum.values[:1])
    error = _errors(gram_there[0], _blocked(gram_there, best, lower, upper)[0], variance)[:count]
    # On the ridge of the quadratic approximation.
    points = np.repeat(best, 2 * count, axis=0)
    grams = np.repeat(gram_there, 2 * count, axis=0)
    longest = FIRST_STEP * np.sqrt(sought) * error[which]
    blocked = _blocked(grams, points, lower, upper)
    ridge, _ = _step(grams, blocked, which, side, longest, target)
    points = np.clip(points + ridge, lower, upper)
    active = np.arange(2 * count)
    found = np.zeros(2 * count, dtype=bool)
    better, least = None, lowest - BETTER * variance
    for _ in range(iterations):
        values = scale.leave(points[active])
        grams = scale.inner(gram(values), values)
        costs = grams[:, -1, -1]
        if np.nanmin(costs, initial=np.inf) < least:
            best_of_all = int(np.nanargmin(costs))
            better, least = values[best_of_all], float(costs[best_of_all])
        k, direction = which[active], side[active]
        blocked = _blocked(grams, points[active], lower, upper)
        goal = target[active]
        step, off = _step(grams, blocked, k, direction, LONGEST_STEP * error[k], goal)
        deviance_off = np.abs(grams[:, -1, -1] - goal) / variance
        at_bound = (points[active, k] <= lower[k]) & (direction < 0)
        at_bound |= (points[active, k] >= upper[k]) & (direction > 0)
        # A bound that was overshot to, where the deviance is too high, is left again.
        at_bound &= step[np.arange(len(k)), k] * direction >= 0.0
        reached = (deviance_off < tolerance) & (off < tolerance * variance)
        found[active] = reached | (at_bound & (costs <= goal))
        done = reached | at_bound
        moved = np.clip(points[active] + step, lower, upper)
        points[active] = np.where(at_bound[:, None], points[active], moved)
        active = active[~done]
        if not active.size:
            break
    # Where the likelihood has another summit the search may end on its side.
    found &= (points[np.arange(2 * count), which] - best[0, which]) * side >= 0.0
    ends = scale.leave(points)[np.arange(2 * count), which]
    if better is None:
        for i in np.flatnonzero(~found):
            index = int(which[i])
            reach = float(side[i]) * math.sqrt(sought[i]) * float(error[index])
            end = float(target[i])
            point, cost = walk(gram, space, minimum.values[0], lowest, end, index, reach)
            ends[i] = point[index]
            if cost < least:
                better, least = point, cost
    best_values = minimum.values[0, :count]
    intervals = np.stack(
        [np.minimum(ends[:count], best_values), np.maximum(ends[count:], best_values)], axis=1
    )
    return Profile(intervals, better)


def _blocked(
    grams: FloatArray, points: FloatArray, lower: FloatArray, upper: FloatArray
) -> BoolArray:
    """Which parameters lie at a bound that descent leads beyond, shape (points, parameters)."""
    descent = grams[:, :-1, -1]
    return np.asarray(((points <= lower) & (descent < 0.0)) | ((points >= upper) & (descent > 0.0)))


def _errors(gram: FloatArray, blocked: BoolArray, variance: float) -> FloatArray:
    """Standard errors, each with all other parameters free but those held by their bounds."""
    hessian = gram[:-1, :-1]
    errors = np.empty(len(hessian))
    for k in range(len(hessian)):
        held = blocked & (np.arange(len(hessian)) != k)
        free = np.where(held[:, None] | held, np.eye(len(hessian)), hessian)
        size = np.sqrt(np.maximum(np.diag(free), 1e-300))
        own = float(np.linalg.inv(free / np.outer(size, size))[k, k])
        errors[k] = math.sqrt(max(own, 1.0) * variance) / float(size[k])
    return errors


def _step(
    grams: FloatArray,
    blocked: BoolArray,
    which: IntArray,
    side: FloatArray,
    longest: FloatArray,
    target: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Steps to the level sought, and what the other parameters still promise."""
    index = np.arange(len(grams))
    hessian, descent = grams[:, :-1, :-1], grams[:, :-1, -1]
    # Rows and columns of the profiled parameter, and of those that a bound holds, are replaced
    # by those of the identity.
    held = blocked.copy()
    held[index, which] = True
    others = np.where(held[:, :, None] | held[:, None, :], np.eye(held.shape[1]), hessian)
    across = np.where(held, 0.0, hessian[index, which])
    right = np.where(held, 0.0, descent)
    solved = _solved(others, np.stack([right, across], axis=-1))
    to_optimum, along_ridge = solved[..., 0], solved[..., 1]
    gained = np.einsum("sp,sp->s", right, to_optimum)
    slope = descent[index, which] - np.einsum("sp,sp->s", across, to_optimum)
    curvature = hessian[index, which, which] - np.einsum("sp,sp->s", across, along_ridge)
    curvature = np.maximum(curvature, 1e-30)
    # cost - gained - 2 slope t + curvature t^2 = target, the root on the outer side
    excess = grams[:, -1, -1] - gained - target
    root = np.sqrt(np.maximum(slope**2 - curvature * excess, 0.0))
    move = np.clip((slope + side * root) / curvature, -longest, longest)
    step = to_optimum - move[:, None] * along_ridge
    step[index, which] = move
    return step, gained


def _solved(matrices: FloatArray, right: FloatArray) -> FloatArray:
    """Solutions of linear systems, of least norm where one is singular."""
    try:
        return np.asarray(np.linalg.solve(matrices, right))
    except np.linalg.LinAlgError:
        # Far from the optimum, or at a bound, a parameter may lose all influence.
        return np.asarray(np.linalg.pinv(matrices) @ right)
