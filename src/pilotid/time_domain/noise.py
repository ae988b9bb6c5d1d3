"""The remnant's model: chosen, and fitted, along with the pilot.

What a pilot leaves of the control suggests models (`contenders`).  Each is fitted together with
the pilot from there on, and the criterion chooses; the pilot then moves, leaves something else,
and the choice is made again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from pilotid.solve.least_squares import Minima, minimise, resume
from pilotid.support.types import FloatArray
from pilotid.time_domain.likelihood import PredictionErrors, binned, for_search, is_large
from pilotid.time_domain.output_error import OutputErrors
from pilotid.time_domain.prediction import Prediction
from pilotid.time_domain.prepare import Band
from pilotid.time_domain.remnant_models import (
    BandPass,
    Guess,
    NoiseModel,
    criterion,
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


@dataclass(frozen=True, eq=False)
class JointFit:
    """The optimum of pilot and remnant with one model of the remnant.

    Attributes
    ----------
    joint
        The problem: prediction, model of the remnant, analysis band.
    end
        Its optimum, whose first entry counts.
    """

    joint: PredictionErrors
    end: Minima

    @property
    def values(self) -> FloatArray:
        """Parameters of pilot and remnant, shape (parameters,)."""
        return np.asarray(self.end.values[0])

    @property
    def pilot(self) -> FloatArray:
        """The pilot's parameters, shape (parameters,)."""
        return self.values[: self.joint.pilot]

    @property
    def criterion(self) -> float:
        """The criterion that chooses the remnant's model, of pilot and remnant together."""
        joint = self.joint
        power = float(self.end.cost[0]) / joint.residuals
        penalty = SEARCH.band_pass_penalty if isinstance(joint.noise, BandPass) else 0.0
        return criterion(joint.noise, power, joint.residuals, joint.pilot) + penalty

    @property
    def short(self) -> float:
        """Possible further decrease of the criterion of a fit that is only compared."""
        return SEARCH.steps_ahead * SEARCH.compared_tolerance * self.joint.residuals

    def is_near(self, pilot: FloatArray) -> bool:
        """Whether a pilot, shape (parameters,), differs by no more than its errors."""
        return self.end.apart(pilot, self.joint.residuals) <= SEARCH.same_optimum_distance

    def refined(self, tolerance: float = SEARCH.reported_tolerance) -> Self:
        """The same to another tolerance, or to that of what is compared as in `descended`."""
        joint, end = self.joint, self.end
        compared = SEARCH.compared_tolerance
        if tolerance < compared and joint.exact is not joint:
            joint = joint.exact
            end = minimise(joint.gram, end.values[:1], joint, tolerance=tolerance)
        else:
            end = resume(joint.gram, end, joint, tolerance=tolerance)
        if tolerance < compared and not end.converged[0]:
            end = resume(joint.gram, end, joint, tolerance=compared)
        return replace(self, joint=joint, end=end)


def descended(
    joint: PredictionErrors, starts: FloatArray, tolerance: float = SEARCH.reported_tolerance
) -> Minima:
    """The best optimum that starts lead to, shape (starts, parameters), to a tolerance.

    Along a flat valley the search creeps; where it got is then good enough if the tolerance of
    what is compared is met.
    """
    end = minimise(joint.gram, starts, joint, tolerance=tolerance)
    if end.converged[0]:
        return end
    return resume(joint.gram, end, joint, tolerance=max(tolerance, SEARCH.compared_tolerance))


class RemnantChoice:
    """Fits near one pilot, of each model of the remnant that came into question.

    Every model is fitted once, from the pilot at which it first did and from where all began: one
    model may lose a channel, which does not come back of itself, where another does not.  What is
    asked for again is there already.

    Parameters
    ----------
    prediction, band
        The prepared prediction, and the analysis band that it was prepared in.
    pilot
        Where to begin, shape (parameters,).
    noise
        The remnant's model if it is not to be chosen.
    coarse
        The prediction with binned spectra, if that is there already.
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
            coarse = binned(prediction)
        self.coarse = coarse
        self.pilot = self._first = pilot
        self.iterations = 0
        self._fits: dict[NoiseModel, tuple[JointFit, float]] = {}

    def look(self) -> JointFit:
        """A first look: the model that suits what the pilot leaves, roughly fitted."""
        return self._chosen(SEARCH.look_tolerance)

    def best(self, rounds: int) -> JointFit:
        """The best of all, as exactly as is needed to compare them.

        Its model is chosen anew as the pilot moves, in as many rounds at most.
        """
        compared = SEARCH.compared_tolerance
        found = self._chosen(compared)
        if self.noise:
            return found
        for _ in range(rounds - 1):
            before, found = found, self._chosen(compared)
            if found.joint.noise == before.joint.noise:
                break
        # Of many long autoregressions the first that suits depends on where the search came from.
        while others := neighbours(found.joint.noise):
            better = self._best(self._guesses(others, self._products()), compared)
            if abs(better.criterion - found.criterion + SEARCH.neighbour_criterion) < found.short:
                found, better = (
                    self._to(fit, SEARCH.reported_tolerance) for fit in (found, better)
                )
            if not better.criterion < found.criterion - SEARCH.neighbour_criterion:
                break
            found = self._moved(better)
        return found

    def _chosen(self, tolerance: float) -> JointFit:
        products = self._products()
        if self.noise:
            models = self._guesses([self.noise], products)
        else:
            models = contenders(products, self.prediction.runs * self.prediction.scored, self.band)
        return self._moved(self._best(models, tolerance))

    def _guesses(self, models: Sequence[NoiseModel], products: FloatArray) -> list[Guess]:
        return [Guess(model, model.guess(products, self.band)[0]) for model in models]

    def _moved(self, fit: JointFit) -> JointFit:
        self.pilot = fit.pilot
        return fit

    def _products(self) -> FloatArray:
        """Lagged products of what the pilot leaves."""
        return lagged_products(OutputErrors(self.prediction).residual(self.pilot))

    def _best(self, models: Sequence[Guess], tolerance: float) -> JointFit:
        """The best of some models, each with the pilot that goes with it."""
        fits = [self._fitted(guess, tolerance) for guess in models]
        best = min(fits, key=_criterion)
        near = [fit for fit in fits if not fit.criterion > best.criterion + best.short]
        if tolerance > SEARCH.compared_tolerance or len(near) == 1:
            return best
        return min((self._to(fit, SEARCH.reported_tolerance) for fit in near), key=_criterion)

    def _fitted(self, guess: Guess, tolerance: float) -> JointFit:
        """A model fitted to a tolerance, if it is not yet."""
        model, values = guess
        if model in self._fits:
            return self._to(self._fits[model][0], tolerance)
        joint = for_search(PredictionErrors(self.prediction, model, self.band), self.coarse)
        pilots = [self.pilot] if self.pilot is self._first else [self.pilot, self._first]
        starts = np.array([np.concatenate([pilot, values]) for pilot in pilots])
        return self._kept(JointFit(joint, descended(joint, starts, tolerance)), tolerance)

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
