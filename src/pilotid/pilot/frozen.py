"""The constant pilots that a pilot who changes is at one time or another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pilotid.pilot.changing import Changing
from pilotid.pilot.factors import Factor
from pilotid.pilot.model import Channel, PilotModel
from pilotid.types import FloatArray, IntArray


def frozen(model: PilotModel) -> PilotModel:
    """The model with its changing parameters taken for constant; a constant one as it is."""
    if not model.changes:
        return model
    channels = tuple(_constant(channel) for channel in model.channels)
    plain = PilotModel(model.name, channels, model.description)
    kept = tuple(p for p in model.overrides if p.key in plain.keys)
    return replace(plain, overrides=kept)


def frozen_over(model: PilotModel, values: FloatArray, time: FloatArray) -> FloatArray:
    """Parameters of the frozen model at several times from the start of the window [s].

    Parameters
    ----------
    model
        The model that changes, or a constant one.
    values
        Its parameters, shape (..., parameters).
    time
        The times, shape (n,).

    Returns
    -------
    FloatArray
        Shape (..., parameters of the frozen model, n).
    """
    plain = frozen(model)
    place = {key: i for i, key in enumerate(model.keys)}
    still = (*values.shape[:-1], time.size)
    found = {
        key: np.broadcast_to(values[..., place[key], None], still)
        for key in plain.keys
        if key in place
    }
    for channel in model.channels:
        if (changing := channel.changing) is not None:
            own = values[..., [place[p.key] for p in changing.parameters]]
            keys = [p.key for factor in changing.factors for p in factor.parameters]
            found.update(zip(keys, np.moveaxis(changing.at(time, own), -2, 0), strict=True))
    return np.stack([found[key] for key in plain.keys], axis=-2)


def ends(model: PilotModel) -> tuple[IntArray, IntArray]:
    """Indices of a model's parameters that are those of the frozen one before and after.

    For a constant model these are all its parameters, twice.
    """
    plain, place = frozen(model), {key: i for i, key in enumerate(model.keys)}
    before, after = dict(place), dict(place)
    for channel in model.channels:
        if (changing := channel.changing) is not None:
            for factor in changing.factors:
                for p in factor.parameters:
                    first, last = changing.ends(p.key)
                    before[p.key], after[p.key] = place[first], place[last]
    return (
        np.array([before[key] for key in plain.keys]),
        np.array([after[key] for key in plain.keys]),
    )


def before_and_after(model: PilotModel, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Parameters (..., parameters) of the frozen model before and after the change."""
    before, after = ends(model)
    return values[..., before], values[..., after]


def searched(model: PilotModel) -> PilotModel:
    """The model that an optimum is searched with: the constant one where parameters vary freely."""
    return frozen(model) if model.curves else model


def unfrozen(model: PilotModel, constant: FloatArray) -> FloatArray:
    """Parameters with which a model that changes is a constant pilot all the time.

    Parameters
    ----------
    model
        The model that changes.
    constant
        Parameters of the frozen model, shape (..., parameters of the frozen model).

    Returns
    -------
    Array of shape (..., parameters).
    """
    plain = {key: i for i, key in enumerate(frozen(model).keys)}
    found = {key: constant[..., i] for key, i in plain.items()}
    for channel in model.channels:
        if (changing := channel.changing) is not None:
            own = constant[..., [plain[p.key] for p in changing.changed]]
            spread = np.moveaxis(changing.constant(own), -1, 0)
            found.update(zip((p.key for p in changing.parameters), spread, strict=True))
    return np.stack([found[key] for key in model.keys], axis=-1)


def _constant(channel: Channel) -> Channel:
    """A channel with its changing factors taken for constant."""
    factors: list[Factor] = []
    for factor in channel.factors:
        factors += list(factor.factors) if isinstance(factor, Changing) else [factor]
    return replace(channel, factors=tuple(factors))
