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

from dataclasses import dataclass

import numpy as np

from pilotid.pilot.courses import Curve
from pilotid.types import FloatArray

#: Logarithms between which a weight is sought, that of the weight which makes penalty and
#: information equal being zero.  At the ends a curve is free, and straight.
LIGHTEST, HEAVIEST = -12.0, 10.0
FLAT = 1.0  # of a weight's logarithm in -2 log of a density that is flat in the standard deviation
TRIED = 12  # weights, the same for all curves, from the best of which the search begins


@dataclass(frozen=True, eq=False)
class Penalty:
    """Roughness that counts as a sum of squares.

    Attributes
    ----------
    curves
        What is penalised.
    weights
        One for each, shape (curves,).
    """

    curves: tuple[Curve, ...]
    weights: FloatArray

    @property
    def rank(self) -> int:
        """How many residuals it is: straight lines are not penalised."""
        return sum(len(curve.indices) - 2 for curve in self.curves)

    def of(self, values: FloatArray) -> FloatArray:
        """The penalty of parameter sets, (sets, parameters), shape (sets,)."""
        total = np.zeros(len(values))
        for (_, indices, matrix), weight in zip(self.curves, self.weights, strict=True):
            logs = np.log(values[:, list(indices)])
            total += weight * np.einsum("si,ij,sj->s", logs, matrix, logs)
        return total

    def gram(self, values: FloatArray) -> FloatArray:
        """What it adds to Gram matrices, see `pilotid.solve.least_squares.Problem.gram`.

        Parameters
        ----------
        values
            Parameter sets, shape (sets, parameters), others behind those of the curves.
        """
        sets, count = values.shape
        total = np.zeros((sets, count + 1, count + 1))
        for (_, indices, matrix), weight in zip(self.curves, self.weights, strict=True):
            own = list(indices)
            scale = 1.0 / values[:, own]
            logs = np.log(values[:, own])
            weighted = weight * matrix
            total[np.ix_(range(sets), own, own)] += scale[:, :, None] * weighted * scale[:, None, :]
            descent = -scale * (logs @ weighted)
            total[:, own, -1] += descent
            total[:, -1, own] += descent
            total[:, -1, -1] += np.einsum("si,ij,sj->s", logs, weighted, logs)
        return total


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
        for k, (_, indices, matrix) in enumerate(curves):
            own = np.ix_(indices, indices)
            self._matrices[k][own] = matrix
            self.even[k] = np.log(np.trace(self._information[own]) / np.trace(matrix))

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
        ranks = self._ranks - FLAT
        # Of a recording without a remnant rounding errors are left, of any sign.
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
            tried = [self.even + at for at in np.linspace(LIGHTEST, HEAVIEST, TRIED)]
            start = min(tried, key=lambda logs: self(logs)[0])
        ends = list(zip(self.even + LIGHTEST, self.even + HEAVIEST, strict=True))
        inside = np.clip(start, self.even + LIGHTEST, self.even + HEAVIEST)
        return np.asarray(minimize(self, inside, jac=True, bounds=ends, method="L-BFGS-B").x)
