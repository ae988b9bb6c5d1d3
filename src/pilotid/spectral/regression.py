"""Linear regression of the control on its own past and on the inputs' past.

The core that black-box methods share: rows of lagged signals, and least squares on a choice
of their columns from one QR factorisation.

Lagged signals are nearly collinear (condition 1e4 to 1e8 for a pilot's), which squares
in normal equations; here everything rests on orthogonal factors of scaled columns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pilotid.estimate.quantities import FrequencyResponse, real_parts
from pilotid.model.model import PilotModel
from pilotid.support.types import ComplexArray, FloatArray, IntArray


@dataclass(frozen=True)
class Structure:
    """Orders and delays of A(q) u(t) = sum_i B_i(q) q^-delay_i input_i(t) + w(t).

    Attributes
    ----------
    poles
        Degree of A: how many past values of the output.
    zeros
        Per input, the number of coefficients of B_i.
    delays
        Per input, the lag of the first of them [samples].
    """

    poles: int
    zeros: tuple[int, ...]
    delays: tuple[int, ...]

    @property
    def parameters(self) -> int:
        """Number of coefficients."""
        return self.poles + sum(self.zeros)

    def lags(self, i: int) -> IntArray:
        """Lags of input `i` [samples], shape (coefficients,)."""
        return self.delays[i] + np.arange(self.zeros[i])


def information_criterion(
    cost: FloatArray, count: FloatArray, samples: int, weight: float
) -> FloatArray:
    """The Bayesian information criterion of structures, to be minimised; shape (structures,).

    Parameters
    ----------
    cost, count
        Residual sums of squares and numbers of coefficients, shape (structures,).
    samples
        Number of rows, less the nuisance terms.
    weight
        Factor on the penalty.  With 3 false channels are rare (Drop et al., IEEE Trans. Cybernetics
        48(1), 2018, who tune it by simulation).
    """
    # A cost of rounding errors alone would make the smallest of them a minimum.
    least = 1e-24 * float(np.max(cost, initial=0.0)) + np.finfo(float).tiny
    deviance = samples * np.log(np.maximum(cost, least) / samples)
    return np.asarray(deviance + weight * count * np.log(samples))


class Regression:
    """All lags of all signals, factorised once.

    Parameters
    ----------
    output
        The output, shape (runs, samples).
    inputs
        The inputs, each of that shape.
    widest
        All lags of which structures are made.
    first
        Index of the first row's output; at least the largest lag.
    nuisance
        What is fitted to every run besides, shape (rows, terms); a constant if not given.
    """

    def __init__(
        self,
        output: FloatArray,
        inputs: Sequence[FloatArray],
        widest: Structure,
        first: int,
        nuisance: FloatArray | None = None,
    ) -> None:
        rows = lagged_rows(output, inputs, widest, first)
        runs, count, _ = rows.shape
        basis = np.linalg.qr(np.ones((count, 1)) if nuisance is None else nuisance).Q
        rows = rows - basis @ (basis.T @ rows)
        self.samples = runs * (count - basis.shape[1])
        self._offsets = np.cumsum([widest.poles, *widest.zeros])[:-1] - widest.delays
        table = rows.reshape(runs * count, -1)
        scale = np.linalg.norm(table, axis=0)
        self._scale = np.where(scale > 0.0, scale, 1.0)
        self._triangle = triangle_of(table / self._scale)

    def _columns(self, structure: Structure) -> IntArray:
        """Indices of a structure's columns."""
        parts = [offset + structure.lags(i) for i, offset in enumerate(self._offsets)]
        return np.concatenate([np.arange(structure.poles), *parts])

    def cost(self, structure: Structure) -> float:
        """Residual sum of squares of one structure; 0 if it has no fewer columns than rows."""
        chosen = self._triangle[:, [*self._columns(structure), -1]]
        left = triangle_of(chosen)[structure.parameters :, -1] * self._scale[-1]
        return float(left @ left)

    def best(self, structures: Sequence[Structure], weight: float) -> Structure:
        """The structure of the lowest `information_criterion`."""
        cost = np.array([self.cost(structure) for structure in structures])
        count = np.array([structure.parameters for structure in structures], dtype=float)
        criterion = information_criterion(cost, count, self.samples, weight)
        return structures[int(np.argmin(criterion))]

    def fit(self, structure: Structure) -> BlackBox:
        """Coefficients of one structure, and their covariance."""
        chosen = self._columns(structure)
        q, r = np.linalg.qr(self._triangle[:, chosen])
        target = self._triangle[:, -1]
        projected = q.T @ target
        cost = float(np.sum((target - q @ projected) ** 2)) * self._scale[-1] ** 2
        units = self._scale[-1] / self._scale[chosen]
        inverse = np.linalg.solve(r, np.eye(len(chosen))) / self._scale[chosen, None]
        freedom = max(1, self.samples - len(chosen))
        return BlackBox(
            structure,
            coefficients=np.linalg.solve(r, projected) * units,
            covariance=inverse @ inverse.T * (cost / freedom),
        )


