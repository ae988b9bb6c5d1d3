"""Time-domain maximum likelihood with the remnant's own spectrum.

The prediction error is whitened by a model of the remnant that is estimated together
with the pilot: a low-pass of order 0 to 3, a band-pass or an autoregression of order 2 to 20,
whichever predicts best by Akaike's criterion.  That is the direct prediction-error method
(Ljung, System Identification, 2nd ed., sec. 13.4), consistent in the closed loop for any
remnant whose spectrum the model can take, and efficient.

Assumes that the pilot is linear and time-invariant over the recording, and that its
delays are longer than the sampling interval of the analysis band.  Gain and lead time
are skewed for short recordings; the profile-likelihood intervals say so, and are widened
for what pilot and remnant, estimated from the same few seconds, take from one another.
What is left is tested; remarks say what the pilot did that no such model does.

Use it for results: it is the default.

Do not use it when the pilot changes during the recording, unless with a model that says how
(`adapting`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from pilotid.estimate.estimate import Estimate, Outcome, failed
from pilotid.likelihood.diagnostics import fit_remarks, with_verdict
from pilotid.likelihood.estimates import make_estimate
from pilotid.likelihood.profile import profile_likelihood, with_profile
from pilotid.likelihood.search import LikelihoodSettings, maxima_from, maximise_likelihood
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.support.types import FloatArray


@dataclass(frozen=True)
class MLE(LikelihoodSettings):
    """Remnant-aware maximum likelihood.

    Attributes
    ----------
    band, wide, noise, loop, weighed
        See `pilotid.likelihood.search.LikelihoodSettings`.
    """

    name: ClassVar[str] = "mle"

    def fit(self, recording: Recording, model: PilotModel, rng: np.random.Generator) -> Estimate:
        """Estimate pilot and remnant together; intervals follow the profile likelihood.

        Parameters
        ----------
        recording
            The recording; all its runs are fitted jointly.
        model
            The pilot model, whose start is one of the starts of the search.
        rng
            Draws the other starts.
        """
        optimum = maximise_likelihood(recording, model, rng, self)
        optimum, profile = profile_likelihood(optimum)
        covariance = optimum.covariance
        if covariance is None:
            return failed(self.name, model, Outcome.SINGULAR)
        estimate = make_estimate(
            self.name,
            recording,
            model,
            optimum.pilot,
            covariance,
            converged=bool(optimum.end.converged[0]),
        )
        if profile is not None:
            estimate = with_profile(estimate, optimum, profile)
        remarks = fit_remarks(optimum, recording, asked_for_band=self.loop)
        estimate = with_verdict(estimate, optimum, recording, estimate.covariance, remarks)
        return replace(estimate, criterion=optimum.criterion)

    def criteria_from(
        self, recording: Recording, model: PilotModel, sets: FloatArray
    ) -> FloatArray:
        """Criteria of the optima that searches from these pilots alone reach, shape (sets,)."""
        return np.array([each.criterion for each in maxima_from(recording, model, self, sets)])
