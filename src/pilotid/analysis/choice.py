"""Which model: candidates ranked by what recordings say, and the reason in words."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pilotid.analysis.forced import Forced, forced, objection
from pilotid.estimates.bounds import bounds_reached
from pilotid.estimates.method import motionless_input
from pilotid.pilot.catalogue import MODELS
from pilotid.pilot.model import PilotModel
from pilotid.recordings.checks import motionless
from pilotid.recordings.names import listed
from pilotid.recordings.recording import Recording
from pilotid.time_domain.evidence import Evidence, evidence
from pilotid.types import InputError

#: The name that asks for a choice.
AUTO = "auto"

#: Models of the catalogue to be asked for by name: beside `lead-lag` a lead that is squared is
#: taken by chance where few runs judge, also of pilots who have no lag at all.
ASKED_FOR = ("lead2-lag", "lead2-lag-motion")

#: Points of VAF by which a model may explain less of the control than the best one, where only
#: the likelihood judges: beyond, it describes the loop and not the pilot.
LOST = 10.0

#: A model with more parameters is taken where it is better by more than so many standard errors,
#: and by so much in deviance: of few runs the standard error itself is hardly known.
CLEARLY, LEAST = 2.0, 4.0

#: Where no run can be left out, it is taken where it is better by more than this in deviance.
CLOSE = 2.0

#: A neuromuscular system of a higher damping ratio is a lag in disguise.
OVERDAMPED = 1.0


@dataclass(frozen=True)
class Candidate:
    """One model on one recording: a line of models.csv.

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
    """

    model: str
    pilot: int
    parameters: int
    remnant: str
    samples: int
    log_likelihood: float
    aicc: float
    bic: float
    vaf: float
    left_out_vaf: float
    left_out_log_likelihood: tuple[float, ...]
    misfit: float
    freedom: int
    left_out_misfit: tuple[float, ...]
    bounds: str
    overdamped: bool

    @property
    def excess(self) -> float:
        """Chi-squared per degree of freedom of the lines."""
        return self.misfit / self.freedom if self.freedom > 0 else math.nan


def sensible(recording: Recording) -> list[PilotModel]:
    """The catalogue's models that a recording can tell apart, the simplest first.

    A channel on the output beside one on the error needs two forcing functions.  Channels on
    the target are left out: a compensatory display does not show it, and a recording does not
    say what was displayed.
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
        if model.name in ASKED_FOR:
            continue
        if inputs <= ({"error", "output"} if both else {"error"}):
            found.append(model)
    return sorted(found, key=lambda model: len(model.parameters))


def compared(recording: Recording, models: Sequence[PilotModel], seed: int) -> list[Candidate]:
    """What a recording says for each of several models, in their order.

    Parameters
    ----------
    recording
        The recording.
    models
        The models; those that have no input in it are left out.
    seed
        Seed of the searches' random starts.

    Raises
    ------
    InputError
        If no model has all its inputs in the recording.
    """
    models = [model for model in models if motionless_input(recording, model) is None]
    if not models:
        raise InputError(f"{recording.source}: none of the models has its inputs in the recording")
    by_lines: dict[str, Forced] = {}
    if all(objection(recording, model) is None for model in models):
        by_lines = {f.model.name: f for f in forced(recording, models, seed)}
    # The likelihood's search begins where the lines lead, and with the model that they favour.
    order = sorted(models, key=lambda m: by_lines[m.name].misfit if by_lines else 0.0)
    starts = [by_lines[m.name].values if by_lines else None for m in order]
    by_name = {e.model.name: e for e in evidence(recording, order, seed, starts)}
    return [_candidate(by_name[m.name], by_lines.get(m.name)) for m in models]


def _candidate(found: Evidence, lines: Forced | None) -> Candidate:
    model = found.model
    values = found.values if lines is None else lines.values
    damping = dict(zip(model.keys, values.tolist(), strict=True)).get("dnm", 0.0)
    return Candidate(
        model=model.name,
        pilot=len(model.parameters),
        parameters=found.parameters,
        remnant=found.remnant,
        samples=found.samples,
        log_likelihood=found.log_likelihood,
        aicc=found.aicc,
        bic=found.bic,
        vaf=found.vaf,
        left_out_vaf=found.left_out_vaf,
        left_out_log_likelihood=tuple(found.left_out.tolist()),
        misfit=math.nan if lines is None else lines.misfit,
        freedom=0 if lines is None else lines.freedom,
        left_out_misfit=() if lines is None else tuple(lines.left_out.tolist()),
        bounds=bounds_reached(model, values),
        overdamped=damping > OVERDAMPED,
    )


@dataclass(frozen=True)
class Choice:
    """The model chosen for one recording, or for several of one condition.

    Attributes
    ----------
    model
        Its name.
    reason
        Why, in sentences.
    """

    model: str
    reason: str


