"""The search for the optimum of the likelihood: band, starts, one sweep, competing optima.

Two ways go wrong on their own.  A remnant taken for white has few wrong optima, but its best one
need not be where the likelihood's is.  A remnant that is estimated along with the pilot makes a
wrong pilot look right: what the pilot misses, the remnant explains.  So `maximise_likelihood`
goes in four steps, of which the first alone fixes the analysis band:

1. `first_fit`: the pilot of the forcing frequencies alone, where there are any, or else that of a
   white residual, with a second-order remnant; in the first analysis band that is wide enough.
2. `sweep`, but where there are forcing frequencies and the first pilot is well known: whitened by
   that remnant, from that pilot with each parameter in turn moved to the ends of its usual range
   and, without forcing frequencies, from usual pilots at random.
3. Each optimum of the sweep that simulates the control, with remnant models of its own; the lines'
   pilot, too.  A search ends as it comes into the valley of an optimum that is known.
4. The best of them, and those that are as likely.

Steps 1 and 2 look at binned spectra, steps 3 and 4 at all samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from pilotid.estimate.estimate import Starts, is_at_bound
from pilotid.estimate.loops import are_pilots
from pilotid.estimate.warnings import lines_objection
from pilotid.likelihood.band_likelihood import weighting_of
from pilotid.likelihood.likelihood import Likelihood
from pilotid.likelihood.optimum import (
    BEHIND_CRITERION,
    COMPARED_TOLERANCE,
    COMPETING_CRITERION,
    SAME_OPTIMUM_DISTANCE,
    Optimum,
    PilotCheck,
    best_of,
    descend,
)
from pilotid.likelihood.prediction import Prediction, predict
from pilotid.likelihood.prepare import Band, decimation
from pilotid.likelihood.remnant_models import (
    FIRST_NOISE_MODEL,
    NOISE_MODELS,
    BandPass,
    Guess,
    LowPass,
    NoiseModel,
    Whitener,
    guesses,
    lagged_products,
    neighbours,
)
from pilotid.model.factors import Lag, Lead
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.recording.spectra import jumps_of
from pilotid.solve.intervals import with_information
from pilotid.solve.least_squares import Minima, draw_starts, minimise, search, solve_linear
from pilotid.spectral.equations import fit_lines
from pilotid.support.types import FloatArray

#: Narrow and cheap band in which the first pilot of a white residual is searched [rad/s], and
#: random starts that are screened there, and minimised.
SEARCH_BAND, CANDIDATES, REFINED = 26.0, 12, 4
#: Tuned: by which the criterion may be higher of a candidate on a first look, and of a remnant's
#: model beside what a first pilot leaves (populations).
LOOK_CRITERION = 20.0
#: Tuned: the same of an autoregression beside a filter that has a fit inside its bounds: farther
#: behind it was the best in 4 of 284 pairs, filters behind autoregressions in 32 of 104 (six
#: populations, seeds 3000 to 3119).
LOOK_REGRESSION = 8.0
#: Tuned: by which the criterion may be higher of other models of the remnant, beside which
#: intervals are sought too (hard remnants: coverage .931 without, .956; with 5 a tenth slower).
RIVAL_CRITERION = 3.0


@dataclass(frozen=True)
class LikelihoodSettings:
    """How the likelihood of pilot and remnant is maximised.

    Attributes
    ----------
    band
        Analysis band [rad/s]; None uses the full sampling rate.
    wide
        Wider bands to try, in order, while there is too much information near the edge of the one
        before; empty for none.  They widen the default band alone: one that is asked for stays.
    noise
        The remnant's model, where it is not to be chosen.
    loop
        Whether the likelihood is that of the band, which needs the controlled element, or that of
        direct prediction errors; see `pilotid.likelihood.band_likelihood`.
    weighed
        Signals whose floors weigh the frequencies besides those of the model's own inputs.
    """

    band: float | None = 50.0
    wide: tuple[float, ...] = (120.0, 300.0)
    noise: NoiseModel | None = None
    loop: bool = True
    weighed: tuple[str, ...] = ()

    def objection(self, recording: Recording, model: PilotModel) -> str | None:
        """None: any recording and any model will do."""
        return None


def maximise_likelihood(
    recording: Recording,
    model: PilotModel,
    rng: np.random.Generator,
    settings: LikelihoodSettings,
) -> Optimum:
    """Maximise the likelihood of pilot and remnant parameters.

    Parameters
    ----------
    recording, model
        What is fitted.
    rng
        Draws the random starts.
    settings
        Bands, starts, and the remnant's model if it is not to be chosen.
    """
    lines = lines_pilot(recording, model, rng)
    first = first_fit(recording, model, settings, lines, rng)
    first = replace(first, check=PilotCheck(first.joint.prediction.binned, lines))
    pilots, starts = [first.pilot], None
    if not (len(lines) and first.is_well_known):
        candidates, starts = sweep(first, rng, lines)
        pilots = [*candidates, *lines]  # the lines' pilot rests on no model of the remnant
    whole = first.joint.prediction
    of_lag: dict[bool, Prediction] = {}

    def choice_at(pilot: FloatArray, noise: NoiseModel | None) -> RemnantChoice:
        """That of a pilot, with the terms of the first that has such a lag as it has."""
        outlasts = whole.outlasting_lag(pilot) > 0.0
        if outlasts not in of_lag:
            of_lag[outlasts] = whole.with_noticeable_terms(pilot, first.whitener)
        return RemnantChoice(of_lag[outlasts], pilot, noise, first.check)

    def fitted(choice: RemnantChoice) -> Optimum:
        """Its best fit, again with other terms where the lag ends as one of the other kind."""
        fit = choice.full_fit()
        own = choice_at(fit.pilot, choice.noise)
        return fit if own.prediction is choice.prediction else own.full_fit()

    likely = _likely([choice_at(pilot, settings.noise) for pilot in pilots])
    best, others = _best_and_others([fitted(choice) for choice in likely])
    # The terms were chosen beside a first estimate; at the optimum the choice may be another.
    for _ in range(4):
        other = whole.with_noticeable_terms(best.pilot, best.whitener)
        before, terms = best.joint.prediction.nuisance_poles, other.nuisance_poles
        if len(terms) == len(before) and np.allclose(terms, before, rtol=0.1):
            break
        of_lag[best.is_slow] = other
        again = [choice_at(each.pilot, best.joint.noise) for each in (best, *others)]
        rivals = best.rivals
        best, others = _best_and_others([choice.full_fit() for choice in again])
        best = replace(best, rivals=rivals)
    ordered = model.ordered(best.pilot[None])[0]
    if np.any(ordered != best.pilot):
        best = best.restarted_at(np.concatenate([ordered, best.values[len(ordered) :]]))
    end = with_information(best.end, best.joint.gram)
    best = replace(best, end=end, starts=starts, lines_pilot=[*lines], others=others)
    return replace(best, rivals=[*best.rivals, *_with_jumps_at_samples(best, recording)])


def _with_jumps_at_samples(best: Optimum, recording: Recording) -> list[Optimum]:
    """The fit beside it of a target that jumps; none where it does not.

    Transforms take a jump between two samples for one half-way between them.  One at the later
    sample, as of a computer that holds its target, is half done there.
    """
    half = 0.5 * jumps_of(recording)
    if not half.any():
        return []
    target = None if recording.ft is None else recording.ft - half
    later = replace(recording, e=recording.e - half, ft=target)
    prediction, model = best.joint.prediction, best.joint.prediction.model
    inputs = predict(later, model, prediction.window.band.limit, fast=True)
    prediction = replace(prediction, spectra=inputs.spectra, fine=inputs.fine)
    joint = Likelihood(prediction, best.joint.noise)
    end = with_information(descend(joint, best.values[None], COMPARED_TOLERANCE), joint.gram)
    return [replace(best, joint=joint, end=end)]


def maxima_from(
    recording: Recording, model: PilotModel, settings: LikelihoodSettings, sets: FloatArray
) -> list[Optimum]:
    """The optima that are reached from pilots alone.

    Parameters
    ----------
    recording, model, settings
        As for `maximise_likelihood`.
    sets
        Pilot parameters, shape (sets, parameters); band and nuisance terms suit the first.
    """
    first = first_fit(recording, model, settings, sets[:1], np.random.default_rng(0))
    prediction = first.joint.prediction.with_noticeable_terms(sets[0], first.whitener)
    choices = [RemnantChoice(prediction, pilot, settings.noise) for pilot in sets]
    return [choice.full_fit().refined() for choice in choices]


def lines_pilot(recording: Recording, model: PilotModel, rng: np.random.Generator) -> FloatArray:
    """The pilot of the forcing frequencies, shape (1, parameters); (0, parameters) if none is."""
    none = np.zeros((0, len(model.parameters)))
    if lines_objection(recording, model):
        return none
    # With 8 starts the optimum depended on the seed in 31 of 175 searches of seven pilots in yaw,
    # with 24 in 16, all of one whose weights change from round to round.
    fit = fit_lines(recording, model, rng, candidates=96, refined=24, same=0.01)
    pilot = fit.values[None]
    return pilot if np.isfinite(pilot).all() and are_pilots(recording, model, pilot)[0] else none


def is_sound(model: PilotModel, lines: FloatArray) -> bool:
    """Whether the lines' pilot can guide a search: a fit that ended at a bound may be astray."""
    return len(lines) > 0 and not is_at_bound(model, lines[0]).any()


