"""Bounded nonlinear least squares from several starts at once.

Levenberg-Marquardt on the normal equations, with the bounds as an active set, for
all starts in one vectorised sweep.  scipy.optimize.least_squares is the oracle of
the tests; it takes one start at a time and factorises the full Jacobian.  `search` screens starts
before.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from pilotid.support.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class LogTransform:
    """Parameters on their own scale and on the inner one.

    Attributes
    ----------
    positive
        Which parameters are taken by their logarithm, shape (parameters,).
    """

    positive: BoolArray

    def enter(self, values: FloatArray) -> FloatArray:
        """Parameters on the inner scale, shape as given, (..., parameters)."""
        return np.where(self.positive, np.log(np.where(self.positive, values, 1.0)), values)

    def leave(self, points: FloatArray) -> FloatArray:
        """Parameters on their own scale, shape as given, (..., parameters)."""
        return np.where(self.positive, np.exp(np.where(self.positive, points, 0.0)), points)

    def inner(self, grams: FloatArray, values: FloatArray) -> FloatArray:
        """Gram matrices by inner parameters, from those by the parameters at `values`."""
        slope = self._padded(values)
        return grams * slope[:, :, None] * slope[:, None, :]

    def outer(self, grams: FloatArray, values: FloatArray) -> FloatArray:
        """The inverse of `inner`."""
        slope = self._padded(values)
        return grams / slope[:, :, None] / slope[:, None, :]

    def _padded(self, values: FloatArray) -> FloatArray:
        """Slopes by inner parameters, and 1 in the residual's place, (sets, parameters + 1)."""
        slope = np.where(self.positive, values, 1.0)
        return np.concatenate([slope, np.ones((len(values), 1))], axis=1)


# glibc gives memory back after every evaluation, and takes it anew page by page, until it once saw
# so large an array freed (mallopt(3), M_MMAP_THRESHOLD): 15 % of a fit of six runs.
np.empty(4_000_000)

PROMISE = 1.5  # by which decreases are larger than promised, at most, near an optimum
BLOCK = 4  # parameter sets evaluated at once: more no longer fit the processor's cache

#: Maps parameter sets (sets, p) to Gram matrices (sets, p + 1, p + 1), see `Problem.gram`.
Gram = Callable[[FloatArray], FloatArray]


class Problem(Protocol):
    """A sum of squares, by the rows of its Jacobian and its residual.

    Who derives from it gives `rows`, and has `gram`.

    Attributes
    ----------
    block
        Parameter sets evaluated at once.
    """

    block: int = BLOCK

    def rows(self, values: FloatArray) -> FloatArray:
        """Jacobian of the prediction, and below it the residual.

        Parameters
        ----------
        values
            Parameter sets, shape (sets, parameters).

        Returns
        -------
        FloatArray
            Shape (sets, parameters + 1, ...).
        """

    def gram(self, values: FloatArray) -> FloatArray:
        """Inner products of the rows, shape (sets, parameters + 1, parameters + 1).

        The last diagonal element is the residual sum of squares; the last column
        above it is the descent direction J'r.

        Parameters
        ----------
        values
            Parameter sets, shape (sets, parameters).
        """
        grams = [
            self.products(values[begin : begin + self.block])
            for begin in range(0, len(values), self.block)
        ]
        return np.concatenate(grams)

    def products(self, values: FloatArray) -> FloatArray:
        """Inner products of the rows of no more than `block` sets.

        Parameters
        ----------
        values
            Parameter sets, shape (sets, parameters).

        Returns
        -------
        FloatArray
            Shape (sets, parameters + 1, parameters + 1).
        """
        rows = self.rows(values)
        flat = rows.reshape(*rows.shape[:2], -1)
        return np.asarray(flat @ flat.transpose(0, 2, 1))


class Bounds(Protocol):
    """Where a search moves."""

    @property
    def lower(self) -> FloatArray:
        """Lower bounds, shape (parameters,)."""

    @property
    def upper(self) -> FloatArray:
        """Upper bounds, shape (parameters,)."""

    @property
    def positive(self) -> BoolArray:
        """Which parameters move on a logarithmic scale, shape (parameters,)."""


