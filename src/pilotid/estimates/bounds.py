"""Which values lie at the bounds of a model's parameters, and how a search ended there."""

from __future__ import annotations

import numpy as np

from pilotid.pilot.model import PilotModel
from pilotid.types import BoolArray, FloatArray


def at_bounds(
    model: PilotModel, lower: FloatArray, upper: FloatArray
) -> tuple[BoolArray, BoolArray]:
    """Which parameters reach their lower and their upper bound, shapes (parameters,).

    Parameters
    ----------
    model
        The model.
    lower, upper
        Ends of intervals, or twice the values, shape (parameters,).
    """
    margin = 1e-6 * (model.upper - model.lower)
    low = lower <= model.lower + np.minimum(margin, 1e-6 * np.abs(model.lower) + 1e-9)
    return low, upper >= model.upper - margin


def held(model: PilotModel, values: FloatArray) -> BoolArray:
    """Which parameters lie at a bound, shape (parameters,), as `values` do."""
    return np.logical_or(*at_bounds(model, values, values))


def bounds_reached(model: PilotModel, values: FloatArray) -> str:
    """Names of the parameters that lie at a bound, empty if none does."""
    low, high = at_bounds(model, values, values)
    named = [
        f"{key} at its {'lower' if is_low else 'upper'} bound {bound:g}"
        for key, is_low, is_high, bound in zip(
            model.keys, low, high, np.where(low, model.lower, model.upper), strict=True
        )
        if is_low or is_high
    ]
    return ", ".join(named)
