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
    at_bound,
    covariance_of,
    failed,
    simulated_vaf,
)
from pilotid.joint import Joint
from pilotid.minimise import Minima, minimise
from pilotid.model import PilotModel
from pilotid.noise import (
    Band,
    LowPass,
    contenders,
    criterion,
    lagged_products,
    remnant_estimate,
)
from pilotid.prediction import LeastSquares, Prediction, predict
from pilotid.prepare import decimation
from pilotid.profile import profile_intervals
from pilotid.recording import Recording
from pilotid.search import record, search
from pilotid.types import FloatArray

USUAL = LowPass(2)


@dataclass(frozen=True)
class MLE:
    """Remnant-aware maximum likelihood.

    Attributes
    ----------
    band
        Analysis band [rad/s].
    search_band
        Band of the first search, which takes the residual for white [rad/s].
    candidates, refined
        Random starts screened, and starts minimised, see `pilotid.search.search`.
    rounds
        How often the remnant's model is chosen anew at most.
    """

    band: float = 50.0
    search_band: float = 26.0
    candidates: int = 8
    refined: int = 2
    rounds: int = 3
    name: ClassVar[str] = "mle"

    def objection(self, recording: Recording, model: PilotModel) -> str | None:
        return None

    def fit(self, recording: Recording, model: PilotModel, rng: np.random.Generator) -> Estimate:
        band = Band(recording.dt, decimation(recording.dt, self.band))
        prediction = predict(recording, model, self.band)
        joint, all_ends, starts = self._estimate(recording, prediction, band, rng)
        end = all_ends[-1]
        values, gram = end.values[0], end.gram[0]
        freedom = joint.samples - len(values)
        covariance = covariance_of(gram[:-1, :-1], end.cost[0] / freedom)
        if covariance is None:
            return failed(self.name, model, Outcome.SINGULAR)
        pilot = values[: joint.pilot]
        message = at_bound(model, pilot)
        outcome = Outcome.AT_BOUND if message else Outcome.CONVERGED
        control = joint.prediction.control
        return Estimate(
            self.name,
            model,
            outcome if end.converged[0] else Outcome.NOT_CONVERGED,
            values=pilot,
            covariance=covariance[: joint.pilot, : joint.pilot],
            intervals=profile_intervals(joint.gram, joint, end, joint.samples, joint.pilot),
            vaf=simulated_vaf(recording, model, pilot),
            message=message,
            iterations=sum(e.iterations for e in all_ends),
            starts=starts,
            remnant=remnant_estimate(
                joint.noise,
                values[joint.pilot :],
                band,
                float(end.cost[0]) / freedom,
                float(np.mean(np.var(control, axis=1))),
            ),
        )

    def _estimate(
        self, recording: Recording, prediction: Prediction, band: Band, rng: np.random.Generator
    ) -> tuple[Joint, list[Minima], Starts]:
        """Pilot and remnant together: the problem solved last, and the ends of every round.

        A wrong optimum of the pilot suggests a wrong remnant, under which it looks right.
        So the first search takes the residual for white: that optimum is biased, but hardly
        ever the wrong one.  Where its starts disagree, a second search, whitened by the
        remnant found, brings more candidates.
        """
        model = prediction.model
        coarse = LeastSquares(predict(recording, model, self.search_band))
        found = search(coarse, model, rng, candidates=self.candidates, refined=self.refined)
        starts = record(found)
        # The residual of a biased estimate has a shape of its own, so the remnant's model is
        # chosen only after a first round with the usual one.
        joint, end = self._fitted(Joint(prediction, USUAL, band), found.distinct(), 1e-3)
        ends = [end]
        best = end.values[:1, : joint.pilot]
        whitened = LeastSquares(prediction, joint.whitener(end.values[0]))
        prediction = replace(prediction, terms=whitened.noticeable_terms(best[0]))
        candidates = best
        if starts.agreeing < len(starts.cost):
            whitened = LeastSquares(prediction, whitened.taps)
            again = search(whitened, model, rng, first=best, candidates=self.candidates)
            candidates = np.concatenate([best, again.distinct(hopeless=0.02)[1:]])
        for _ in range(self.rounds):
            noise = joint.noise
            residual = LeastSquares(prediction).residual(candidates[0])
            fits = [
                self._fitted(Joint(prediction, rival, band), candidates, 1e-5)
                for rival in contenders(residual, band)
            ]
            joint, end = min(fits, key=lambda fit: _criterion(*fit))
            ends.append(end)
            candidates = end.values[:1, : joint.pilot]
            if joint.noise == noise:
                break
        return joint, ends, starts

    def _fitted(
        self, joint: Joint, candidates: FloatArray, tolerance: float
    ) -> tuple[Joint, Minima]:
        residual = LeastSquares(joint.prediction).residual(candidates[0])
        guess = joint.noise.guess(lagged_products(residual), joint.band)
        starts = np.concatenate([candidates, np.tile(guess, (len(candidates), 1))], axis=1)
        return joint, minimise(joint.gram, starts, joint, tolerance=tolerance, iterations=40)


def _criterion(joint: Joint, end: Minima) -> float:
    return criterion(joint.noise, float(end.cost[0]) / joint.samples, joint.samples)