# ------------------------------------------------------------- 1. the first pilot, and the band


def first_fit(
    recording: Recording,
    model: PilotModel,
    settings: LikelihoodSettings,
    known: FloatArray,
    rng: np.random.Generator,
) -> Optimum:
    """The best pilot with a second-order remnant, in the first band that is wide enough for it.

    It is in the last one where none is.

    Parameters
    ----------
    recording, model, settings
        As for `maximise_likelihood`.
    known
        Pilots to begin at, shape (pilots, parameters): that of the forcing functions' lines, say.
    rng
        Draws starts for pilots of a white residual where what is known is unsound.
    """
    pilots = known if is_sound(model, known) else None
    # Each band to choose from has less decimation than the one before.
    rates = {decimation(recording.dt, settings.band): settings.band}
    for wider in settings.wide if settings.band == LikelihoodSettings.band else ():
        rates.setdefault(decimation(recording.dt, wider), wider)
    for rate in rates.values():
        prediction = predict(recording, model, rate, fast=True)
        if settings.loop:
            control, dt = prediction.control, prediction.dt
            weighting = weighting_of(recording, model, control, dt, settings.weighed)
            prediction = replace(prediction, weighting=weighting)
        if pilots is None:
            few = prediction.binned_below(SEARCH_BAND)
            white = Likelihood(replace(few, weighting=None))
            ends = search(white.gram, model, rng, candidates=CANDIDATES, refined=REFINED)
            pilots = np.concatenate([optima(ends, white.residuals, far=300.0)[0], known])
        joint = Likelihood(prediction, settings.noise or FIRST_NOISE_MODEL)
        first = Optimum(joint, with_remnants(joint, pilots))
        if wide_enough(first):
            break
    return first


