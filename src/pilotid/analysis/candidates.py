"""Candidates: what a recording says for each of several models."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from pilotid.analysis.forced import Forced, forced
from pilotid.estimates.applicability import lines_objection, motionless_input
from pilotid.estimates.estimate import bounds_reached
from pilotid.pilot.catalogue import MODELS
from pilotid.pilot.model import PilotModel
from pilotid.recordings.checks import motionless
from pilotid.recordings.recording import Recording
from pilotid.time_domain.constancy import changes
from pilotid.time_domain.information_criteria import Evidence, evidence
from pilotid.time_domain.output_error import simulated_vaf
from pilotid.types import FloatArray, InputError

#: Models of the catalogue to be asked for by name: beside `lead-lag` a lead that is squared is
#: taken by chance where few runs judge, also of pilots who have no lag at all.
ASKED_FOR = ("lead2-lag", "lead2-lag-motion")

#: A neuromuscular system of a higher damping ratio is a lag in disguise.
OVERDAMPED = 1.0


@dataclass(frozen=True)
class Candidate:
    """One model on one recording: a line of models.csv; NaN and 0 for what was not worked out.

    Attributes
    ----------
    model
        Name of the model.
    pilot, parameters
        Number of the pilot's parameters, and of all that were estimated.
    remnant
        Name of the remnant's model.
    samples
        Number of prediction errors that the log-likelihood is of.
    log_likelihood, aicc, bic
        Of pilot and remnant together.
    vaf, left_out_vaf
        Variance accounted for, and in runs left out of the fit [%].
    left_out_log_likelihood
        Of each run under what the others say; empty where there is one run alone.
    misfit, freedom
        Chi-squared of the forcing functions' lines and its degrees of freedom; NaN and 0 where
        there are no lines.
    left_out_misfit
        Chi-squared of each run's lines under what the others say; empty where there is none.
    bounds
        The bounds that parameters reached, in words.
    overdamped
        Whether the neuromuscular system is overdamped.
    change_p, change_size, change_time
        How often a pilot whose gains and leads are constant would seem to change as this one
        does, by how much of its value a gain or lead changes at most, and when that is seen best
        [s]; NaN for a model that varies.
    """

    model: str
    pilot: int
    parameters: int = 0
    remnant: str = ""
    samples: int = 0
    log_likelihood: float = math.nan
    aicc: float = math.nan
    bic: float = math.nan
    vaf: float = math.nan
    left_out_vaf: float = math.nan
    left_out_log_likelihood: tuple[float, ...] = ()
    misfit: float = math.nan
    freedom: int = 0
    left_out_misfit: tuple[float, ...] = ()
    bounds: str = ""
    overdamped: bool = False
    change_p: float = math.nan
    change_size: float = math.nan
    change_time: float = math.nan

    @property
    def changes(self) -> bool:
        """Whether the pilot is said to change, see `pilotid.time_domain.constancy`."""
        return changes(self.change_p, self.change_size)

    @property
    def excess(self) -> float:
        """Chi-squared per degree of freedom of the lines."""
        return self.misfit / self.freedom if self.freedom > 0 else math.nan

    @property
    def left_out(self) -> tuple[float, ...]:
        """What each run left out of the fit is not explained by, in units of deviance."""
        if self.freedom > 0:
            return self.left_out_misfit
        return tuple(-2.0 * likelihood for likelihood in self.left_out_log_likelihood)

    def to_dict(self) -> dict[str, object]:
        """Plain objects, as JSON has them; NaN where there is none."""
        return {
            "model": self.model,
            "pilot_parameters": self.pilot,
            "parameters": self.parameters,
            "log_likelihood": self.log_likelihood,
            "aicc": self.aicc,
            "bic": self.bic,
            "vaf": self.vaf,
            "left_out_vaf": self.left_out_vaf,
            "left_out_log_likelihood": list(self.left_out_log_likelihood),
            "chi_squared": self.misfit,
            "freedom": self.freedom,
            "left_out_chi_squared": list(self.left_out_misfit),
            "bounds": self.bounds,
            "change_p": self.change_p,
            "change_size": self.change_size,
            "change_time": self.change_time,
        }


def sensible(recording: Recording) -> list[PilotModel]:
    """The catalogue's models that a recording can tell apart, the simplest first.

    A channel on the output beside one on the error needs two forcing functions.  Channels on
    the target are left out: a compensatory display does not show it, and a recording does not
    say what was displayed.  Models that vary in time are to be asked for.
    """
    both = (
        recording.ft is not None
        and recording.fd is not None
        and not motionless(recording, "ft")
        and not motionless(recording, "fd")
    )
    found = []
    for model in MODELS.values():
        inputs = {channel.input for channel in model.channels}
        if model.name in ASKED_FOR or model.changes:
            continue
        if inputs <= ({"error", "output"} if both else {"error"}):
            found.append(model)
    return sorted(found, key=lambda model: len(model.parameters))


def compared(
    recording: Recording, models: Sequence[PilotModel], seed: int, *, likelihood: bool = True
) -> list[Candidate]:
    """What a recording says for each of several models, in their order.

    Parameters
    ----------
    recording
        The recording.
    models
        The models; those that have no input in it are left out.
    seed
        Seed of the searches' random starts.
    likelihood
        Whether to work out likelihoods too where the lines of forcing functions judge: most of
        the time goes there.

    Raises
    ------
    InputError
        If no model has all its inputs in the recording.
    """
    models = [model for model in models if motionless_input(recording, model) is None]
    if not models:
        raise InputError(f"{recording.source}: none of the models has its inputs in the recording")
    if any(lines_objection(recording, model) is not None for model in models):
        return [_by_likelihood(found) for found in evidence(recording, models, seed)]
    lines = forced(recording, models, seed)
    if not likelihood:
        return [_by_lines(recording, found) for found in lines]
    # The likelihood's search begins where the lines lead, and with the model that they favour.
    order = sorted(range(len(models)), key=lambda place: lines[place].misfit)
    found = evidence(recording, [models[i] for i in order], seed, [lines[i].values for i in order])
    return [_with_lines(_by_likelihood(found[order.index(i)]), own) for i, own in enumerate(lines)]


def _by_likelihood(found: Evidence) -> Candidate:
    return Candidate(
        model=found.model.name,
        pilot=len(found.model.parameters),
        parameters=found.parameters,
        remnant=found.remnant,
        samples=found.samples,
        log_likelihood=found.log_likelihood,
        aicc=found.aicc,
        bic=found.bic,
        vaf=found.vaf,
        left_out_vaf=found.left_out_vaf,
        left_out_log_likelihood=tuple(found.left_out.tolist()),
        bounds=bounds_reached(found.model, found.values),
        overdamped=_overdamped(found.model, found.values),
        change_p=math.nan if found.constancy is None else found.constancy.p,
        change_size=math.nan if found.constancy is None else found.constancy.size,
        change_time=math.nan if found.constancy is None else found.constancy.time,
    )


def _with_lines(candidate: Candidate, lines: Forced) -> Candidate:
    """A candidate with what the lines say of its model."""
    return replace(
        candidate,
        misfit=lines.misfit,
        freedom=lines.freedom,
        left_out_misfit=tuple(lines.left_out.tolist()),
        bounds=bounds_reached(lines.model, lines.values),
        overdamped=_overdamped(lines.model, lines.values),
    )


def _by_lines(recording: Recording, found: Forced) -> Candidate:
    vaf = simulated_vaf(recording, found.model, found.values)
    return _with_lines(Candidate(found.model.name, len(found.model.parameters), vaf=vaf), found)


def _overdamped(model: PilotModel, values: FloatArray) -> bool:
    damping = dict(zip(model.keys, values.tolist(), strict=True)).get("dnm", 0.0)
    return bool(damping > OVERDAMPED)
