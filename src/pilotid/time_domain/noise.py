"""The remnant's model: chosen, and fitted, along with the pilot.

What a pilot leaves of the control suggests models (`contenders`).  Each is fitted together with
the pilot from there on, and the criterion chooses; the pilot then moves, leaves something else,
and the choice is made again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pilotid.support.types import FloatArray
from pilotid.time_domain.likelihood import Likelihood
from pilotid.time_domain.optimum import Candidates, Optimum, descended
from pilotid.time_domain.prediction import Prediction
from pilotid.time_domain.prepare import Band
from pilotid.time_domain.remnant_models import (
    BandPass,
    Guess,
    NoiseModel,
    guesses,
    lagged_products,
    neighbours,
)
from pilotid.time_domain.settings import SEARCH


def contenders(products: FloatArray, samples: int, band: Band) -> list[Guess]:
    """The model that suits a residual best, and the best of the other kind if it is close.

    The kinds are filters of white noise and autoregressions.  Beside a band-pass stands the best
    low-pass as well: whether there is a corner is for the penalty on band-passes to decide.

    Parameters
    ----------
    products, samples, band
        See `pilotid.time_domain.remnant_models.guesses`.
    """
    scored = guesses(products, samples, band)
    filters = [each for each in scored if not each[1].model.regressive]
    best = [_lowest(filters), _lowest([each for each in scored if each[1].model.regressive])]
    if isinstance(best[0][1].model, BandPass):
        best.append(_lowest([each for each in filters if not isinstance(each[1].model, BandPass)]))
    best.sort(key=_score)
    return [guess for score, guess in best if score < best[0][0] + SEARCH.contender_criterion]


def _score(scored: tuple[float, Guess]) -> float:
    return scored[0]


def _lowest(scored: Sequence[tuple[float, Guess]]) -> tuple[float, Guess]:
    return min(scored, key=_score)


class RemnantChoice:
    """Fits near one pilot, of each model of the remnant that came into question.

    Every model is fitted once, from the pilot at which it first did and from where all began: one
    model may lose a channel, which does not come back of itself, where another does not.  What is
    asked for again is there already.

    Parameters
    ----------
    prediction
        The prepared prediction.
    pilot
        Where to begin, shape (parameters,).
    noise
        The remnant's model if it is not to be chosen.
    check
        Which parameters simulate the control.
    """

    def __init__(
        self,
        prediction: Prediction,
        pilot: FloatArray,
        noise: NoiseModel | None,
        check: Candidates | None = None,
    ) -> None:
        self.prediction, self.noise, self.check = prediction, noise, check
        self.pilot = self._first = pilot
        self.iterations = 0
        self._fits: dict[NoiseModel, tuple[Optimum, float]] = {}

    def look(self) -> Optimum:
        """A first look: the model that suits what the pilot leaves, roughly fitted."""
        return self._chosen(1e-3)

    def best(self, rounds: int) -> Optimum:
        """The best of all, as exactly as is needed to compare them.

        Its model is chosen anew as the pilot moves, in as many rounds at most.
        """
        compared = SEARCH.compared_tolerance
        found = self._chosen(compared)
        for _ in range(0 if self.noise else rounds - 1):
            before, found = found, self._chosen(compared)
            if found.joint.noise == before.joint.noise:
                break
        # Of many long autoregressions the first that suits depends on where the search came from.
        while others := [] if self.noise else neighbours(found.joint.noise):
            better = self._best(self._guesses(others, self._products()), compared)
            gain = found.criterion - better.criterion
            if abs(gain - 0.1) < found.short:
                found, better = (
                    self._to(fit, SEARCH.reported_tolerance) for fit in (found, better)
                )
            if not better.criterion < found.criterion - 0.1:
                break
            found = self._moved(better)
        return replace(found, iterations=self.iterations)

    def _chosen(self, tolerance: float) -> Optimum:
        products = self._products()
        if self.noise:
            models = self._guesses([self.noise], products)
        else:
            samples = self.prediction.runs * self.prediction.scored
            models = contenders(products, samples, self.prediction.band)
        return self._moved(self._best(models, tolerance))

    def _guesses(self, models: Sequence[NoiseModel], products: FloatArray) -> list[Guess]:
        return [Guess(model, model.guess(products, self.prediction.band)[0]) for model in models]

    def _moved(self, fit: Optimum) -> Optimum:
        self.pilot = fit.pilot
        return fit

    def _products(self) -> FloatArray:
        """Lagged products of what the pilot leaves."""
        return lagged_products(self.prediction.errors(self.pilot))

    def _best(self, models: Sequence[Guess], tolerance: float) -> Optimum:
        """The best of some models, each with the pilot that goes with it."""
        fits = [self._fitted(guess, tolerance) for guess in models]
        best = min(fits, key=_criterion)
        near = [fit for fit in fits if not fit.criterion > best.criterion + best.short]
        if tolerance > SEARCH.compared_tolerance or len(near) == 1:
            return best
        return min((self._to(fit, SEARCH.reported_tolerance) for fit in near), key=_criterion)

    def _fitted(self, guess: Guess, tolerance: float) -> Optimum:
        """A model fitted to a tolerance, if it is not yet."""
        model, values = guess
        if model in self._fits:
            return self._to(self._fits[model][0], tolerance)
        joint = Likelihood(self.prediction, model, adjoint=self.prediction.is_large)
        pilots = [self.pilot] if self.pilot is self._first else [self.pilot, self._first]
        starts = np.array([np.concatenate([pilot, values]) for pilot in pilots])
        fit = Optimum(joint, descended(joint, starts, tolerance), check=self.check)
        return self._kept(fit, tolerance)

    def _to(self, fit: Optimum, tolerance: float) -> Optimum:
        """A fit that was made before, to a tolerance."""
        reached = self._fits[fit.joint.noise][1]
        return fit if reached <= tolerance else self._kept(fit.refined(tolerance), tolerance)

    def _kept(self, fit: Optimum, tolerance: float) -> Optimum:
        self.iterations += fit.end.iterations
        self._fits[fit.joint.noise] = fit, tolerance
        return fit


def _criterion(fit: Optimum) -> float:
    return fit.criterion
