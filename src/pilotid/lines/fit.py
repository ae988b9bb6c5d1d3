"""A pilot fitted to what the forcing functions make of the control, at their lines alone.

The model in its loop is set against the forced response (`Equations` with all of the remnant
removed).  That judges the pilot and nothing else.  The likelihood of the whole control does
not: a channel on the output can also predict the control as the inverse of the controlled
element does, x = Hc (u + fd), which no forced response mistakes for a pilot.  The lines know
less of gain and lead than the whole recording does, but their optimum lies in its basin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pilotid.lines.coefficients import NEIGHBOURS, TREND, Coefficients, coefficients_of
from pilotid.lines.equations import Equations
from pilotid.pilot.model import PilotModel
from pilotid.recordings.recording import Recording
from pilotid.solve.least_squares import minimise, solve_linear
from pilotid.solve.search import search
from pilotid.types import FloatArray

ROUNDS = 8  # in which leakage and power are found anew


@dataclass(frozen=True, eq=False)
class LinesFit:
    """A pilot that explains the forced response at the lines.

    Attributes
    ----------
    coefficients
        The recording's coefficients.
    model
        The pilot model.
    values
        Its parameters, shape (parameters,).
    power
        Power of the remnant at the lines that this pilot leaves, shape (n,).
    """

    coefficients: Coefficients
    model: PilotModel
    values: FloatArray
    power: FloatArray

    def misfits(self, sets: FloatArray) -> FloatArray:
        """Chi-squared of the equations at the lines, shape (sets,).

        Parameters
        ----------
        sets
            Parameters, shape (sets, parameters).
        """
        return np.asarray(np.sum(self._equations.rows(sets)[:, -1] ** 2, axis=1))

    @cached_property
    def misfit(self) -> float:
        """The same of these parameters."""
        return float(self.misfits(self.values[None])[0])

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the misfit."""
        return 2 * self.coefficients.lines - len(self.values)

    @cached_property
    def _equations(self) -> Equations:
        return Equations(self.coefficients, self.model, self.power)

    def minimised(self) -> LinesFit:
        """The same with the parameters that fit best under this power, from these ones."""
        return self._minimised(self.coefficients, self.power)

    def again(self) -> LinesFit:
        """The same with the power and the leakage that these parameters leave, and a new fit."""
        responses = self.model.response(self.coefficients.omega, self.values)
        residuals = self.coefficients.residuals(responses)
        alone = self.coefficients.at_lines_alone(residuals)
        return self._minimised(alone, self.coefficients.power(residuals))

    def _minimised(self, coefficients: Coefficients, power: FloatArray) -> LinesFit:
        problem = Equations(coefficients, self.model, power, 1.0, self.values)
        end = minimise(problem.gram, self.values[None], self.model, tolerance=1e-6)
        return replace(self, values=end.values[0], power=power)


def fit_lines(
    recording: Recording,
    model: PilotModel,
    rng: np.random.Generator,
    *,
    starts: Sequence[FloatArray] = (),
    candidates: int = 48,
    refined: int = 6,
    same: float = 1e-4,
) -> LinesFit:
    """The pilot whose response in the loop to the forcing functions alone fits best.

    Parameters
    ----------
    recording, model
        What is fitted; `pilotid.estimates.applicability.lines_objection` has none.
    rng
        Draws the random starts.
    starts
        Starts that are minimised beside the random ones, each of shape (parameters,).
    candidates, refined
        Starts screened, and starts minimised, see `pilotid.solve.search.search`.
    same
        Largest relative change of the parameters in the last round.
    """
    coefficients = coefficients_of(recording, model, NEIGHBOURS, TREND)
    residuals = coefficients.first_residuals()
    power = coefficients.power(residuals)
    first = Equations(coefficients.at_lines_alone(residuals), model, power)
    found = search(first.gram, model, rng, candidates=candidates, refined=refined)
    if starts:
        points = np.array(starts)
        points, _ = solve_linear(first.gram(points), points, model.linear, model.lower)
        more = minimise(first.gram, points, model, tolerance=1e-3, iterations=16)
        found = min((found, more), key=lambda minima: float(minima.cost[0]))
    fit = LinesFit(coefficients, model, found.values[0], power)
    for _ in range(ROUNDS):
        before, fit = fit.values, fit.again()
        if np.all(np.abs(fit.values - before) <= same * np.abs(before)):
            break
    return fit
