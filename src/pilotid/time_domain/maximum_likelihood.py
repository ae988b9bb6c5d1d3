"""The maximum of the likelihood of pilot and remnant together.

Candidates for the pilot come from a search at few frequencies; the remnant's model is then
chosen, and estimated along with the pilot, in the analysis band.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from pilotid.chance import chi_squared_limit
from pilotid.estimates.applicability import lines_objection
from pilotid.estimates.estimate import Starts, is_at_bound
from pilotid.estimates.parts import AnalysedBand, RemnantEstimate
from pilotid.limits import ESTIMATE
from pilotid.lines.fit import fit_lines
from pilotid.pilot.model import PilotModel
from pilotid.recordings.recording import Recording
from pilotid.recordings.spectra import floors_of
from pilotid.solve.covariance import covariance_of, score_dispersion
from pilotid.solve.least_squares import minimise
from pilotid.solve.smoothing import criterion_and_degrees, fit_smooth
from pilotid.time_domain.output_error import OutputErrors
from pilotid.time_domain.prediction import Prediction, predict, weighted
from pilotid.time_domain.prediction_errors import PredictionErrors, for_search
from pilotid.time_domain.prepare import Band, analysis_band, decimation
from pilotid.time_domain.remnant_models import guess_parameters, remnant_estimate
from pilotid.time_domain.search import (
    FIRST_NOISE_MODEL,
    REPORTED_TOLERANCE,
    Following,
    JointFit,
    JointFits,
    LikelihoodSettings,
    explore,
    grouped,
    optimum,
    terms_at,
)
from pilotid.types import FloatArray

#: A band is wide enough if its upper part, from this share on, holds no more than this share of
#: what the recording tells of any parameter.  Filter and decimation reach into the future a
#: little; in a loop that answers at once (position control) the remnant there, which the error
#: shows too, would otherwise bias delays and neuromuscular parameters by up to 10 %.
EDGE_BEGINS, LARGEST_EDGE_SHARE = 0.6, 0.01
#: The same share in the likelihood of a band whose loop falls off above it: nothing is biased then,
#: and this much information may be lost.  A step, which has all frequencies, has .13 to .31 there;
#: multisines have .00 to .07 (populations usual and inner, tuning seed 3003).
LARGEST_LOST_SHARE = 0.1

#: Candidates whose criterion, on a first look, is higher than the lowest by more are left out.
FIRST_LOOK_MARGIN = 20.0

#: Optima of the whole search whose criterion is higher by no more are as likely as the best one.
#: Two whose criteria differ by less than `SAME_CRITERION` are one.
COMPETING_MARGIN, SAME_CRITERION = 5.0, 0.01

#: Likelihood ratios are larger than chi-squared says in short recordings, since pilot and remnant
#: share what little there is: by this many seconds over the scored time (Bartlett's correction,
#: with the constant measured on populations of pilots; docs/remnant.md).
BARTLETT_SECONDS = 5.0

#: What is told of a search from one start.
ONE_START = Starts(cost=np.ones(1), agreeing=1)


@dataclass(frozen=True, eq=False)
class Maximum(JointFit):
    """Where the likelihood of pilot and remnant is largest.

    Attributes
    ----------
    joint
        The problem solved last: prediction, model of the remnant, analysis band.
    end
        Its optimum, whose first entry counts.
    starts
        Record of the search that led there.
    iterations
        Iterations in the analysis band.
    following
        Tells whether parameters follow the control, where that was asked.
    known
        The pilot that the forcing functions' lines show, shape (1, parameters), if they do.
    competing
        Pilots of other optima that are as likely, each of shape (parameters,).
    """

    starts: Starts = ONE_START
    iterations: int = 0
    following: Following | None = None
    known: FloatArray | None = None
    competing: Sequence[FloatArray] = ()

    @property
    def follows(self) -> bool:
        """Whether the control is followed as a pilot does, see `pilotid.time_domain.search`."""
        return self.following is None or bool(self.following(self.pilot[None])[0])

    @property
    def variance(self) -> float:
        """Variance of the prediction error."""
        freedom = self.joint.residuals - int(self.end.values.shape[1])
        # Of a recording without a remnant rounding errors are left, of any sign.
        return max(float(self.end.cost[0]), 1e-300) / freedom

    @cached_property
    def tested_rows(self) -> FloatArray:
        """Whitened Jacobian and, last, prediction errors, (parameters + 1, runs, samples)."""
        return self.joint.tested_rows(self.end.values[0])

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
        statistic, freedom = score_dispersion(self.tested_rows, self.joint.pilot, length)
        certain = freedom > 0 and statistic > chi_squared_limit(freedom, ESTIMATE.dispersed)
        return statistic / freedom if certain else 1.0

    @property
    def widened(self) -> float:
        """Factor on variances, and on the deviance that an interval goes to."""
        prediction = self.joint.prediction
        seconds = prediction.runs * prediction.scored * prediction.dt
        return (1.0 + BARTLETT_SECONDS / seconds) * self.dispersion

    @cached_property
    def by_element(self) -> FloatArray:
        """Factor on the variances of the pilot for what is not known of the element's gain."""
        joint, prediction = self.joint, self.joint.prediction
        weighting, terms = prediction.weighting, prediction.band_terms
        if weighting is None or terms is None or weighting.unknown == 0.0:
            return np.ones(joint.pilot)
        loop = prediction.loop.row_spectra(self.pilot[None])[:, :, 0]
        change = np.zeros(len(joint.lower))
        change[: joint.pilot] = terms.by_gain(loop)[0] * float(self.end.cost[0]) / joint.residuals
        inverse = covariance_of(self.end.gram[0, :-1, :-1], 1.0)
        if inverse is None:
            return np.ones(joint.pilot)
        moved = weighting.unknown * (inverse @ change)[: joint.pilot]
        variances = self.variance * np.diag(inverse)[: joint.pilot]
        return np.asarray(1.0 + moved**2 / variances)

    @property
    def criterion(self) -> float:
        """The criterion that chose the remnant's model, of pilot and remnant together."""
        if self.joint.penalty is not None:
            return criterion_and_degrees(self.joint, self.joint, self.end)[0]
        return super().criterion

    @property
    def curves(self) -> str:
        """How free the curves of a pilot are who varies freely, in words; empty for others."""
        if self.joint.penalty is None:
            return ""
        degrees = criterion_and_degrees(self.joint, self.joint, self.end)[1]
        named = zip(self.joint.penalty.curves, degrees, strict=True)
        told = " and ".join(f"{curve.key} {degree:.1f}" for curve, degree in named)
        return f"degrees of freedom of {told}"

    @property
    def remnant(self) -> RemnantEstimate:
        """The remnant at the optimum."""
        joint = self.joint
        return remnant_estimate(
            joint.noise,
            self.end.values[0, joint.pilot :],
            joint.band,
            self.variance / joint.scaling(self.end.values[0]),
            float(np.mean(np.var(joint.prediction.control, axis=1))),
        )

    def band_of(self, recording: Recording) -> AnalysedBand:
        """The frequencies that it rests on."""
        prediction = self.joint.prediction
        weighting, nyquist = prediction.weighting, math.pi / prediction.dt
        if weighting is None:
            return AnalysedBand(nyquist, "direct")
        counting = weighting.omega[weighting.share > 0.0]
        return AnalysedBand(
            float(counting[-1]),
            "band",
            weighting.omega,
            weighting.share,
            floors_of(recording).floor,
            weighting.element.name,
        )

    @cached_property
    def search(self) -> PredictionErrors:
        """The same problem for searches from here, see `pilotid.time_domain.prediction_errors`."""
        return for_search(self.joint)

    @property
    def enough(self) -> float:
        """Largest share at the edge with which the band is wide enough."""
        weighting = self.joint.prediction.weighting
        return (
            LARGEST_EDGE_SHARE
            if weighting is None or weighting.answers_at_once
            else LARGEST_LOST_SHARE
        )

    @cached_property
    def at_edge(self) -> float:
        """Largest share of what is known of a parameter that lies near the band's edge.

        Of two optima that are as likely, which one a search found must not decide on the band.
        One at a bound is no pilot, and whether a search comes upon it is chance.
        """
        model = self.joint.prediction.model
        inside = [pilot for pilot in self.competing if not is_at_bound(model, pilot).any()]
        return max(map(self.edge_of, [self.pilot, *inside]))

    def edge_of(self, pilot: FloatArray) -> float:
        """The same of a pilot, shape (parameters,), with the remnant of the optimum."""
        joint = self.joint
        prediction = joint.prediction
        rows = prediction.row_spectra(pilot[None], joint.whitener(self.end.values[0]))[0, :-1]
        # A step has all frequencies: when it was, the band need not tell in full.
        when = [i for indices in prediction.model.whens for i in indices]
        rows = np.delete(rows, when, axis=0)
        power = np.sum(np.abs(rows) ** 2, axis=1)
        if prediction.weighting is not None:  # a recorder's noise tells nothing
            power = power * prediction.weighting.weights(prediction.s.imag)
        upper = prediction.s.imag > EDGE_BEGINS * np.pi / prediction.dt
        return float(np.max(np.sum(power[:, upper], axis=1) / np.sum(power, axis=1)))

    def refined(self, tolerance: float = REPORTED_TOLERANCE) -> Self:
        """The same optimum to the tolerance of what is reported."""
        found = super().refined(tolerance)
        return replace(found, iterations=self.iterations + found.end.iterations)

    def moved(self, start: FloatArray) -> Maximum:
        """The optimum that a better point leads to, pilot and remnant, shape (parameters,)."""
        end = optimum(self.joint, start[None])
        return replace(self, end=end, iterations=self.iterations + end.iterations)


