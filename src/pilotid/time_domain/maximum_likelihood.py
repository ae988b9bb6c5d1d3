"""The maximum of the likelihood of pilot and remnant together.

Candidates for the pilot come from a search in a narrow band; the remnant's model is then
chosen, and estimated along with the pilot, in the analysis band.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pilotid.estimates.estimate import Starts
from pilotid.estimates.remnant import RemnantEstimate
from pilotid.pilot.model import PilotModel
from pilotid.recordings.recording import Recording
from pilotid.solve.least_squares import Minima, minimise, solve_linear
from pilotid.solve.search import draw_starts, record, search
from pilotid.time_domain.output_error import OutputErrors
from pilotid.time_domain.prediction import Prediction, predict
from pilotid.time_domain.prediction_errors import PredictionErrors
from pilotid.time_domain.remnant_choice import contenders, criterion, lagged_products
from pilotid.time_domain.remnant_models import (
    Band,
    LowPass,
    analysis_band,
    remnant_estimate,
)
from pilotid.time_domain.settings import LikelihoodSettings
from pilotid.types import FloatArray

#: The remnant's model before one is chosen: most published remnants are of this kind.
FIRST = LowPass(2)


@dataclass(frozen=True, eq=False)
class Maximum:
    """Where the likelihood of pilot and remnant is largest.

    Attributes
    ----------
    joint
        The problem solved last: prediction, model of the remnant, analysis band.
    end
        Its optimum, whose first entry counts.
    starts
        Record of the search that led there.
    iterations
        Iterations in the analysis band.
    """

    joint: PredictionErrors
    end: Minima
    starts: Starts
    iterations: int

    @property
    def variance(self) -> float:
        """Variance of the prediction error."""
        freedom = self.joint.residuals - int(self.end.values.shape[1])
        return float(self.end.cost[0]) / freedom

    @property
    def remnant(self) -> RemnantEstimate:
        """The remnant at the optimum."""
        joint = self.joint
        return remnant_estimate(
            joint.noise,
            self.end.values[0, joint.pilot :],
            joint.band,
            self.variance,
            float(np.mean(np.var(joint.prediction.control, axis=1))),
        )


def maximise_likelihood(
    recording: Recording,
    model: PilotModel,
    rng: np.random.Generator,
    settings: LikelihoodSettings,
) -> Maximum:
    """Maximise the likelihood of pilot and remnant parameters.

    Parameters
    ----------
    recording, model
        What is fitted.
    rng
        Draws the random starts.
    settings
        Bands, starts, and the remnant's model if it is not to be chosen.
    """
    points, terms, starts = _explored(recording, model, rng, settings)
    prediction = replace(predict(recording, model, settings.band), terms=terms)
    band = analysis_band(recording.dt, settings.band)
    joint, ends = _estimated(prediction, band, points, settings)
    return Maximum(joint, ends[-1], starts, sum(e.iterations for e in ends))


def _explored(
    recording: Recording,
    model: PilotModel,
    rng: np.random.Generator,
    settings: LikelihoodSettings,
) -> tuple[FloatArray, tuple[float, ...], Starts]:
    """Candidates for the optimum, nuisance terms to fit, and the record of the search.

    A wrong optimum of the pilot suggests a wrong remnant, under which it looks right.
    So the first search takes the residual for white: that optimum is biased, but hardly
    ever the wrong one.  Where its starts disagree, or lead to an unusual pilot, a second
    search, whitened by the remnant found, brings more candidates.  If the first has lost a
    channel, so has that whitening: a third search, from usual pilots, each with the remnant
    that it leaves, finds it again.
    """
    candidates, noise = settings.candidates, settings.noise or FIRST
    prediction = predict(recording, model, settings.search_band)
    found = search(
        OutputErrors(prediction).gram,
        model,
        rng,
        candidates=candidates,
        refined=settings.refined,
    )
    starts = record(found)
    # The residual of a biased estimate has a shape of its own, so the remnant's model is
    # chosen only later, after this round with the usual one.
    joint = PredictionErrors(prediction, noise, analysis_band(recording.dt, settings.search_band))
    ends = found.distinct()
    end = _fitted(joint, ends, OutputErrors(prediction).residual(ends[0]), 1e-3)
    best = end.values[:1, : joint.pilot]
    whitened = OutputErrors(prediction, joint.whitener(end.values[0]))
    terms = whitened.noticeable_terms(best[0])
    if starts.agreeing == len(starts.cost) and model.within_usual(best[0]):
        return best, terms, starts
    narrowed = replace(prediction, terms=terms)
    whitened = OutputErrors(narrowed, whitened.taps)
    again = search(whitened.gram, model, rng, known=best, candidates=candidates)
    usual = np.concatenate([model.start[None], draw_starts(model, rng, candidates)])
    usual, _ = solve_linear(whitened.gram(usual), usual, model.linear, model.lower)
    joint = PredictionErrors(narrowed, noise, joint.band)
    guesses = [_guess(joint, OutputErrors(narrowed).residual(pilot)) for pilot in usual]
    least = minimise(joint.gram, np.hstack([usual, guesses]), joint, tolerance=1e-3)
    others = [again.distinct(far=0.02)[1:], least.values[:1, : joint.pilot]]
    return np.concatenate([best, *others]), terms, starts


def _estimated(
    prediction: Prediction,
    band: Band,
    candidates: FloatArray,
    settings: LikelihoodSettings,
) -> tuple[PredictionErrors, list[Minima]]:
    """Pilot and remnant together: the problem solved last, and the end of every round."""
    ends: list[Minima] = []
    chosen = settings.noise or FIRST
    for _ in range(settings.rounds):
        residual = OutputErrors(prediction).residual(candidates[0])
        models = [settings.noise] if settings.noise else contenders(residual, band)
        joints = [PredictionErrors(prediction, model, band) for model in models]
        fits = [(joint, _fitted(joint, candidates, residual, 1e-5)) for joint in joints]
        joint, end = min(fits, key=lambda fit: _criterion(*fit))
        ends.append(end)
        candidates = end.values[:1, : joint.pilot]
        if joint.noise == chosen:
            break
        chosen = joint.noise
    return joint, ends


def _fitted(
    joint: PredictionErrors, candidates: FloatArray, residual: FloatArray, tolerance: float
) -> Minima:
    guess = _guess(joint, residual)
    starts = np.concatenate([candidates, np.tile(guess, (len(candidates), 1))], axis=1)
    return minimise(joint.gram, starts, joint, tolerance=tolerance)


def _guess(joint: PredictionErrors, residual: FloatArray) -> FloatArray:
    """The remnant's parameters that a residual suggests."""
    return np.asarray(joint.noise.guess(lagged_products(residual), joint.band))


def _criterion(joint: PredictionErrors, end: Minima) -> float:
    return criterion(joint.noise, float(end.cost[0]) / joint.residuals, joint.residuals)
