"""Pilot and remnant estimated together, with each model of the remnant that may suit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pilotid.solve.least_squares import Minima, minimise
from pilotid.time_domain.band import Band
from pilotid.time_domain.output_error import OutputErrors
from pilotid.time_domain.prediction import Prediction
from pilotid.time_domain.prediction_errors import PredictionErrors
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

COARSE, FINE = 1e-3, 1e-10  # tolerances of a first look, and of what is compared
ENOUGH = 1e-6  # tolerance at which a search has converged that creeps along a flat valley


def optimum(joint: PredictionErrors, starts: FloatArray, tolerance: float = FINE) -> Minima:
    """The best optimum that starts lead to, shape (starts, parameters), to a tolerance.

    Along a flat valley the search creeps; where it got is then good enough if `ENOUGH` is met.
    """
    end = minimise(joint.gram, starts, joint, tolerance=tolerance)
    if end.converged[0]:
        return end
    return minimise(joint.gram, end.values[:1], joint, tolerance=max(tolerance, ENOUGH))


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

    def refined(self, tolerance: float) -> JointFit:
        """The same to another tolerance."""
        return JointFit(self.joint, optimum(self.joint, self.end.values[:1], tolerance))


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
    """

    def __init__(
        self, prediction: Prediction, band: Band, pilot: FloatArray, noise: NoiseModel | None
    ) -> None:
        self.prediction, self.band, self.noise = prediction, band, noise
        self.pilot = self._first = pilot
        self.iterations = 0
        self._fits: dict[NoiseModel, tuple[JointFit, float]] = {}

    def look(self) -> JointFit:
        """A first look: the model that suits what the pilot leaves, roughly fitted."""
        return self._chosen(COARSE)

    def best(self, rounds: int) -> JointFit:
        """The best of all, its model chosen anew as the pilot moves, up to so many times."""
        found = self._chosen(FINE)
        if self.noise:
            return found
        for _ in range(rounds - 1):
            before, found = found, self._chosen(FINE)
            if found.joint.noise == before.joint.noise:
                break
        # Of many long autoregressions the first that suits depends on where the search came from.
        while others := neighbours(found.joint.noise):
            better = self._best(self._guesses(others, self._products()), FINE)
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
        fits = []
        for model, values in guesses:
            fit, reached = self._fits.get(model, (None, np.inf))
            if fit is None:
                joint = PredictionErrors(self.prediction, model, self.band)
                pilots = [self.pilot] if self.pilot is self._first else [self.pilot, self._first]
                starts = np.array([np.concatenate([pilot, values]) for pilot in pilots])
                end = optimum(joint, starts, tolerance)
                fit = JointFit(joint, end)
                self.iterations += end.iterations
            elif reached > tolerance:
                fit = fit.refined(tolerance)
                self.iterations += fit.end.iterations
            self._fits[model] = fit, min(reached, tolerance)
            fits.append(fit)
        return min(fits, key=lambda fit: fit.criterion)