@dataclass(frozen=True, eq=False)
class _Fit:
    """What is fitted, and how: a recording, a model, and the settings of the likelihood."""

    recording: Recording
    model: PilotModel
    settings: LikelihoodSettings

    def predicted(self, rate: float | None) -> Prediction:
        """The prediction in a band, weighted for its likelihood where that is to be had."""
        prediction = predict(self.recording, self.model, rate)
        if not self.settings.loop:
            return prediction
        return weighted(prediction, self.recording, self.settings.weighed)

    def narrowed(self, pilot: FloatArray, rate: float | None) -> tuple[Prediction, Band]:
        """The prediction in a band, with the nuisance terms that suit a pilot."""
        prediction, band = self.predicted(rate), analysis_band(self.recording.dt, rate)
        return replace(prediction, terms=terms_at(prediction, band, pilot, self.settings)), band

    def is_wider(self, rate: float, found: Maximum) -> bool:
        """Whether a band is wider than that of an optimum."""
        band = self.settings.band
        if band is None or rate <= band:
            return False
        return decimation(self.recording.dt, rate) < found.joint.band.factor

    def maximum(
        self,
        prediction: Prediction,
        band: Band,
        pilot: FloatArray,
        following: Following | None = None,
    ) -> Maximum:
        """Pilot and remnant together from one pilot, the remnant's model chosen as they move."""
        if prediction.model.curves and prediction.penalty is None:
            return self.smooth_maximum(prediction, band, pilot)
        fits = JointFits(prediction, band, pilot, self.settings.noise)
        return self.best_of(fits, following).refined()

    def best_of(self, fits: JointFits, following: Following | None) -> Maximum:
        """The best of all models of the remnant near one pilot."""
        best = fits.best(self.settings.rounds)
        return Maximum(best.joint, best.end, iterations=fits.iterations, following=following)

    def smooth_maximum(self, prediction: Prediction, band: Band, pilot: FloatArray) -> Maximum:
        """As `maximum`, for a pilot who varies freely: how smoothly is found on the way."""
        curves, residual = prediction.model.curves, OutputErrors(prediction).residual(pilot)
        # What the first pilot leaves is not the remnant alone: a long autoregression would keep it.
        noise = self.settings.noise or FIRST_NOISE_MODEL
        joint = PredictionErrors(prediction, noise, band)
        values = np.concatenate([pilot, guess_parameters(noise, residual, band)])
        joint, end = fit_smooth(joint, joint, curves, values, REPORTED_TOLERANCE)
        iterations = end.iterations
        for _ in range(self.settings.rounds):
            other = self.maximum(joint.prediction, band, end.values[0, : joint.pilot])
            if other.joint.noise == joint.noise:
                break
            joint, end = fit_smooth(
                other.joint, other.joint, curves, other.end.values[0], REPORTED_TOLERANCE
            )
            iterations += other.iterations + end.iterations
        return Maximum(joint, end, iterations=iterations)

    def beside_lines(self, found: Maximum) -> Maximum:
        """An optimum compared with the one near the pilot of the forcing frequencies.

        Only if that one asks for a wider band: the search may have passed it by, with one seed
        and not with another.
        """
        enough = found.enough
        if found.known is None or found.at_edge > enough or found.edge_of(found.known[0]) <= enough:
            return found
        joint = found.joint
        other = self.maximum(joint.prediction, joint.band, found.known[0], found.following)
        if not other.follows:
            return found
        best = min(found, other, key=lambda maximum: maximum.criterion)
        competing = [*found.competing, *_competing([found, other], best.criterion)]
        return replace(best, starts=found.starts, known=found.known, competing=competing)

    def searched(
        self,
        rng: np.random.Generator,
        rate: float | None,
        known: FloatArray | None,
        beside: Sequence[FloatArray] = (),
    ) -> Maximum:
        """The optimum in one band.

        `known` is the pilot of the forcing frequencies, `beside` are those of another band.
        """
        prediction = self.predicted(rate)
        if self.model.curves:
            plain = replace(self, model=self.model.constant)
            first = plain.searched(rng, rate, lines_pilot(self.recording, plain.model, rng))
            free = replace(prediction, terms=first.joint.prediction.terms)
            found = self.maximum(free, first.joint.band, free.model.of_constant(first.pilot))
            return replace(_elsewhere(found), starts=first.starts)
        band = analysis_band(self.recording.dt, rate)
        explored = explore(prediction, band, rng, self.settings, known, beside)
        narrowed, following = replace(prediction, terms=explored.terms), explored.following
        # The lines' pilot rests on no model of the remnant.
        pilots = [*explored.candidates, *([] if known is None else known)]
        candidates = [
            JointFits(narrowed, band, pilot, self.settings.noise, explored.coarse)
            for pilot in pilots
        ]
        if len(candidates) > 1:
            candidates = _likely(candidates, following)
        tried = [self.best_of(fits, following) for fits in candidates]
        followed = [maximum for maximum in tried if maximum.follows] or tried
        lowest = min(maximum.criterion for maximum in followed)
        # What was far behind to `ENOUGH` is no rival.
        far = lowest + 2.0 * COMPETING_MARGIN
        followed = [each.refined() for each in followed if not each.criterion > far]
        best = min(followed, key=lambda maximum: maximum.criterion)
        competing = _competing(followed, best.criterion)
        # The terms were chosen beside a first estimate; at the optimum the choice may be another.
        whitened = OutputErrors(prediction, best.joint.whitener(best.end.values[0]))
        terms = whitened.noticeable_terms(best.pilot)
        if terms != explored.terms:
            best = self.maximum(replace(prediction, terms=terms), band, best.pilot, following)
        return replace(_elsewhere(best), starts=explored.starts, known=known, competing=competing)


