"""Fourier coefficients at the lines of multisine forcing functions, then a fit.

Van Paassen & Mulder, *Identification of human operator control behaviour in multiple-loop
tracking tasks*, 1998.  At every line U = Hpe E - Hpx X.  That is one equation; for a pilot
with two channels the second comes from the lines of the other forcing function, whose
ratios U/E and X/E are interpolated.  The error that this makes is some per cent of the
responses, and is reported; it does not reach the parameters, since the second step is
fitted to the equation at each line itself.

The remnant is not periodic in the window.  What it leaves in the pilot at both ends leaks
to all frequencies; above 8 rad/s that exceeds the remnant's own power twentyfold.  It is
smooth in frequency, so that the residuals of the bins beside a line tell it (the idea of
the local polynomial method; Pintelon & Schoukens, *System Identification*, 2nd ed.,
sec. 7.2).  With `trend=None` it stays in, as in 1998.

Assumes whole periods of the forcing in the window, a pilot who does not change, and, for
two channels, both a target and a disturbance.

Use it to see frequency responses with error bars, and to check `mle` against a method that
shares nothing with it.

Do not use it for gain and lead time where the remnant exceeds the forced response at low
frequency, of which the lines know little.  It uses the lines alone: the remnant that
circulates between them excites the pilot as well, so that methods which use all of the
recording know gain and lead time better.

The remnant is in the inputs as well, through the loop.  Where it exceeds the response to the
forcing functions, least squares on that equation tends to the inverse of the controlled
element, as all direct estimates in a closed loop.  To compare the control with what the
forcing functions make of it in the loop instead (whose way through the loop the bins tell
without noise) is free of that, and knows as little of gain and lead time as the lines alone
do: in some recordings of `nominal` nothing keeps the lead time from its bound.  What is minimised
is the geometric mean of both (`removed`), a k-class estimator in the words of econometrics
(Theil, *Economic Forecasts and Policy*, 1958).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from pilotid.estimate.estimate import Estimate, Outcome
from pilotid.estimate.loops import are_pilots
from pilotid.estimate.quantities import AnalysedBand, FrequencyResponse
from pilotid.estimate.warnings import lines_objection
from pilotid.likelihood.second_step import second_step
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.solve.least_squares import minimise, search
from pilotid.spectral.coefficients import NEIGHBOURS, TREND, Coefficients, coefficients_of
from pilotid.spectral.equations import Equations, best_pilot


@dataclass(frozen=True)
class Fourier:
    """Fourier coefficients at the forcing lines, and a fit weighted by the remnant's power.

    Attributes
    ----------
    neighbours
        Bins beside each line that tell the leakage of transients and, where there is only
        one run, the remnant's power.
    trend
        Order of the polynomial that this leakage follows beside a line; None leaves it in.
    rounds
        How often leakage and power are found anew at most, with the fitted model's response
        between the lines.
    removed
        Share of the remnant that is taken out of the inputs, from 0 (least squares on the
        equations at the lines, as published) to 1.
    """

    neighbours: int = NEIGHBOURS
    trend: int | None = TREND
    rounds: int = 8
    removed: float = 0.5
    name: ClassVar[str] = "fourier"

    def objection(self, recording: Recording, model: PilotModel) -> str | None:
        """Why the forcing functions have no lines, or too few, for the model's channels."""
        return lines_objection(recording, model)

    def first_step(self, recording: Recording, model: PilotModel) -> FrequencyResponse:
        """The channels' responses at the forcing lines, without a model of the pilot.

        Parameters
        ----------
        recording, model
            As for `fit`.

        Returns
        -------
        FrequencyResponse
            At the forcing lines, ascending.
        """
        return coefficients_of(recording, model, self.neighbours, self.trend).answered()

    def fit(self, recording: Recording, model: PilotModel, rng: np.random.Generator) -> Estimate:
        """Fit the equations at the lines, their leakage and weights in rounds.

        Parameters
        ----------
        recording
            The recording; the coefficients of all its runs are averaged in phase.
        model
            The pilot model, whose start is one of the starts of the search.
        rng
            Draws the other starts.
        """
        coefficients = coefficients_of(recording, model, self.neighbours, self.trend)
        residuals = coefficients.first_residuals()
        problem = Equations(coefficients, model, coefficients.power(residuals))
        minima = search(problem.gram, model, rng, candidates=48, refined=6)
        end = best_pilot(recording, model, minima).values
        settled = False
        for _ in range(self.rounds):
            minimum = minimise(problem.gram, end, model, tolerance=1e-6)
            information = minimum.gram[0, :-1, :-1]
            step = minimum.values[0] - end[0]
            end = minimum.values[:1]
            residuals = coefficients.residuals(model.response(coefficients.omega, end[0]))
            power = coefficients.power(residuals)
            problem = Equations(coefficients, model, power, self.removed, end[0])
            settled = bool(step @ information @ step < 1e-3 * len(step))
            if settled:
                break
        response = coefficients.answered(residuals)
        estimate = second_step(
            self.name, recording, model, response, rng, problem=problem, known=end
        )
        if not np.isfinite(estimate.values).all():
            return replace(estimate, frequency_response=response)
        if not settled and estimate.outcome.usable:
            estimate = replace(
                estimate,
                outcome=Outcome.NOT_CONVERGED,
                message=f"power and leakage of the remnant did not settle in {self.rounds} rounds",
            )
        if estimate.outcome.usable and not are_pilots(recording, model, estimate.values[None])[0]:
            why = "the loop of this pilot with the controlled element would be unstable"
            estimate = replace(estimate, outcome=Outcome.CONTRADICTED, message=why)
        estimate = replace(estimate, band=AnalysedBand(float(response.omega[-1])))
        return _with_interpolation_error(estimate, coefficients, response)


def _with_interpolation_error(
    estimate: Estimate, coefficients: Coefficients, response: FrequencyResponse
) -> Estimate:
    """The estimate with the responses' error by interpolation, as the fitted model has it."""
    model, lines = estimate.model, coefficients.lines
    if len(model.channels) < 2:
        return estimate
    exact = model.response(coefficients.omega[:lines], estimate.values)
    inputs = coefficients.at_lines(coefficients.inputs[:, :, :lines])
    control = np.sum(exact * inputs, axis=0)
    interpolated = coefficients.response(control, np.zeros(lines))
    true = model.response(response.omega, estimate.values)
    error = np.abs(interpolated.value - true)
    share = 100.0 * error / np.abs(true)
    note = (
        f"interpolation between the lines changes the responses by {np.median(share):.1f} % in "
        f"the median, {share.max():.1f} % at most"
    )
    return replace(estimate, frequency_response=replace(response, systematic=error, note=note))
