"""Leave-one-run-out cross-validation: how well the fit of the other runs predicts each run.

No truth is known of people.  What can be held against an estimate is a run that it has not seen:
how much of its control the simulated response explains (VAF), and how likely it is under the
pilot and a model of the remnant that are known from the other runs.  The remnant's model is
chosen the same way for all methods, from what each of them leaves of the other runs, so that
methods without one can be judged too.  The likelihood is of the whole control: in a closed loop
the inverse of the controlled element predicts it well without being a pilot, which the VAF
shows.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pilotid.analysis.combine import plain_mean
from pilotid.analysis.recordings import Part, alone, without
from pilotid.analysis.rows import grouped
from pilotid.estimates.method import Method, identify
from pilotid.pilot.model import PilotModel
from pilotid.recordings.recording import Recording
from pilotid.support.numbers import fit_rng
from pilotid.support.store import number
from pilotid.support.types import FloatArray
from pilotid.time_domain.output_error import OutputErrors, simulated_vaf
from pilotid.time_domain.prediction import Prediction, predict
from pilotid.time_domain.prepare import analysis_band
from pilotid.time_domain.remnant_models import best_noise_model

BAND = 50.0  # analysis band of the likelihood [rad/s], that of `mle`
COLUMNS = ("run", "model", "method", "outcome", "vaf", "log_likelihood", "seconds")


@dataclass(frozen=True)
class LeftOut:
    """A run that the fit of the others predicts: a line of left_out.csv.

    Attributes
    ----------
    part, run
        The recording, and which of its runs, from 1.
    model, method
        What was fitted to the others.
    outcome, usable
        How that ended, and whether it counts.
    vaf
        Of the run's control [%]; NaN where the fit does not count.
    log_likelihood
        Of the run's prediction errors.
    seconds
        Time of the fit.
    """

    part: Part
    run: int
    model: str
    method: str
    outcome: str
    usable: bool
    vaf: float
    log_likelihood: float
    seconds: float

    @property
    def cells(self) -> list[object]:
        """`COLUMNS`."""
        return [getattr(self, column) for column in COLUMNS]


def predict_left_out(
    recording: Recording, model: PilotModel, methods: Mapping[str, Method], run: int, seed: int
) -> list[dict[str, object]]:
    """Fit all runs but one by each method, and hold that one against the fits.

    Parameters
    ----------
    recording
        A recording of two runs at least.
    model, methods, seed
        What is fitted, methods by their labels.
    run
        The run that is left out, from 1.

    Returns
    -------
    Plain objects, one for each method.
    """
    others, own = without(recording, run), alone(recording, run)
    found: list[dict[str, object]] = []
    for label, method in methods.items():
        estimate = identify(method, others, model, fit_rng(seed, label))
        told: dict[str, object] = {"vaf": None, "log_likelihood": None}
        if estimate.outcome.usable:
            told["vaf"] = number(simulated_vaf(own, model, estimate.values))
            told["log_likelihood"] = number(log_likelihood(others, own, model, estimate.values))
        ended = estimate.outcome.slug, estimate.outcome.usable
        head = dict(zip(("method", "outcome", "usable"), (label, *ended), strict=True))
        found.append({**head, **told, "seconds": number(estimate.seconds)})
    return found


def log_likelihood(
    others: Recording, own: Recording, model: PilotModel, values: FloatArray
) -> float:
    """Of a run, under a pilot and the remnant that he leaves in other runs.

    Parameters
    ----------
    others, own
        The runs that the remnant is known from, and the one that is judged.
    model, values
        The pilot, with his parameters, shape (parameters,).
    """
    band = analysis_band(others.dt, BAND)
    left = _errors(others, model, values)
    taps = best_noise_model(left, band).whitener(band)
    variance = float(np.mean(_errors(others, model, values, taps) ** 2))
    errors = _errors(own, model, values, taps)
    squares = float(np.sum(errors**2)) / variance
    return -0.5 * (errors.size * math.log(2.0 * math.pi * variance) + squares)


def _errors(
    recording: Recording, model: PilotModel, values: FloatArray, taps: FloatArray | None = None
) -> FloatArray:
    """Control less prediction, whitened if need be, shape (runs, scored); offsets are fitted."""
    prediction: Prediction = predict(recording, model, BAND)
    prediction = replace(prediction, terms=(0.0,))
    if taps is None:
        return OutputErrors(prediction).residual(values)
    return prediction.without_nuisance(prediction.residual(values, taps))


def failed_rows(methods: Mapping[str, Method], outcome: str) -> list[dict[str, object]]:
    """The same as `predict_left_out` of fits that a process was lost with."""
    nothing = dict.fromkeys(("vaf", "log_likelihood", "seconds"))
    return [{"method": label, "outcome": outcome, "usable": False, **nothing} for label in methods]


def left_out_rows(part: Part, run: int, content: Mapping[str, Any]) -> list[LeftOut]:
    """Lines of a model's name and what `predict_left_out` gave."""

    def line(own: Mapping[str, Any]) -> LeftOut:
        held = (own[k] for k in ("vaf", "log_likelihood", "seconds"))
        numbers = (math.nan if number is None else float(number) for number in held)
        ended = str(own["method"]), str(own["outcome"]), bool(own["usable"])
        return LeftOut(part, run, content["model"], *ended, *numbers)

    return [line(own) for own in content["left_out"]]


@dataclass(frozen=True)
class Standing:
    """What a method makes of runs left out, with one model in recordings of one kind.

    Attributes
    ----------
    model, method
        The method's label.
    runs, failed
        Runs left out, and fits of the others that do not count.
    vaf
        Mean over the runs, and its standard error [%].
    behind
        Log-likelihood of a run less that of the best in the list, mean over the runs that all
        predict, and its standard error; 0 and NaN for the best.
    """

    model: str
    method: str
    runs: int
    failed: int
    vaf: tuple[float, float]
    behind: tuple[float, float]


def rank_methods(left: Sequence[LeftOut]) -> list[Standing]:
    """Models and methods by the likelihood of runs left out, the best first.

    Methods whose fits fail in more than half of the runs come last and are not compared run by
    run, so that they do not cost the others theirs.
    """
    held = grouped(left, lambda each: (each.model, each.method))
    likelihoods = {
        key: {(e.part.name, e.run): e.log_likelihood for e in own if e.usable}
        for key, own in held.items()
    }
    able = [key for key, own in held.items() if 2 * len(likelihoods[key]) >= len(own)]
    common = sorted(set.intersection(*(set(likelihoods[key]) for key in able))) if able else []
    scores = {key: np.array([likelihoods[key][run] for run in common]) for key in able}
    best = max(able, key=lambda key: float(np.sum(scores[key])), default=None)
    found = []
    for key, own in held.items():
        vaf = plain_mean(np.array([e.vaf for e in own if e.usable]))
        behind = math.nan, math.nan
        if best is not None and key in scores and common:
            apart = plain_mean(scores[key] - scores[best])
            behind = apart.value, apart.std_error if key != best else math.nan
        failed = sum(not e.usable for e in own)
        found.append(Standing(*key, len(own), failed, (vaf.value, vaf.std_error), behind))
    return sorted(found, key=lambda s: -s.behind[0] if math.isfinite(s.behind[0]) else math.inf)
