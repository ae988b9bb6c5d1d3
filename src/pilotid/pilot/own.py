"""Models of one's own, taken from code as ``file.py:NAME`` or ``package.module:NAME``."""

from __future__ import annotations

import re

import numpy as np

from pilotid.naming.code import reason, taken
from pilotid.pilot.frozen import frozen
from pilotid.pilot.model import PilotModel
from pilotid.types import FloatArray, InputError

#: Frequencies [rad/s] at which a model is tried.
TRIED = np.geomspace(0.1, 30.0, 7)
#: Step by which derivatives are tried, as a share of the parameter, and how far a derivative may
#: be off, as a share of its largest value.
STEP, OFF = 1e-5, 1e-3


def own_model(text: str) -> PilotModel:
    """The model that stands at a place in code, with the settings behind it.

    Raises
    ------
    InputError
        If it is no `PilotModel`, or one with which no method can reckon.
    """
    thing = taken(text)
    if not isinstance(thing, PilotModel):
        raise InputError(
            f"{text}: is no PilotModel; write NAME = PilotModel('name', (Channel(...), ...)) there"
        )
    require_name(thing.name)
    fault = fault_of(thing)
    if fault:
        raise InputError(f"{text}: {fault}")
    return thing


def require_name(name: object) -> None:
    """Refuse a name that cannot stand in files and links."""
    if not isinstance(name, str) or not re.fullmatch(r"\w[\w.+-]{0,100}", name, re.ASCII):
        raise InputError(
            f"a model has the name {name!r}; it must be of letters, digits and the signs . + -"
        )


def fault_of(model: PilotModel) -> str:
    """What is wrong with the numbers that a model's factors give, empty if they are sound."""
    if not model.parameters:
        return f"model {model.name} has no parameter to estimate"
    model = frozen(model)  # what varies in time is put together of constant factors
    try:
        response, jacobian = model.response_and_jacobian(TRIED, model.start)
        differences = [_difference(model, i) for i in range(len(model.parameters))]
    except Exception as error:  # code of others may raise anything
        return f"model {model.name} gives no response ({reason(error)})"
    if not np.isfinite(response).all():
        return f"the response of model {model.name} is no number at its start"
    for i, (parameter, difference) in enumerate(zip(model.parameters, differences, strict=True)):
        slope = jacobian[:, i]
        if not np.allclose(slope, difference, rtol=0.0, atol=OFF * np.max(np.abs(difference))):
            return (
                f"the derivative of model {model.name} by {parameter.key} is not that of its "
                "response; correct the `log_derivative` of its factors"
            )
    return ""


def _difference(model: PilotModel, index: int) -> FloatArray:
    """The response's derivative by a parameter at the start, from a small step."""
    ends = np.array([model.start, model.start])
    parameter, start = model.parameters[index], float(model.start[index])
    room = min(parameter.upper - start, start - parameter.lower)
    ends[:, index] += np.array([-1.0, 1.0]) * min(STEP * max(abs(start), 1e-3), 0.5 * room)
    behind, ahead = (model.response(TRIED, end) for end in ends)
    return np.asarray((ahead - behind) / (ends[1, index] - ends[0, index]))