def lines_pilot(
    recording: Recording, model: PilotModel, rng: np.random.Generator
) -> FloatArray | None:
    """The pilot that the forcing frequencies show, shape (1, parameters), if they do."""
    if lines_objection(recording, model):
        return None
    fit = fit_lines(recording, model, rng, candidates=96, refined=8, same=0.01)
    return fit.values[None] if np.isfinite(fit.values).all() else None


def maximise_likelihood(
    recording: Recording,
    model: PilotModel,
    rng: np.random.Generator,
    settings: LikelihoodSettings,
) -> Maximum:
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
    fit = _Fit(recording, model, settings)
    found = fit.searched(rng, settings.band, lines_pilot(recording, model, rng))
    return in_wide_band(found, recording, model, rng, settings)


def in_wide_band(
    found: Maximum,
    recording: Recording,
    model: PilotModel,
    rng: np.random.Generator,
    settings: LikelihoodSettings,
) -> Maximum:
    """The optimum in the wide band, where the recording tells of the pilot near this one's edge.

    Parameters
    ----------
    found
        The optimum in the usual band.
    recording, model, rng, settings
        As for `maximise_likelihood`.
    """
    fit = _Fit(recording, model, settings)
    for rate in settings.wide:
        if not fit.is_wider(rate, found):
            continue
        found = fit.beside_lines(found)
        if found.at_edge <= found.enough:
            continue
        beside = [found.pilot, *found.competing] if found.follows else []
        wider = fit.searched(rng, rate, found.known, beside)
        # The wider the band, the better the forcing functions are predicted, see `Following`.
        if found.follows and not wider.follows:
            break
        found = wider
    return found


