"""Profile-likelihood intervals, and the covariance of a least-squares estimate.

The interval of a parameter holds the values at which the likelihood, maximised over
all other parameters, falls short of its maximum by less than the 95 % quantile of
chi-squared allows.  Unlike value +- 1.96 standard errors it follows the likelihood
where it is skewed, as in gain and lead time.

With A the Hessian of half the sum of squares and B the covariance of its gradient, the
estimate has the covariance A^-1 B A^-1, whatever the residual is (Ljung, System
Identification, 2nd ed., sec. 9.2).  The inverse of A alone holds for a white residual only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from pilotid.solve.least_squares import Bounds, Box, Gram, LogTransform, Minima, minimise
from pilotid.support.numbers import CHI_SQUARED_95, Z95, scaled_inverse
from pilotid.support.types import BoolArray, FloatArray, IntArray

# -------------------------------------------------------------------------------------- covariance

#: Ratio of the smallest to the largest eigenvalue below which a model is next to singular.
NEAR_SINGULAR = 1e-9


def with_information(end: Minima, gram: Gram) -> Minima:
    """An optimum that has the Hessian where J'J is singular, as where a model's two lags are equal.

    They have one slope there, but together a curvature.

    Parameters
    ----------
    end
        The optimum, whose first entry counts.
    gram
        Gram matrices of the problem.
    """
    if scaled_inverse(end.gram[0, :-1, :-1], NEAR_SINGULAR) is not None:
        return end
    matrix = end.gram[0].copy()
    matrix[:-1, :-1] = hessian_of(gram, end.values[0])
    is_better = scaled_inverse(matrix[:-1, :-1], NEAR_SINGULAR) is not None
    return replace(end.only([0]), gram=matrix[None]) if is_better else end


def errors_from(
    values: FloatArray, intervals: FloatArray, bounds: Bounds, reach: float | FloatArray = Z95
) -> FloatArray | None:
    """Standard errors that intervals about values tell, None where one has no length.

    Root mean square distances from the mode of a distribution that is normal with another spread on
    either side, which is what a skewed likelihood looks like; shape (parameters,).

    Parameters
    ----------
    values, intervals
        Shapes (parameters,) and (parameters, 2).
    bounds
        Those of the parameters: a side of an interval that one cuts short counts as long as the
        other.
    reach
        Standard errors on each side.
    """
    sides, near = np.abs(intervals - values[:, None]), 1e-3 * np.ptp(intervals, axis=1)
    is_cut = np.column_stack(
        [intervals[:, 0] <= bounds.lower + near, intervals[:, 1] >= bounds.upper - near]
    )
    below, above = np.where(is_cut, np.maximum(sides, sides[:, ::-1]), sides).T
    errors = np.asarray(np.sqrt(below**2 + above**2 - below * above) / reach)
    return errors if (errors > 0.0).all() else None


def apart(hessian: FloatArray, which: BoolArray) -> FloatArray:
    """A Hessian (parameters, parameters) in which some parameters are independent of all others."""
    return np.where(which[:, None] | which, np.diag(np.diag(hessian)), hessian)


def covariance_at_bounds(
    hessian: FloatArray, bounded: BoolArray, errors: FloatArray | None
) -> FloatArray | None:
    """Covariance of an estimate of which some parameters lie at bounds, None if it is singular.

    There the inverse of the information tells nothing: it lets the parameters pass their
    bounds.  Correlations are those of the parameters inside, given the others.

    Parameters
    ----------
    hessian
        Inner products J'J, shape (parameters, parameters).
    bounded
        Which parameters lie at a bound, shape (parameters,).
    errors
        Standard errors, which profile intervals tell, see `errors_from`.
    """
    inverted = scaled_inverse(apart(hessian, bounded))
    if inverted is None or errors is None:
        return None
    scaled, _ = inverted
    size = np.sqrt(np.diag(scaled))
    return np.asarray(scaled * np.outer(errors / size, errors / size))


#: Longest time over which scores are taken to be correlated [s].
REACH = 5.0


def hessian_of(gram: Gram, values: FloatArray, step: float = 1e-4) -> FloatArray:
    """Hessian of half the sum of squares, from differences of its exact gradient.

    J'J leaves out the residual times the model's curvature, which matters where the
    residual is large.

    Parameters
    ----------
    gram
        Gram matrices of the problem.
    values
        Where, shape (parameters,).
    step
        Step of the central differences, as a share of each value.
    """
    steps = np.diag(step * np.maximum(np.abs(values), 1e-3))
    gradients = -gram(np.concatenate([values + steps, values - steps]))[:, :-1, -1]
    ahead, behind = np.split(gradients, 2)
    rows = (ahead - behind) / (2.0 * np.diag(steps))[:, None]
    return np.asarray(0.5 * (rows + rows.T))


def score_products(rows: FloatArray, reach: int) -> FloatArray:
    """Covariance of the sum of the scores, Jacobian times residual, over all samples.

    Products of scores up to `reach` samples apart, weighted by Parzen's lag window, which
    keeps the result positive semidefinite (Newey and West 1987; Andrews 1991).  Runs are
    independent.

    Parameters
    ----------
    rows
        Jacobian and, last, residual, shape (parameters + 1, runs, samples).
    reach
        Longest lag [samples].
    """
    scores = rows[:-1] * rows[-1]
    half = 1 << (scores.shape[2] + reach).bit_length() - 1  # transforms of other lengths are slow
    share = np.minimum(np.arange(half + 1) / (reach + 1.0), 1.0)
    window = np.where(share < 0.5, 1.0 - 6.0 * share**2 + 6.0 * share**3, 2.0 * (1.0 - share) ** 3)
    smoothing = np.fft.hfft(window, n=2 * half)[: half + 1]
    smoothing[1:-1] *= 2.0  # bins stand for two, but for the first and the last
    spectra = np.fft.rfft(scores, n=2 * half)
    products = np.einsum("prn,qrn,n->pq", spectra, spectra.conj(), smoothing, optimize=True)
    return np.asarray(products.real / (2 * half))


def score_dispersion(rows: FloatArray, estimated: int, length: int) -> tuple[float, float]:
    """How much the scores of segments scatter: about chi-squared if errors are as large as claimed.

    Scores count by what their segment knows: where next to nothing moves they tell of the remnant's
    model alone.  The statistic has the mean of chi-squared, and its variance with that freedom.

    Parameters
    ----------
    rows
        Jacobian and, last, residual at the estimate, shape (parameters + 1, runs, samples).
    estimated
        Parameters that count, the first ones.
    length
        Samples of a segment, about; runs are cut into equal ones.

    Returns
    -------
    The statistic and its degrees of freedom; 0, 0 where there is nothing to tell them by.
    """
    _, runs, samples = rows.shape
    pieces = max(1, round(samples / length))
    whole = rows[..., : samples // pieces * pieces].reshape(len(rows), runs * pieces, -1)
    jacobian, errors = whole[:estimated].transpose(1, 0, 2), whole[-1]
    size = np.sqrt(np.sum(jacobian**2, axis=(0, 2), keepdims=True))
    known = size[0, :, 0] > 0.0
    jacobian = jacobian[:, known] / size[:, known]
    information = jacobian @ jacobian.transpose(0, 2, 1)
    sizes, directions = np.linalg.eigh(information.sum(axis=0))
    root = (directions / np.sqrt(np.maximum(sizes, 1e-12)))[:, sizes > 1e-9]
    shares = root.T @ information @ root
    scores = np.einsum("kps,ks->kp", jacobian, errors) @ root
    # The whole score is zero but for what a likelihood adds evenly to what the segments know.
    scores -= shares @ scores.sum(axis=0)
    variance, lost = float(np.mean(errors**2)), float(np.sum(shares**2))
    mean = root.shape[1] - lost  # of the sum of squares, at a variance of one
    if mean < 0.5 or variance == 0.0:
        return 0.0, 0.0
    freedom = mean**2 / lost
    return freedom * float(np.sum(scores**2)) / (variance * mean), freedom


# -------------------------------------------------------------------- profile-likelihood intervals


@dataclass(frozen=True, eq=False)
class ProfileSearch:
    """A search for the ends of intervals, and the points that it comes upon.

    Attributes
    ----------
    gram
        Gram matrices of residual and Jacobian.
    box
        Bounds, at which intervals end.
    lowest
        The cost of the optimum.
    points, costs
        Points, each of shape (parameters,), and their costs.
    """

    gram: Gram
    box: Box
    lowest: float
    points: list[FloatArray]
    costs: list[float]

    def end(
        self, which: int, target: float, start: FloatArray, cost: float, near: FloatArray
    ) -> float:
        """Where the least cost at a value of one parameter reaches the target.

        The point there is added to those come upon, and the search ends early at one whose cost is
        below the lowest.

        Parameters
        ----------
        which
            Index of the parameter.
        target
            The cost that is sought.
        start, cost
            The optimum, or another point that suits, shape (parameters,), and its cost.
        near
            A point that may lie near the end, shape (parameters,): the search begins there, and
            goes on its side of the start.
        """
        close, sought = 0.04, target - self.lowest  # as a share of the distance
        origin = float(start[which])
        reach = float(near[which]) - origin
        bound = float((self.box.lower if reach < 0.0 else self.box.upper)[which])
        allowed = abs(bound - origin)
        inside, outside = 0.0, math.inf
        # The root of the deviance, as a share of that sought, grows about in proportion.
        root_inside, root_outside = math.sqrt(max(cost - self.lowest, 0.0) / sought), math.inf
        distance = min(abs(reach), allowed)
        point, beyond = start, start
        # What is far outside need not be known.
        far = target + 8.0 * sought
        descend = partial(minimise, self.gram, tolerance=1e-5, iterations=20, merge=True, above=far)
        for _ in range(14 if distance else 0):
            fixed = Box.holding(self.box, which, origin + math.copysign(distance, reach))
            end = descend(near[None], fixed)
            if end.cost[0] > target and near is not point:
                # The point that was given may lie in another valley.
                end = descend(np.array([end.values[0], point]), fixed)
            share = (float(end.cost[0]) - self.lowest) / sought
            if share <= 1.0:
                point, cost = end.values[0], float(end.cost[0])
                inside, root_inside = distance, math.sqrt(max(share, 0.0))
                if share < 0.0 or distance >= allowed or root_inside > 1.0 - close:
                    break
            else:
                outside, root_outside, beyond = distance, math.sqrt(share), end.values[0]
            near = point
            if math.isinf(outside):
                longer = distance / max(root_inside, 1.0 / 3.0) if inside else 2.0 * distance
                distance = min(max(longer, 1.2 * distance), allowed)
                continue
            if outside - inside < close * outside:
                break
            rise = (1.0 - root_inside) / (root_outside - root_inside) if root_outside < 3.0 else 0.5
            rise = min(max(rise, 0.1), 0.9)
            distance = inside + (outside - inside) * rise
            if root_outside < 3.0:
                near = point + rise * (beyond - point)
        self.points.append(point)
        self.costs.append(cost)
        return float(point[which])

    def look_in_valleys(
        self, others: FloatArray, known: FloatArray, targets: FloatArray, doubted: BoolArray
    ) -> None:
        """Go to ends that lie farther out in other valleys than where they were sought.

        Parameters
        ----------
        others
            Points of other valleys, shape (points, parameters).
        known, targets
            The intervals, shape (count, 2), which are made longer, and the cost of the ends of
            each, shape (count,).
        doubted
            Which ends may lie farther out, shape (count, 2).
        """
        if not (len(others) and doubted.any()):
            return
        costs = self.gram(others)[:, -1, -1]
        self.points.extend(others)
        self.costs.extend(costs.tolist())
        order = np.argsort(costs, kind="stable")
        for k, side in np.argwhere(doubted).tolist():
            end, level = known[k, side], float(targets[k])
            if not self.box.lower[k] < end < self.box.upper[k]:
                continue
            held = Box.holding(self.box, k, end)
            # What is nearly as high as the level is the end that was sought.
            above = self.lowest + 0.8 * (level - self.lowest)
            for start in others[order[costs[order] <= level]]:
                there = minimise(
                    self.gram, start[None], held, tolerance=1e-4, iterations=20, above=above
                )
                point, cost = there.values[0], float(there.cost[0])
                if cost < above:
                    near = farther(point, k, side, known[k])
                    known[k, side] = self.end(k, level, point, cost, near)
                    break

    def extended(self, known: FloatArray, targets: FloatArray) -> FloatArray:
        """Intervals (count, 2) that hold all points that suit, and what of those lies farther out.

        Parameters
        ----------
        known, targets
            As for `look_in_valleys`.
        """
        for _ in range(3):  # each round goes on where the one before has come to
            # What suits one parameter may not suit another whose level is lower.
            suits = np.array(self.costs)[:, None] <= targets
            suiting = np.where(suits, np.array(self.points)[:, : len(known)], np.nan)
            hull = np.stack([np.nanmin(suiting, axis=0), np.nanmax(suiting, axis=0)], axis=1)
            sides = np.array([-1.0, 1.0])
            # What lies beyond an end by a tenth of the length, on the inner scale, is walked on
            # from.
            beyond = (hull - known) * sides > 0.1 * np.diff(known, axis=1)
            known = sides * np.maximum(sides * known, sides * hull)
            if not beyond.any():
                break
            for k, side in np.argwhere(beyond).tolist():
                at = int(np.nanargmax(sides[side] * suiting[:, k]))
                start, cost, level = self.points[at], self.costs[at], float(targets[k])
                near = farther(start, k, side, known[k])
                known[k, side] = self.end(k, level, start, cost, near)
        return known


def farther(point: FloatArray, which: int, side: int, interval: FloatArray) -> FloatArray:
    """The point with one parameter farther out, by a tenth of the length of its interval."""
    moved = point.copy()
    moved[which] += (-1.0, 1.0)[side] * max(0.1 * float(np.ptp(interval)), 1e-9)
    return moved


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
    space: Bounds,
    minimum: Minima,
    variance: float,
    count: int,
    *,
    estimated: int | None = None,
    widened: float | FloatArray = 1.0,
    others: FloatArray | None = None,
    tolerance: float = 0.3,
) -> Profile:
    """95 % profile-likelihood intervals of the first `count` parameters.

    All end points are sought at once by Newton steps (Venzon & Moolgavkar, Applied
    Statistics 37, 1988): along the profiled parameter to the sought level, in all
    others to their conditional optimum.  The Hessian has the curvature that the search for
    the optimum learned.  Ends whose steps lead away are sought by `ProfileSearch.end`, from
    the nearest point that they came to.

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
    others
        Points that may suit as well, shape (points, parameters); None for none.
    tolerance
        How far from the deviance sought, of 3.84, the last Newton step may begin.
    """
    scale = LogTransform(space.positive)
    lower, upper = scale.enter(space.lower), scale.enter(space.upper)
    box = Box(lower, upper, np.zeros_like(space.positive))
    room = np.where(space.positive, 1.0, 0.25 * (upper - lower))

    def inner(points: FloatArray) -> FloatArray:
        values = scale.leave(points)
        grams = scale.inner(gram(values), values)
        # A search would chase what has no influence, such as the delay of a gain that is zero.
        curved, slopes = grams.diagonal(axis1=1, axis2=2)[:, :-1], np.abs(grams[:, :-1, -1])
        for each, k in np.argwhere((curved * room + 2.0 * slopes) * room < 0.01 * variance):
            grams[each, k], grams[each, :, k], grams[each, k, k] = 0.0, 0.0, 1.0
        return grams

    best = scale.enter(minimum.values[:1])
    optimum_gram = scale.inner(minimum.gram[:1], minimum.values[:1])
    lowest = float(minimum.cost[0])
    which = np.tile(np.arange(count), 2)
    side = np.repeat([-1.0, 1.0], count)
    sought = np.broadcast_to(CHI_SQUARED_95 * np.asarray(widened), count)[which]
    target = lowest + sought * variance
    if estimated is not None:
        # The variance is then one more parameter, maximised over as well.
        target = lowest * np.exp(sought / estimated)

    blocked = _blocked(optimum_gram, best, lower, upper)
    error = _errors(optimum_gram[0], blocked[0], variance)[:count]
    # On the ridge of the quadratic approximation.
    points = np.repeat(best, 2 * count, axis=0)
    grams = np.repeat(optimum_gram, 2 * count, axis=0)
    longest = 1.5 * np.sqrt(sought) * error[which]
    ridge, _ = _step(grams, np.repeat(blocked, 2 * count, axis=0), which, side, longest, target)
    points = np.clip(points + np.clip(ridge, -room, room), lower, upper)
    active = np.arange(2 * count)
    reached_end = np.zeros(2 * count, dtype=bool)
    search = ProfileSearch(inner, box, lowest, [best[0]], [lowest])
    closest = points.copy()
    # Nothing is near an end where the deviance is a hundred times that sought.
    least_off = 100.0 * (target - lowest)
    for _ in range(8):
        grams = inner(points[active])
        grams[:, :-1, :-1] += minimum.curvature[0]
        costs = grams[:, -1, -1]
        search.points.extend(points[active])
        search.costs.extend(costs.tolist())
        k, direction = which[active], side[active]
        blocked = _blocked(grams, points[active], lower, upper)
        goal = target[active]
        # No step is longer than a standard error.
        step, off = _step(grams, blocked, k, direction, error[k], goal)
        at_bound = (points[active, k] <= lower[k]) & (direction < 0)
        at_bound |= (points[active, k] >= upper[k]) & (direction > 0)
        # A bound that was overshot to, where the deviance is too high, is left again.
        at_bound &= step[np.arange(len(k)), k] * direction >= 0.0
        either = np.maximum(np.abs(costs - goal), off)
        reached = either < tolerance * variance
        reached_end[active] = reached | (at_bound & (costs <= goal))
        # Newton steps that lead away do not come back.
        nearer = (either < least_off[active]) & (direction * (points[active, k] - best[0, k]) > 0.0)
        on = active[nearer]
        closest[on], least_off[on] = points[on], either[nearer]
        moved = np.clip(points[active] + step, lower, upper)
        points[active] = np.where(at_bound[:, None], points[active], moved)
        active = active[nearer & ~(reached | at_bound)]
        if not active.size:
            break
    # Where the likelihood has another summit the search may end on its side.
    reached_end &= (points[np.arange(2 * count), which] - best[0, which]) * side >= 0.0
    ends = points[np.arange(2 * count), which]
    least = lowest - 0.2 * variance  # what is lower takes the minimum's place
    # Beside it, where it is refused, what was not reached is not known.
    known = np.where(reached_end, ends, np.where(side < 0.0, lower[which], upper[which]))
    known = known.reshape(2, count).T
    if not np.nanmin(search.costs) < least:
        for i in np.flatnonzero(~reached_end):
            ends[i] = search.end(int(which[i]), float(target[i]), best[0], lowest, closest[i])
        known = np.sort(np.column_stack([ends.reshape(2, count).T, best[0, :count]]))[:, [0, -1]]
        # What is hardly known goes far, and may lead to another valley, which ends farther inside.
        near = np.where(np.arange(len(room)) == which[:, None], np.inf, room)
        is_far = (np.abs(points - best) > near).any(axis=1).reshape(2, count).T
        search.look_in_valleys(best, known, target[:count], is_far)
        if others is not None:
            search.look_in_valleys(scale.enter(others), known, target[:count], np.ones_like(is_far))
        known = search.extended(known, target[:count])
    lowest_of_all = int(np.nanargmin(search.costs))
    is_better = search.costs[lowest_of_all] < least
    better = scale.leave(search.points[lowest_of_all]) if is_better else None
    found = LogTransform(space.positive[:count]).leave(known.T)
    low, high = np.clip(found, space.lower[:count], space.upper[:count])
    values = minimum.values[0, :count]
    intervals = np.stack([np.minimum(low, values), np.maximum(high, values)], axis=1)
    return Profile(intervals, better)


def _blocked(
    grams: FloatArray, points: FloatArray, lower: FloatArray, upper: FloatArray
) -> BoolArray:
    """Which parameters lie at a bound that descent leads beyond, shape (points, parameters)."""
    descent = grams[:, :-1, -1]
    return np.asarray(((points <= lower) & (descent < 0.0)) | ((points >= upper) & (descent > 0.0)))


def _errors(gram: FloatArray, blocked: BoolArray, variance: float) -> FloatArray:
    """Standard errors, each with all other parameters free but those held by their bounds."""
    size = np.sqrt(np.maximum(np.diag(gram)[:-1], 1e-300))
    index = np.arange(len(size))
    fixed = blocked & (index[:, None] != index)
    scaled = gram[:-1, :-1] / np.outer(size, size)
    free = np.where(fixed[:, :, None] | fixed[:, None], np.eye(len(size)), scaled)
    share = np.linalg.inv(free)[index, index, index]
    return np.asarray(np.sqrt(np.maximum(share, 1.0) * variance) / size)


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
    fixed = blocked.copy()
    fixed[index, which] = True
    others = np.where(fixed[:, :, None] | fixed[:, None, :], np.eye(fixed.shape[1]), hessian)
    across = np.where(fixed, 0.0, hessian[index, which])
    right = np.where(fixed, 0.0, descent)
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
        # Far from the optimum, or at a bound, a parameter may lose all influence; what is outside a
        # problem's domain, without a number, goes nowhere.
        return np.asarray(np.linalg.pinv(np.where(np.isfinite(matrices), matrices, 0.0)) @ right)
