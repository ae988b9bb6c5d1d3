"""The optimum of the likelihood, how it was found, and what its errors follow from."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from pilotid.estimate.estimate import Starts, is_at_bound
from pilotid.estimate.quantities import AnalysedBand, RemnantEstimate
from pilotid.likelihood.likelihood import Likelihood
from pilotid.likelihood.prediction import Prediction
from pilotid.likelihood.remnant_models import BandPass, are_invertible, bounds_of, criterion
from pilotid.model.factors import Gain, Lead
from pilotid.model.loops import are_stable
from pilotid.recording.recording import Recording
from pilotid.recording.spectra import floors_of
from pilotid.solve.intervals import apart, score_dispersion, with_information
from pilotid.solve.least_squares import LogTransform, Minima, is_told, minimise
from pilotid.support.limits import ESTIMATE
from pilotid.support.numbers import CHI_SQUARED_95, chi_squared_limit, covariance_of
from pilotid.support.types import BoolArray, FloatArray, IntArray

#: Tuned: VAF of the simulated control over that of the lines' pilot.  In populations right optima
#: have .90 or more; of people in stable loops some that are usable have little more than half
#: (subject gy with `pursuit`).
MIN_VAF_RATIO = 0.5
#: The same from which an optimum is preferred to all below: where a model is wrong, of people say,
#: what explains two thirds may be likelier by 100 (yaw, subject 6: a motion delay of .10 or .37 s).
USUAL_VAF_RATIO = 0.7
#: Share of the control that the lines' pilot explains simulated, over that in its loop, below which
#: a slow remnant hides right pilots (hidden: .22 and less; people who see the target ahead: .72).
HIDDEN = 0.5
#: Statistics: squared distance of ends in standard errors below which they are one.
SAME_OPTIMUM_DISTANCE = 4.0
#: Statistics: deviance up to which a likelihood may be told by its curvature.
NEAR_DEVIANCE = 20.0
#: Numerics: relative decrease that ends fits that are compared, and searches that creep along a
#: flat valley.
COMPARED_TOLERANCE = 1e-6
#: Tuned: behind what is known by more a pilot is given up: another model of the remnant made up for
#: more in 4 of 1,563 pairs (six populations, seeds 3000 to 3119, and five other strata).
BEHIND_CRITERION = 40.0
#: Tuned: relative errors of pilots that no other start leads away from: of 596 with forcing lines
#: (13 strata) none of 385 with errors up to .2, two of 24 up to .22.
WELL_KNOWN = 0.15
#: Tuned: over the scored time, by how much likelihood ratios exceed chi-squared, as pilot and
#: remnant share what there is [s] (short, seeds from 1000).
BARTLETT_SECONDS = 5.0


class PilotCheck:
    """Which parameters can be those of a pilot: the recorded loop was stable.

    A model that predicts the control as the inverse of the controlled element does has a high
    likelihood; its loop with the element is unstable, or so near to it that its simulated response
    explains nothing of the control, or far less than that of the pilot of the forcing lines.

    Parameters
    ----------
    coarse
        The prediction with binned spectra.
    lines
        The pilot fitted to the forcing functions' lines, shape (1, parameters); (0, parameters)
        where there are none.
    """

    def __init__(self, coarse: Prediction, lines: FloatArray) -> None:
        self._coarse = coarse
        self._total = float(np.sum(coarse.samples_of(coarse.control_spectrum) ** 2))
        #: What the lines' pilot explains as it is simulated, and in its loop; 0 without one.
        self._shares = [
            float(self.explained(lines, in_loop=each)[0]) if len(lines) else 0.0
            for each in (False, True)
        ]
        #: Whether a slow remnant hides what it explains as it is simulated.
        self._hidden = self._shares[0] < HIDDEN * self._shares[1]
        self._hidden &= not is_at_bound(coarse.model, lines).any()  # such a pilot may be none

    def explained(self, sets: FloatArray, *, in_loop: bool = False) -> FloatArray:
        """Share of the control that parameters explain, shape (sets,).

        Parameters
        ----------
        sets
            Parameters of the pilot, shape (sets, parameters).
        in_loop
            Whether it is that of the response to the forcing functions in the loop, which
            suppresses a slow remnant, if the element is known; else of the simulated response to
            what was recorded.
        """
        coarse = self._coarse
        residual = coarse.residual_spectra(sets)
        if in_loop and coarse.weighting is not None:
            residual /= coarse.loop_at(coarse.s.imag).residual_spectra(sets)
        left = coarse.samples_of(residual)
        return np.asarray(1.0 - np.sum(left**2, axis=(1, 2)) / self._total)

    def ranks(self, sets: FloatArray) -> IntArray:
        """2 for what explains as much as is usual, 1 for a pilot, else 0.

        Of sets of parameters, the pilot's first, shape (sets,).  The share as in `explained` must
        reach a ratio of that of the lines' pilot, as it is simulated or, where a slow remnant hides
        it, in the loop.  There none at a bound passes: subject gy has such ones with `pursuit`.
        """
        model, weighting = self._coarse.model, self._coarse.weighting
        pilots = sets[:, : len(model.parameters)]
        stable = weighting is None or are_stable(model, pilots, weighting.element)
        inside = ~is_at_bound(model, pilots).any(axis=1)
        ranks = np.zeros(len(sets), dtype=int)
        for in_loop, lines in zip((False, True), self._shares, strict=True):
            share = self.explained(pilots, in_loop=in_loop)
            able = stable & (share > 0.0) & (inside | (not in_loop))
            usual = able & (share >= USUAL_VAF_RATIO * lines) & (self._hidden or not in_loop)
            pilot = able & (share >= MIN_VAF_RATIO * lines)
            ranks = np.maximum(ranks, np.where(usual, 2, pilot))
            if (ranks == 2).all():
                break
        return ranks

    def which(self, ends: Minima) -> IntArray:
        """Indices of the ends that explain as much as is usual, or else are pilots, or else all."""
        ranks = self.ranks(ends.values)
        return np.flatnonzero(ranks == ranks.max())


#: Statistics: by which another optimum's criterion may be higher to compete: more than the 3.84 of
#: an interval's end.
COMPETING_CRITERION = 5.0


@dataclass(frozen=True, eq=False)
class Optimum:
    """Where the likelihood of pilot and remnant is largest.

    Attributes
    ----------
    joint
        The problem: prediction and model of the remnant.
    end
        Its optimum, whose first entry counts.
    starts
        Record of the search that led there.
    iterations
        Iterations in the analysis band.
    check
        Tells whether parameters simulate the control, where that was asked.
    lines_pilot
        The pilot that the forcing functions' lines show, of shape (parameters,), if they do.
    is_refined
        Whether it is to the tolerance of what is reported.
    others
        Other optima that were about as likely.
    rivals
        Fits near it that are about as likely: other models of the remnant, jumps at samples.
    """

    joint: Likelihood
    end: Minima
    starts: Starts | None = None
    iterations: int = 0
    check: PilotCheck | None = None
    lines_pilot: Sequence[FloatArray] = ()
    is_refined: bool = False
    others: Sequence[Optimum] = ()
    rivals: Sequence[Optimum] = ()

    @property
    def competing(self) -> list[FloatArray]:
        """Pilots of other optima that are as likely, each of shape (parameters,)."""
        highest = self.criterion + COMPETING_CRITERION
        return [other.pilot for other in self.others if other.criterion < highest]

    @property
    def values(self) -> FloatArray:
        """Parameters of pilot and remnant, shape (parameters,)."""
        return np.asarray(self.end.values[0])

    @property
    def pilot(self) -> FloatArray:
        """The pilot's parameters, shape (parameters,)."""
        return self.values[: self.joint.pilot_count]

    @cached_property
    def whitener(self) -> FloatArray:
        """The filter that whitens its remnant, shape (taps,)."""
        return np.asarray(self.joint.taps(self.values[None])[0][0])

    @cached_property
    def is_invertible(self) -> bool:
        """Whether its filter predicts from the past alone, as that of a low-pass always does."""
        return not self.joint.noise.regressive or bool(are_invertible(self.whitener[None])[0])

    @property
    def is_sound_filter(self) -> bool:
        """Whether its remnant is filtered white noise, by a filter inside its bounds."""
        noise, own = self.joint.noise, self.values[self.joint.pilot_count :]
        return not (noise.regressive or np.isclose(own, bounds_of(noise)).any())

    @cached_property
    def criterion(self) -> float:
        """The criterion of pilot, remnant and nuisance terms together, by which optima compare."""
        joint, prediction = self.joint, self.joint.prediction
        amplitudes = prediction.runs * len(prediction.nuisance_poles)
        # Of as many residuals whatever the terms: else the unit of the control would count.
        scaling, samples = joint.scaling(self.values), joint.residuals + amplitudes
        power = float(self.end.cost[0]) / scaling / samples
        # Tuned: a band-pass must predict so much better, since its corner and the gain explain one
        # another (nominal, seed 1; exotic, seed 1502).
        penalty = 7.0 if isinstance(joint.noise, BandPass) else 0.0
        if joint.band_terms is not None and not self.is_invertible:
            penalty = 1e9  # what predicts from samples to come has a likelihood without bound
        penalty += joint.residuals * math.log(scaling)
        return criterion(joint.noise, power, samples, joint.pilot_count + amplitudes) + penalty

    def is_near(self, pilot: FloatArray) -> bool:
        """Whether a pilot, shape (parameters,), differs by no more than its errors."""
        return self.end.apart(pilot, self.joint.residuals) <= SAME_OPTIMUM_DISTANCE

    def tells(self, values: FloatArray, cost: FloatArray) -> BoolArray:
        """Whether its curvature tells the cost of sets of parameters: they are in its valley.

        Shapes are (sets, parameters) and (sets,).
        """
        # Where gain and lead share what is known of their product the valley is straight in logs.
        scale, end = LogTransform(self.joint.positive), self.end
        least = max(float(end.cost[0]), 1e-300)
        away = scale.enter(values) - scale.enter(end.values[0])
        squares = np.vecdot(away @ scale.inner(end.gram, end.values)[0, :-1, :-1], away)
        excess, told = self.joint.residuals / least * np.array([cost - least, squares])
        # Far away the two may agree by chance.
        return np.asarray((told < NEAR_DEVIANCE) & is_told(excess, told))

    @cached_property
    def rank(self) -> int:
        """See `PilotCheck.ranks`; 2 where that was not asked, and 0 where it can be no pilot."""
        return 2 if self.check is None else int(self.check.ranks(self.pilot[None])[0])

    @property
    def is_well_known(self) -> bool:
        """Whether it explains as much as is usual, with errors so small that no other is likelier.

        Errors of a gain and a lead do not count: along their product is a valley, but one optimum.
        A slow lag with a lead is much like a gain.
        """
        model = self.joint.prediction.model
        covariance = covariance_of(self.information, self.variance)
        if covariance is None or self.is_slow:
            return False
        leading = [at for at in model.layout if any(isinstance(f, Lead) for f, _ in at)]
        along = [i for at in leading for f, own in at if isinstance(f, Gain | Lead) for i in own]
        errors = np.sqrt(np.diag(covariance)[: self.joint.pilot_count])
        is_open = np.delete(errors > WELL_KNOWN * np.abs(self.pilot), along).any()
        return not is_open and self.rank == 2  # last, as it takes time

    @property
    def is_slow(self) -> bool:
        """Whether a lag of the pilot outlasts the pre-history."""
        return self.joint.prediction.outlasting_lag(self.pilot) > 0.0

    @property
    def freedom(self) -> int:
        """Residuals less parameters."""
        return self.joint.residuals - len(self.values)

    @property
    def variance(self) -> float:
        """Variance of the prediction error."""
        # Of a recording without a remnant rounding errors are left, of any sign.
        return max(float(self.end.cost[0]), 1e-300) / self.freedom

    @cached_property
    def tested_rows(self) -> FloatArray:
        """Whitened Jacobian and, last, prediction errors, (parameters + 1, runs, samples).

        Their products with the errors are those of the fit: in a band the Jacobian by the pilot is
        filtered by the weights, and the errors are not.
        """
        terms, pilot = self.joint.band_terms, slice(self.joint.pilot_count)
        rows = self.joint.rows(self.values[None])[0]
        if terms is not None:
            rows[pilot] = terms.filtered(rows[pilot])
        return np.asarray(rows)

    @cached_property
    def dispersion(self) -> float:
        """Variance of the scores of segments over what it would be of a constant pilot.

        It is 1 unless that is certain, and of a time-varying model; larger where the pilot wanders
        or the model lacks something (quasi-likelihood: McCullagh and Nelder, Generalized Linear
        Models, 2nd ed., sec. 4.5).
        """
        if self.joint.prediction.model.changes:
            return 1.0
        length = max(1, round(ESTIMATE.segment / self.joint.prediction.dt))
        statistic, freedom = score_dispersion(self.tested_rows, self.joint.pilot_count, length)
        certain = freedom > 0 and statistic > chi_squared_limit(freedom, ESTIMATE.dispersed)
        return statistic / freedom if certain else 1.0

    @cached_property
    def explained(self) -> float:
        """Share of the control that its simulated response explains; 0 where that was not asked."""
        return 0.0 if self.check is None else float(self.check.explained(self.pilot[None])[0])

    @property
    def variance_factor(self) -> float:
        """Factor on variances, and on the deviance that an interval goes to."""
        prediction = self.joint.prediction
        seconds = prediction.runs * prediction.window.scored * prediction.dt
        return (1.0 + BARTLETT_SECONDS / seconds) * self.dispersion

    @cached_property
    def information(self) -> FloatArray:
        """Information of pilot and remnant at unit variance, shape (parameters, parameters).

        At a bound the likelihood need not be curved: where it is singular, what lies there is taken
        for independent of all else.
        """
        information = np.asarray(self.end.gram[0, :-1, :-1])
        if covariance_of(information, 1.0) is not None:
            return information
        bounded = is_at_bound(self.joint.prediction.model, self.pilot)
        return apart(information, np.pad(bounded, (0, len(information) - bounded.size)))

    @property
    def covariance(self) -> FloatArray | None:
        """Covariance of the pilot's parameters, None if it is singular."""
        variance, pilot = self.variance * self.variance_factor, slice(self.joint.pilot_count)
        covariance = covariance_of(self.information, variance)
        if covariance is None:
            # A remnant without a shape (next to none, or white) leaves its own parameters
            # open, but not the pilot's.
            covariance = covariance_of(self.information[pilot, pilot], variance)
        return None if covariance is None else covariance[pilot, pilot]

    @property
    def remnant(self) -> RemnantEstimate:
        """What the fit says of the remnant."""
        joint, band = self.joint, self.joint.band
        innovation = self.variance / joint.scaling(self.values)
        lags = np.arange(self.whitener.size)
        response = np.exp(-1j * np.outer(band.omega * band.dt, lags)) @ self.whitener
        density = innovation * band.dt / np.pi / np.abs(response) ** 2
        control = float(np.mean(np.var(joint.prediction.control, axis=1)))
        power = float(np.mean(density) * np.pi / band.dt) / control
        shape = dict(zip(joint.noise.keys, self.values[joint.pilot_count :].tolist(), strict=True))
        return RemnantEstimate(joint.noise.name, shape, power, band.omega, density)

    def band_of(self, recording: Recording) -> AnalysedBand:
        """The frequencies that it rests on."""
        prediction = self.joint.prediction
        weighting, nyquist = prediction.weighting, math.pi / prediction.dt
        if weighting is None:
            return AnalysedBand(nyquist, "direct")
        omega, share, floor = weighting.omega, weighting.share, floors_of(recording).floor
        highest = float(omega[share > 0.0][-1])
        return AnalysedBand(highest, "band", omega, share, floor, weighting.element.name)

    @cached_property
    def search_problem(self) -> Likelihood:
        """The same problem for searches from here, see `Prediction.is_large`."""
        prediction, noise = self.joint.prediction, self.joint.noise
        invertible = noise.regressive and self.is_invertible
        return Likelihood(prediction, noise, adjoint=prediction.is_large, invertible=invertible)

    def refined(self) -> Optimum:
        """The same to the tolerance of what is reported, see `descend`."""
        if self.is_refined:
            return self
        joint, end = self.joint, descend(self.joint, self.end.only([0]))
        if joint.adjoint:  # its gradient is exact, but for errors the whole matrix must be
            joint = Likelihood(joint.prediction, joint.noise)
            end = replace(end, gram=joint.gram(end.values))
        iterations = self.iterations + end.iterations
        return replace(self, joint=joint, end=end, iterations=iterations, is_refined=True)

    def restarted_at(self, start: FloatArray) -> Optimum:
        """The optimum that a better point leads to, pilot and remnant, shape (parameters,)."""
        end = with_information(descend(self.joint, start[None]), self.joint.gram)
        return replace(self, end=end, iterations=self.iterations + end.iterations)