def with_remnants(joint: Likelihood, pilots: FloatArray, tolerance: float = 3e-3) -> Minima:
    """Each pilot with the remnant that it leaves, estimated together on binned spectra."""
    residuals = map(joint.prediction.errors, pilots)
    guesses = [joint.noise.guess(lagged_products(left), joint.band)[0] for left in residuals]
    starts = np.hstack([pilots, guesses])
    return minimise(joint.coarse.gram, starts, joint, tolerance=tolerance, iterations=12)


def wide_enough(first: Optimum) -> bool:
    """Whether the band holds what the recording tells of the pilot.

    Near its edge there is no more than a small share of what is known of any parameter.  Filter and
    decimation reach into the future a little; in a loop that answers at once (position control)
    the remnant there, which the error shows too, would otherwise bias delays and neuromuscular
    parameters.  In the likelihood of a band whose loop falls off above it nothing is biased, and
    information is lost.
    """
    prediction = first.joint.prediction
    weighting, omega = prediction.weighting, prediction.s.imag
    rows = prediction.row_spectra(first.pilot[None])[0, :-1]
    # A step has all frequencies: when it was, the band need not tell in full.
    rows = np.delete(rows * prediction.filter_response(first.whitener), prediction.model.change, 0)
    power = np.sum(np.abs(rows) ** 2, axis=1)
    if weighting is not None:  # a recorder's noise tells nothing
        power = power * weighting.weights(omega)
    power = power[power.any(axis=1)]  # nothing is known of a level that a late change never reaches
    upper = power[:, omega > 0.6 * np.pi / prediction.dt]
    biased = weighting is None or weighting.gain_is_flat_above_band
    # Tuned: of a loop that answers at once a narrower band biases delays by up to 10 % (eight
    # pilots in position control, 40 runs each).  In others information is lost: steps have .13 to
    # .31 there, multisines .00 to .07 (populations usual and inner, seed 3003).
    most = 0.01 if biased else 0.1
    return bool(np.max(np.sum(upper, axis=1) / np.sum(power, axis=1)) <= most)