def chosen(recordings: Sequence[Sequence[Candidate]]) -> Choice:
    """The simplest model that explains recordings as well as any.

    Runs left out of the fit judge: of the models whose misfit there exceeds the smallest by no
    more than two standard errors, the one with the fewest parameters (after Hastie, Tibshirani &
    Friedman, *The Elements of Statistical Learning*, 2nd ed., sec. 7.10, who take one).  Single
    runs are judged by an information criterion.

    Parameters
    ----------
    recordings
        For each recording the candidates, see `compared`.
    """
    names = [c.model for c in recordings[0]]
    names = [name for name in names if all(name in [c.model for c in held] for held in recordings)]
    held = [{c.model: c for c in candidates} for candidates in recordings]
    by_lines = all(c.freedom > 0 for own in held for c in own.values())
    credible = names if by_lines else _credible(held, names)
    deficits = _deficits(held, credible, by_lines)
    best = min(credible, key=lambda name: (sum(deficits[name]), held[0][name].pilot))
    least = {n: [a - b for a, b in zip(deficits[n], deficits[best], strict=True)] for n in credible}
    units = len(least[best])
    limit = {
        n: max(LEAST, CLEARLY * _standard_error(least[n])) if units > 1 else CLOSE for n in credible
    }
    close = [n for n in credible if sum(least[n]) <= limit[n] or n == best]
    taken = min(close, key=lambda name: (held[0][name].pilot, sum(least[name])))
    told = _reason(held, taken, best, least, by_lines)
    told += _warnings(held, names, credible, taken)
    return Choice(taken, " ".join(told))


def _credible(held: Sequence[Mapping[str, Candidate]], names: Sequence[str]) -> list[str]:
    """Models that explain about as much of the control as the best one."""
    most = [max(own[name].vaf for name in names) for own in held]
    return [
        name
        for name in names
        if all(own[name].vaf >= top - LOST for own, top in zip(held, most, strict=True))
    ] or [max(names, key=lambda name: sum(own[name].vaf for own in held))]


def _deficits(
    held: Sequence[Mapping[str, Candidate]], names: Sequence[str], by_lines: bool
) -> dict[str, list[float]]:
    """What each model leaves unexplained, in units of deviance: by run left out, else by file."""
    found: dict[str, list[float]] = {name: [] for name in names}
    for own in held:
        # What even the best candidate cannot follow counts as noise.
        size = max(1.0, min(own[n].excess for n in names)) if by_lines else 1.0
        for name in names:
            candidate = own[name]
            if by_lines and candidate.left_out_misfit:
                found[name] += [m / size for m in candidate.left_out_misfit]
            elif by_lines:
                found[name].append(candidate.misfit / size + 2.0 * candidate.pilot)
            elif candidate.left_out_log_likelihood:
                found[name] += [-2.0 * m for m in candidate.left_out_log_likelihood]
            else:
                found[name].append(candidate.aicc)
    return found


def _standard_error(differences: Sequence[float]) -> float:
    """Of their sum."""
    return float(np.std(differences, ddof=1) * math.sqrt(len(differences)))


def _reason(
    held: Sequence[Mapping[str, Candidate]],
    taken: str,
    best: str,
    least: Mapping[str, Sequence[float]],
    by_lines: bool,
) -> list[str]:
    units = len(least[best])
    what = "at the lines of the forcing functions" if by_lines else "by the errors of prediction"
    judge = f"{units} runs, each left out of its fit" if units > 1 else "one fit"
    names = sorted(least, key=lambda name: sum(least[name]))
    told = [f"{taken} was chosen among {listed(names)} {what} ({judge})."]
    if all(len(candidates) == 1 for candidates in held):
        return []
    own, pilot = held[0], held[0][taken].pilot
    for name in names:
        differences = [a - b for a, b in zip(least[name], least[taken], strict=True)]
        size = f"{abs(sum(differences)):.0f}"
        size += f" +- {_standard_error(differences):.0f}" if units > 1 else ""
        if name != taken and sum(differences) < 0.0:
            told.append(
                f"{name} leaves {size} less of the deviance unexplained, which is no clear gain "
                f"for {own[name].pilot} parameters instead of {pilot}."
            )
        elif name != taken:
            told.append(f"{name} leaves {size} more.")
    return told


def _warnings(
    held: Sequence[Mapping[str, Candidate]],
    names: Sequence[str],
    credible: Sequence[str],
    taken: str,
) -> list[str]:
    told = []
    for name in names:
        if name not in credible:
            vaf = min(own[name].vaf for own in held)
            told.append(
                f"{name} explains no more than {vaf:.0f} % of the control of a recording that "
                "others explain better: it describes the loop, not the pilot."
            )
    likeliest = min(names, key=lambda name: sum(own[name].bic for own in held))
    if likeliest != taken:
        lower = sum(own[taken].bic - own[likeliest].bic for own in held)
        told.append(f"BIC of the whole control prefers {likeliest}, by {lower:.0f}")
        lost = max(own[taken].vaf - own[likeliest].vaf for own in held)
        told[-1] += f", though its VAF is up to {lost:.0f} points lower." if lost > LOST else "."
    disguised = [
        name
        for name in names
        if name != taken and 2 * sum(own[name].overdamped for own in held) > len(held)
    ]
    if disguised:
        told.append(
            f"{listed(disguised)} {'makes' if len(disguised) == 1 else 'make'} do with an "
            "overdamped neuromuscular system in place of a lag."
        )
    bounds = [own[taken].bounds for own in held if own[taken].bounds]
    if bounds:
        told.append(f"With {taken}, {len(bounds)} of {len(held)} end at a bound ({bounds[0]}).")
    return told
