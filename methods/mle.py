"""Time-domain maximum likelihood with the remnant's own spectrum.

The prediction error is whitened by a model of the remnant that is estimated together
with the pilot: a low-pass filter of order 0 to 3 or, where the residual demands it, an
autoregressive spectrum.  That is the direct prediction-error method (Ljung, System
Identification, 2nd ed., sec. 13.4), consistent in the closed loop for any remnant whose
spectrum the model can take, and efficient.

Assumes that the pilot is linear and time-invariant over the recording, and that its
delays are longer than the sampling interval of the analysis band.  Gain and lead time
are skewed for short recordings; the profile-likelihood intervals say so.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from pilotid.estimate import (
    Estimate,
    Outcome,
    Starts,
    covariance_of,
    failed,
    outcome_of,
    simulated_vaf,
    symmetric_intervals,
)
from pilotid.joint import Joint
from pilotid.minimise import Minima, minimise
from pilotid.model import PilotModel
from pilotid.noise import (
    Band,
    LowPass,
    NoiseModel,
    analysis_band,
    contenders,
    criterion,
    lagged_products,
    remnant_estimate,
)
from pilotid.prediction import LeastSquares, Prediction, predict
from pilotid.profile import profile_intervals
from pilotid.recording import Recording
from pilotid.search import record, search
from pilotid.types import FloatArray

#: The remnant's model before one is chosen: most published remnants are of this kind.
USUAL = LowPass(2)


@dataclass(frozen=True)
class MLE:
    """Remnant-aware maximum likelihood.

    Attributes
    ----------
    band
        Analysis band [rad/s].
    search_band
        Narrower and cheaper band in which the optimum is searched [rad/s].
    candidates, refined
        Random starts screened, and starts minimised, see `pilotid.search.search`.
    rounds
        How often the remnant's model is chosen anew at most.
    """

    band: float = 50.0
    search_band: float = 26.0
    candidates: int = 6
    refined: int = 2
    rounds: int = 3
    name: ClassVar[str] = "mle"

    def objection(self, recording: Recording, model: PilotModel) -> str | None:
        return None

    def fit(self, recording: Recording, model: PilotModel, rng: np.random.Generator) -> Estimate:
        candidates, terms, starts = self._explored(recording, model, rng)
        prediction = replace(predict(recording, model, self.band), terms=terms)
        band = analysis_band(recording.dt, self.band)
        joint, all_ends = self._estimated(prediction, band, candidates)
        end = all_ends[-1]
        values, gram = end.values[0], end.gram[0]
        freedom = joint.samples - len(values)
        variance = float(end.cost[0]) / freedom
        covariance = covariance_of(gram[:-1, :-1], variance)
        pilot = values[: joint.pilot]
        if covariance is None:
            # A remnant without a shape (next to none, or white) leaves its own parameters
            # open, but not the pilot's.
            own = covariance_of(gram[: joint.pilot, : joint.pilot], variance)
            if own is None:
                return failed(self.name, model, Outcome.SINGULAR)
            covariance, intervals = own, symmetric_intervals(pilot, own)
        else:
            intervals = profile_intervals(
                joint.gram, joint, end, variance, joint.pilot, estimated=freedom
            )
        outcome, message = outcome_of(model, pilot, bool(end.converged[0]))
        control = joint.prediction.control
        return Estimate(
            self.name,
            model,
            outcome,
            values=pilot,
            covariance=covariance[: joint.pilot, : joint.pilot],
            intervals=intervals,
            vaf=simulated_vaf(recording, model, pilot),
            message=message,
            iterations=sum(e.iterations for e in all_ends),
            starts=starts,
            remnant=remnant_estimate(
                joint.noise,
                values[joint.pilot :],
                joint.band,
                variance,
                float(np.mean(np.var(control, axis=1))),
            ),
        )

    def _explored(
        self, recording: Recording, model: PilotModel, rng: np.random.Generator
    ) -> tuple[FloatArray, tuple[float, ...], Starts]:
        """Candidates for the optimum, nuisance terms to fit, and the record of the search.

        A wrong optimum of the pilot suggests a wrong remnant, under which it looks right.
        So the first search takes the residual for white: that optimum is biased, but hardly
        ever the wrong one.  Where its starts disagree, or lead to an unusual pilot, a second
        search, whitened by the remnant found, brings more candidates.
        """
        prediction = predict(recording, model, self.search_band)
        found = search(
            LeastSquares(prediction).gram,
            model,
            rng,
            candidates=self.candidates,
            refined=self.refined,
        )
        starts = record(found)
        # The residual of a biased estimate has a shape of its own, so the remnant's model is
        # chosen only later, after this round with the usual one.
        joint = Joint(prediction, USUAL, analysis_band(recording.dt, self.search_band))
        ends = found.distinct()
        end = self._fitted(joint, ends, LeastSquares(prediction).residual(ends[0]), 1e-3)
        best = end.values[:1, : joint.pilot]
        whitened = LeastSquares(prediction, joint.whitener(end.values[0]))
        terms = whitened.noticeable_terms(best[0])
        if starts.agreeing == len(starts.cost) and model.is_usual(best[0]):
            return best, terms, starts
        whitened = LeastSquares(replace(prediction, terms=terms), whitened.taps)
        again = search(whitened.gram, model, rng, known=best, candidates=self.candidates)
        return np.concatenate([best, again.distinct(hopeless=0.02)[1:]]), terms, starts

    def _estimated(
        self, prediction: Prediction, band: Band, candidates: FloatArray
    ) -> tuple[Joint, list[Minima]]:
        """Pilot and remnant together: the problem solved last, and the end of every round."""
        ends: list[Minima] = []
        chosen: NoiseModel = USUAL
        for _ in range(self.rounds):
            residual = LeastSquares(prediction).residual(candidates[0])
            joints = [Joint(prediction, noise, band) for noise in contenders(residual, band)]
            fits = [(joint, self._fitted(joint, candidates, residual, 1e-5)) for joint in joints]
            joint, end = min(fits, key=lambda fit: _criterion(*fit))
            ends.append(end)
            candidates = end.values[:1, : joint.pilot]
            if joint.noise == chosen:
                break
            chosen = joint.noise
        return joint, ends

    def _fitted(
        self, joint: Joint, candidates: FloatArray, residual: FloatArray, tolerance: float
    ) -> Minima:
        guess = joint.noise.guess(lagged_products(residual), joint.band)
        starts = np.concatenate([candidates, np.tile(guess, (len(candidates), 1))], axis=1)
        return minimise(joint.gram, starts, joint, tolerance=tolerance)


def _criterion(joint: Joint, end: Minima) -> float:
    return criterion(joint.noise, float(end.cost[0]) / joint.samples, joint.samples)