# ------------------------------------------------------------------------------ 2. the sweep


def sweep(first: Optimum, rng: np.random.Generator, lines: FloatArray) -> tuple[FloatArray, Starts]:
    """Search the candidates, whitened by the remnant of the first pilot.

    Parameters
    ----------
    first
        The first pilot, with its check.
    rng
        Draws the random starts.
    lines
        The pilot of the forcing functions' lines, as of `lines_pilot`.

    Returns
    -------
    Pilots, best first, shape (candidates, parameters); how many starts ended in the best optimum.
    """
    coarse, check = first.joint.prediction.binned, first.check
    assert check is not None
    # Least squares of prediction errors, without what the loop adds in a band.
    whitened = Likelihood(replace(coarse, weighting=None), Whitener(first.whitener))
    model, samples = coarse.model, whitened.residuals
    count = 0 if is_sound(model, lines) else CANDIDATES
    starts = _starts(model, first.pilot, rng, count)
    starts, _ = solve_linear(whitened.gram(starts), starts, model.linear, model.lower)
    starts = np.concatenate([first.pilot[None], lines, starts])
    rough = minimise(whitened.gram, starts, model, tolerance=1e-3, iterations=8)
    # What is far behind by then is given up, and of starts that met one goes on for all.
    met = group_by_optimum(rough, samples)[:9]
    on = rough.values[[group[0] for group in met]]
    ends = minimise(whitened.gram, on, model, tolerance=1e-3, iterations=16, sort=False)
    sizes = np.array([len(group) for group in met])
    kept = check.which(ends)
    passed = ends.only(np.repeat(kept, sizes[kept])).best_first()
    # The whitening of the sweep favours the pilot that it is from.
    candidates, agreeing = optima(passed, samples, far=1000.0)
    if len(candidates) > 1:
        rematched = with_remnants(first.joint, candidates, 1e-4)
        rematched = rematched.only(check.which(rematched))
        # Binned spectra missed 170 in deviance once (populations).
        candidates = optima(rematched, samples, far=300.0)[0][:5, : first.joint.pilot_count]
    given_up = np.delete(rough.cost, [start for group in met for start in group])
    cost = np.sort(np.concatenate([np.repeat(ends.cost, sizes), given_up]))
    return candidates, Starts(cost / cost[0], agreeing)


