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
    at_bound,
    covariance_of,
    failed,
    simulated_vaf,
)
from pilotid.joint import Joint
from pilotid.minimise import Minima, minimise
from pilotid.model import PilotModel
from pilotid.noise import Band, LowPass, NoiseModel, remnant_estimate, select
from pilotid.prediction import LeastSquares, Prediction, predict
from pilotid.prepare import decimation
from pilotid.profile import profile_intervals
from pilotid.recording import Recording
from pilotid.search import record, search
from pilotid.types import FloatArray

#: Remnant of the search, whose colour is typical of published ones [rad/s].
TYPICAL_REMNANT = 5.0


@dataclass(frozen=True)
class MLE:
    """Remnant-aware maximum likelihood.

    Attributes
    ----------
    band
        Analysis band [rad/s].
    candidates, refined
        Random starts screened, and starts minimised, see `pilotid.search.search`.
    rounds
        How often the remnant's model is chosen anew at most.
    """

    band: float = 31.4
    candidates: int = 12
    refined: int = 3
    rounds: int = 3
    name: ClassVar[str] = "mle"

    def objection(self, recording: Recording, model: PilotModel) -> str | None:
        return None

    def fit(self, recording: Recording, model: PilotModel, rng: np.random.Generator) -> Estimate:
        band = Band(recording.dt, decimation(recording.dt, self.band))
        prediction = predict(recording, model, self.band)
        typical = LowPass(1).taps(np.array([[TYPICAL_REMNANT]]), band)[0][0]
        found = search(
            LeastSquares(prediction, typical),
            model,
            rng,
            candidates=self.candidates,
            refined=self.refined,
        )
        joint, all_ends = self._estimate(prediction, band, found.values)
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
            iterations=found.iterations + sum(e.iterations for e in all_ends),
            starts=record(all_ends[0]),
            remnant=remnant_estimate(
                joint.noise,
                values[joint.pilot :],
                band,
                float(end.cost[0]) / freedom,
                float(np.mean(np.var(control, axis=1))),
            ),
        )

    def _estimate(
        self, prediction: Prediction, band: Band, starts: FloatArray
    ) -> tuple[Joint, list[Minima]]:
        """Pilot and remnant together: the problem solved last, and every end on the way."""
        ends: list[Minima] = []
        previous: tuple[NoiseModel, Prediction] | None = None
        for _ in range(self.rounds):
            residual = LeastSquares(prediction).residual(starts[0])
            noise, guess = select(residual, band)
            if previous == (noise, prediction):
                break
            joint = Joint(prediction, noise, band)
            both = np.concatenate([starts, np.tile(guess, (len(starts), 1))], axis=1)
            end = minimise(joint.gram, both, joint, tolerance=1e-5 if ends else 1e-4)
            ends.append(end)
            starts = end.values[:1, : joint.pilot]
            previous = noise, prediction
            terms = LeastSquares(prediction, joint.whitener(end.values[0])).noticeable_terms(
                starts[0]
            )
            if len(ends) == 1 and terms != prediction.terms:
                prediction = replace(prediction, terms=terms)
        return joint, ends
