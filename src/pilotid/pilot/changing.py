"""Factors whose parameters change during a recording.

Gain and lead act on the channel's input before delay and neuromuscular system.  Where they vary
in time, what these are given is a sum of the input and its derivatives, each times a function of
time: K(t) (1 + T(t) s) e becomes K(t) e + K(t) T(t) de/dt.  So variation in time is a property
of the model, and any method that predicts in the time domain can take it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol, cast, runtime_checkable

import numpy as np

from pilotid.pilot.courses import Course, Sigmoid
from pilotid.pilot.factors import Factor, Parameter, Values
from pilotid.types import FloatArray


@runtime_checkable
class Polynomial(Protocol):
    """A factor that is a polynomial in s, each of whose coefficients is affine in its parameters.

    Such a factor may vary in time: it takes derivatives of the input and has no memory.
    """

    def coefficients(self, values: Values) -> tuple[FloatArray, ...]:
        """Coefficients, lowest power of s first."""
        ...


@dataclass(frozen=True)
class Changing:
    """Factors of a channel whose parameters vary in time along a course.

    Where a product of leads varies it is the product of their polynomials at each time that acts
    on the input and its derivatives.

    Attributes
    ----------
    factors
        `Gain`, `Lead`, or others that are a `Polynomial`.
    course
        How their parameters go over time: `Sigmoid` or `Spline` of `pilotid.pilot.courses`.
    """

    factors: tuple[Factor, ...]
    course: Course = Sigmoid()
    fixed_poles = ()

    def __post_init__(self) -> None:
        if not self.factors or not self.changed:
            raise ValueError("a change needs at least one factor with a parameter")
        for factor in self.factors:
            if not isinstance(factor, Polynomial):
                raise ValueError(
                    f"{type(factor).__name__} cannot vary in time: it has a memory of its own; "
                    "only gains and leads can"
                )

    @property
    def changed(self) -> tuple[Parameter, ...]:
        """The parameters of the factors, which vary."""
        return tuple(p for factor in self.factors for p in factor.parameters)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters of the course, which do not."""
        return self.course.parameters(self.changed)

    @property
    def order(self) -> int:
        """Highest derivative of the channel's input that is used."""
        return sum(len(c) - 1 for c in self._coefficients([p.start for p in self.changed]))

    def over(self, seconds: float) -> Changing:
        """The same over a measurement window of so many seconds."""
        return replace(self, course=self.course.over(seconds))

    def at(self, time: FloatArray, values: FloatArray) -> FloatArray:
        """Parameters of the factors at some times, shape (..., parameters of the factors, n).

        Parameters
        ----------
        time
            Times from the start of the measurement window [s], shape (n,).
        values
            Sets of this factor's parameters, shape (..., parameters).
        """
        return self.course.at(time, values)

    def weights(self, time: FloatArray, values: FloatArray) -> list[FloatArray]:
        """What multiplies the channel's input and its derivatives, each of shape (..., n).

        Parameters
        ----------
        time, values
            See `at`.
        """
        return _product(self._coefficients(list(np.moveaxis(self.at(time, values), -2, 0))))

    def modulated(
        self, signals: FloatArray, time: FloatArray, values: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """The modulated input, and its derivative by each parameter.

        Parameters
        ----------
        signals
            The channel's input and its derivatives up to `order`, shape (order + 1, runs, n).
        time
            See `at`.
        values
            Sets of this factor's parameters, shape (sets, parameters).

        Returns
        -------
        Arrays of shape (sets, runs, n) and (sets, parameters, runs, n).
        """
        parameters = list(np.moveaxis(self.at(time, values), -2, 0))
        signal = _weighted(_product(self._coefficients(parameters)), signals)
        by_own = [
            _weighted(_product(self._coefficients(parameters, by=i)), signals)
            for i in range(len(parameters))
        ]
        slopes = np.empty((len(values), values.shape[1], *signals.shape[1:]))
        for j, moved in enumerate(self.course.moved(time, values)):
            (first, weight), *others = moved
            np.multiply(by_own[first], weight[:, None], out=slopes[:, j])
            for i, weight in others:
                slopes[:, j] += by_own[i] * weight[:, None]
        return signal, slopes

    def _coefficients(
        self, parameters: list[FloatArray] | list[float], by: int | None = None
    ) -> list[tuple[FloatArray, ...]]:
        """Coefficients of each factor; of one their derivative by its parameter `by`.

        They are affine: the derivative is the difference between parameters one apart.
        """
        result, first = [], 0
        for factor in self.factors:
            last = first + len(factor.parameters)
            own = [np.asarray(value, dtype=float) for value in parameters[first:last]]
            given = cast(Polynomial, factor)
            coefficients = given.coefficients(own)
            if by is not None and first <= by < last:
                own[by - first] = own[by - first] + 1.0
                further = given.coefficients(own)
                coefficients = tuple(b - a for a, b in zip(coefficients, further, strict=True))
            result.append(coefficients)
            first = last
        return result


def _product(polynomials: list[tuple[FloatArray, ...]]) -> list[FloatArray]:
    """Coefficients of a product of polynomials, lowest power first."""
    total: list[FloatArray] = [np.ones(1)]
    for polynomial in polynomials:
        longer: list[FloatArray] = [np.zeros(1)] * (len(total) + len(polynomial) - 1)
        for i, a in enumerate(total):
            for j, b in enumerate(polynomial):
                longer[i + j] = longer[i + j] + a * b
        total = longer
    return total


def _weighted(weights: list[FloatArray], signals: FloatArray) -> FloatArray:
    """Sum of weights (sets, n) times signals (order + 1, runs, n), shape (sets, runs, n)."""
    parts = [weight[..., None, :] * signal for weight, signal in zip(weights, signals, strict=True)]
    total = parts[0]
    for part in parts[1:]:
        total = total + part
    return np.asarray(total)
