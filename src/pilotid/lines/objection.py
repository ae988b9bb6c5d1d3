"""Whether a recording's forcing lines can tell the parameters of a model."""

from __future__ import annotations

import numpy as np

from pilotid.estimates.method import dependent_signals, varying
from pilotid.pilot.model import PilotModel
from pilotid.recordings.lines import NotMultisineError, forcing_lines
from pilotid.recordings.recording import Recording


def objection(recording: Recording, model: PilotModel) -> str | None:
    """Why the forcing functions have no lines, or too few, for the model's channels; or None."""
    if constant_only := varying(model):
        return constant_only
    try:
        lines = forcing_lines(recording)
    except NotMultisineError as error:
        return str(error)
    if not lines:
        return "the recording holds neither ft or fd nor their lines"
    inputs = [channel.input for channel in model.channels]
    if len(set(inputs)) < len(inputs):
        return f"model {model.name} has two channels on one input, which no lines tell apart"
    if inputs == ["target"]:
        return f"model {model.name} acts on the target alone, outside any loop"
    if dependent := dependent_signals(model):
        return dependent
    fewest = min(own.size for own in lines.values())
    if len(inputs) == 2 and len(lines) < 2:
        return "two channels need both a target and a disturbance forcing function"
    if len(inputs) == 2 and np.intersect1d(lines["ft"], lines["fd"]).size:
        return "two channels need forcing functions without common lines"
    if fewest < 2:
        return "a forcing function has a single line, where two or more are needed"
    count = sum(own.size for own in lines.values())
    if 2 * count < len(model.parameters):
        return f"{count} lines are too few for {len(model.parameters)} parameters"
    return None