def criteria_from(
    recording: Recording, model: PilotModel, settings: LikelihoodSettings, sets: FloatArray
) -> FloatArray:
    """Criteria of the optima that are reached from pilots alone, shape (sets,).

    Parameters
    ----------
    recording, model, settings
        As for `maximise_likelihood`.
    sets
        Pilot parameters, shape (sets, parameters); nuisance terms are those that suit the first,
        and the band is wide enough for all.
    """
    fit = _Fit(recording, model, settings)

    def reached(rate: float | None) -> list[Maximum]:
        narrowed, band = fit.narrowed(sets[0], rate)
        return [fit.maximum(narrowed, band, values) for values in sets]

    found = reached(settings.band)
    for rate in settings.wide:
        wider = fit.is_wider(rate, found[0])
        if wider and any(maximum.at_edge > maximum.enough for maximum in found):
            found = reached(rate)
    return np.array([maximum.criterion for maximum in found])


def maximum_from(
    recording: Recording, model: PilotModel, settings: LikelihoodSettings, pilot: FloatArray
) -> Maximum:
    """The optimum that is reached from one pilot alone, in the analysis band of the settings.

    Parameters
    ----------
    recording, model, settings
        As for `maximise_likelihood`.
    pilot
        Pilot parameters, shape (parameters,).
    """
    fit = _Fit(recording, model, settings)
    return fit.maximum(*fit.narrowed(pilot, settings.band), pilot)


