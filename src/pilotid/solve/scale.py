"""The scale on which searches and samplers move: the logarithm of positive parameters.

There the narrow valley of gain and lead time, whose product alone is well known, is straight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pilotid.chance import Z95
from pilotid.types import BoolArray, FloatArray


@dataclass(frozen=True, eq=False)
class Scale:
    """Parameters on their own scale and on the inner one.

    Attributes
    ----------
    positive
        Which parameters are taken by their logarithm, shape (parameters,).
    """

    positive: BoolArray

    def enter(self, values: FloatArray) -> FloatArray:
        """Parameters on the inner scale, shape as given, (..., parameters)."""
        positive = self.positive
        return np.where(positive, np.log(np.where(positive, values, 1.0)), values)

    def leave(self, points: FloatArray) -> FloatArray:
        """Parameters on their own scale, shape as given, (..., parameters)."""
        positive = self.positive
        return np.where(positive, np.exp(np.where(positive, points, 0.0)), points)

    def slope(self, values: FloatArray) -> FloatArray:
        """Derivatives of the parameters by inner ones, shape (sets, parameters)."""
        return np.where(self.positive, values, 1.0)

    def unknown(self, lower: FloatArray, upper: FloatArray) -> FloatArray:
        """Inner standard errors of what is only known to lie within its bounds, (parameters,)."""
        return 0.25 * (self.enter(upper) - self.enter(lower))

    def interval(
        self, values: FloatArray, error: FloatArray, lower: FloatArray, upper: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Ends of 95 % intervals, not beyond bounds, each of shape (..., parameters).

        Parameters
        ----------
        values
            Parameters, shape (..., parameters).
        error
            Their standard errors on the inner scale, of the same shape.
        lower, upper
            Bounds, shape (parameters,).
        """
        points, reach = self.enter(values), Z95 * error
        least, most = np.minimum(lower, values), np.maximum(upper, values)
        low, high = self.leave(points - reach), self.leave(points + reach)
        return np.clip(low, least, most), np.clip(high, least, most)

    def inner(self, grams: FloatArray, values: FloatArray) -> FloatArray:
        """Gram matrices by inner parameters, from those by the parameters at `values`."""
        slope = self._padded(values)
        return grams * slope[:, :, None] * slope[:, None, :]

    def outer(self, grams: FloatArray, values: FloatArray) -> FloatArray:
        """The inverse of `inner`."""
        slope = self._padded(values)
        return grams / slope[:, :, None] / slope[:, None, :]

    def _padded(self, values: FloatArray) -> FloatArray:
        """Slopes, and 1 in the residual's place, shape (sets, parameters + 1)."""
        return np.concatenate([self.slope(values), np.ones((len(values), 1))], axis=1)
