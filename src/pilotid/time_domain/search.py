"""Where the optimum of the likelihood lies: starts, competing optima, and the fit of each.

Two ways go wrong on their own.  A remnant taken for white has few wrong optima, but its
best one need not be where the likelihood's is.  A remnant that is estimated along with the
pilot makes a wrong pilot look right: what the pilot misses, the remnant explains.  So the
first optimum is that of the forcing frequencies alone, where there are any, or else one
with a white residual.  The remnant that it leaves whitens a second sweep, from that optimum
with each parameter in turn moved to the ends of its usual range, and, without forcing
frequencies, from usual pilots at random.  What this sweep ends in, each with a remnant of its
own, are the candidates; optima that do not simulate the control are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from pilotid.estimates.estimate import Starts, is_at_bound
from pilotid.pilot.model import PilotModel
from pilotid.solve.least_squares import Minima, minimise, minimise_each, resume, solve_linear
from pilotid.solve.search import draw_starts, search
from pilotid.time_domain.output_error import OutputErrors
from pilotid.time_domain.prediction import Prediction
from pilotid.time_domain.prediction_errors import PredictionErrors, for_search, is_large, reduced
from pilotid.time_domain.prepare import Band
from pilotid.time_domain.remnant_models import (
    Guess,
    LowPass,
    NoiseModel,
    contenders,
    criterion,
    guess_parameters,
    lagged_products,
    neighbours,
    selection_penalty,
)
from pilotid.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class SearchSettings:
    """How the optimum is searched.

    Attributes
    ----------
    search_band
        Narrow and cheap band in which the optimum is searched [rad/s].
    candidates, refined
        Random starts screened, and starts minimised, see `pilotid.solve.search.search`.
    """

    search_band: float = 26.0
    candidates: int = 6
    refined: int = 2


@dataclass(frozen=True)
class LikelihoodSettings(SearchSettings):
    """How the likelihood of pilot and remnant is maximised.

    Attributes
    ----------
    search_band, candidates, refined
        See `SearchSettings`.
    band
        Analysis band [rad/s]; None uses the full sampling rate.
    wide
        Bands that take its place, one after the other, while the recording tells of the pilot
        near the edge of the one before; empty for none.
    rounds
        How often the remnant's model is chosen anew at most.
    noise
        The remnant's model, where it is not to be chosen.
    loop
        Whether the likelihood is that of the band, which needs the controlled element, or that of
        direct prediction errors; see `pilotid.time_domain.band_likelihood`.
    weighed
        Signals whose floors weigh the frequencies besides those of the model's own inputs.
    """

    band: float | None = 50.0
    wide: tuple[float, ...] = (120.0, 300.0)
    rounds: int = 3
    noise: NoiseModel | None = None
    loop: bool = True
    weighed: tuple[str, ...] = ()


#: A pilot's simulated response explains at least this share of what that of the lines' pilot does;
#: in populations what is right has .90 or more, what has slid to the inverse -100 to .84.
LEAST_EXPLAINED = 0.8


class Following:
    """Whether parameters follow the control, as the pilot that the lines show does.

    Parameters
    ----------
    coarse
        The prediction at few frequencies.
    known
        Pilots of whom the first is that one, shape (sets, parameters); None if there are no
        lines: then all parameters follow.
    """

    def __init__(self, coarse: Prediction, known: FloatArray | None) -> None:
        self._errors = OutputErrors(coarse)
        self._pilot = len(coarse.model.parameters)
        self._total = float(np.sum(coarse.samples_of(coarse.control_spectrum) ** 2))
        self.lines = 0.0 if known is None else float(self.explained(known[:1])[0])

    def explained(self, sets: FloatArray) -> FloatArray:
        """Share of the control that simulated responses explain, shape (sets,).

        Parameters
        ----------
        sets
            Parameters, the pilot's first, shape (sets, parameters).
        """
        left = self._errors.gram(sets[:, : self._pilot])[:, -1, -1]
        return np.asarray(1.0 - left / self._total)

    def __call__(self, sets: FloatArray) -> BoolArray:
        """Which parameters do, the pilot's first, shape (sets,)."""
        if self.lines <= 0.0:
            return np.ones(len(sets), dtype=bool)
        return np.asarray(self.explained(sets) >= LEAST_EXPLAINED * self.lines)

    def which(self, ends: Minima) -> IntArray:
        """Indices of the ends that do, of all if none does."""
        kept = self(ends.values)
        return np.flatnonzero(kept if kept.any() else ~kept)

    def only(self, ends: Minima) -> Minima:
        """The ends that do, all if none does."""
        which = self.which(ends)
        return ends if len(which) == len(ends.cost) else ends.only(which)


