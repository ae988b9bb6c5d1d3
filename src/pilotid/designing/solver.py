"""Minimises a goal over the powers that linear limits allow.

A barrier method with exact Newton steps (Boyd and Vandenberghe, Convex Optimization, 2004,
ch. 11).  How far from the optimum its answer can be does not rest on it: a linear program
minimises the goal's linear lower bound over the same limits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pilotid.designing.goals import Goal, Terms
from pilotid.types import FloatArray, InputError

GROWTH = 20.0  # of the sharpness from one centre to the next
CLOSE = 1e-6  # of a goal of size 1: where the path ends


@dataclass(frozen=True, eq=False)
class Limit:
    """A linear limit, gradient'powers <= bound.

    Attributes
    ----------
    name
        For sentences: what binds.
    gradient
        Shape (lines,).
    bound
        What it must not exceed.
    equal
        Whether it must be equal to the bound.
    """

    name: str
    gradient: FloatArray
    bound: float
    equal: bool = False

    def room(self, powers: FloatArray) -> float:
        """What it leaves: what doubling it adds to."""
        return abs(self.bound)


@dataclass(frozen=True, eq=False)
class Optimum:
    """Powers, and how good they are.

    Attributes
    ----------
    powers
        Shape (lines,).
    value, lower
        The goal there, and what no powers within the limits can go below.
    prices
        Names of limits and by how much the goal falls where a limit is moved by the whole of
        its bound, largest first; those that do not bind are left out.
    steps
        Newton steps taken.
    """

    powers: FloatArray
    value: float
    lower: float
    prices: tuple[tuple[str, float], ...]
    steps: int


class InfeasibleError(InputError):
    """No powers keep the limits; the message names those that exclude one another."""


def minimised(goal: Goal, limits: Sequence[Limit]) -> Optimum:
    """The powers that minimise a goal within limits; powers are never below zero.

    Raises
    ------
    InfeasibleError
        If there are no such powers.
    """
    bounding = [limit for limit in limits if not limit.equal]
    lines = limits[0].gradient.size
    rows = np.array([*(limit.gradient for limit in bounding), *-np.eye(lines)])
    bounds = np.array([*(limit.bound for limit in bounding), *np.zeros(lines)])
    size = np.maximum(np.abs(rows).max(axis=1), 1e-300)
    rows, bounds = rows / size[:, None], bounds / size
    equal = [limit for limit in limits if limit.equal]
    fixed = np.array([limit.gradient for limit in equal]).reshape(-1, lines)
    levels = np.array([limit.bound for limit in equal])
    names = [*(limit.name for limit in bounding), *[""] * lines]

    powers = _inside(rows, bounds, fixed, levels, names)
    point = np.concatenate([powers, goal.start(powers)])
    wide = np.pad(rows, ((0, 0), (0, goal.extra)))
    free = _free(np.pad(fixed, ((0, 0), (0, goal.extra))))
    count = rows.shape[0] + goal.barriers
    sharpness, steps = count / max(abs(goal.value(powers)), 1e-9), 0
    while True:
        point, taken = _centred(goal, wide, bounds, free, point, sharpness)
        steps += taken
        if count / sharpness < CLOSE * max(abs(goal.value(point[:lines])), 1e-9):
            break
        sharpness *= GROWTH
    powers = point[:lines]
    slack = bounds - rows @ powers
    duals = 1.0 / (sharpness * slack)
    worth: dict[str, float] = {}
    for limit, dual, own in zip(bounding, duals, size, strict=False):
        worth[limit.name] = worth.get(limit.name, 0.0) + float(dual * limit.room(powers) / own)
    value = goal.value(powers)
    floor = 1e-3 * abs(value)
    prices = sorted(((n, w) for n, w in worth.items() if w > floor), key=lambda p: -p[1])
    lower = _lower(goal.cut(point, sharpness), rows, bounds, fixed, levels)
    return Optimum(powers, value, lower, tuple(prices), steps)


def _centred(
    goal: Goal,
    rows: FloatArray,
    bounds: FloatArray,
    free: FloatArray,
    point: FloatArray,
    sharpness: float,
) -> tuple[FloatArray, int]:
    """Newton's way to the minimum of the goal and the barrier."""

    def terms(at: FloatArray) -> Terms:
        slack = bounds - rows @ at
        if not (slack > 0.0).all():
            return Terms(np.inf, at, rows)
        value, gradient, hessian = goal.terms(at, sharpness)
        scaled = rows / slack[:, None]
        return Terms(
            value - float(np.log(slack).sum()),
            gradient + scaled.sum(axis=0),
            hessian + scaled.T @ scaled,
        )

    here = terms(point)
    for step in range(1, 101):
        move = _newton(here, free)
        decrement = -float(here.gradient @ move)
        if decrement < 1e-8:
            return point, step
        length = 1.0
        while True:
            there = terms(point + length * move)
            if there.value <= here.value - 0.1 * length * decrement:
                break
            length *= 0.5
            if length < 1e-9:  # rounding decides
                return point, step
        point, here = point + length * move, there
    return point, step


