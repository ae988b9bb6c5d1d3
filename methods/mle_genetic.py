"""Time-domain maximum likelihood with a white residual, after a genetic search.

The estimator that the field uses: a genetic algorithm finds the neighbourhood of the optimum,
Gauss-Newton its bottom.  Here the first phase is differential evolution (scipy) in a narrow
band, over the usual ranges of the parameters and somewhat beyond, without regard to the
model's start; the second is that of `mle-white`.

It shows what a global search alone buys: wrong optima are rare without any start, bias stays.
Several random starts do as well, in a tenth of the time: mostly it ends where `mle-white` does,
and for a coloured remnant it is biased and claims too small standard errors just as that one
is.

Assumes that the remnant is white.

Use it to compare with papers that used a genetic search, without giving it a start.

Do not use it for results: it is biased as `mle-white` is.

References
----------
P. M. T. Zaal, D. M. Pool, Q. P. Chu, M. M. van Paassen, M. Mulder and J. A. Mulder, *Modeling
human multimodal perception and control using genetic maximum likelihood estimation*, JGCD
32(4) 2009.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pilotid.likelihood.estimates import WhiteLikelihood
from pilotid.model.model import PilotModel
from pilotid.solve.least_squares import Gram, Minima, evolve


@dataclass(frozen=True)
class MLEGenetic(WhiteLikelihood):
    """Maximum likelihood under a white residual, searched by differential evolution.

    Attributes
    ----------
    band
        See `pilotid.likelihood.estimates.WhiteLikelihood`.
    population
        Points of a generation for each parameter but the gains.
    generations
        Largest number of generations.
    """

    population: int = 15
    generations: int = 40
    name: ClassVar[str] = "mle-genetic"
    libraries: ClassVar[tuple[str, ...]] = ("scipy.optimize",)

    def search(self, gram: Gram, model: PilotModel, rng: np.random.Generator) -> Minima:
        """By generations that `rng` draws; the model's start plays no part."""
        return evolve(gram, model, rng, population=self.population, generations=self.generations)