#: The remnant's model before one is chosen: most published remnants are of this kind.
FIRST_NOISE_MODEL = LowPass(2)

#: Deviance by which a candidate may be worse than the best one.  The sweep's whitening is that
#: of one pilot and favours it; with a remnant of its own each candidate has the same chance, but
#: for what the few frequencies do not tell (170 was seen, and the right one left out for it).
SWEEP_MARGIN, CANDIDATE_MARGIN = 1000.0, 300.0
MOST_CANDIDATES = 5  # candidates that are looked at closely
SWEEP_ITERATIONS = 8  # iterations of the sweep, after which the `SWEEP_SURVIVORS` best go on
SWEEP_SURVIVORS = 9
#: Ends are one optimum where they lie so close, in squared standard errors.
SAME_OPTIMUM = 4.0


@dataclass(frozen=True, eq=False)
class Explored:
    """What a search found.

    Attributes
    ----------
    candidates
        Pilot parameters, best first, shape (candidates, parameters).
    terms
        The nuisance terms that the recording shows.
    starts
        How many starts ended in the best optimum.
    following
        Which parameters follow the control as a pilot does.
    coarse
        The prediction, reduced.
    """

    candidates: FloatArray
    terms: tuple[float, ...]
    starts: Starts
    following: Following
    coarse: Prediction


def explore(
    prediction: Prediction,
    band: Band,
    rng: np.random.Generator,
    settings: LikelihoodSettings,
    known: FloatArray | None = None,
    beside: Sequence[FloatArray] = (),
) -> Explored:
    """Search the candidates.

    Parameters
    ----------
    prediction
        Prediction in the analysis band.
    band
        The analysis band.
    rng
        Draws the random starts.
    settings
        Number of starts, and the remnant's model if it is not to be chosen.
    known
        The pilot fitted to the forcing functions' lines alone, shape (1, parameters); None where
        there are no such lines.
    beside
        Pilots that are known of another band.
    """
    model = prediction.model
    none = np.zeros((0, len(model.parameters)))
    near = np.concatenate([none if known is None else known, *(pilot[None] for pilot in beside)])
    coarse = reduced(prediction)
    following = Following(coarse, known)
    # A fit of the lines that ended at a bound may have gone astray.
    guided = known is not None and not is_at_bound(model, known[0]).any()
    firsts = near
    if not guided:
        white = OutputErrors(coarse.below(settings.search_band))
        ends = search(
            white.gram, model, rng, candidates=settings.candidates, refined=settings.refined
        )
        firsts = np.concatenate([ends.distinct(), near])
    joint = PredictionErrors(coarse, settings.noise or FIRST_NOISE_MODEL, band)
    end = _own_remnant(joint, prediction, firsts)
    taps = joint.whitener(end.values[0])
    best = end.values[0, : joint.pilot]
    whitened = OutputErrors(coarse, taps)
    starts = _starts(model, best, rng, 0 if guided else settings.candidates)
    starts, _ = solve_linear(whitened.gram(starts), starts, model.linear, model.lower)
    starts = np.concatenate([best[None], near, starts])
    first = minimise(whitened.gram, starts, model, tolerance=1e-3, iterations=SWEEP_ITERATIONS)
    # What is far behind by then is given up, and of starts that met one goes on for all.
    met = together(first, coarse.samples)[:SWEEP_SURVIVORS]
    swept = minimise_each(
        lambda values, _: whitened.gram(values),
        first.values[[group[0] for group in met]],
        model,
        tolerance=1e-3,
        iterations=2 * SWEEP_ITERATIONS,
    )
    sizes = np.array([len(group) for group in met])
    kept = following.which(swept)
    followed = swept.only(np.repeat(kept, sizes[kept])).best_first()
    candidates, agreeing = optima(followed, coarse.samples, SWEEP_MARGIN)
    candidates = np.concatenate([candidates, near])
    if len(candidates) > 1:
        ends = following.only(_own_remnant(joint, prediction, candidates))
        candidates = optima(ends, coarse.samples, CANDIDATE_MARGIN)[0][:, : joint.pilot]
    if beside:
        # What is known of another band may be nearer than where the first remnant leads.
        candidates = np.concatenate([candidates, near])
    terms = OutputErrors(prediction, taps).noticeable_terms(candidates[0])
    given_up = np.delete(first.cost, [start for group in met for start in group])
    cost = np.sort(np.concatenate([np.repeat(swept.cost, sizes), given_up]))
    return Explored(candidates, terms, Starts(cost / cost[0], agreeing), following, coarse)


