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

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pilotid.likelihood.estimates import WhiteLikelihood
from pilotid.model.model import PilotModel
from pilotid.solve.least_squares import Gram, Minima, search


@dataclass(frozen=True)
class MLEWhite(WhiteLikelihood):
    """Maximum likelihood under a white residual.

    Attributes
    ----------
    band
        See `pilotid.likelihood.estimates.WhiteLikelihood`.
    """

    name: ClassVar[str] = "mle-white"

    def search(self, gram: Gram, model: PilotModel, rng: np.random.Generator) -> Minima:
        """From several starts, of which the model's is one; `rng` draws the others."""
        return search(gram, model, rng, candidates=6, refined=2)
