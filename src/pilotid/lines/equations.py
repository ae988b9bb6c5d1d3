"""The equations between control and inputs at the forcing lines."""

from __future__ import annotations

import numpy as np

from pilotid.lines.coefficients import Coefficients
from pilotid.pilot.model import PilotModel
from pilotid.solve.least_squares import Problem
from pilotid.types import ComplexArray, FloatArray

#: Parameter sets evaluated at once where there are lines alone.
MANY = 64


class Equations(Problem):
    """Residuals of U = sum of H I at the lines, less the trend of those at the bins beside.

    Times the sensitivity S = 1/(1 - sum of H G), with G the loop's way from the control to the
    inputs, this is the control less what the forcing functions make of it in the loop, and
    its derivative holds what the forcing functions excite alone.  Times a power of S it holds
    the rest of the remnant in the inputs.

    Parameters
    ----------
    coefficients
        The recording's coefficients.
    model
        The pilot model.
    power
        Power of the remnant in each equation, shape (n,).
    removed
        That power, from 0 to 1.
    fitted
        Parameters whose sensitivity the weights are told by, shape (parameters,); needed if
        `removed` is not 0.
    """

    def __init__(
        self,
        coefficients: Coefficients,
        model: PilotModel,
        power: FloatArray,
        removed: float = 0.0,
        fitted: FloatArray | None = None,
    ) -> None:
        self._at = model.at(coefficients.omega)
        alone = coefficients.omega.size == coefficients.lines
        if alone:
            self.block = MANY
        # Real and imaginary parts have half the power each.
        scale = np.sqrt(2.0 / power)
        lines = coefficients.lines
        self._paths, self._removed = coefficients.paths, removed
        if removed and fitted is not None:
            responses = model.response(coefficients.omega[:lines], fitted)
            around = np.sum(responses * coefficients.paths, axis=0)
            scale = scale * np.abs(1.0 - around) ** removed

        def at_lines(signal: ComplexArray) -> ComplexArray:
            """What multiplies a response at the lines, shape (n,)."""
            return np.asarray(scale * coefficients.at_lines(signal[:, :lines]))

        def beside(signal: ComplexArray) -> ComplexArray:
            """What multiplies it at the bins beside them, shape (n, bins)."""
            matrix = np.zeros((lines, coefficients.omega.size), dtype=complex)
            near = np.mean(coefficients.phases[:, :, None] * signal[:, coefficients.beside], axis=0)
            matrix[np.arange(lines)[:, None], coefficients.beside] = -coefficients.trend * near
            return scale[:, None] * matrix[:, lines:]

        self._control = at_lines(coefficients.control) + beside(coefficients.control).sum(axis=1)
        self._lines = np.array([at_lines(signal) for signal in coefficients.inputs])
        self._beside = () if alone else tuple(beside(signal) for signal in coefficients.inputs)

    @property
    def residuals(self) -> int:
        """Number of real residuals."""
        return 2 * int(self._control.size)

    def rows(self, values: FloatArray) -> FloatArray:
        """Standardised Jacobian and residual, shape (sets, parameters + 1, residuals)."""
        rows = self._at(values)
        at_lines = rows[..., : self._control.size]
        found = (at_lines * self._lines[:, None]).sum(axis=1)
        for c, inputs in enumerate(self._beside):
            found += rows[:, c, :, self._control.size :] @ inputs.T
        np.subtract(self._control, found[:, -1], out=found[:, -1])
        if self._removed:
            around = (at_lines * self._paths[:, None]).sum(axis=1)
            sensitivity = 1.0 / (1.0 - around[:, -1:])
            found[:, :-1] -= self._removed * sensitivity * around[:, :-1] * found[:, -1:]
            found *= sensitivity if self._removed == 1.0 else sensitivity**self._removed
        # Real and imaginary parts side by side.
        return np.asarray(found.view(float))
