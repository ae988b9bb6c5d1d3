"""Estimates and recordings as plain objects for JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable

import numpy as np

from pilotid.estimates.estimate import Estimate
from pilotid.estimates.quantities import Fitted, Quantity, derived, parameters
from pilotid.estimates.response import FrequencyResponse
from pilotid.pilot.model import PilotModel
from pilotid.recordings.recording import SIGNALS, Recording


def fit_json(fit: Fitted) -> dict[str, object]:
    """A fit as plain objects, in the form that `pilotid fit --json` writes."""
    return {
        "recording": _recording_json(fit.recording),
        "model": fit.model.name,
        "estimates": [estimate_json(estimate) for estimate in fit.estimates],
    }


def estimate_json(estimate: Estimate) -> dict[str, object]:
    """An estimate as plain objects."""
    starts = estimate.starts
    result: dict[str, object] = {
        "method": estimate.method,
        "outcome": estimate.outcome.slug,
        "message": estimate.sentence,
        "parameters": _quantities_json(parameters(estimate)),
        "derived": _quantities_json(derived(estimate)),
        "correlation": estimate.correlation.tolist(),
        "vaf": estimate.vaf,
        "iterations": estimate.iterations,
        "starts": starts and {"total": len(starts.cost), "agreeing": starts.agreeing},
        "seconds": estimate.seconds,
    }
    remnant = estimate.remnant
    if remnant is not None:
        result["remnant"] = {
            "model": remnant.model,
            "parameters": remnant.parameters,
            "power_ratio": remnant.power_ratio,
            "omega": remnant.omega.tolist(),
            "density": remnant.density.tolist(),
        }
    if estimate.frequency_response is not None:
        result["frequency_response"] = _response_json(estimate.model, estimate.frequency_response)
    return result


def _response_json(model: PilotModel, response: FrequencyResponse) -> dict[str, object]:
    result: dict[str, object] = {"omega": response.omega.tolist()}
    if response.note:
        result["note"] = response.note
    for c, channel in enumerate(model.channels):
        entry = {
            "real": np.real(response.value[c]).tolist(),
            "imag": np.imag(response.value[c]).tolist(),
            "std": response.std[c].tolist(),
        }
        if response.systematic is not None:
            entry["systematic"] = response.systematic[c].tolist()
        result[channel.name] = entry
    return result


def strict_json(value: object) -> str:
    """JSON text; what is not finite becomes null, since JSON has no word for it."""
    return json.dumps(_finite(value), indent=2, allow_nan=False) + "\n"


def _finite(value: object) -> object:
    if isinstance(value, dict):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _recording_json(recording: Recording) -> dict[str, object]:
    return {
        "source": recording.source,
        "runs": recording.runs,
        "samples": recording.samples,
        "dt": recording.dt,
        "duration": recording.duration,
        "run_in": recording.run_in * recording.dt,
        "signals": [name for name in SIGNALS if getattr(recording, name) is not None],
        "units": dict(recording.units),
        "lines": {name: list(lines) for name, lines in recording.lines.items()},
        "controlled_element": recording.controlled_element,
    }


def _quantities_json(quantities: Iterable[Quantity]) -> dict[str, object]:
    return {
        q.key: {
            "value": q.value,
            "std_error": q.std_error,
            "interval_95": [q.lower, q.upper],
            "unit": q.unit,
        }
        for q in quantities
    }