def best_of(optima: Sequence[Optimum]) -> Optimum:
    """The likeliest optimum; where its scores scatter, that of as likely ones that explains most.

    The model is then wrong, and by how much one optimum exceeds another is chance (leave-one-out of
    three people who saw the target ahead: median loss to `fourier` 1.9 -> 1.3 points of VAF).

    One whose lag outlasts the pre-history comes behind as likely ones without: a lead with a slow
    lag is much like a gain, and the free decay of that lag fits what the pilot did not do.
    """
    best = min(optima, key=lambda each: each.criterion)
    if len(optima) > 1 and best.dispersion > 1.0:
        highest = best.criterion + CHI_SQUARED_95 * best.dispersion
        more = [o for o in optima if o.criterion < highest and o.explained > best.explained + 0.001]
        best = max(more, key=lambda each: each.explained, default=best)
    if best.is_slow:
        highest = best.criterion + COMPETING_CRITERION
        quick = [o for o in optima if o.criterion < highest and not o.is_slow]
        best = min(quick, key=lambda each: each.criterion, default=best)
    return best


def descend(
    joint: Likelihood,
    starts: FloatArray | Minima,
    tolerance: float = 1e-10,
    known: Optimum | None = None,
) -> Minima:
    """The best optimum that starts lead to, as in `minimise`, to a tolerance.

    Along a flat valley the search creeps; where it got is then good enough if the tolerance of
    what is compared is met.  Starts that a known optimum of the same likelihood tells are left
    out, and those far behind one that explains as much as is usual.
    """
    go = partial(minimise, joint.gram, space=joint, merge=True)
    if known:
        far = BEHIND_CRITERION / joint.residuals if known.rank == 2 else math.inf
        go = partial(go, is_known=known.tells, above=known.end.cost[0] * np.exp(far))
    end = go(starts, tolerance=tolerance)
    if end.converged[:1].all():
        return end
    return go(end.only([0]), tolerance=max(tolerance, COMPARED_TOLERANCE))
