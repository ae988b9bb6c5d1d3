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
from typing import Any, ClassVar

import numpy as np

from pilotid.likelihood.estimates import WhiteLikelihood
from pilotid.model.model import PilotModel
from pilotid.solve.least_squares import Gram, LogTransform, Minima, minimise, solve_linear
from pilotid.support.types import FloatArray


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
        """From the best point that differential evolution finds; the model's start plays no part.

        It looks in the parameters' usual ranges and somewhat beyond, within the bounds.  Gains
        enter linearly: they are solved for, and evolution is left with the others, positive ones on
        a logarithmic scale.  `rng` draws the first population and its offspring.
        """
        from scipy.optimize import Bounds, differential_evolution

        free = [i for i in range(len(model.parameters)) if i not in model.linear]
        scale = LogTransform(model.positive[free])
        low, high = model.usual
        # Below and above their usual range by a factor of 2; the range of others is twice as wide.
        beyond = 0.5 * (high - low)
        low = np.maximum(np.where(model.positive, low / 2.0, low - beyond), model.lower)
        high = np.minimum(np.where(model.positive, high * 2.0, high + beyond), model.upper)
        # Where a gain would have to be negative, a tenth of this is taken for it.
        base = np.where(model.positive, 10.0 * model.lower, 0.0)

        def solved(points: FloatArray) -> tuple[FloatArray, FloatArray]:
            """Whole parameter sets for evolving ones, shape (sets, free), and their costs."""
            values = np.tile(base, (len(points), 1))
            values[:, free] = scale.leave(points)
            return solve_linear(gram(values), values, model.linear, model.lower)

        def cost(points: FloatArray, /) -> Any:  # one for each column: scipy's types do not know
            costs = solved(points.T)[1]
            return np.where(np.isnan(costs), np.inf, costs)

        best = np.zeros(0)
        if free:
            best = differential_evolution(
                cost,
                Bounds(scale.enter(low[free]), scale.enter(high[free])),
                popsize=self.population,
                maxiter=self.generations,
                polish=False,
                updating="deferred",
                vectorized=True,
                seed=rng,
            ).x
        return minimise(gram, solved(best[None])[0], model, tolerance=1e-3)
