"""What a design is to make small: convex functions of the powers of the lines.

Each goal knows its part of a barrier function, for `pilotid.designing.solver`, and a lower
bound that is linear in the powers, from which the optimality gap follows.  All are taken of
relative errors: criteria A (mean of the variances, of all or of some parameters), D
(determinant) and E (largest eigenvalue of the covariance).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol

import numpy as np

from pilotid.types import FloatArray


class Terms(NamedTuple):
    """Value, gradient (n,) and Hessian (n, n) of a function; the value is inf outside."""

    value: float
    gradient: FloatArray
    hessian: FloatArray


class Cut(NamedTuple):
    """A linear function of the powers that no value of a goal lies below."""

    value: float
    gradient: FloatArray


@dataclass(frozen=True, eq=False)
class Criterion:
    """One pilot's relative errors as one number, in units of a reference design's.

    Attributes
    ----------
    base, factors
        Information without lines, (parameters, parameters), and of each line with unit
        power, (lines, parameters, 2).
    weights
        Weights of the parameters' variances, shape (parameters,); None for criterion D: the
        mean of the logarithms of the covariance's eigenvalues.
    scale
        Value that counts as 1; for criterion D what is taken off.
    """

    base: FloatArray
    factors: FloatArray
    weights: FloatArray | None
    scale: float = 1.0

    def value(self, powers: FloatArray) -> float:
        """The criterion; inf where a parameter is not known at all."""
        information = self.information(powers)
        sign, log_volume = np.linalg.slogdet(information)
        if sign <= 0.0:
            return np.inf
        if self.weights is None:
            return float(-log_volume / information.shape[0] - self.scale)
        return float(self.weights @ np.diag(np.linalg.inv(information)) / self.scale)

    def information(self, powers: FloatArray) -> FloatArray:
        """Information at these powers, shape (parameters, parameters)."""
        return np.asarray(
            self.base + np.einsum("j,jpa,jqa->pq", powers, self.factors, self.factors)
        )

    def covariance(self, powers: FloatArray) -> FloatArray:
        """Covariance over the scale, shape (parameters, parameters)."""
        return np.asarray(np.linalg.inv(self.scale * self.information(powers)))

    def terms(self, powers: FloatArray) -> Terms:
        """Value, gradient and Hessian, all exact."""
        value = self.value(powers)
        lines, parameters, _ = self.factors.shape
        if not np.isfinite(value):
            return Terms(np.inf, np.zeros(lines), np.zeros((lines, lines)))
        columns = self.factors.transpose(1, 0, 2).reshape(parameters, 2 * lines)
        seen = np.linalg.solve(self.information(powers), columns)
        plain = columns.T @ seen
        if self.weights is None:
            gradient = -np.einsum("jaja->j", plain.reshape(lines, 2, lines, 2)) / parameters
            return Terms(value, gradient, _blocks(plain * plain, lines) / parameters)
        weighted = (seen.T * self.weights) @ seen
        gradient = -np.einsum("jaja->j", weighted.reshape(lines, 2, lines, 2)) / self.scale
        return Terms(value, gradient, 2.0 * _blocks(plain * weighted, lines) / self.scale)


def _blocks(products: FloatArray, lines: int) -> FloatArray:
    """Sums over the 2 x 2 blocks of a matrix."""
    return np.asarray(products.reshape(lines, 2, lines, 2).sum(axis=(1, 3)))


class Goal(Protocol):
    """What is minimised over the powers and `extra` variables of the goal's own."""

    @property
    def extra(self) -> int:
        """How many variables follow the powers."""
        ...

    @property
    def barriers(self) -> int:
        """How many logarithms its own barrier has."""
        ...

    def start(self, powers: FloatArray) -> FloatArray:
        """The extra variables, strictly inside, shape (extra,)."""
        ...

    def terms(self, point: FloatArray, sharpness: float) -> Terms:
        """Sharpness times the goal, and its own barrier."""
        ...

    def value(self, powers: FloatArray) -> float:
        """What is minimised."""
        ...

    def cut(self, point: FloatArray, sharpness: float) -> Cut:
        """A linear lower bound, exact at the optimum."""
        ...


@dataclass(frozen=True, eq=False)
class Mean:
    """The mean of criteria over pilots."""

    criteria: Sequence[Criterion]
    extra: int = 0
    barriers: int = 0

    def start(self, powers: FloatArray) -> FloatArray:
        return np.zeros(0)

    def terms(self, point: FloatArray, sharpness: float) -> Terms:
        share = sharpness / len(self.criteria)
        each = [criterion.terms(point) for criterion in self.criteria]
        return Terms(*(share * sum(part) for part in zip(*each, strict=True)))

    def value(self, powers: FloatArray) -> float:
        return float(np.mean([criterion.value(powers) for criterion in self.criteria]))

    def cut(self, point: FloatArray, sharpness: float) -> Cut:
        value, gradient, _ = self.terms(point, 1.0)
        return Cut(value - float(gradient @ point), gradient)