def _free(fixed: FloatArray) -> FloatArray:
    """Directions that leave equalities as they are, shape (variables, directions)."""
    if not fixed.size:
        return np.eye(fixed.shape[1])
    _, _, right = np.linalg.svd(fixed)
    return np.asarray(right[np.linalg.matrix_rank(fixed) :].T)


def _newton(here: Terms, free: FloatArray) -> FloatArray:
    """The Newton step along the free directions, those that keep the equalities."""
    hessian, gradient = free.T @ here.hessian @ free, free.T @ here.gradient
    scale = 1.0 / np.sqrt(np.maximum(np.diag(hessian), 1e-300))
    matrix = hessian * np.outer(scale, scale)
    try:
        move = np.linalg.solve(matrix, -gradient * scale)
    except np.linalg.LinAlgError:
        move = np.linalg.lstsq(matrix, -gradient * scale, rcond=1e-14)[0]
    return np.asarray(free @ (move * scale))


def _inside(
    rows: FloatArray,
    bounds: FloatArray,
    fixed: FloatArray,
    levels: FloatArray,
    names: Sequence[str],
) -> FloatArray:
    """Powers as far as possible from all limits, by linear programming."""
    from scipy.optimize import linprog

    lines = rows.shape[1]
    answer = linprog(
        np.append(np.zeros(lines), -1.0),
        A_ub=np.column_stack([rows, np.maximum(np.abs(rows).sum(axis=1), 1e-12)]),
        b_ub=bounds,
        A_eq=np.column_stack([fixed, np.zeros(fixed.shape[0])]) if fixed.size else None,
        b_eq=levels if fixed.size else None,
        bounds=[(None, None)] * lines + [(None, 1.0)],
    )
    if answer.x is not None and (rows @ answer.x[:-1] < bounds).all():
        return np.asarray(answer.x[:-1])
    duals = np.zeros(rows.shape[0]) if answer.x is None else np.abs(answer.ineqlin.marginals)
    against = dict.fromkeys(names[i] for i in np.argsort(-duals) if duals[i] > 1e-9 and names[i])
    what = " and ".join(list(against)[:3]) or "the limits"
    raise InfeasibleError(f"no powers of the lines keep {what} at once; widen one of them")


def _lower(
    cut: tuple[float, FloatArray],
    rows: FloatArray,
    bounds: FloatArray,
    fixed: FloatArray,
    levels: FloatArray,
) -> float:
    """What the goal cannot go below within the limits."""
    from scipy.optimize import linprog

    value, gradient = cut
    size = max(float(np.abs(gradient).max()), 1e-300)
    answer = linprog(
        gradient / size,
        A_ub=rows,
        b_ub=bounds,
        A_eq=fixed if fixed.size else None,
        b_eq=levels if fixed.size else None,
        bounds=[(None, None)] * rows.shape[1],
    )
    if answer.status != 0 or answer.fun is None:
        return -np.inf
    return value + size * float(answer.fun)
