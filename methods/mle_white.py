"""Time-domain maximum likelihood with a white residual.

The likelihood of AIAA 2008-7109 (output error, residual assumed white), without that
route's approximations: exact delays, bounds, several starts, transients handled, runs
fitted jointly.

Assumes that the remnant is white.  The sandwich covariance mends the standard errors, not the
bias: intervals are then honest about where the biased estimate lies.

Use it when the remnant is white within the pilot's band, or to compare with earlier papers.

Do not use it for a coloured remnant: the estimate is then biased in a closed loop, however long
the recording, and its standard errors are far too small.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from pilotid.estimate.estimate import Estimate
from pilotid.likelihood.estimates import starts_of
from pilotid.likelihood.likelihood import Likelihood
from pilotid.likelihood.output_error import WhiteLikelihood
from pilotid.likelihood.prediction import predict
from pilotid.likelihood.settings import StartSettings
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.solve.search import search


@dataclass(frozen=True)
class MLEWhite(WhiteLikelihood, StartSettings):
    """Maximum likelihood under a white residual.

    Attributes
    ----------
    search_band, candidates, refined
        See `pilotid.likelihood.settings.StartSettings`; what the search finds is only
        polished in the analysis band.
    band, covariance
        See `pilotid.likelihood.output_error.WhiteLikelihood`.
    """

    name: ClassVar[str] = "mle-white"

    def objection(self, recording: Recording, model: PilotModel) -> str | None:
        """None: any recording and any model will do."""
        return None

    def fit(self, recording: Recording, model: PilotModel, rng: np.random.Generator) -> Estimate:
        """Minimise the sum of squares of the residual.

        Parameters
        ----------
        recording
            The recording; all its runs are fitted jointly.
        model
            The pilot model, whose start is one of the starts of the search.
        rng
            Draws the other starts.
        """
        coarse = Likelihood(predict(recording, model, self.search_band))
        found = search(coarse.gram, model, rng, candidates=self.candidates, refined=self.refined)
        estimate = self.polished(self.name, recording, model, found)
        return replace(estimate, starts=starts_of(found))