@dataclass(frozen=True, eq=False)
class Worst:
    """The largest of several criteria: of pilots, or of wishes."""

    criteria: Sequence[Criterion]
    extra: int = 1

    @property
    def barriers(self) -> int:
        return len(self.criteria)

    def start(self, powers: FloatArray) -> FloatArray:
        value = self.value(powers)
        return np.array([value + 0.1 * max(abs(value), 1e-3)])

    def terms(self, point: FloatArray, sharpness: float) -> Terms:
        powers, above = point[:-1], point[-1]
        size = point.size
        value, gradient, hessian = sharpness * above, np.zeros(size), np.zeros((size, size))
        gradient[-1] = sharpness
        for criterion in self.criteria:
            f = criterion.terms(powers)
            slack = above - f.value
            if not slack > 0.0:
                return Terms(np.inf, gradient, hessian)
            slope = np.append(f.gradient, -1.0) / slack
            value -= np.log(slack)
            gradient += slope
            hessian += np.outer(slope, slope)
            hessian[:-1, :-1] += f.hessian / slack
        return Terms(float(value), gradient, hessian)

    def value(self, powers: FloatArray) -> float:
        return max(criterion.value(powers) for criterion in self.criteria)

    def cut(self, point: FloatArray, sharpness: float) -> Cut:
        powers, above = point[:-1], point[-1]
        each = [criterion.terms(powers) for criterion in self.criteria]
        weights = np.array([1.0 / (above - f.value) for f in each])
        weights /= weights.sum()
        gradient = np.sum([w * f.gradient for w, f in zip(weights, each, strict=True)], axis=0)
        value = float(weights @ [f.value for f in each])
        return Cut(value - float(gradient @ powers), gradient)


@dataclass(frozen=True, eq=False)
class LongestAxis:
    """Criterion E: the largest eigenvalue of the covariance, the mean over pilots or the worst.

    Of the criteria only `base`, `factors` and `scale` count.
    """

    criteria: Sequence[Criterion]
    over: Literal["mean", "worst"] = "worst"

    @property
    def extra(self) -> int:
        return len(self.criteria) if self.over == "mean" else 1

    @property
    def barriers(self) -> int:
        return sum(c.base.shape[0] for c in self.criteria)

    def start(self, powers: FloatArray) -> FloatArray:
        each = self._each(powers)
        return 1.1 * (each if self.over == "mean" else np.array([each.max()]))

    def terms(self, point: FloatArray, sharpness: float) -> Terms:
        count, size = point.size - self.extra, point.size
        powers, above = point[:count], point[count:]
        value, gradient, hessian = sharpness * above.mean(), np.zeros(size), np.zeros((size, size))
        gradient[count:] = sharpness / above.size
        for i, c in enumerate(self.criteria):
            at = count + (i if self.over == "mean" else 0)
            covariance = c.covariance(powers)
            axes, turn = np.linalg.eigh(covariance)
            slack = point[at] - axes
            if not (slack > 0.0).all():
                return Terms(np.inf, gradient, hessian)
            inverse = (turn / slack) @ turn.T
            parameters, lines = c.base.shape[0], c.factors.shape[0]
            columns = c.factors.transpose(1, 0, 2).reshape(parameters, -1) * np.sqrt(c.scale)
            seen = covariance @ columns
            plain, weighted = columns.T @ seen, seen.T @ inverse @ seen
            value -= float(np.log(slack).sum())
            gradient[:count] -= np.einsum("jaja->j", weighted.reshape(lines, 2, lines, 2))
            gradient[at] -= np.trace(inverse)
            hessian[:count, :count] += _blocks(weighted * (weighted + 2.0 * plain), lines)
            spread = (inverse @ seen).reshape(parameters, lines, 2)
            crossed = np.sum(spread**2, axis=(0, 2))
            hessian[:count, at] += crossed
            hessian[at, :count] += crossed
            hessian[at, at] += np.sum(inverse * inverse)
        return Terms(float(value), gradient, hessian)

    def value(self, powers: FloatArray) -> float:
        try:
            each = self._each(powers)
        except np.linalg.LinAlgError:
            return np.inf
        return float(each.mean() if self.over == "mean" else each.max())

    def _each(self, powers: FloatArray) -> FloatArray:
        return np.array([np.linalg.eigvalsh(c.covariance(powers))[-1] for c in self.criteria])

    def cut(self, point: FloatArray, sharpness: float) -> Cut:
        count = point.size - self.extra
        powers = point[:count]
        above = np.broadcast_to(point[count:], len(self.criteria))
        each = [c.covariance(powers) for c in self.criteria]
        weights = [np.linalg.inv(a * np.eye(len(c)) - c) for a, c in zip(above, each, strict=True)]
        traces = np.array([np.trace(weight) for weight in weights])
        # One weight of trace 1 for the worst; one for each pilot, over their number, for the mean.
        totals = traces * traces.size if self.over == "mean" else np.full_like(traces, traces.sum())
        value, gradient = 0.0, np.zeros(count)
        # No mean of covariances with weights of trace 1 is above their largest eigenvalue, and
        # such a mean is convex in the powers.
        for c, covariance, weight, total in zip(self.criteria, each, weights, totals, strict=True):
            value += float(np.sum(weight * covariance)) / total
            seen = np.einsum("pq,jqa->jpa", covariance, np.sqrt(c.scale) * c.factors)
            gradient -= np.einsum("jpa,pq,jqa->j", seen, weight / total, seen)
        return Cut(value - float(gradient @ powers), gradient)


#: The goals there are.
AnyGoal = Mean | Worst | LongestAxis