@dataclass(frozen=True, eq=False)
class Box:
    """Bounds as arrays.

    Attributes
    ----------
    lower, upper, positive
        As in `Bounds`.
    """

    lower: FloatArray
    upper: FloatArray
    positive: BoolArray

    @classmethod
    def holding(cls, space: Bounds, which: int, value: float) -> Box:
        """The bounds of a space in which one parameter, by its index, keeps a value."""
        lower, upper = space.lower.copy(), space.upper.copy()
        lower[which] = upper[which] = value
        return cls(lower, upper, space.positive)


@dataclass(frozen=True, eq=False)
class Minima:
    """Where each start ended, best first.

    Attributes
    ----------
    values
        End points, shape (starts, parameters).
    converged
        Whether the stopping rule was met, shape (starts,).
    gram
        Gram matrices at the end points, shape (starts, parameters + 1, parameters + 1).
    curvature
        What secants told of the Hessian beyond the Gram matrix, by logarithms of positive
        parameters, shape (starts, parameters, parameters); it belongs to `gram` and spares a
        search that goes on from here to learn it again.
    iterations
        Iterations of the sweep.
    """

    values: FloatArray
    converged: BoolArray
    gram: FloatArray
    curvature: FloatArray
    iterations: int

    @property
    def cost(self) -> FloatArray:
        """Residual sums of squares, shape (starts,)."""
        return np.asarray(self.gram[:, -1, -1])

    def only(self, which: IntArray | BoolArray | list[int]) -> Minima:
        """Some of the ends, in the order given."""
        values, converged = self.values[which], self.converged[which]
        return Minima(values, converged, self.gram[which], self.curvature[which], self.iterations)

    def best_first(self) -> Minima:
        """The same ends in the order of their costs."""
        return self.only(np.argsort(self.cost, kind="stable"))

    def apart(self, values: FloatArray, residuals: int, which: int = 0) -> float:
        """How far values lie from an end, squared, in standard errors.

        Parameters
        ----------
        values
            The first of the parameters, shape (q,); the others are left out.
        residuals
            Number of independent residuals.
        which
            The end.
        """
        step = values - self.values[which, : len(values)]
        information = self.gram[which, : len(values), : len(values)]
        # Nothing is left where the residual is without noise.
        return float(step @ information @ step) * residuals / max(float(self.cost[which]), 1e-300)


def is_told(excess: FloatArray, told: FloatArray) -> BoolArray:
    """Whether costs above an optimum's are those that its curvature tells, to a factor of two."""
    return (excess > 0.5 * told) & (excess < 2.0 * told)