def _likely(candidates: list[JointFits], following: Following) -> list[JointFits]:
    """Candidates whose criterion is low on a first look, one of each optimum, best first."""
    firsts = [fits.look() for fits in candidates]
    reached = np.array([first.criterion for first in firsts])
    kept = following(np.array([first.pilot for first in firsts]))
    if kept.any():
        reached[~kept] = np.inf
    near = np.flatnonzero(reached < np.min(reached) + FIRST_LOOK_MARGIN)
    ranked = near[np.argsort(reached[near], kind="stable")].tolist()
    met = grouped(ranked, lambda first, index: firsts[first].is_near(firsts[index].pilot))
    return [candidates[group[0]] for group in met]


def _competing(tried: Sequence[Maximum], lowest: float) -> list[FloatArray]:
    """Pilots of optima that are nearly as good as the best one, each once."""
    reached, competing = [lowest], []
    for other in tried:
        criterion = other.criterion
        if (
            criterion < lowest + COMPETING_MARGIN
            and min(abs(criterion - known) for known in reached) > SAME_CRITERION
        ):
            reached.append(criterion)
            competing.append(other.pilot)
    return competing


def _elsewhere(found: Maximum) -> Maximum:
    """The optimum, or a better one where a change in time lies elsewhere."""
    values, pilot = found.end.values[0], found.joint.pilot
    others = found.joint.prediction.model.elsewhere(values[:pilot])
    if not others:
        return found
    starts = np.array([np.concatenate([other, values[pilot:]]) for other in others])
    ends = minimise(found.joint.gram, starts, found.joint, tolerance=1e-4, iterations=20)
    return found.moved(ends.values[0]) if ends.cost[0] < found.end.cost[0] else found
