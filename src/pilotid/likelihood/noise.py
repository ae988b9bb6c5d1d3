"""The remnant's model: chosen, and fitted, along with the pilot.

What a pilot leaves of the control suggests models (`contenders`).  Each is fitted together with
the pilot from there on, and the criterion chooses; the pilot then moves, leaves something else,
and the choice is made again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from operator import attrgetter

import numpy as np

from pilotid.likelihood.likelihood import Likelihood
from pilotid.likelihood.optimum import Candidates, Optimum, descend
from pilotid.likelihood.prediction import Prediction
from pilotid.likelihood.prepare import Band
from pilotid.likelihood.remnant_models import (
    BandPass,
    Guess,
    NoiseModel,
    guesses,
    lagged_products,
    neighbours,
)
from pilotid.likelihood.settings import COMPARED_TOLERANCE, LOOK_CRITERION, REPORTED_TOLERANCE
from pilotid.support.types import FloatArray


def contenders(products: FloatArray, samples: int, band: Band) -> list[Guess]:
    """The model that suits a residual best, and the best of the other kind if it is close.

    The kinds are filters of white noise and autoregressions.  Beside a band-pass stands the best
    low-pass as well: whether there is a corner is for the penalty on band-passes to decide.

    Parameters
    ----------
    products, samples, band
        See `pilotid.likelihood.remnant_models.guesses`.
    """
    scored = sorted(guesses(products, samples, band), key=_criterion)
    filters = [each for each in scored if not each.model.regressive]
    best = [filters[0], next(each for each in scored if each.model.regressive)]
    if isinstance(filters[0].model, BandPass):
        best.append(next(each for each in filters if not isinstance(each.model, BandPass)))
    limit = scored[0].criterion + LOOK_CRITERION
    return [each for each in sorted(best, key=_criterion) if each.criterion < limit]


_criterion = attrgetter("criterion")


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

    def quick_fit(self) -> Optimum:
        """A first look: the model that suits what the pilot leaves, roughly fitted."""
        return self._moved(self._best_of(None, 1e-3))

    def full_fit(self, rounds: int) -> Optimum:
        """The best of all, as exactly as is needed to compare them.

        Its model is chosen anew as the pilot moves, in as many rounds at most.
        """
        compared = COMPARED_TOLERANCE
        found = self._moved(self._best_of(None, compared))
        for _ in range(0 if self.noise else rounds - 1):
            before, found = found, self._moved(self._best_of(None, compared))
            if found.joint.noise == before.joint.noise:
                break
        # Of many long autoregressions the first that suits depends on where the search came from.
        while others := [] if self.noise else neighbours(found.joint.noise):
            better = self._best_of(others, compared)
            if abs(better.criterion - found.criterion + 0.1) < found.remaining_decrease:
                found, better = (self._to(fit, REPORTED_TOLERANCE) for fit in (found, better))
            if not better.criterion < found.criterion - 0.1:
                break
            found = self._moved(better)
        return replace(found, iterations=self.iterations)

    def _moved(self, fit: Optimum) -> Optimum:
        self.pilot = fit.pilot
        return fit

    def _best_of(self, models: Sequence[NoiseModel] | None, tolerance: float) -> Optimum:
        """The best of some models, each with the pilot that goes with it; None for contenders."""
        prediction = self.prediction
        products = lagged_products(prediction.errors(self.pilot))
        suited = products, prediction.runs * prediction.scored, prediction.band
        models = [self.noise] if self.noise else models
        every = contenders(*suited) if models is None else guesses(*suited, models)
        fits = [self._fitted(guess, tolerance) for guess in every]
        best = min(fits, key=_criterion)
        near = [fit for fit in fits if not fit.criterion > best.criterion + best.remaining_decrease]
        if tolerance > COMPARED_TOLERANCE or len(near) == 1:
            return best
        return min((self._to(fit, REPORTED_TOLERANCE) for fit in near), key=_criterion)

    def _fitted(self, guess: Guess, tolerance: float) -> Optimum:
        """A model fitted to a tolerance, if it is not yet."""
        if guess.model in self._fits:
            return self._to(self._fits[guess.model][0], tolerance)
        joint = Likelihood(self.prediction, guess.model, adjoint=self.prediction.is_large)
        pilots = [self.pilot] if self.pilot is self._first else [self.pilot, self._first]
        starts = np.array([np.concatenate([pilot, guess.values]) for pilot in pilots])
        fit = Optimum(joint, descend(joint, starts, tolerance), check=self.check)
        return self._kept(fit, tolerance)

    def _to(self, fit: Optimum, tolerance: float) -> Optimum:
        """A fit that was made before, to a tolerance."""
        reached = self._fits[fit.joint.noise][1]
        return fit if reached <= tolerance else self._kept(fit.refined(tolerance), tolerance)

    def _kept(self, fit: Optimum, tolerance: float) -> Optimum:
        self.iterations += fit.end.iterations
        self._fits[fit.joint.noise] = fit, tolerance
        return fit