def minimise(
    gram: Gram,
    starts: FloatArray | Minima,
    space: Bounds,
    *,
    tolerance: float = 1e-9,
    iterations: int = 60,
    above: float = math.inf,
    merge: bool = False,
    is_known: Callable[[FloatArray, FloatArray], BoolArray] | None = None,
    sort: bool = True,
) -> Minima:
    """Minimise a sum of squares within bounds from every start, all at once.

    Positive parameters move on a logarithmic scale, on which the narrow valley of gain
    and lead time, whose product alone is well known, is straight.

    Parameters
    ----------
    gram
        Evaluates Gram matrices of Jacobian and residual.
    starts
        Start points, shape (starts, parameters), or the ends of a search that goes on.
    space
        Bounds of the parameters, and which of them are positive; a model for example.
    tolerance
        Stop when a step is predicted to lower the cost by less than this share.
    iterations
        Largest number of evaluations.
    above
        Cost above which an end is of no use: what promises no such end is given up.
    merge
        Whether a start is left out as soon as an optimum that another has come to tells its cost.
    is_known
        By values, shape (sets, parameters), and costs, which sets a known optimum tells: a start
        that comes to one is left out, and none may be left.
    sort
        Whether the best end comes first; they are in the order of the starts otherwise.
    """
    scale = LogTransform(space.positive)
    lower, upper = scale.enter(space.lower), scale.enter(space.upper)
    # A gain that is extrapolated towards zero would not come back.
    longest = np.where(space.positive, 1.0, 0.25 * (space.upper - space.lower))

    def inner_gram(points: FloatArray) -> FloatArray:
        values = scale.leave(points)
        return scale.inner(gram(values), values)

    if isinstance(starts, Minima):
        clipped = np.clip(starts.values, space.lower, space.upper)
        values, grams = scale.enter(clipped), scale.inner(starts.gram, clipped)
        curvature = starts.curvature.copy()
    else:
        values = scale.enter(np.clip(starts, space.lower, space.upper))
        grams = inner_gram(values)
        curvature = np.zeros_like(grams[:, :-1, :-1])
    damping = np.full(len(values), 1e-3)  # in shares of the diagonal of the Hessian
    converged, alone = np.zeros(len(values), dtype=bool), np.ones(len(values), dtype=bool)
    going, count = np.arange(len(values)), 1
    while going.size and count < iterations:
        was, old, learned = values[going], grams[going], curvature[going]
        step, undamped, promised = _step(old, learned, was, damping[going], lower, upper)
        cost = old[:, -1, -1]
        done = promised <= tolerance * cost
        converged[going[done]] = True
        # Far from the optimum what is promised says little; few leave unstable loops, and soon.
        done |= (cost < 1.02 * above) & (cost - PROMISE * promised > above)
        done |= (cost > 100.0 * above) & (count > 4)
        if merge and converged.any():
            lead = min(np.flatnonzero(converged), key=lambda k: grams[k, -1, -1])
            away, excess = was - values[lead], cost - grams[lead, -1, -1]
            told = np.vecdot(away @ grams[lead, :-1, :-1], away)
            alone[going] = ~is_told(excess, told)
        if is_known:
            alone[going] &= ~is_known(scale.leave(was), cost)
        done |= ~alone[going]
        if done.any():
            was, old, learned, step, undamped, promised = (
                each[~done] for each in (was, old, learned, step, undamped, promised)
            )
            going = going[~done]
            if not going.size:
                break
        step = np.minimum(np.maximum(step, -longest), longest)
        trial = np.minimum(np.maximum(was + step, lower), upper)
        new = inner_gram(trial)
        count += 1
        cost, reached = old[:, -1, -1], new[:, -1, -1]
        better = reached < cost  # false for NaN
        # Far from the optimum a secant says little about the curvature there.
        near = better & (reached > 0.99 * cost)
        learned[near] = _secant(learned[near], old[near], new[near], (trial - was)[near])
        learned[~near] = 0.0
        on, failed = going[better], np.flatnonzero(~better)
        values[on], grams[on], curvature[on] = trial[better], new[better], learned[better]
        damping[on] = np.maximum(damping[on] / 10.0, 1e-9)
        if failed.size:
            # A parabola through what was promised and what came tells how much too long the step
            # was, and the Hessian along it, in shares of its diagonal, how much damping that takes.
            promised, undamped, back = promised[failed], undamped[failed], going[failed]
            stiff = promised / np.maximum(np.vecdot(undamped, undamped), 1e-300)
            rise = (reached - cost)[failed] / np.maximum(promised, 1e-200)
            longer = np.fmin(1.0 + 2.0 * rise, 100.0)  # the latter for NaN
            damping[back] = np.maximum(8.0 * damping[back], longer * stiff)
            # Rounding, not the model, is what keeps a step so damped from lowering the cost.
            stuck = back[damping[back] > 1e7]
            converged[stuck] = np.isfinite(grams[stuck, -1, -1])
            going = going[damping[going] <= 1e7]
    values = np.clip(scale.leave(values), space.lower, space.upper)
    ends = Minima(values, converged, scale.outer(grams, values), curvature, count).only(alone)
    return ends.best_first() if sort else ends