def terms_at(
    prediction: Prediction, band: Band, pilot: FloatArray, settings: LikelihoodSettings
) -> tuple[float, ...]:
    """The nuisance terms that the recording shows beside a pilot, shape (parameters,)."""
    joint = PredictionErrors(reduced(prediction), settings.noise or FIRST_NOISE_MODEL, band)
    end = _own_remnant(joint, prediction, pilot[None])
    return OutputErrors(prediction, joint.whitener(end.values[0])).noticeable_terms(pilot)


def _starts(
    model: PilotModel, best: FloatArray, rng: np.random.Generator, count: int
) -> FloatArray:
    """The best pilot with one parameter moved far away, and usual pilots.

    A delay that is wrong by a period of the strongest line is the commonest wrong optimum.
    """
    low, high = model.usual
    moved = []
    for index, parameter in enumerate(model.parameters):
        if not parameter.linear:  # gains are solved for
            between = (0.5 * (low[index] + high[index]),) if parameter.delay else ()
            for value in (low[index], *between, high[index]):
                moved.append(best.copy())
                moved[-1][index] = value
    moved += model.elsewhere(best)
    return np.array([*moved, *draw_starts(model, rng, count), model.start])


def _own_remnant(joint: PredictionErrors, prediction: Prediction, pilots: FloatArray) -> Minima:
    """Each pilot with the remnant that it leaves, both estimated together."""
    residuals = [OutputErrors(prediction).residual(pilot) for pilot in pilots]
    guesses = [guess_parameters(joint.noise, residual, joint.band) for residual in residuals]
    return minimise(joint.gram, np.hstack([pilots, guesses]), joint, tolerance=3e-3, iterations=12)


def together(ends: Minima, samples: int) -> list[list[int]]:
    """Which ends are in one optimum, the best one's first; `ends`, `samples` as in `optima`."""
    return grouped(
        range(len(ends.values)),
        lambda first, index: ends.apart(ends.values[index], samples, first) <= SAME_OPTIMUM,
    )


def grouped(indices: Iterable[int], near: Callable[[int, int], bool]) -> list[list[int]]:
    """Indices, each with the first before it that it is near to.

    Parameters
    ----------
    indices
        What is grouped, in an order of which the first of each group comes.
    near
        Whether the second index belongs to the group of the first.
    """
    groups: list[list[int]] = []
    for index in indices:
        for group in groups:
            if near(group[0], index):
                group.append(index)
                break
        else:
            groups.append([index])
    return groups