def _starts(
    model: PilotModel, best: FloatArray, rng: np.random.Generator, count: int
) -> FloatArray:
    """The best pilot with one parameter moved far away, and usual pilots.

    A delay that is wrong by a period of the strongest line is the commonest wrong optimum.
    """
    (low, high), at = model.usual, np.arange(best.size)
    moved = []
    for index, parameter in enumerate(model.parameters):
        if not parameter.linear:  # gains are solved for
            between = (0.5 * (low[index] + high[index]),) if parameter.delay else ()
            values = low[index], *between, high[index]
            moved += [np.where(at == index, value, best) for value in values]
    times = model.indices_of(Lag | Lead)
    if len(times) > 1:  # a slow lag with a lead is much like a fast one with another
        moved.append(np.where(np.isin(at, times), low, best))
    moved += model.changes_elsewhere(best)
    return np.array([*moved, *draw_starts(model, rng, count), model.start])


def group_by_optimum(ends: Minima, samples: int) -> list[list[int]]:
    """Which ends are in one optimum, each with the first before it that it is near to.

    `ends` and `samples` are as in `optima`.
    """
    groups: dict[int, list[int]] = {}
    for index, values in enumerate(ends.values):
        near = (g for g in groups if ends.apart(values, samples, g) <= SAME_OPTIMUM_DISTANCE)
        groups.setdefault(next(near, index), []).append(index)
    return [*groups.values()]


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
    groups = group_by_optimum(near, samples)
    return near.values[[group[0] for group in groups]], len(groups[0]) if groups else 0


# ------------------------------------------------------- 3. and 4. pilot and remnant together


_criterion = attrgetter("criterion")


def contenders(residual: FloatArray, band: Band, known: Sequence[NoiseModel] = ()) -> list[Guess]:
    """Known models, the one that suits a residual best, and the best other kind if it is close.

    The kinds are filters of white noise and autoregressions.  Beside a band-pass stands the best
    low-pass as well: whether there is a corner is for the penalty on band-passes to decide.

    Parameters
    ----------
    residual, band
        See `pilotid.likelihood.remnant_models.guesses`.
    known
        Models that come first in any case.
    """
    scored = sorted(guesses(residual, band), key=_criterion)
    best = {type(each.model): each for each in reversed(scored)}
    if best[LowPass].criterion <= best[BandPass].criterion:
        del best[BandPass]
    limit = scored[0].criterion + LOOK_CRITERION
    first = [each for model in known for each in scored if each.model == model]
    near = [each for each in sorted(best.values(), key=_criterion) if each.criterion < limit]
    return [*{each.model: each for each in (*first, *near)}.values()]