def _step(
    grams: FloatArray,
    curvature: FloatArray,
    values: FloatArray,
    damping: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Damped steps, undamped ones times `_scale`, and the decrease that the latter promise."""
    scale = _scale(grams)
    right = grams[:, :-1, -1] / scale
    matrix = grams[:, :-1, :-1] + curvature
    matrix /= scale[:, :, None] * scale[:, None, :]
    low, high = values <= lower, values >= upper
    if (low | high).any():
        low &= right < 0.0
        high &= right > 0.0
        free = ~(low | high)
        none = np.eye(right.shape[1])
        matrix = np.where(free[:, :, None] & free[:, None, :], matrix, none)
        right = np.where(free, right, 0.0)
    damped, undamped = _solved(matrix, right, damping)
    return damped / scale, undamped, np.vecdot(right, undamped)


def _solved(matrix: FloatArray, right: FloatArray, damping: FloatArray) -> FloatArray:
    """Damped and undamped steps, (2, sets, p); negative curvature is turned: they descend."""
    with suppress(np.linalg.LinAlgError):  # more exact than eigenvalues along a flat valley
        pivots = np.diagonal(np.linalg.cholesky(matrix), axis1=1, axis2=2)
        if pivots.min() > 1e-6:
            damped = matrix + damping[:, None, None] * np.eye(right.shape[1])
            return np.asarray(np.linalg.solve(np.stack([damped, matrix]), right[:, :, None]))[
                ..., 0
            ]
    # A start outside the model's domain has no Hessian; it goes nowhere.
    finite = np.isfinite(matrix).all(axis=(1, 2), keepdims=True)
    eigenvalues, vectors = np.linalg.eigh(np.where(finite, matrix, 0.0))
    eigenvalues = np.maximum(np.abs(eigenvalues), 1e-9)
    along = (right[:, None] @ vectors)[:, 0]
    each = np.stack([along / (eigenvalues + damping[:, None]), along / eigenvalues])
    return np.asarray((vectors @ each[..., None])[..., 0])


def _secant(
    curvature: FloatArray, old: FloatArray, new: FloatArray, step: FloatArray
) -> FloatArray:
    """Symmetric rank-one update of what Gauss-Newton leaves out of the Hessian.

    With a large residual the curvature of the model matters: plain Gauss-Newton
    then overshoots and creeps from side to side.  The change of the gradient along
    each step shows that curvature (Dennis, Gay & Welsch, NL2SOL, 1981).
    """
    change = old[:, :-1, -1] - new[:, :-1, -1]  # of the gradient
    predicted = np.vecdot(new[:, :-1, :-1] + curvature, step[:, None])
    missing = change - predicted
    scale = _scale(new)
    scaled_missing, scaled = missing / scale, step * scale
    product = np.vecdot(missing, step)
    square = np.vecdot(scaled_missing, scaled_missing) * np.vecdot(scaled, scaled)
    trusted = product * product > 1e-6 * square
    factor = np.divide(1.0, product, out=np.zeros_like(product), where=trusted)
    return np.asarray(curvature + (factor[:, None] * missing)[:, :, None] * missing[:, None])


def _scale(grams: FloatArray) -> FloatArray:
    scale = np.sqrt(grams.diagonal(axis1=1, axis2=2)[:, :-1])
    return np.where(scale > 0.0, scale, 1.0)


def solve_linear(
    grams: FloatArray, values: FloatArray, linear: Sequence[int], lower: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Best values of the linear parameters with all others as they are.

    Returns
    -------
    The parameter sets with those values, and the residual sums of squares, where a
    parameter that would leave its lower bound is set to a tenth of its old value.
    """
    index = list(linear)
    hessian = grams[:, index][:, :, index]
    descent = grams[:, index, -1]
    size = np.sqrt(np.einsum("sii->si", hessian))
    size = np.where(size > 0.0, size, 1.0)  # a gain that a change never lets act
    scaled = hessian / (size[:, :, None] * size[:, None, :]) + 1e-10 * np.eye(len(index))
    step = np.linalg.solve(scaled, (descent / size)[:, :, None])[:, :, 0] / size
    old = values[:, index]
    new = np.where(old + step > lower[index], old + step, 0.1 * old)
    change = new - old
    slope = (hessian @ change[:, :, None])[:, :, 0] - 2.0 * descent
    result = values.copy()
    result[:, index] = new
    return result, grams[:, -1, -1] + np.vecdot(change, slope)


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
    """
    first = space.start[None] if known is None else known
    points = np.concatenate([first, draw_starts(space, rng, candidates)])
    points, cost = solve_linear(gram(points), points, space.linear, space.lower)
    if known is not None:
        cost[0] = -np.inf
    # A start that gives no number comes last.
    best = np.argsort(np.where(np.isnan(cost), np.inf, cost), kind="stable")[:refined]
    # A start that needs more iterations is a bad one.
    return minimise(gram, points[best], space, tolerance=1e-3, iterations=16)


def draw_starts(space: SearchSpace, rng: np.random.Generator, count: int) -> FloatArray:
    """Random points in the parameters' usual ranges, shape (count, parameters).

    Positive parameters are drawn on a logarithmic scale.
    """
    low, high = space.usual
    share = rng.uniform(size=(count, len(low)))
    drawn = np.where(space.positive, low * (high / low) ** share, low + share * (high - low))
    return np.asarray(drawn)