def optima(ends: Minima, samples: int, far: float) -> tuple[FloatArray, int]:
    """One end of each optimum, best first, and how many ends are in the best one.

    Parameters
    ----------
    ends
        Where starts ended, best first.
    samples
        Number of residuals.
    far
        Optima are left out whose deviance exceeds the lowest by more.
    """
    near = ends.only(ends.cost <= ends.cost[0] * np.exp(far / samples))
    groups = together(near, samples)
    return near.values[[group[0] for group in groups[:MOST_CANDIDATES]]], len(
        groups[0]
    ) if groups else 0


#: By how much the criterion of a longer or shorter autoregression must be lower.
NEIGHBOUR_MARGIN = 0.1

#: Relative decrease of the cost at which a search ends: of a first look, and of what is reported.
FIRST_LOOK_TOLERANCE, REPORTED_TOLERANCE = 1e-3, 1e-10
#: Tolerance of what is compared, and at which a search has converged that creeps along a flat
#: valley.
COMPARED_TOLERANCE = 1e-6
#: What such a search is still short of, in steps of its tolerance: those ahead add up.
STEPS_AHEAD = 10.0


def optimum(
    joint: PredictionErrors, starts: FloatArray, tolerance: float = REPORTED_TOLERANCE
) -> Minima:
    """The best optimum that starts lead to, shape (starts, parameters), to a tolerance.

    Along a flat valley the search creeps; where it got is then good enough if
    `COMPARED_TOLERANCE` is met.
    """
    end = minimise(joint.gram, starts, joint, tolerance=tolerance)
    if end.converged[0]:
        return end
    return resume(joint.gram, end, joint, tolerance=max(tolerance, COMPARED_TOLERANCE))


@dataclass(frozen=True, eq=False)
class JointFit:
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
        return own + selection_penalty(self.joint.noise)

    @property
    def short(self) -> float:
        """Possible further decrease of the criterion after a fit to `COMPARED_TOLERANCE`."""
        return STEPS_AHEAD * COMPARED_TOLERANCE * self.joint.residuals

    def is_near(self, pilot: FloatArray) -> bool:
        """Whether a pilot, shape (parameters,), differs by no more than its errors."""
        return self.end.apart(pilot, self.joint.residuals) <= SAME_OPTIMUM

    def refined(self, tolerance: float = REPORTED_TOLERANCE) -> Self:
        """The same to another tolerance, or to `COMPARED_TOLERANCE` as in `optimum`."""
        joint, end = self.joint, self.end
        if tolerance < COMPARED_TOLERANCE and joint.exact is not joint:
            joint = joint.exact
            end = minimise(joint.gram, end.values[:1], joint, tolerance=tolerance)
        else:
            end = resume(joint.gram, end, joint, tolerance=tolerance)
        if tolerance < COMPARED_TOLERANCE and not end.converged[0]:
            end = resume(joint.gram, end, joint, tolerance=COMPARED_TOLERANCE)
        return replace(self, joint=joint, end=end)


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
        return self._chosen(FIRST_LOOK_TOLERANCE)

    def best(self, rounds: int) -> JointFit:
        """The best of all to `COMPARED_TOLERANCE`.

        Its model is chosen anew as the pilot moves, in as many rounds at most.
        """
        found = self._chosen(COMPARED_TOLERANCE)
        if self.noise:
            return found
        for _ in range(rounds - 1):
            before, found = found, self._chosen(COMPARED_TOLERANCE)
            if found.joint.noise == before.joint.noise:
                break
        # Of many long autoregressions the first that suits depends on where the search came from.
        while others := neighbours(found.joint.noise):
            better = self._best(self._guesses(others, self._products()), COMPARED_TOLERANCE)
            if abs(better.criterion - found.criterion + NEIGHBOUR_MARGIN) < found.short:
                found, better = (
                    self._to(found, REPORTED_TOLERANCE),
                    self._to(better, REPORTED_TOLERANCE),
                )
            if not better.criterion < found.criterion - NEIGHBOUR_MARGIN:
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
        if tolerance > COMPARED_TOLERANCE or len(near) == 1:
            return best
        return min((self._to(fit, REPORTED_TOLERANCE) for fit in near), key=_criterion)

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
