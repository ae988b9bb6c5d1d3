"""Linear regression of the control on its own past and on the inputs' past.

The core that black-box methods share: rows of lagged signals, and the residual sums of
squares of very many choices of columns from one QR factorisation.

Lagged signals are nearly collinear (condition 1e4 to 1e8 for a pilot's), which squares
in normal equations; here everything rests on orthogonal factors of scaled columns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pilotid.estimates.parts import FrequencyResponse, real_parts
from pilotid.pilot.model import PilotModel
from pilotid.support.types import ComplexArray, FloatArray, IntArray
from pilotid.time_domain.prediction import Prediction


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


Criterion = Literal["aicc", "bic", "heavy"]
HEAVY = 3.0  # weight of the heavy penalty


@dataclass(frozen=True, eq=False)
class StructureSearch:
    """The criterion surface of a search among structures.

    Attributes
    ----------
    structures
        What was tried.
    cost
        Residual sum of squares of each, shape (structures,).
    samples
        Number of rows, less the nuisance terms.
    """

    structures: tuple[Structure, ...]
    cost: FloatArray
    samples: int

    def criterion(self, name: Criterion, weight: float = HEAVY) -> FloatArray:
        """An information criterion of each structure, to be minimised; shape (structures,).

        Parameters
        ----------
        name
            ``aicc`` (Hurvich & Tsai 1989), ``bic``, or ``heavy``: BIC with its penalty
            multiplied by `weight` (Drop et al., IEEE Trans. Cybernetics 48(1), 2018, who tune
            the weight by simulation until no false channel is found).
        weight
            Of the heavy penalty.
        """
        count = np.array([s.parameters for s in self.structures], dtype=float)
        # A cost of rounding errors alone would make the smallest of them a minimum.
        least = 1e-24 * float(np.max(self.cost, initial=0.0)) + np.finfo(float).tiny
        deviance = self.samples * np.log(np.maximum(self.cost, least) / self.samples)
        if name == "aicc":
            left = np.maximum(self.samples - count - 1.0, 1e-3)
            return np.asarray(deviance + 2.0 * count * (1.0 + (count + 1.0) / left))
        return np.asarray(
            deviance + (weight if name == "heavy" else 1.0) * count * np.log(self.samples)
        )

    def best(self, name: Criterion, weight: float = HEAVY) -> Structure:
        """The structure of the lowest criterion.

        Parameters
        ----------
        name, weight
            As for `criterion`.
        """
        return self.structures[int(np.argmin(self.criterion(name, weight)))]


BLOCK = 256  # factorisations at once: their columns then stay in the processor's cache


class Regression:
    """All lags of all signals, factorised once.

    Parameters
    ----------
    output
        The output, shape (runs, samples).
    inputs
        The inputs, each of that shape.
    poles
        Largest lag of the output.
    lags
        Per input, its smallest and largest lag.
    first
        Index of the first row's output; at least the largest lag.
    nuisance
        What is fitted to every run besides, shape (rows, terms); a constant if not given.
    """

    def __init__(
        self,
        output: FloatArray,
        inputs: Sequence[FloatArray],
        poles: int,
        lags: Sequence[tuple[int, int]],
        first: int,
        nuisance: FloatArray | None = None,
    ) -> None:
        rows = lagged_rows(output, inputs, poles, lags, first)
        runs, count, _ = rows.shape
        basis = np.linalg.qr(np.ones((count, 1)) if nuisance is None else nuisance).Q
        rows = rows - basis @ (basis.T @ rows)
        self.samples = runs * (count - basis.shape[1])
        widths = [poles, *(high - low + 1 for low, high in lags)]
        self._begin = np.concatenate([[0], np.cumsum(widths)])
        self._lags = tuple(lags)
        table = rows.reshape(runs * count, -1)
        scale = np.linalg.norm(table, axis=0)
        self._scale = np.where(scale > 0.0, scale, 1.0)
        self._triangle = triangle_of(table / self._scale)

    def columns(self, structure: Structure) -> IntArray:
        """Indices of a structure's columns; a ValueError if not all of them are there."""
        held = structure.poles <= self._begin[1]
        parts = [np.arange(structure.poles)]
        for i, (low, high) in enumerate(self._lags):
            lags = structure.lags(i)
            held &= lags.size == 0 or bool(low <= lags[0] and lags[-1] <= high)
            parts.append(self._begin[i + 1] + lags - low)
        if not held:
            raise ValueError(f"the regression does not hold all lags of {structure}")
        return np.concatenate(parts)

    def costs(self, structures: Sequence[Structure]) -> FloatArray:
        """Residual sums of squares, shape (structures,)."""
        result = np.empty(len(structures))
        families: dict[tuple[int, ...], dict[tuple[int, ...], list[int]]] = {}
        for place, structure in enumerate(structures):
            family = families.setdefault(structure.zeros, {})
            family.setdefault(structure.delays, []).append(place)
        for zeros, family in families.items():
            members = list(family.values())
            poles = np.array([structures[i].poles for places in members for i in places])
            row = np.repeat(np.arange(len(members)), [len(places) for places in members])
            places = np.concatenate([np.asarray(places) for places in members])
            delays = np.array(list(family), dtype=int)
            for corner in (delays.min(axis=0), delays.max(axis=0)):
                self.columns(Structure(int(poles.max()), zeros, tuple(corner.tolist())))
            ends = self._ends(zeros, delays, int(poles.max()))
            result[places] = ends[row, np.minimum(sum(zeros) + poles, ends.shape[1] - 1)]
        return result

    def search(self, structures: Sequence[Structure]) -> StructureSearch:
        """What many structures cost, as a search for the best of them."""
        return StructureSearch(tuple(structures), self.costs(structures), self.samples)

    def _ends(self, zeros: tuple[int, ...], delays: IntArray, poles: int) -> FloatArray:
        """Residual sums of squares of the first 0, 1, ... columns of structures.

        The inputs' columns come before the output's: one factorisation then has the costs of
        all degrees of A, as what the later columns leave of the target.

        Parameters
        ----------
        zeros
            Numbers of coefficients of the B_i.
        delays
            Delays, shape (sets, inputs).
        poles
            Largest degree of A.
        """
        parts = [
            self._begin[i + 1] + delays[:, i, None] - low + np.arange(count)
            for i, ((low, _), count) in enumerate(zip(self._lags, zeros, strict=True))
        ]
        past = [*range(poles), self._triangle.shape[1] - 1]
        chosen = np.concatenate([*parts, np.tile(past, (len(delays), 1))], axis=1)
        rows = self._triangle.T
        ends = []
        for block in np.split(chosen, range(BLOCK, len(chosen), BLOCK)):
            target = triangle_of(rows[block].swapaxes(1, 2))[:, :, -1] * self._scale[-1]
            left = np.cumsum(target[:, ::-1] ** 2, axis=1)[:, ::-1]
            ends.append(np.pad(left, ((0, 0), (0, 1))))
        return np.concatenate(ends)

    def fit(self, structure: Structure) -> BlackBox:
        """Coefficients of one structure, and their covariance."""
        chosen = self.columns(structure)
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
            cost=cost,
        )


