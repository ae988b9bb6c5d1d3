"""Fits of a subject's conditions with parameters in common."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from pilotid.estimates.estimate import Estimate
from pilotid.estimates.fitted import Fitted
from pilotid.estimates.shared import share
from pilotid.estimates.warnings import all_remarks
from pilotid.pilot.model import PilotModel
from pilotid.recordings.recording import Recording
from pilotid.time_domain.output_error import simulated_vaf
from pilotid.types import InputError


def require_keys(models: Iterable[PilotModel], keys: Sequence[str]) -> None:
    """Refuse shared parameters that a model lacks."""
    for model in models:
        if lacking := [key for key in keys if key not in model.keys]:
            raise InputError(
                f"--share {','.join(keys)}: the model {model.name} has no {lacking[0]} to "
                f"estimate; it has {', '.join(model.keys)}"
            )


def share_fits(
    fits: Sequence[Fitted], conditions: Sequence[str], keys: Sequence[str]
) -> list[Fitted]:
    """Fits of one subject's conditions with parameters in common, method by method."""
    columns = []
    for separate in zip(*(fitted.estimates for fitted in fits), strict=True):
        together, _ = share(dict(zip(conditions, separate, strict=True)), keys)
        each = zip(separate, conditions, fits, strict=True)
        columns.append([_told_anew(own, together[name], f.recording) for own, name, f in each])
    rows = zip(*columns, strict=True)
    return [replace(f, estimates=tuple(own)) for f, own in zip(fits, rows, strict=True)]


def _told_anew(own: Estimate, shared: Estimate, recording: Recording) -> Estimate:
    """An estimate with shared parameters: what it explains, and what its numbers call for."""
    if not own.outcome.usable:
        return shared
    called_for = {str(r) for r in all_remarks(replace(own, remarks=()), recording)}
    kept = tuple(r for r in shared.remarks if str(r) not in called_for)
    vaf = simulated_vaf(recording, own.model, shared.values)
    shared = replace(shared, remarks=kept, vaf=vaf)
    return replace(shared, remarks=all_remarks(shared, recording))
