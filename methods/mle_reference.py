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
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from scipy.fft import next_fast_len

from pilotid.chance import CHI_SQUARED_95
from pilotid.estimates.applicability import varying
from pilotid.estimates.estimate import Estimate, Outcome, failed
from pilotid.pilot.element import ControlledElement
from pilotid.pilot.loops import pilot_on, unstable_poles
from pilotid.pilot.model import PilotModel
from pilotid.recordings.recording import Recording
from pilotid.solve.covariance import covariance_of
from pilotid.solve.intervals import profile_intervals
from pilotid.solve.least_squares import Problem, minimise
from pilotid.time_domain.band_likelihood import closing_element
from pilotid.time_domain.maximum_likelihood import Maximum, maximise_likelihood
from pilotid.time_domain.output_error import concluded
from pilotid.time_domain.prediction import Prediction, predict
from pilotid.time_domain.search import LikelihoodSettings
from pilotid.types import FloatArray

#: Seconds of zeros behind a recording, in which the loop comes to rest.
REST = 30.0
#: Bins over which the power of the prediction error is averaged.
SMOOTHED = 61


@dataclass(frozen=True)
class MLEReference(LikelihoodSettings):
    """Instrumental variables from the forcing functions, with the weights of maximum likelihood.

    Attributes
    ----------
    search_band, candidates, refined, band, wide, rounds, noise, loop, weighed
        See `pilotid.time_domain.search.LikelihoodSettings`: of the fit by ``mle`` that gives the
        remnant's spectrum and the instruments.
    """

    name: ClassVar[str] = "mle-reference"

    def objection(self, recording: Recording, model: PilotModel) -> str | None:
        """Why there are no instruments: no forcing function, no element, or a pilot who changes."""
        if why := varying(model):
            return why
        if not any(np.ptp(signal) > 0.0 for signal in _forcing(recording)):
            return "no forcing function is recorded (ft, fd), and instruments are made of them"
        if closing_element(recording)[0] is None:
            return "the controlled element is not known: name it, for example --element 4/s^2"
        return None

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
        found = maximise_likelihood(recording, model, rng, self)
        element, _ = closing_element(recording)
        assert element is not None
        values = found.pilot[None]
        if not found.follows and found.known is not None:
            values = found.known
        if unstable_poles(model, values[0], element):
            why = f"the loop of the pilot and {element.name} is unstable: there are no instruments"
            return failed(self.name, model, Outcome.NOT_APPLICABLE, why)
        moments = Moments(found, references(recording, model, values[0], element), values[0])
        # The weights of the moments do not move their root, but they say how well it is known.
        moments = moments.at(minimise(moments.gram, values, model).values[0])
        end = minimise(moments.gram, moments.values[None], model)
        covariance = covariance_of(end.gram[0, :-1, :-1], found.widened)
        if covariance is None:
            return failed(self.name, model, Outcome.SINGULAR)
        profile = profile_intervals(
            moments.gram, model, end, 1.0, len(values[0]), widened=found.widened
        )
        estimate = concluded(
            self.name, recording, model, end.values[0], covariance, converged=bool(end.converged[0])
        )
        length = np.diff(profile.intervals, axis=1)[:, 0]
        return replace(
            estimate,
            intervals=profile.intervals,
            errors=length / (2.0 * CHI_SQUARED_95**0.5),
            iterations=found.iterations + end.iterations,
            starts=found.starts,
            remnant=found.remnant,
            band=found.band_of(recording),
        )


def references(
    recording: Recording, model: PilotModel, values: FloatArray, element: ControlledElement
) -> Recording:
    """A recording with the e and x that its forcing functions alone make in the loop."""
    target, disturbance = _forcing(recording)
    samples = target.shape[1]
    length = next_fast_len(samples + round(REST / recording.dt), real=True)
    omega = np.asarray(2.0 * np.pi * np.fft.rfftfreq(length, recording.dt), dtype=float)
    omega[0] = 1e-3 * omega[1]  # an integrator has no response at rest
    on_error, on_output = pilot_on(model, omega, values)
    plant = element.response(omega)
    closed = 1.0 + plant * (on_error + on_output)
    driven = on_error * np.fft.rfft(target, length) + np.fft.rfft(disturbance, length)
    output = np.fft.irfft(plant / closed * driven, length)[:, :samples]
    return replace(recording, e=target - output, x=output, ft=target)


def _forcing(recording: Recording) -> tuple[FloatArray, FloatArray]:
    """Target and disturbance, shape (runs, samples); zeros for one that there is not."""
    none = np.zeros_like(recording.e)
    target = recording.input("target")
    if recording.ft is None and np.std(target) <= 1e-6 * np.std(recording.e):
        target = none
    return target, none if recording.fd is None else recording.fd


class Moments(Problem):
    """Products of instruments and prediction errors, standardised: their root is the estimate.

    Parameters
    ----------
    found
        The optimum of the likelihood: band, weights and whitening filter.
    reference
        The recording whose Jacobian the instruments are.
    values
        Parameters at which the prediction errors tell their power, shape (parameters,).
    """

    def __init__(self, found: Maximum, reference: Recording, values: FloatArray) -> None:
        prediction: Prediction = found.joint.prediction
        self.found, self.reference, self.values = found, reference, values
        self._prediction = prediction
        self._taps = found.joint.whitener(found.end.values[0])
        rate = None if found.joint.band.factor == 1 else np.pi / prediction.dt
        other = predict(reference, prediction.model, rate)
        instruments = prediction.without_nuisance(other.rows(found.pilot[None], self._taps)[0, :-1])
        errors = prediction.without_nuisance(prediction.rows(values[None], self._taps)[0, -1:])
        self._instruments = self._weighed(instruments)
        power = self._weighed(errors).reshape(-1, 2)
        power = np.mean(power**2, axis=1)
        half = SMOOTHED // 2
        smooth = np.convolve(
            np.pad(power, half, mode="reflect"), np.ones(SMOOTHED) / SMOOTHED, "valid"
        )
        scatter = (self._instruments * np.repeat(smooth, 2)) @ self._instruments.T
        self._whitener = np.linalg.inv(np.linalg.cholesky(scatter))

    def at(self, values: FloatArray) -> Moments:
        """The same, with the power that prediction errors have at other parameters."""
        return Moments(self.found, self.reference, values)

    def _weighed(self, rows: FloatArray) -> FloatArray:
        """Rows (n, runs, samples) as real numbers whose products are weighted, shape (n, m)."""
        weighed = self._prediction.weighed(rows)
        return weighed.reshape(len(rows), -1)

    @property
    def residuals(self) -> int:
        """Number of moments."""
        return len(self._instruments)

    def rows(self, values: FloatArray) -> FloatArray:
        """Jacobian and below it the moments, shape (sets, parameters + 1, parameters)."""
        rows = self._prediction.rows(values, self._taps)
        weighed = self._weighed(rows.reshape(-1, *rows.shape[2:]))
        products = weighed.reshape(*rows.shape[:2], -1) @ self._instruments.T
        return np.asarray(products @ self._whitener.T)
