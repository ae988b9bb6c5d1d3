"""Maximum likelihood's weights with instruments from the forcing functions.

The remnant and whatever a recorder adds to e and x are in the model's inputs too, through the loop
or by themselves.  The forcing functions know of neither.  What they alone make of e and x in the
closed loop, and hence of the prediction's Jacobian, are instruments: the estimate is where they are
orthogonal to the whitened prediction error (refined instrumental variables; Young & Jakeman,
*International Journal of Control* 29, 1979; Gilson & Van den Hof, *Automatica* 41, 2005).

It is consistent whatever the remnant's spectrum and wherever it enters, with noise on e and x, and
with an instrument from a wrong pilot or element, which costs precision alone.  Standard errors are
those of the moments, from the power that the prediction error has at each frequency.  It knows
nothing that the remnant excites: where the forcing functions tell little of gain and lead time,
their intervals are wide.

Assumes recorded forcing functions, a controlled element that is named or found, and a pilot who
does not change.

Use it to check `mle` without trusting its model of the remnant, also where the forcing functions
are no sums of sines.

Do not use it for gain and lead time where the remnant exceeds, at low frequency, what the forcing
functions make of the control.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from pilotid.estimate.estimate import Estimate, Outcome, failed
from pilotid.estimate.loops import stabilised_element
from pilotid.estimate.warnings import element_unknown, varying
from pilotid.likelihood.diagnostics import Moments, forcing_functions
from pilotid.likelihood.estimates import make_estimate
from pilotid.likelihood.search import LikelihoodSettings, maximise_likelihood
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.solve.intervals import errors_from, profile_intervals, with_information
from pilotid.solve.least_squares import minimise
from pilotid.support.numbers import covariance_of


@dataclass(frozen=True)
class MLEReference(LikelihoodSettings):
    """Instrumental variables from the forcing functions, with the weights of maximum likelihood.

    Attributes
    ----------
    band, wide, noise, loop, weighed
        See `pilotid.likelihood.search.LikelihoodSettings`: of the fit by ``mle`` that gives the
        remnant's spectrum and the instruments.
    """

    name: ClassVar[str] = "mle-reference"

    def objection(self, recording: Recording, model: PilotModel) -> str | None:
        """Why there are no instruments: no forcing function, no element, or a pilot who changes."""
        if why := varying(model):
            return why
        if model.extra:
            return f"instruments are e, x and ft, and model {model.name} acts on {model.extra[0]}"
        if not any(np.ptp(signal) > 0.0 for signal in forcing_functions(recording)):
            return "no forcing function is recorded (ft, fd), and instruments are made of them"
        return element_unknown(recording)

    def fit(self, recording: Recording, model: PilotModel, rng: np.random.Generator) -> Estimate:
        """Solve the moments from the optimum of the likelihood; intervals follow their deviance.

        Parameters
        ----------
        recording
            The recording; all its runs are fitted jointly.
        model
            The pilot model, whose start is one of the starts of the search.
        rng
            Draws the other starts.
        """
        optimum = maximise_likelihood(recording, model, rng, self)
        instead = optimum.lines_pilot if optimum.rank == 0 else ()
        values = next(iter(instead), optimum.pilot)[None]
        element = stabilised_element(recording, model, values[0])
        if element is None:
            why = "the loop with the controlled element is unstable: there are no instruments"
            return failed(self.name, model, Outcome.NOT_APPLICABLE, why)
        moments = Moments(optimum, recording, element, values[0])
        # The weights of the moments do not move their root, but they say how well it is known.
        values = minimise(moments.gram, values, model).values
        moments.weigh_at(values[0])
        end = with_information(minimise(moments.gram, values, model), moments.gram)
        # Nothing is left of the moments there, and what secants tell is rounding.
        end = replace(end, curvature=np.zeros_like(end.curvature))
        covariance = covariance_of(end.gram[0, :-1, :-1], optimum.variance_factor)
        if covariance is None:
            return failed(self.name, model, Outcome.SINGULAR)
        profile = profile_intervals(
            moments.gram, model, end, 1.0, len(values[0]), widened=optimum.variance_factor
        )
        estimate = make_estimate(
            self.name, recording, model, end.values[0], covariance, converged=bool(end.converged[0])
        )
        return replace(
            estimate,
            intervals=profile.intervals,
            errors=errors_from(end.values[0], profile.intervals, model),
            iterations=optimum.iterations + end.iterations,
            starts=optimum.starts,
            remnant=optimum.remnant,
            band=optimum.band_of(recording),
        )
