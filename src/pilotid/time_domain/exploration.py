"""Where the optimum of the likelihood may lie: candidates for pilot parameters.

Two ways go wrong on their own.  A remnant taken for white has few wrong optima, but its
best one need not be where the likelihood's is.  A remnant that is estimated along with the
pilot makes a wrong pilot look right: what the pilot misses, the remnant explains.  So the
first optimum is that of the forcing functions' lines alone, where there are lines, or else one
with a white residual.  The remnant that it leaves whitens a second sweep, from that optimum
with each parameter in turn moved to the ends of its usual range, and, without lines, from usual
pilots at random.  What this sweep ends in, each with a remnant of its own, are the candidates;
what does not follow the control as a pilot does is none, see `following`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from pilotid.estimates.estimate import Starts, is_at_bound
from pilotid.pilot.model import PilotModel
from pilotid.solve.least_squares import Minima, minimise, minimise_each, solve_linear
from pilotid.solve.search import draw_starts, search
from pilotid.time_domain.band import Band
from pilotid.time_domain.following import Following
from pilotid.time_domain.output_error import OutputErrors
from pilotid.time_domain.prediction import Prediction
from pilotid.time_domain.prediction_errors import PredictionErrors
from pilotid.time_domain.reduced import reduced
from pilotid.time_domain.remnant_choice import guessed
from pilotid.time_domain.remnant_models import LowPass
from pilotid.time_domain.settings import LikelihoodSettings
from pilotid.types import FloatArray

#: The remnant's model before one is chosen: most published remnants are of this kind.
FIRST = LowPass(2)

#: Deviance by which a candidate may be worse than the best one.  The sweep's whitening is that
#: of one pilot and favours it; with a remnant of its own each candidate has the same chance, but
#: for what the few frequencies do not tell (170 was seen, and the right one left out for it).
SWEPT, LIKELY = 1000.0, 300.0
MOST = 5  # candidates that are looked at closely
SWEEP = 8  # iterations of the sweep, after which the `PROMISING` best go on
PROMISING = 9
#: Ends are one optimum where they lie so close, in squared standard errors.
SAME = 4.0


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
    joint = PredictionErrors(coarse, settings.noise or FIRST, band)
    end = _own_remnant(joint, prediction, firsts)
    taps = joint.whitener(end.values[0])
    best = end.values[0, : joint.pilot]
    whitened = OutputErrors(coarse, taps)
    starts = _starts(model, best, rng, 0 if guided else settings.candidates)
    starts, _ = solve_linear(whitened.gram(starts), starts, model.linear, model.lower)
    starts = np.concatenate([best[None], near, starts])
    first = minimise(whitened.gram, starts, model, tolerance=1e-3, iterations=SWEEP)
    # What is far behind by then is given up, and of starts that met one goes on for all.
    met = together(first, coarse.samples)[:PROMISING]
    swept = minimise_each(
        lambda values, _: whitened.gram(values),
        first.values[[group[0] for group in met]],
        model,
        tolerance=1e-3,
        iterations=2 * SWEEP,
    )
    sizes = np.array([len(group) for group in met])
    kept = following.which(swept)
    followed = swept.only(np.repeat(kept, sizes[kept])).best_first()
    candidates, agreeing = optima(followed, coarse.samples, SWEPT)
    candidates = np.concatenate([candidates, near])
    if len(candidates) > 1:
        ends = following.only(_own_remnant(joint, prediction, candidates))
        candidates = optima(ends, coarse.samples, LIKELY)[0][:, : joint.pilot]
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
    joint = PredictionErrors(reduced(prediction), settings.noise or FIRST, band)
    end = _own_remnant(joint, prediction, pilot[None])
    return OutputErrors(prediction, joint.whitener(end.values[0])).noticeable_terms(pilot)


def _starts(
    model: PilotModel, best: FloatArray, rng: np.random.Generator, count: int
) -> FloatArray:
    """The best pilot with one parameter moved far away, and usual pilots.

    A delay that is wrong by a period of the strongest line is the commonest wrong optimum.
    """
    low, high = np.array([p.usual for p in model.parameters]).T
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
    guesses = [guessed(joint.noise, residual, joint.band) for residual in residuals]
    return minimise(joint.gram, np.hstack([pilots, guesses]), joint, tolerance=3e-3, iterations=12)


def together(ends: Minima, samples: int) -> list[list[int]]:
    """Which ends are in one optimum, the best one's first; `ends`, `samples` as in `optima`."""
    return grouped(
        range(len(ends.values)),
        lambda first, index: ends.apart(ends.values[index], samples, first) <= SAME,
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
    return near.values[[group[0] for group in groups[:MOST]]], len(groups[0]) if groups else 0
