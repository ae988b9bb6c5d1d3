"""A black-box model: discrete transfer functions, and their frequency response with its covariance.

What the regression of the control on lagged signals finds, for the second step to use.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pilotid.estimates.parts import FrequencyResponse, real_parts
from pilotid.frequency.structures import Structure
from pilotid.pilot.model import Channel, PilotModel
from pilotid.types import ComplexArray, FloatArray


@dataclass(frozen=True, eq=False)
class BlackBox:
    """Least-squares coefficients of a structure.

    Attributes
    ----------
    structure
        Orders and delays.
    coefficients
        a_1, a_2, ... of A = 1 + a_1 q^-1 + ..., then those of each B_i.
    covariance
        Their covariance for a white residual.
    cost
        Residual sum of squares.
    """

    structure: Structure
    coefficients: FloatArray
    covariance: FloatArray
    cost: float

    @property
    def denominator(self) -> FloatArray:
        """Coefficients of A, its leading 1 included."""
        return np.concatenate([[1.0], self.coefficients[: self.structure.poles]])

    @property
    def numerators(self) -> list[FloatArray]:
        """Coefficients of each B_i, without its delay."""
        ends = self.structure.poles + np.cumsum(self.structure.zeros)
        return np.split(self.coefficients, [self.structure.poles, *ends])[1:-1]

    def unstable(self, dt: float) -> FloatArray:
        """Frequencies of the poles outside the unit circle [rad/s], ascending."""
        poles = np.roots(self.denominator)
        return np.sort(np.abs(np.angle(poles[np.abs(poles) >= 1.0]))) / dt


def known_dynamics(channel: Channel, s: ComplexArray) -> ComplexArray:
    """Product of a channel's factors without parameters, differentiators apart, shape (n,)."""
    product = np.ones_like(s)
    for factor in channel.dynamics:
        if not factor.parameters:
            product = product * factor.response(s, [])
    return product


def discrete_response(
    omega: FloatArray,
    dt: float,
    fit: BlackBox,
    factors: ComplexArray,
    reference: ComplexArray | None = None,
) -> tuple[ComplexArray, FloatArray]:
    """Frequency responses of the transfer functions B_i/A, and their covariance.

    Parameters
    ----------
    omega
        Frequencies [rad/s], shape (n,).
    dt
        Sampling interval [s].
    fit
        Coefficients and their covariance.
    factors
        What each response is multiplied by, shape (inputs, n).
    reference
        Responses at which errors are propagated, shape (inputs, n); None for the estimated
        ones, whose errors make small responses look accurate.

    Returns
    -------
    Responses (inputs, n), and the covariance of `pilotid.estimates.parts.real_parts` of them.
    """
    structure = fit.structure
    delay = np.exp(-1j * omega * dt)
    powers = delay ** np.arange(1, structure.poles + 1)[:, None]
    bottom = 1.0 + fit.coefficients[: structure.poles] @ powers
    value = np.zeros(factors.shape, dtype=complex)
    slopes = np.zeros((structure.parameters, *factors.shape), dtype=complex)
    begin = structure.poles
    for i, top in enumerate(fit.numerators):
        shifts = delay ** structure.lags(i)[:, None]
        common = factors[i] / bottom
        value[i] = common * (top @ shifts)
        slopes[begin : begin + top.size, i] = common * shifts
        begin += top.size
    at = value if reference is None else reference
    slopes[: structure.poles] = -at * (powers / bottom)[:, None]
    jacobian = real_parts(slopes)
    return value, jacobian.T @ fit.covariance @ jacobian


def channel_response(
    model: PilotModel,
    omega: FloatArray,
    dt: float,
    fit: BlackBox,
    misfit: float,
    note: str,
    values: FloatArray | None = None,
) -> FrequencyResponse:
    """The responses of a pilot's channels by a black-box model of them.

    Parameters
    ----------
    model
        The pilot model, whose channels are the inputs.
    omega
        Frequencies [rad/s], shape (n,).
    dt
        Sampling interval of the black-box model [s].
    fit
        The black-box model.
    misfit
        Error of the black-box model as a share of the response, independent at every
        frequency; it adds to the covariance.
    note
        What a reader should know of the black-box model.
    values
        Parameters of the pilot model at which errors are propagated; None for the estimated
        response.
    """
    s = np.asarray(1j * omega, dtype=complex)
    factors = np.array([known_dynamics(c, s) * s**c.derivative for c in model.channels])
    reference = None if values is None else model.response(omega, values)
    value, covariance = discrete_response(omega, dt, fit, factors, reference)
    size = np.abs(value if reference is None else reference).ravel()
    allowance = np.tile(0.5 * (misfit * size) ** 2, 2)
    return FrequencyResponse(omega, value, covariance + np.diag(allowance), note=note)
