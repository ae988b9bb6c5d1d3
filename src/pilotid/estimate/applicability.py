"""Why a model cannot be identified from a recording, for the objections of methods."""

from __future__ import annotations

import numpy as np

from pilotid.checks.checks import motionless
from pilotid.model.catalogue import fault_of
from pilotid.model.element import parsed_element
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.recording.roles import listed
from pilotid.recording.spectra import NotMultisineError, at_lines, forcing_lines, told_apart
from pilotid.support.limits import SIGNAL
from pilotid.support.types import FloatArray, InputError

CLEAR = 4.0  # times its noise that an extra signal's power at lines must be
#: What to do where channels cannot be told apart.
REMEDY = "record with a target and a disturbance, or fit one channel"


def motionless_input(recording: Recording, model: PilotModel) -> str | None:
    """Why no method can identify a model: a channel has nothing to act on, or is infinite."""
    if fault := fault_of(model):
        return fault
    if model.needs_element:
        named = recording.controlled_element
        return (
            f"model {model.name} is made for a controlled element with a stable inverse, and the "
            f"recording names {named or 'none'}; name one, for example --element 4/s^2"
        )
    if missing := unrecorded(recording, model):
        return missing
    for channel in model.channels:
        if (
            _absent(recording, recording.input("ft"), recording.e)
            if channel.on == "ft"
            else motionless(recording, channel.on)
        ):
            return f"{channel.on} does not move, so that the {channel.name} channel has no input"
    return None


def unrecorded(recording: Recording, model: PilotModel) -> str | None:
    """Why no method at all can treat a model: what it acts on, or sees ahead, was not recorded.

    A target is known from e and x as well.
    """
    known = {*recording.signals, *(("ft",) if {"e", "x"} <= set(recording.signals) else ())}
    missing = [channel.on for channel in model.channels if channel.on not in known]
    if missing:
        return (
            f"model {model.name} acts on what is not recorded ({listed(dict.fromkeys(missing))}); "
            f"name the column, for example --map {missing[0]}=COLUMN, or choose another model"
        )
    if model.ahead <= 0.5 * recording.duration:
        return None
    return (
        f"model {model.name} looks up to {model.ahead:g} s ahead, and so much of the end of "
        f"{recording.duration:.3g} s cannot be scored, since the target beyond it is not recorded; "
        "bound the look-ahead, for example --fix tlook=0..2"
    )


def made_for(recording: Recording, model: PilotModel) -> PilotModel:
    """A model for the controlled element that a recording names; one that needs none as it is.

    It stays as it is, too, where no element is named that a pilot can invert.
    """
    element = parsed_element(recording.controlled_element) if model.needs_element else None
    try:
        return model if element is None else model.with_element(element)
    except InputError:
        return model


def shared_signals(recording: Recording, model: PilotModel) -> str | None:
    """Why channels can hardly be told apart: their signals depend on one another."""
    inputs = {channel.on for channel in model.channels} - {*model.extra}
    if "ft" not in inputs or len(inputs) < 2:
        return one_signal(recording, model)
    if dependent := dependent_signals(model):
        return dependent
    names = " and ".join(channel.name for channel in model.channels)
    if recording.fd is not None and not _absent(recording, recording.fd, recording.u):
        return None
    return (
        f"no disturbance is recorded, and without one the {names} channels follow one signal: "
        f"nothing but their form and the remnant tells them apart; {REMEDY}"
    )


def dependent_signals(model: PilotModel) -> str | None:
    """Why no response of each channel can be measured: they act on e, x and ft, which is e + x."""
    if not {channel.on for channel in model.channels} >= {"e", "x", "ft"}:
        return None
    names = " and ".join(channel.name for channel in model.channels)
    return (
        f"ft = e + x, so that the {names} channels act on two signals: nothing but their form "
        "tells them apart; fit two channels"
    )


def varying(model: PilotModel) -> str | None:
    """Why a method of constant pilots cannot treat a model: its parameters vary in time."""
    if not model.changes:
        return None
    return (
        f"model {model.name} varies in time, and this method assumes constant parameters; use mle, "
        "or fit a constant model"
    )


def looking_ahead(model: PilotModel) -> str | None:
    """Why a method of causal systems cannot treat a model: it sees the target ahead."""
    if not model.ahead:
        return None
    return (
        f"model {model.name} looks ahead, and this method is of systems that answer after their "
        "input; use mle or fourier"
    )


def one_signal(recording: Recording, model: PilotModel) -> str | None:
    """Why channels on error and output can hardly be told apart: there is no target."""
    if not {channel.on for channel in model.channels} >= {"e", "x"}:
        return None
    if not _absent(recording, recording.e + recording.x, recording.e):
        return None
    names = " and ".join(channel.name for channel in model.channels)
    return (
        f"there is no target, so that e = -x and the {names} channels act on one signal: only "
        f"what they do together is measured, and nothing but their form tells them apart; {REMEDY}"
    )


def _absent(recording: Recording, forcing: FloatArray, beside: FloatArray) -> bool:
    """Whether a forcing function is no more than rounding errors beside another signal."""
    size = np.std(recording.window(beside), axis=1)
    return not np.any(np.std(recording.window(forcing), axis=1) > SIGNAL.motionless_forcing * size)


def lines_objection(recording: Recording, model: PilotModel) -> str | None:
    """Why the forcing functions have no lines, or too few, for the model's channels; or None."""
    if constant_only := varying(model):
        return constant_only
    try:
        lines = forcing_lines(recording)
    except NotMultisineError as error:
        return str(error)
    if not lines:
        return "the recording holds neither ft or fd nor their lines"
    inputs = [channel.on for channel in model.channels]
    if len(set(inputs)) < len(inputs):
        return f"model {model.name} has two channels on one input, which no lines tell apart"
    if inputs == ["ft"]:
        return f"model {model.name} acts on the target alone, outside any loop"
    if dependent := dependent_signals(model):
        return dependent
    every = np.concatenate(list(lines.values()))
    for name in model.extra:
        values, noise = at_lines(recording, recording.input(name), every, lines)
        if np.mean(np.abs(values) ** 2) < CLEAR * np.mean(noise):
            return (
                f"{name} does not follow the forcing functions, so that their lines do not tell it"
            )
    if len(inputs) > 2 or (model.extra and "ft" in inputs):
        return (
            f"model {model.name} acts on {listed(inputs)}, which two forcing functions do not tell "
            "apart"
        )
    if len(inputs) == 2 and len(lines) < 2:
        return "two channels need both a target and a disturbance forcing function"
    if len(inputs) == 2 and not told_apart(recording):
        return "two channels need forcing functions without common lines in a run"
    if min(line.size for line in lines.values()) < 2:
        return "a forcing function has a single line, where two or more are needed"
    if 2 * every.size < len(model.parameters):
        return f"{every.size} lines are too few for {len(model.parameters)} parameters"
    return None
