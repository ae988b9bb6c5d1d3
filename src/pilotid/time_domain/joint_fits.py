"""Pilot and remnant estimated together, with each model of the remnant that may suit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pilotid.solve.least_squares import Minima, minimise, resume
from pilotid.time_domain.adjoint import for_search, is_large
from pilotid.time_domain.band import Band
from pilotid.time_domain.output_error import OutputErrors
from pilotid.time_domain.prediction import Prediction
from pilotid.time_domain.prediction_errors import PredictionErrors
from pilotid.time_domain.reduced import reduced
from pilotid.time_domain.remnant_choice import (
    Guess,
    contenders,
    criterion,
    handicap,
    lagged_products,
    neighbours,
)
from pilotid.time_domain.remnant_models import NoiseModel
from pilotid.types import FloatArray

#: By how much the criterion of a longer or shorter autoregression must be lower.
CLEARLY = 0.1

COARSE, FINE = 1e-3, 1e-10  # tolerances of a first look, and of what is reported
#: Tolerance of what is compared, and at which a search has converged that creeps along a flat
#: valley.
ENOUGH = 1e-6
#: What such a search is still short of, in steps of its tolerance: those ahead add up.
AHEAD = 10.0

#: Two first looks are at one optimum where their pilots are so close, in squared standard errors.
SAME = 4.0


def optimum(joint: PredictionErrors, starts: FloatArray, tolerance: float = FINE) -> Minima:
    """The best optimum that starts lead to, shape (starts, parameters), to a tolerance.

    Along a flat valley the search creeps; where it got is then good enough if `ENOUGH` is met.
    """
    end = minimise(joint.gram, starts, joint, tolerance=tolerance)
    if end.converged[0]:
        return end
    return resume(joint.gram, end, joint, tolerance=max(tolerance, ENOUGH))


class JointFit(NamedTuple):
    """The optimum with one model of the remnant.

    Attributes
    ----------
    joint
        The problem.
    end
        Its optimum, whose first entry counts.
    """

    joint: PredictionErrors
    end: Minima

    @property
    def pilot(self) -> FloatArray:
        """The pilot's parameters, shape (parameters,)."""
        return self.end.values[0, : self.joint.pilot]

    @property
    def criterion(self) -> float:
        """The criterion that chooses the remnant's model, of pilot and remnant together."""
        power = float(self.end.cost[0]) / self.joint.residuals
        own = criterion(self.joint.noise, power, self.joint.residuals, self.joint.pilot)
        return own + handicap(self.joint.noise)

    @property
    def short(self) -> float:
        """By how much the criterion may be lower at the optimum, of a fit to `ENOUGH`."""
        return AHEAD * ENOUGH * self.joint.residuals

    def is_near(self, pilot: FloatArray) -> bool:
        """Whether a pilot, shape (parameters,), differs by no more than its errors."""
        return self.end.apart(pilot, self.joint.residuals) <= SAME

    def refined(self, tolerance: float) -> JointFit:
        """The same to another tolerance, or to `ENOUGH` as in `optimum`."""
        joint, end = self.joint, self.end
        if tolerance < ENOUGH and joint.exact is not joint:
            joint = joint.exact
            end = minimise(joint.gram, end.values[:1], joint, tolerance=tolerance)
        else:
            end = resume(joint.gram, end, joint, tolerance=tolerance)
        if tolerance < ENOUGH and not end.converged[0]:
            end = resume(joint.gram, end, joint, tolerance=ENOUGH)
        return JointFit(joint, end)


