"""Whether what a method returned is an estimate at all, and makes sense."""

from __future__ import annotations

import numbers
from typing import Any

import numpy as np

from pilotid.estimates.draws import Draws
from pilotid.estimates.estimate import Estimate, Outcome, Starts
from pilotid.estimates.remnant import RemnantEstimate
from pilotid.estimates.response import FrequencyResponse
from pilotid.estimates.trajectory import Trajectory
from pilotid.pilot.frozen import frozen
from pilotid.pilot.model import PilotModel

#: Rounding that a correlation matrix may show: Kvis and tlead are correlated at -0.99.
ROUNDING = 1e-6
MOST_ITERATIONS = 2**63 - 1  # what a store's integer holds

#: The optional parts of an estimate and their types.
PARTS = {
    "starts": Starts,
    "remnant": RemnantEstimate,
    "frequency_response": FrequencyResponse,
    "draws": Draws,
    "trajectory": Trajectory,
}


def fault_of(estimate: object, model: PilotModel) -> str:
    """What is wrong with an estimate of a model, empty if it is sound.

    A fit that failed need not give numbers, but what it gives has the right shapes.
    """
    if not isinstance(estimate, Estimate):
        return f"it returned {_a(estimate)} in place of an Estimate"
    if estimate.model != model:
        return "it is an estimate of another model"
    return (
        _wrong_shapes(estimate)
        or _wrong_parts(estimate)
        or (_senseless(estimate) if estimate.outcome.usable else "")
    )


def _a(thing: object) -> str:
    name = type(thing).__name__
    return "nothing" if thing is None else f"{'an' if name[0] in 'aeiou' else 'a'} {name}"


def _wrong_shapes(estimate: Any) -> str:
    count = len(estimate.model.parameters)
    shapes = {"values": (count,), "covariance": (count, count), "intervals": (count, 2)}
    if estimate.errors is not None:
        shapes["errors"] = (count,)
    for name, shape in shapes.items():
        given = getattr(estimate, name)
        if not isinstance(given, np.ndarray):
            return f"its {name} are {_a(given)} in place of an array"
        if given.shape != shape:
            return f"its {name} have the shape {given.shape} in place of {shape}"
        if given.dtype.kind not in "fiu":
            return f"its {name} are of type {given.dtype} in place of real numbers"
    return ""


def _wrong_parts(estimate: Any) -> str:
    if not isinstance(estimate.outcome, Outcome):
        return f"its outcome is {_a(estimate.outcome)} in place of an Outcome"
    if not isinstance(estimate.message, str):
        return f"its message is {_a(estimate.message)} in place of a text"
    if not isinstance(estimate.remarks, tuple) or not all(
        isinstance(remark, str) for remark in estimate.remarks
    ):
        return "its remarks are no tuple of texts"
    if not all(isinstance(remark, str) for remark in estimate.remarks):
        return "its remarks are no texts"
    for name, value in (("VAF", estimate.vaf), ("criterion", estimate.criterion)):
        if not isinstance(value, numbers.Real):
            return f"its {name} is {_a(value)} in place of a number"
    count = estimate.iterations
    if not isinstance(count, numbers.Integral) or not 0 <= int(count) <= MOST_ITERATIONS:
        return "its iterations are no count"
    for name, kind in PARTS.items():
        part = getattr(estimate, name)
        if part is not None and not isinstance(part, kind):
            return f"its {name} is {_a(part)} in place of a {kind.__name__}"
    response, draws = estimate.frequency_response, estimate.draws
    if response is not None and len(response.value) != len(estimate.model.channels):
        return "its frequency response is not of the model's channels"
    if draws is not None and (
        draws.values.ndim != 2
        or draws.values.shape[1] < len(estimate.model.parameters)
        or draws.weights.shape != draws.values.shape[:1]
    ):
        return "its draws are not of the model's parameters"
    return _wrong_trajectory(estimate.trajectory, estimate.model)


def _wrong_trajectory(trajectory: Trajectory | None, model: PilotModel) -> str:
    if trajectory is None:
        return ""
    if trajectory.keys != frozen(model).keys:
        return "its trajectory is not of the model's parameters"
    shape = (len(trajectory.keys), trajectory.time.size)
    for part in (trajectory.values, trajectory.lower, trajectory.upper):
        if part.shape != shape:
            return f"its trajectory has the shape {part.shape} in place of {shape}"
    if not (np.isfinite(trajectory.time).all() and (np.diff(trajectory.time) > 0.0).all()):
        return "the times of its trajectory do not rise"
    return ""


def _senseless(estimate: Estimate) -> str:
    """What a usable estimate claims that cannot be."""
    values, covariance = estimate.values, estimate.covariance
    low, high = estimate.intervals.T
    if not np.isfinite(values).all():
        return "a value is not finite"
    if not np.isfinite(covariance).all():
        return "the covariance is not finite"
    variances = np.diag(covariance)
    if not (variances > 0.0).all():
        return "a variance is not positive"
    correlation = covariance / np.sqrt(np.outer(variances, variances))
    if not np.allclose(correlation, correlation.T, rtol=0.0, atol=ROUNDING):
        return "the covariance is not symmetric"
    if np.linalg.eigvalsh(correlation)[0] < -ROUNDING:
        return "the covariance is not positive"
    if not (np.isfinite(estimate.std_error) & (estimate.std_error > 0.0)).all():
        return "a standard error is not positive"
    if not ((low <= values) & (values <= high)).all():
        return "an interval does not hold its value"
    if not (np.isnan(estimate.vaf) or 0.0 <= estimate.vaf <= 100.0):
        return f"a VAF of {float(estimate.vaf):g} % cannot be"
    return ""