def triangle_of(matrices: FloatArray) -> FloatArray:
    """Triangular factors R of matrices (..., m, n), shape (..., min(m, n), n)."""
    return np.asarray(np.linalg.qr(matrices, mode="r"))


def lagged_rows(
    output: FloatArray, inputs: Sequence[FloatArray], structure: Structure, first: int
) -> FloatArray:
    """Rows of the regression, run by run.

    A row holds -u(t-1) ... -u(t-poles), then the lags of each input in ascending order,
    and last u(t).  No row reaches from one run into another.

    Parameters
    ----------
    output, inputs, first
        See `Regression`.
    structure
        The lags.

    Returns
    -------
    Array of shape (runs, samples - first, columns).
    """
    end = output.shape[1]
    columns = [-output[:, first - lag : end - lag] for lag in range(1, structure.poles + 1)]
    for i, signal in enumerate(inputs):
        columns += [signal[:, first - lag : end - lag] for lag in structure.lags(i)]
    columns.append(output[:, first:])
    return np.stack(columns, axis=-1)


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
    """

    structure: Structure
    coefficients: FloatArray
    covariance: FloatArray

    @property
    def poles(self) -> ComplexArray:
        """Roots of A."""
        return np.asarray(np.roots([1.0, *self.coefficients[: self.structure.poles]]))

    @property
    def numerators(self) -> list[FloatArray]:
        """Coefficients of each B_i, without its delay."""
        ends = self.structure.poles + np.cumsum(self.structure.zeros)
        return np.split(self.coefficients, [self.structure.poles, *ends])[1:-1]

    def response(
        self,
        omega: FloatArray,
        dt: float,
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
        factors
            What each response is multiplied by, shape (inputs, n).
        reference
            Responses at which errors are propagated, shape (inputs, n); None for the estimated
            ones, whose errors make small responses look accurate.

        Returns
        -------
        Responses (inputs, n), and the covariance of their `pilotid.estimate.quantities.real_parts`.
        """
        poles, shift = self.structure.poles, np.exp(-1j * omega * dt)
        down = shift ** np.arange(1, poles + 1)[:, None]
        bottom = 1.0 + self.coefficients[:poles] @ down
        value = np.empty(factors.shape, dtype=complex)
        slopes = np.zeros((self.coefficients.size, *factors.shape), dtype=complex)
        begin = poles
        for i, top in enumerate(self.numerators):
            up = shift ** self.structure.lags(i)[:, None]
            common = factors[i] / bottom
            value[i] = common * (top @ up)
            slopes[begin : begin + top.size, i] = common * up
            begin += top.size
        at = value if reference is None else reference
        slopes[:poles] = -at * (down / bottom)[:, None]
        jacobian = real_parts(slopes)
        return value, jacobian.T @ self.covariance @ jacobian


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
    known = zip(model.channels, model.fixed_responses(s), strict=True)
    factors = np.array([fixed * s**channel.derivative for channel, fixed in known])
    reference = None if values is None else model.response(omega, values)
    value, covariance = fit.response(omega, dt, factors, reference)
    size = np.abs(value if reference is None else reference).ravel()
    allowance = np.tile(0.5 * (misfit * size) ** 2, 2)
    return FrequencyResponse(omega, value, covariance + np.diag(allowance), note=note)
