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

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pilotid.estimates.estimate import Estimate, Outcome, failed, outcome_of, symmetric_intervals
from pilotid.pilot.model import PilotModel
from pilotid.recordings.recording import Recording
from pilotid.solve.covariance import covariance_of
from pilotid.solve.intervals import profile_intervals
from pilotid.time_domain.maximum_likelihood import maximum
from pilotid.time_domain.output_error import simulated_vaf


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
        Random starts screened, and starts minimised, see `pilotid.solve.search.search`.
    rounds
        How often the remnant's model is chosen anew at most, see
        `pilotid.time_domain.maximum_likelihood`.
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
        found = maximum(
            recording,
            model,
            rng,
            band=self.band,
            search_band=self.search_band,
            candidates=self.candidates,
            refined=self.refined,
            rounds=self.rounds,
        )
        joint, end = found.joint, found.end
        values, gram = end.values[0], end.gram[0]
        freedom = joint.residuals - len(values)
        variance = found.variance
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
        return Estimate(
            self.name,
            model,
            outcome,
            values=pilot,
            covariance=covariance[: joint.pilot, : joint.pilot],
            intervals=intervals,
            vaf=simulated_vaf(recording, model, pilot),
            message=message,
            iterations=found.iterations,
            starts=found.starts,
            remnant=found.remnant,
        )
