"""Information criteria of several pilot models of one recording, made comparable.

Each model is fitted by maximum likelihood, the remnant along with it, in one analysis band, with
one kind of model of the remnant and the same nuisance terms, and all are scored on the same
samples: information criteria of fits of different bands, or of windows that end at different
samples, say nothing.  Runs that a fit has not seen judge without any count of parameters: models
of people are never true, and what a criterion counts as a parameter may only be a misfit that
another parameter mends.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pilotid.estimates.estimate import bounds_reached
from pilotid.pilot.model import PilotModel
from pilotid.recordings.recording import Recording
from pilotid.solve.least_squares import minimise
from pilotid.support.numbers import fit_rng
from pilotid.support.types import FloatArray
from pilotid.time_domain.constancy import Constancy, constancy
from pilotid.time_domain.likelihood import Likelihood
from pilotid.time_domain.optimum import Optimum
from pilotid.time_domain.output_error import simulated_vaf
from pilotid.time_domain.search import maxima_from, maximise_likelihood
from pilotid.time_domain.settings import LikelihoodSettings

#: One band for all models.
SETTINGS = LikelihoodSettings(wide=())

TOLERANCE, STEPS = 2e-5, 12  # of the fits that leave a run out; they start close by


@dataclass(frozen=True, eq=False)
class Evidence:
    """What a recording says for one model.

    Attributes
    ----------
    model
        The pilot model.
    values
        Its parameters where the likelihood is largest, shape (parameters,).
    remnant
        Name of the remnant's model.
    parameters
        Number of parameters estimated: pilot, remnant and variance.
    samples
        Number of prediction errors scored.
    log_likelihood
        Of all runs together, at its largest.
    vaf
        Variance accounted for by the simulated response [%].
    left_out
        Log-likelihood of each run under what the other runs say, shape (runs,); empty where
        there is one run alone.
    left_out_vaf
        Variance accounted for in these runs [%]; NaN where there is one run alone.
    bounds
        The bounds that parameters reached, in words; empty if none.
    constancy
        Test for gains and leads that change; None for a model that varies already.
    """

    model: PilotModel
    values: FloatArray
    remnant: str
    parameters: int
    samples: int
    log_likelihood: float
    vaf: float
    left_out: FloatArray
    left_out_vaf: float
    bounds: str
    constancy: Constancy | None

    @property
    def aicc(self) -> float:
        """Akaike's information criterion, corrected for few samples."""
        freedom = max(self.samples - self.parameters - 1.0, 1.0)
        return -2.0 * self.log_likelihood + 2.0 * self.parameters * self.samples / freedom

    @property
    def bic(self) -> float:
        """Bayesian information criterion."""
        return -2.0 * self.log_likelihood + self.parameters * math.log(self.samples)


def evidence(
    recording: Recording,
    models: Sequence[PilotModel],
    seed: int,
    starts: Sequence[FloatArray | None] = (),
) -> list[Evidence]:
    """What a recording says for each of several models, in their order.

    Parameters
    ----------
    recording
        The recording.
    models
        Models that its signals allow, the most likely first: the kind of the remnant's model is
        what suits that one.
    seed
        Seed of the searches' random starts.
    starts
        For each model the pilot that its optimum is sought from, shape (parameters,); where
        there is none, it is searched everywhere.
    """
    # All are weighted alike: a frequency counts if no model's input is noise there.
    signals = (channel.on for model in models for channel in model.channels)
    # A pilot who changes has no likelihood of a band: criteria of the two say nothing.
    loop = not any(model.changes for model in models)
    settings = replace(SETTINGS, weighed=tuple(dict.fromkeys(signals)), loop=loop)
    maxima: list[Optimum] = []
    for model, start in zip(models, starts or [None] * len(models), strict=True):
        if start is None:
            found = maximise_likelihood(recording, model, fit_rng(seed, model.name), settings)
        else:
            found = maxima_from(recording, model, settings, start[None])[0]
        settings = replace(settings, noise=found.joint.noise)
        maxima.append(found)
    terms = tuple(sorted({term for found in maxima for term in found.joint.prediction.terms}))
    maxima = [_with_terms(found, terms) for found in maxima]
    scored = min(found.joint.prediction.scored for found in maxima)
    return [_evidence(recording, found, scored, seed) for found in maxima]


def _with_terms(found: Optimum, terms: tuple[float, ...]) -> Optimum:
    """The optimum with these nuisance terms."""
    joint = found.joint
    if joint.prediction.terms == terms:
        return found
    prediction = replace(joint.prediction, terms=terms)
    changed = replace(found, joint=Likelihood(prediction, joint.noise))
    return changed.moved(found.end.values[0])


def _evidence(recording: Recording, found: Optimum, scored: int, seed: int) -> Evidence:
    values = found.end.values[0]
    prediction = replace(found.joint.prediction, scored=scored)
    joint = Likelihood(prediction, found.joint.noise)
    model, pilot = prediction.model, values[: joint.pilot]
    left = [_left_out(joint, values, run) for run in range(prediction.runs)]
    alone = prediction.runs == 1
    return Evidence(
        model=model,
        values=pilot,
        remnant=joint.noise.name,
        parameters=len(values) + 1,
        samples=joint.residuals,
        log_likelihood=joint.log_likelihood(values),
        vaf=simulated_vaf(recording, model, pilot),
        left_out=np.array([] if alone else [likelihood for likelihood, _ in left]),
        left_out_vaf=math.nan if alone else float(np.mean([vaf for _, vaf in left])),
        bounds=bounds_reached(model, pilot),
        constancy=constancy(found, recording, fit_rng(seed, "constancy")),
    )


def _left_out(joint: Likelihood, values: FloatArray, run: int) -> tuple[float, float]:
    """Log-likelihood and VAF [%] of a run under what the others say."""
    prediction = joint.prediction
    if prediction.runs == 1:
        return math.nan, math.nan
    rest = [r for r in range(prediction.runs) if r != run]
    others = Likelihood(prediction.of_runs(rest), joint.noise)
    end = minimise(others.gram, values[None], others, tolerance=TOLERANCE, iterations=STEPS)
    variance = float(end.cost[0]) / others.scaling(end.values[0])
    variance /= others.residuals - len(values)
    alone = Likelihood(prediction.of_runs([run]), joint.noise)
    likelihood = alone.log_likelihood(end.values[0], variance)
    residual = alone.prediction.errors(end.values[0, : joint.pilot])
    share = float(np.var(residual)) / float(np.var(alone.prediction.control))
    return likelihood, 100.0 * max(0.0, 1.0 - share)
