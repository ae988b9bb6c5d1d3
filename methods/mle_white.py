"""Time-domain maximum likelihood with a white residual.

The likelihood of AIAA 2008-7109 (output error, residual assumed white), without that
route's approximations: exact delays, bounds, several starts, transients handled, runs
fitted jointly.

Assumes that the remnant is white.

Use it when the remnant is white within the pilot's band, or to compare with earlier papers.

Do not use it for a coloured remnant: the estimate is then biased in a closed loop, however long
the recording, and its standard errors are far too small.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from pilotid.estimate.estimate import Estimate
from pilotid.likelihood.estimates import WhiteLikelihood, starts_of
from pilotid.likelihood.likelihood import Likelihood
from pilotid.likelihood.prediction import predict
from pilotid.likelihood.search import CANDIDATES, REFINED, SEARCH_BAND
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.solve.least_squares import search


@dataclass(frozen=True)
class MLEWhite(WhiteLikelihood):
    """Maximum likelihood under a white residual.

    Attributes
    ----------
    band
        See `pilotid.likelihood.estimates.WhiteLikelihood`.
    """

    name: ClassVar[str] = "mle-white"

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
        coarse = Likelihood(predict(recording, model, SEARCH_BAND))
        ends = search(coarse.gram, model, rng, candidates=CANDIDATES, refined=REFINED)
        return replace(self.polished(recording, model, ends), starts=starts_of(ends))