class JointFits:
    """Optima near one pilot, of each model of the remnant that came into question.

    Every model is fitted once, from the pilot at which it first did and from where all began: one
    model may lose a channel, which does not come back of itself, where another does not.  What is
    asked for again is there already.

    Parameters
    ----------
    prediction
        The prepared prediction.
    band
        The analysis band that it was prepared in.
    pilot
        Where to begin, shape (parameters,).
    noise
        The remnant's model if it is not to be chosen.
    coarse
        The prediction, reduced, if that is there already.
    """

    def __init__(
        self,
        prediction: Prediction,
        band: Band,
        pilot: FloatArray,
        noise: NoiseModel | None,
        coarse: Prediction | None = None,
    ) -> None:
        self.prediction, self.band, self.noise = prediction, band, noise
        # For all models once, and only where a search wants it.
        if coarse is None and is_large(prediction):
            coarse = reduced(prediction)
        self.coarse = coarse
        self.pilot = self._first = pilot
        self.iterations = 0
        self._fits: dict[NoiseModel, tuple[JointFit, float]] = {}

    def look(self) -> JointFit:
        """A first look: the model that suits what the pilot leaves, roughly fitted."""
        return self._chosen(COARSE)

    def best(self, rounds: int) -> JointFit:
        """The best of all to `ENOUGH`, its model chosen anew as the pilot moves, up to so often."""
        found = self._chosen(ENOUGH)
        if self.noise:
            return found
        for _ in range(rounds - 1):
            before, found = found, self._chosen(ENOUGH)
            if found.joint.noise == before.joint.noise:
                break
        # Of many long autoregressions the first that suits depends on where the search came from.
        while others := neighbours(found.joint.noise):
            better = self._best(self._guesses(others, self._products()), ENOUGH)
            if abs(better.criterion - found.criterion + CLEARLY) < found.short:
                found, better = self._to(found, FINE), self._to(better, FINE)
            if not better.criterion < found.criterion - CLEARLY:
                break
            found = self._moved(better)
        return found

    def _chosen(self, tolerance: float) -> JointFit:
        products = self._products()
        samples = self.prediction.runs * self.prediction.scored
        guesses = (
            self._guesses([self.noise], products)
            if self.noise
            else contenders(products, samples, self.band)
        )
        return self._moved(self._best(guesses, tolerance))

    def _guesses(self, models: Sequence[NoiseModel], products: FloatArray) -> list[Guess]:
        return [Guess(model, model.guess(products, self.band)[0]) for model in models]

    def _moved(self, fit: JointFit) -> JointFit:
        self.pilot = fit.pilot
        return fit

    def _products(self) -> FloatArray:
        """Lagged products of what the pilot leaves."""
        return lagged_products(OutputErrors(self.prediction).residual(self.pilot))

    def _best(self, guesses: Sequence[Guess], tolerance: float) -> JointFit:
        """The best of some models, each with the pilot that goes with it."""
        fits = [self._fitted(guess, tolerance) for guess in guesses]
        best = min(fits, key=_criterion)
        near = [fit for fit in fits if not fit.criterion > best.criterion + best.short]
        if tolerance > ENOUGH or len(near) == 1:
            return best
        return min((self._to(fit, FINE) for fit in near), key=_criterion)

    def _fitted(self, guess: Guess, tolerance: float) -> JointFit:
        """A model fitted to a tolerance, if it is not yet."""
        model, values = guess
        if model in self._fits:
            return self._to(self._fits[model][0], tolerance)
        joint = for_search(PredictionErrors(self.prediction, model, self.band), self.coarse)
        pilots = [self.pilot] if self.pilot is self._first else [self.pilot, self._first]
        starts = np.array([np.concatenate([pilot, values]) for pilot in pilots])
        return self._kept(JointFit(joint, optimum(joint, starts, tolerance)), tolerance)

    def _to(self, fit: JointFit, tolerance: float) -> JointFit:
        """A fit that was made before, to a tolerance."""
        reached = self._fits[fit.joint.noise][1]
        return fit if reached <= tolerance else self._kept(fit.refined(tolerance), tolerance)

    def _kept(self, fit: JointFit, tolerance: float) -> JointFit:
        self.iterations += fit.end.iterations
        self._fits[fit.joint.noise] = fit, tolerance
        return fit


def _criterion(fit: JointFit) -> float:
    return fit.criterion
