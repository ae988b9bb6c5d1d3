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
        self.model, self.omega = model, coefficients.omega
        if self.omega.size == coefficients.lines:
            self.block = MANY
        # Real and imaginary parts have half the power each.
        scale = np.sqrt(2.0 / power)
        lines = coefficients.lines
        self._paths, self._removed = coefficients.paths, removed
        if removed and fitted is not None:
            responses = model.response(self.omega[:lines], fitted)
            around = np.sum(responses * coefficients.paths, axis=0)
            scale = scale * np.abs(1.0 - around) ** removed

        def combined(signal: ComplexArray) -> ComplexArray:
            """What multiplies responses at lines and bins, shape (n, all)."""
            count = len(self.omega)
            matrix = np.zeros((lines, count), dtype=complex)
            rows = np.arange(lines)
            matrix[rows, rows] = coefficients.at_lines(signal[:, :lines])
            beside = np.mean(
                coefficients.phases[:, :, None] * signal[:, coefficients.beside], axis=0
            )
            matrix[rows[:, None], coefficients.beside] = -coefficients.trend * beside
            return scale[:, None] * matrix

        self._control = combined(coefficients.control).sum(axis=1)
        self._inputs = np.array([combined(signal) for signal in coefficients.inputs])

    @property
    def residuals(self) -> int:
        """Number of real residuals."""
        return 2 * int(self._control.size)

    def rows(self, values: FloatArray) -> FloatArray:
        """Standardised Jacobian and residual, shape (sets, parameters + 1, residuals)."""
        responses, slopes = self.model.response_and_jacobian(self.omega, values)
        everything = np.concatenate([slopes, responses[:, :, None]], axis=2)
        rows = sum(everything[:, c] @ inputs.T for c, inputs in enumerate(self._inputs))
        rows[:, -1] = self._control - rows[:, -1]
        if self._removed:
            around = np.einsum("scpn,cn->spn", everything[..., : self._control.size], self._paths)
            sensitivity = 1.0 / (1.0 - around[:, -1:])
            rows[:, :-1] -= self._removed * sensitivity * around[:, :-1] * rows[:, -1:]
            rows *= sensitivity**self._removed
        return np.concatenate([rows.real, rows.imag], axis=-1)