def triangle_of(matrices: FloatArray) -> FloatArray:
    """Triangular factors R of matrices (..., m, n), shape (..., min(m, n), n)."""
    return np.asarray(np.linalg.qr(matrices, mode="r"))


def lagged_rows(
    output: FloatArray,
    inputs: Sequence[FloatArray],
    poles: int,
    lags: Sequence[tuple[int, int]],
    first: int,
) -> FloatArray:
    """Rows of the regression, run by run.

    A row holds -u(t-1) ... -u(t-poles), then the lags of each input in ascending order,
    and last u(t).  No row reaches from one run into another.

    Parameters
    ----------
    output, inputs, poles, lags, first
        See `Regression`.

    Returns
    -------
    Array of shape (runs, samples - first, columns).
    """
    end = output.shape[1]
    columns = [-output[:, first - lag : end - lag] for lag in range(1, poles + 1)]
    for signal, (low, high) in zip(inputs, lags, strict=True):
        columns += [signal[:, first - lag : end - lag] for lag in range(low, high + 1)]
    columns.append(output[:, first:])
    return np.stack(columns, axis=-1)


def signals(prediction: Prediction) -> tuple[FloatArray, list[FloatArray]]:
    """Control and signed inputs of a prediction, each of shape (runs, first + scored).

    The inputs have passed through their channel's known dynamics, so that the slow poles of
    these need not be found: a regression takes little notice of them.
    """
    end = prediction.first + prediction.scored

    def samples(spectrum: ComplexArray) -> FloatArray:
        return np.asarray(np.fft.irfft(spectrum, n=prediction.length)[:, :end])

    return samples(prediction.control_spectrum), [samples(each) for each in prediction.inputs]


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


def arx_response(
    structure: Structure,
    coefficients: FloatArray,
    shift: ComplexArray,
    factors: ComplexArray | float = 1.0,
    reference: ComplexArray | None = None,
) -> tuple[ComplexArray, ComplexArray]:
    """Responses F_i B_i/A of many models of one structure, and their derivatives by coefficients.

    Parameters
    ----------
    structure
        Orders and delays.
    coefficients
        Those of A behind its 1, then those of each B_i, shape (models, coefficients).
    shift
        Response of a delay by one sample at the frequencies, shape (n,).
    factors
        F_i, shape (inputs, n).
    reference
        Responses at which derivatives are taken, shape (inputs, n); None for the models' own.

    Returns
    -------
    Arrays of shape (models, inputs, n) and (models, coefficients, inputs, n).
    """
    poles, shape = structure.poles, (len(structure.zeros), shift.size)
    down = shift ** np.arange(1, poles + 1)[:, None]
    bottom = 1.0 + coefficients[:, :poles] @ down
    value = np.empty((len(coefficients), *shape), dtype=complex)
    slopes = np.zeros((*coefficients.shape, *shape), dtype=complex)
    ends = poles + np.cumsum([0, *structure.zeros])
    known = np.broadcast_to(factors, shape)
    for i, own in enumerate(map(slice, ends[:-1], ends[1:])):
        up = shift ** structure.lags(i)[:, None]
        common = known[i] / bottom
        value[:, i] = common * (coefficients[:, own] @ up)
        slopes[:, own, i] = common[:, None] * up
    at = value if reference is None else reference[None]
    slopes[:, :poles] = -at[:, None] * (down / bottom[:, None])[:, :, None]
    return value, slopes


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
    shift = np.exp(-1j * omega * dt)
    values = fit.coefficients[None]
    response, slopes = arx_response(fit.structure, values, shift, factors, reference)
    jacobian = real_parts(slopes[0])
    return response[0], jacobian.T @ fit.covariance @ jacobian


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
    value, covariance = discrete_response(omega, dt, fit, factors, reference)
    size = np.abs(value if reference is None else reference).ravel()
    allowance = np.tile(0.5 * (misfit * size) ** 2, 2)
    return FrequencyResponse(omega, value, covariance + np.diag(allowance), note=note)
