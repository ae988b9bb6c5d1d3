"""Penalties on rough curves, and how heavy they must be.

A curve that is described by its values at many knots is held together by a penalty on its
roughness, weight times f'Kf with f the logarithms at the knots.  That is a normal prior of
f'Kf, whose variance is that of the residuals over the weight, and so as many more residuals as K
has rank; with them the inverse of the information is the posterior covariance, whose bands hold
the truth in 95 % of the time on average, the penalty's bias included (Nychka, JASA 83, 1988).
The weights are those of the largest likelihood once all curves are integrated out (restricted
maximum likelihood; Wood, JRSS B 73, 2011), here for the problem made linear about an optimum,
and under a flat prior of each curve's standard deviation (Gelman, Bayesian Analysis 1, 2006):
without it the likelihood of a short recording is often largest for a straight line, and bands
are then too narrow.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from pilotid.solve.least_squares import (
    Bounds,
    Curve,
    LogTransform,
    Minima,
    Penalty,
    Problem,
    minimise,
)
from pilotid.types import FloatArray

#: Logarithms between which a weight is sought, that of the weight which makes penalty and
#: information equal being zero.  At the ends a curve is free, and straight.
LIGHTEST, HEAVIEST = -12.0, 10.0
#: Factor of a weight's logarithm in -2 log of a density that is flat in the standard deviation.
FLAT_PRIOR_EXPONENT = 1.0
WEIGHTS_TRIED = 12  # weights, the same for all curves, from the best of which the search begins


class Restricted:
    """-2 log of the weights' density, the curves integrated out, by the weights' logarithms.

    Parameters
    ----------
    gram
        Gram matrix without penalty, by parameters on the inner scale, shape
        (parameters + 1, parameters + 1).
    point
        Where, on the inner scale, shape (parameters,).
    curves
        What is penalised.
    samples
        Number of residuals without the penalty's.
    """

    def __init__(
        self, gram: FloatArray, point: FloatArray, curves: tuple[Curve, ...], samples: int
    ) -> None:
        self._information, self._descent = gram[:-1, :-1], gram[:-1, -1]
        self._squares = float(gram[-1, -1])
        self._point = point
        self._matrices = np.zeros((len(curves), len(point), len(point)))
        self._ranks = np.array([len(curve.indices) - 2.0 for curve in curves])
        self._freedom = samples - (len(point) - float(self._ranks.sum()))
        #: Logarithms of the weights that make penalty and information equal.
        self.even = np.empty(len(curves))
        for k, curve in enumerate(curves):
            own = np.ix_(curve.indices, curve.indices)
            self._matrices[k][own] = curve.matrix
            self.even[k] = np.log(np.trace(self._information[own]) / np.trace(curve.matrix))

    def __call__(self, logs: FloatArray) -> tuple[float, FloatArray]:
        """The criterion and its gradient at logarithms of weights, shape (curves,)."""
        weighted = np.exp(logs)[:, None, None] * self._matrices
        total = weighted.sum(axis=0)
        inverse, determinant = self._inverse(total)
        step = inverse @ (self._descent - total @ self._point)
        moved = self._point + step
        squares = (
            self._squares
            - 2.0 * step @ self._descent
            + step @ self._information @ step
            + moved @ total @ moved
        )
        ranks = self._ranks - FLAT_PRIOR_EXPONENT
        # Of a residual without noise rounding errors are left, of any sign.
        squares = max(float(squares), 1e-13 * self._squares, 1e-300)
        value = self._freedom * np.log(squares) + determinant - ranks @ logs
        rough = np.einsum("i,kij,j->k", moved, weighted, moved)
        used = np.einsum("ij,kji->k", inverse, weighted)
        return float(value), self._freedom * rough / squares + used - ranks

    def degrees(self, logs: FloatArray) -> FloatArray:
        """Effective degrees of freedom of each curve: 2 straight, as many as knots free."""
        weighted = np.exp(logs)[:, None, None] * self._matrices
        inverse, _ = self._inverse(weighted.sum(axis=0))
        return np.asarray(self._ranks + 2.0 - np.einsum("ij,kji->k", inverse, weighted))

    def _inverse(self, penalty: FloatArray) -> tuple[FloatArray, float]:
        """Inverse and log-determinant of the information with a penalty."""
        matrix = self._information + penalty
        size = np.diag(matrix)
        # When a change by nothing was, nobody knows.
        scale = np.sqrt(np.where(size > 0.0, size, 1.0))
        scaled = matrix / np.outer(scale, scale) + 1e-12 * np.eye(len(scale))
        determinant = float(np.linalg.slogdet(scaled)[1] + 2.0 * np.sum(np.log(scale)))
        return np.linalg.inv(scaled) / np.outer(scale, scale), determinant

    def best(self, start: FloatArray | None = None) -> FloatArray:
        """Logarithms of the weights at its minimum, shape (curves,).

        Parameters
        ----------
        start
            Where to begin, of the same shape; None to try several.
        """
        from scipy.optimize import minimize

        if start is None:
            tried = [self.even + at for at in np.linspace(LIGHTEST, HEAVIEST, WEIGHTS_TRIED)]
            start = min(tried, key=lambda logs: self(logs)[0])
        ends = list(zip(self.even + LIGHTEST, self.even + HEAVIEST, strict=True))
        inside = np.clip(start, self.even + LIGHTEST, self.even + HEAVIEST)
        return np.asarray(minimize(self, inside, jac=True, bounds=ends, method="L-BFGS-B").x)


MOST_ROUNDS = 25  # of weights and optimum in turn, at the most
SETTLED_LOG_CHANGE = 0.05  # change of the logarithms of the weights that ends them
ROUND_TOLERANCE = 1e-5  # of the optima between


P = TypeVar("P", bound=Problem)


def fit_smooth(
    problem: P,
    space: Bounds,
    curves: tuple[Curve, ...],
    values: FloatArray,
    tolerance: float,
) -> tuple[P, Minima]:
    """The problem with the penalty that suits the recording best, and its optimum.

    Weights are those of the largest restricted likelihood of the problem made linear about the
    optimum, which is then sought anew, until both stay.

    Parameters
    ----------
    problem
        The sum of squares, by parameters in bounds and any others behind them.
    space
        Their bounds.
    curves
        What is penalised.
    values
        Where to begin, shape (parameters,).
    tolerance
        Of the last optimum.
    """
    free = problem.penalised(None)
    point = values[None]
    logs: FloatArray | None = None
    for _ in range(MOST_ROUNDS):
        last, logs = logs, _restricted(free, space, point, curves).best(logs)
        problem = free.penalised(Penalty(curves, np.exp(logs)))
        end = minimise(problem.gram, point, space, tolerance=ROUND_TOLERANCE)
        point = end.values[:1]
        if last is not None and np.max(np.abs(logs - last)) < SETTLED_LOG_CHANGE:
            break
    return problem, minimise(problem.gram, point, space, tolerance=tolerance)


def criterion_and_degrees(problem: Problem, space: Bounds, end: Minima) -> tuple[float, FloatArray]:
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
    free: Problem, space: Bounds, point: FloatArray, curves: tuple[Curve, ...]
) -> Restricted:
    scale = LogTransform(space.positive)
    gram = scale.inner(free.gram(point), point)[0]
    return Restricted(gram, scale.enter(point)[0], curves, free.residuals)
