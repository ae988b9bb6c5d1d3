"""Time-domain maximum likelihood with the remnant's own spectrum.

The prediction error is whitened by a model of the remnant that is estimated together
with the pilot: a low-pass of order 0 to 3, a band-pass or an autoregression of order 2 to 20,
whichever predicts best by Akaike's criterion.  That is the direct prediction-error method
(Ljung, System Identification, 2nd ed., sec. 13.4), consistent in the closed loop for any
remnant whose spectrum the model can take, and efficient.

Assumes that the pilot is linear and time-invariant over the recording, and that its
delays are longer than the sampling interval of the analysis band.  Gain and lead time
are skewed for short recordings; the profile-likelihood intervals say so, and are widened
for what pilot and remnant, estimated from the same few seconds, take from one another.
What is left is tested; remarks say what the pilot did that no such model does.

Use it for results: it is the default.

Do not use it when the pilot changes during the recording, unless with a model that says how
(`adapting`, `adapting-free`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from pilotid.chance import CHI_SQUARED_95
from pilotid.estimates.estimate import Estimate, Outcome, failed, is_at_bound
from pilotid.limits import ESTIMATE
from pilotid.lines.fit import specification_of
from pilotid.pilot.model import PilotModel
from pilotid.recordings.plant import element_changes
from pilotid.recordings.recording import Recording
from pilotid.remarks import Remark
from pilotid.solve.covariance import covariance_at_bounds, covariance_of
from pilotid.solve.intervals import Profile, profile_intervals
from pilotid.time_domain.competing_optima import (
    competing_optima,
    deviances,
    off_bounds,
    over_changes,
)
from pilotid.time_domain.instruments import specification_by_instruments
from pilotid.time_domain.maximum_likelihood import (
    Maximum,
    criteria_from,
    in_wide_band,
    maximise_likelihood,
)
from pilotid.time_domain.output_error import make_estimate
from pilotid.time_domain.residual_tests import residual_remarks
from pilotid.time_domain.search import LikelihoodSettings
from pilotid.types import FloatArray

#: Said where direct prediction errors take the place of the likelihood of a band.
NOT_CLOSED = Remark(
    "element-unknown",
    "the controlled element is not known, so that noise of the recorder on e and x counts as "
    "signal and delays may be biased: name the element, for example --element 4/s^2",
)
#: Said there of an element that changes during the recording.
VARYING = Remark(
    "element-unknown",
    "the controlled element changes during the recording: noise of the recorder on e and x "
    "counts as signal, and delays may be biased; fit the parts with --span",
)
#: Said where nothing stands above the recorder's floor.
HIDDEN = Remark(
    "hidden-signal",
    "what the pilot acts on (e, x) hardly stands above the noise of the recorder at any frequency: "
    "the values mean little; record these signals with less noise or more bits",
)
#: How often a profile that comes upon a better optimum moves the estimate there.
MOVES = 3


@dataclass(frozen=True)
class MLE(LikelihoodSettings):
    """Remnant-aware maximum likelihood.

    Attributes
    ----------
    search_band, candidates, refined, band, wide, rounds, noise, loop, weighed
        See `pilotid.time_domain.search.LikelihoodSettings`.
    """

    name: ClassVar[str] = "mle"

    def objection(self, recording: Recording, model: PilotModel) -> str | None:
        """None: any recording and any model will do."""
        return None

    def fit(self, recording: Recording, model: PilotModel, rng: np.random.Generator) -> Estimate:
        """Estimate pilot and remnant together; intervals follow the profile likelihood.

        Parameters
        ----------
        recording
            The recording; all its runs are fitted jointly.
        model
            The pilot model, whose start is one of the starts of the search.
        rng
            Draws the other starts.
        """
        found = maximise_likelihood(recording, model, rng, self)
        profile = profile_of(found)
        for _ in range(MOVES):
            if profile is None or profile.better is None:
                break
            moved = found.moved(profile.better)
            if found.follows and not moved.follows:
                break
            found = in_wide_band(moved, recording, model, rng, self)
            profile = profile_of(found)
        joint, end = found.joint, found.end
        values, gram = end.values[0], end.gram[0]
        pilot = slice(joint.pilot)
        variance = found.variance * found.widened
        covariance = covariance_of(gram[:-1, :-1], variance)
        if covariance is None:
            # A remnant without a shape (next to none, or white) leaves its own parameters
            # open, but not the pilot's.
            covariance = covariance_of(gram[pilot, pilot], variance)
        if covariance is None:
            return failed(self.name, model, Outcome.SINGULAR)
        estimate = make_estimate(
            self.name,
            recording,
            model,
            values[pilot],
            covariance[pilot, pilot],
            converged=bool(end.converged[0]),
        )
        if profile is not None:
            sought = deviances(found)
            intervals = over_changes(found, profile.intervals, sought)
            # The length of an interval tells the scatter of skewed estimates; the likelihood's
            # curvature at its maximum, from which the covariance is, only the middle of it.
            length = np.diff(profile.intervals, axis=1)[:, 0]
            widened = found.widened * found.by_element
            errors = length / (2.0 * np.sqrt(sought / widened))
            known = errors if (errors > 0.0).all() else None
            estimate = replace(estimate, intervals=intervals, errors=known)
            at_bound = is_at_bound(model, estimate.values)
            if at_bound.any():
                information = np.asarray(np.linalg.inv(covariance[pilot, pilot]))
                inside = covariance_at_bounds(information, at_bound, profile.intervals)
                estimate = estimate if inside is None else replace(estimate, covariance=inside)
        tested = None
        enough = recording.runs * recording.duration >= ESTIMATE.tested_from
        if enough and not is_at_bound(model, estimate.values).any():  # no score is zero there
            values, covariance = estimate.values, estimate.covariance
            tested = specification_of(
                recording, model, values, covariance, found.remnant
            ) or specification_by_instruments(found, recording, values, covariance, "mle-reference")
        return replace(
            estimate,
            specification=tested,
            iterations=found.iterations,
            starts=found.starts,
            remnant=found.remnant,
            criterion=found.criterion,
            band=found.band_of(recording),
            message="; ".join(part for part in (estimate.message, found.curves) if part),
            remarks=(
                *(tested.remarks if tested else ()),
                *self._not_closed(found, recording),
                *_not_followed(found),
                *residual_remarks(found, recording),
            ),
        )

    def _not_closed(self, found: Maximum, recording: Recording) -> list[Remark]:
        """What to say where the recording does not allow for the likelihood of a band."""
        prediction = found.joint.prediction
        if prediction.weighting is not None:
            return [HIDDEN] if prediction.weighting.hidden else []
        if not self.loop or prediction.model.changes:
            return []
        return [VARYING if element_changes(recording) else NOT_CLOSED]

    def criteria_from(
        self, recording: Recording, model: PilotModel, sets: FloatArray
    ) -> FloatArray:
        """Criteria of the optima reached from pilots alone, see `Searching`."""
        return criteria_from(recording, model, self, sets)


def _not_followed(found: Maximum) -> list[Remark]:
    """What to say where the likelihood has no optimum that follows the control as a pilot does."""
    if found.follows or found.following is None:
        return []
    own = 100.0 * max(0.0, float(found.following.explained(found.pilot[None])[0]))
    lines = 100.0 * found.following.lines
    return [
        Remark(
            "inverse-plant",
            "the best fit is the inverse of the controlled element, not a pilot: it explains "
            f"{own:.0f} % of the control, a pilot fitted at the forcing frequencies {lines:.0f} %; "
            "choose a simpler model or the method fourier",
        )
    ]


def profile_of(found: Maximum) -> Profile | None:
    """Profile-likelihood intervals; None where the remnant has no shape.

    Parameters
    ----------
    found
        The optimum; its competing optima are held by the intervals as far as they suit.
    """
    joint, end = found.joint, found.end
    if covariance_of(end.gram[0, :-1, :-1], found.variance) is None:
        return None
    freedom = joint.residuals - int(end.values.shape[1])
    return profile_intervals(
        found.search.gram,
        joint,
        end,
        found.variance,
        joint.pilot,
        estimated=freedom,
        widened=deviances(found) / CHI_SQUARED_95,
        others=np.concatenate([competing_optima(found), off_bounds(found)]),
    )