@dataclass(eq=False)
class RemnantChoice:
    """Fits near one pilot, of each model of the remnant that came into question.

    Every model is fitted once, from the pilot at which it first did and from where all began: one
    model may lose a channel, which does not come back of itself, where another does not.

    Attributes
    ----------
    prediction
        The prepared prediction.
    pilot
        Where to begin, and where the latest fit ended, shape (parameters,).
    noise
        The remnant's model if it is not to be chosen.
    check
        Which parameters simulate the control.
    """

    prediction: Prediction
    pilot: FloatArray
    noise: NoiseModel | None
    check: PilotCheck | None = None

    def __post_init__(self) -> None:
        self._first, self._fits = self.pilot, dict[NoiseModel, Optimum]()

    def full_fit(self) -> Optimum:
        """The best of all: its model is chosen anew as the pilot moves."""
        best = self.suited_fit()
        # Of many long autoregressions the first that suits depends on where the search came from.
        while others := [] if self.noise else neighbours(best.joint.noise):
            better = self.suited_fit(others)
            if not better.criterion < best.criterion - 0.1:
                break
            best = better
        fits = self._fits.values()
        limit = best.criterion + RIVAL_CRITERION
        rivals = [fit for fit in fits if best.criterion < fit.criterion < limit]
        return replace(best, iterations=sum(fit.iterations for fit in fits), rivals=rivals)

    def suited_fit(
        self, models: Sequence[NoiseModel] | None = None, known: Sequence[Optimum] = ()
    ) -> Optimum:
        """The best of some models, each with the pilot that goes with it.

        None for those that suit what the pilot leaves, without autoregressions far behind a filter.
        It is as exact as is compared.  Models of what is known come first; after a fit that falls
        behind it, or is the same, no other is made.
        """
        given = self.prediction.errors(self.pilot), self.prediction.window.band
        models = [self.noise] if self.noise else models
        alike = [o.joint.noise for o in known]  # beside whose remnant a known optimum is told
        every = contenders(*given, alike) if models is None else guesses(*given, models)
        fits, least = list[Optimum](), min(map(_criterion, every))
        for guess in every:
            behind = guess.criterion - least if guess.model.regressive else 0.0
            if fits and fits[0].is_sound_filter and behind > LOOK_REGRESSION:
                continue
            fit = self._fitted(guess, known)
            fits.append(fit)
            lost = [o for o in known if fit.criterion > o.criterion + BEHIND_CRITERION]
            if any(fit.is_near(o.pilot) for o in known) or any(fit.rank <= o.rank for o in lost):
                break
        if not (self.noise or any(fit.is_invertible for fit in fits)):
            filters = [model for model in NOISE_MODELS if not model.regressive]
            fits += [self._fitted(guess) for guess in guesses(*given, filters)]
        best = min(fits, key=_criterion)
        self.pilot = best.pilot
        return best

    def _fitted(self, guess: Guess, known: Sequence[Optimum] = ()) -> Optimum:
        """A model's fit, made when it is first asked for; a known one that the search leads to."""
        if guess.model not in self._fits:
            joint = Likelihood(self.prediction, guess.model, adjoint=self.prediction.is_large)
            pilots = [self.pilot] if self.pilot is self._first else [self.pilot, self._first]
            starts = np.array([np.concatenate([pilot, guess.values]) for pilot in pilots])
            of = self.prediction, guess.model
            like = next((o for o in known if (o.joint.prediction, o.joint.noise) == of), None)
            end = descend(joint, starts, COMPARED_TOLERANCE, like)
            if like and not end.cost.size:
                return like
            fit = Optimum(joint, end, iterations=end.iterations, check=self.check)
            self._fits[guess.model] = fit
        return self._fits[guess.model]


def _likely(choices: list[RemnantChoice]) -> list[RemnantChoice]:
    """Choices whose criterion is low on a first look, one of each optimum, best first."""
    firsts: list[tuple[Optimum, RemnantChoice]] = []
    for choice in choices:
        firsts.append((choice.suited_fit(known=[fit for fit, _ in firsts]), choice))
    firsts.sort(key=lambda first: (-first[0].rank, first[0].criterion))
    best, likely = firsts[0][0], dict[Optimum, RemnantChoice]()
    for fit, choice in firsts:
        is_likely = fit.rank == best.rank and fit.criterion < best.criterion + LOOK_CRITERION
        if is_likely and not any(better.is_near(fit.pilot) for better in likely):
            likely[fit] = choice
    return [*likely.values()]


def _best_and_others(tried: Sequence[Optimum]) -> tuple[Optimum, list[Optimum]]:
    """The best optimum that simulates the control, and the others that are as likely."""
    highest = max(each.rank for each in tried)
    passed = [each for each in tried if each.rank == highest]
    lowest = min(each.criterion for each in passed)
    # What is far behind where fits are compared does not compete.
    far = lowest + 2.0 * COMPETING_CRITERION
    passed = [each.refined() for each in passed if not each.criterion > far]
    best, others = best_of(passed), list[Optimum]()
    for other in passed:
        apart = min(abs(other.criterion - known.criterion) for known in (best, *others))
        if other.criterion < best.criterion + COMPETING_CRITERION and apart > 0.01:
            others.append(other)
    return best, others
