"""Posterior predictive band of the control."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pilotid.estimate.loops import COUNT, Loop, sampled_loops
from pilotid.estimate.quantities import TAILS, Draws, Quantity, combined, sampled
from pilotid.likelihood.prediction import predict
from pilotid.model.element import ControlledElement
from pilotid.model.model import PilotModel
from pilotid.posterior.likelihood import Marginal
from pilotid.recording.recording import Recording
from pilotid.support.types import FloatArray

SIMULATED = 400  # recordings
SETTLE = 400  # samples in which the simulated remnant forgets where it started


@dataclass(frozen=True, eq=False)
class PredictiveBand:
    """95 % bands of the control of every run, in the analysis band.

    Attributes
    ----------
    time
        From the first scored sample [s], shape (samples,).
    control
        What was recorded, shape (runs, samples).
    model
        Band of the model's answer to the recorded inputs, which is as wide as the parameters
        are unknown, shape (2, runs, samples).
    with_remnant
        The same with a remnant of the spectrum and power that each draw has, in which 95 %
        of the recorded samples should lie, shape (2, runs, samples).
    """

    time: FloatArray
    control: FloatArray
    model: FloatArray
    with_remnant: FloatArray

    @property
    def inside(self) -> float:
        """Share of the recorded samples inside the band with remnant."""
        low, high = self.with_remnant
        return float(np.mean((low <= self.control) & (self.control <= high)))


def predictive_band(draws: Draws, likelihood: Marginal, rng: np.random.Generator) -> PredictiveBand:
    """The band from equally weighted draws.

    Parameters
    ----------
    draws, likelihood
        The posterior's draws, and the likelihood that they come from.
    rng
        Draws the remnants.
    """
    from scipy.signal import lfilter

    joint = likelihood.joint
    prediction, pilot = joint.prediction, joint.pilot_count
    values = draws.thinned(SIMULATED)
    if likelihood.integrated:
        shapes = likelihood.coefficients(values)
        values = np.concatenate([values, shapes], axis=1)
    taps = joint.noise.filters(values[:, pilot:], joint.band)
    squares = likelihood.sums_of_squares(values)
    deviations = np.sqrt(squares / rng.chisquare(joint.residuals, len(squares)))
    control = prediction.control
    shape = (len(values), *control.shape)
    answers, remnants = np.empty(shape), np.empty(shape)
    for i, own in enumerate(values):
        spectra = prediction.residual_spectra(own[None, :pilot])
        residual = prediction.without_nuisance(prediction.samples_of(spectra))[0]
        answers[i] = control - residual
        noise = deviations[i] * rng.standard_normal((len(control), SETTLE + control.shape[1]))
        remnants[i] = lfilter([1.0], taps[i], noise, axis=1)[:, SETTLE:]
    return PredictiveBand(
        np.arange(prediction.scored, dtype=float) * prediction.dt,
        control,
        np.quantile(answers, TAILS, axis=0),
        np.quantile(answers + remnants, TAILS, axis=0),
    )


BLOCK = 8  # parameter sets simulated at once


def sampled_parameters(draws: Draws, model: PilotModel) -> list[Quantity]:
    """The sampled parameters, the remnant's last."""
    units = {p.key: p.unit for p in model.parameters} | {"frequency": "rad/s"}
    return [
        sampled(
            key,
            units.get(key, ""),
            draws.values[:, i],
            effective=float(draws.effective[i]),
            r_hat=float(draws.r_hat[i]),
            positive=bool(draws.positive[i]),
        )
        for i, key in enumerate(draws.keys)
    ]


def derived(
    draws: Draws,
    model: PilotModel,
    recording: Recording,
    element: ControlledElement | None,
) -> list[Quantity]:
    """Products and sums of parameters, the VAF, and loop margins if the element is known."""
    result = combined(draws.keys, draws.centre, draws.covariance, draws)
    some = draws.thinned(COUNT)[:, : len(model.parameters)]
    result.append(sampled("VAF", "%", vafs(recording, model, some)))
    if element is not None and not model.no_loop:
        result += _margins(draws, model, element)
    return result


def vafs(recording: Recording, model: PilotModel, values: FloatArray) -> FloatArray:
    """Variance accounted for [%] by each parameter set, see `simulated_vaf`, shape (sets,)."""
    prediction = predict(recording, model)
    spread = np.mean(np.var(prediction.control, axis=1))
    left = np.empty(len(values))
    for begin in range(0, len(values), BLOCK):
        block = slice(begin, begin + BLOCK)
        samples = prediction.samples_of(prediction.residual_spectra(values[block]))
        left[block] = np.mean(np.var(prediction.without_nuisance(samples), axis=2), axis=1)
    return np.asarray(np.maximum(0.0, 100.0 * (1.0 - left / spread)))


def _margins(draws: Draws, model: PilotModel, element: ControlledElement) -> list[Quantity]:
    return [
        replace(quantity, key=f"{loop.name} {what}")
        for loop in _sampled(draws, model, element)
        for what, quantity in (
            ("crossover", loop.crossover),
            ("phase margin", loop.phase_margin),
        )
    ]


def loop_notes(draws: Draws, model: PilotModel, element: ControlledElement) -> list[str]:
    """What should be known of the loops' margins over draws, a sentence each."""
    if model.no_loop:
        return [model.no_loop]
    return [note for loop in _sampled(draws, model, element) for note in loop.notes]


def _sampled(draws: Draws, model: PilotModel, element: ControlledElement) -> list[Loop]:
    count = len(model.parameters)
    sets = draws.thinned(COUNT)[:, :count]
    return sampled_loops(model, draws.centre[:count], sets, element)
