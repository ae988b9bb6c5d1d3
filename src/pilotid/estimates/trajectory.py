"""The parameters of a pilot over time, with a band.

Of a model that changes, the trajectory follows from its parameters.  The band is that of draws:
to first order a step would have no error at all but at the very time where it is put.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pilotid.chance import Z95
from pilotid.pilot.model import PilotModel, frozen, frozen_over
from pilotid.types import FloatArray

SPACING = 0.25  # s between times of a trajectory
MOST = 1000  # times of a trajectory
DRAWS = 1000


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Parameters of a constant pilot, that of `pilotid.pilot.model.frozen`, over time.

    Attributes
    ----------
    keys
        Its parameters, such as Kvis, tlead, tdvis, fnm and dnm.
    time
        From the start of the measurement window [s], rising, shape (times,).
    values
        The parameters, shape (keys, times); NaN where nothing is known.
    lower, upper
        Ends of the 95 % band at each time, shape (keys, times).
    """

    keys: tuple[str, ...]
    time: FloatArray
    values: FloatArray
    lower: FloatArray
    upper: FloatArray

    def __post_init__(self) -> None:
        shape = (len(self.keys), self.time.size)
        if {self.values.shape, self.lower.shape, self.upper.shape} != {shape}:
            raise ValueError(f"values and bands of a trajectory must have the shape {shape}")
        if not (np.isfinite(self.time).all() and (np.diff(self.time) > 0.0).all()):
            raise ValueError("the times of a trajectory must rise")

    def at(self, time: FloatArray) -> Trajectory:
        """The trajectory at other times, straight between those known and NaN beyond them.

        Parameters
        ----------
        time
            The times, shape (n,).
        """
        values, lower, upper = (
            np.array([_between(time, self.time, row) for row in part])
            for part in (self.values, self.lower, self.upper)
        )
        return Trajectory(self.keys, time, values, lower, upper)

    def to_dict(self) -> dict[str, object]:
        """Plain objects for JSON: the times, and by key values and band."""
        rows = zip(self.keys, self.values, self.lower, self.upper, strict=True)
        parameters = {
            key: {"value": value.tolist(), "lower": lower.tolist(), "upper": upper.tolist()}
            for key, value, lower, upper in rows
        }
        return {"time": self.time.tolist(), "parameters": parameters}


def times_of(length: float) -> FloatArray:
    """Times of a trajectory over a window of some length [s], both ends included, shape (n,)."""
    return np.linspace(0.0, length, 1 + max(1, min(MOST, math.ceil(length / SPACING))))


def trajectory_of(
    model: PilotModel,
    values: FloatArray,
    covariance: FloatArray,
    intervals: FloatArray,
    time: FloatArray,
    rng: np.random.Generator,
    *,
    draws: FloatArray | None = None,
) -> Trajectory:
    """The trajectory that the parameters of a model are.

    Parameters
    ----------
    model
        The model that changes, or a constant one.
    values, covariance, intervals
        Its estimate, see `pilotid.estimates.estimate.Estimate`.
    time
        See `Trajectory`.
    rng
        Draws parameters with these intervals and correlations.
    draws
        Draws of a posterior in their place, shape (draws, parameters).
    """
    if draws is None:
        draws = drawn(model, values, covariance, intervals, rng)
    over = frozen_over(model, draws, time)
    lower, upper = np.quantile(over, (0.025, 0.975), axis=0)
    own = frozen_over(model, values, time)
    place = {key: i for i, key in enumerate(model.keys)}
    keys = frozen(model).keys
    for i, key in enumerate(keys):
        if key in place:  # it does not vary, so that its interval is known
            lower[i], upper[i] = intervals[place[key]]
    return Trajectory(keys, time, own, np.minimum(lower, own), np.maximum(upper, own))


def drawn(
    model: PilotModel,
    values: FloatArray,
    covariance: FloatArray,
    intervals: FloatArray,
    rng: np.random.Generator,
    count: int = DRAWS,
) -> FloatArray:
    """Draws of parameters with an estimate's intervals and correlations, (count, parameters).

    Each parameter is normal on either side of its value, as far as its interval reaches
    there, on the logarithm if it is positive: a rate of which only a lower end is known is
    drawn below its bound.
    """
    error = np.sqrt(np.diag(covariance))
    shares, vectors = np.linalg.eigh(covariance / np.outer(error, error))
    root = vectors * np.sqrt(np.maximum(shares, 0.0))
    normal = rng.standard_normal((count, len(values))) @ root.T
    # Parameters whose interval is all of their value's sign and positive: by their logarithm.
    logs = model.positive & (np.minimum(values, intervals[:, 0]) > 0.0)
    ends = np.stack([values, intervals[:, 0], intervals[:, 1]])
    middle, low, high = np.where(logs, np.log(np.where(logs, ends, 1.0)), ends)
    reach = np.where(normal > 0.0, high - middle, middle - low) / Z95
    found = middle + normal * reach
    found = np.where(logs, np.exp(np.where(logs, found, 0.0)), found)
    return np.asarray(np.clip(found, model.lower, model.upper))


def _between(time: FloatArray, known: FloatArray, row: FloatArray) -> FloatArray:
    """A row of numbers at other times; NaN where it has none at the next known ones."""
    return np.asarray(np.interp(time, known, row, left=math.nan, right=math.nan))
