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

from pilotid.pilot.courses import SIGMOID, Course, Sigmoid
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
    course: Course = SIGMOID
    fixed_poles = ()

    def __post_init__(self) -> None:
        if not self.factors or not self.changed:
            raise ValueError("a change needs at least one factor with a parameter")
        for factor in self.factors:
            if not isinstance(factor, Polynomial):
                raise ValueError(
                    f"{type(factor).__name__} cannot vary in time: it has a memory of its own; "
                    "only gains and leads can, or whole channels by Fading"
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

    def ends(self, key: str) -> tuple[str, str]:
        """Keys of what a parameter of the factors is at the beginning and at the end."""
        return self.course.ends(key)

    def constant(self, values: FloatArray) -> FloatArray:
        """The parameters, (..., parameters), with which those of the factors stay as given."""
        return self.course.constant(values)

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
        signal, by_own = self._by_changed(signals, time, values)
        slopes = np.empty((len(values), values.shape[1], *signals.shape[1:]))
        for j, moved in enumerate(self.course.moved(time, values)):
            (first, weight), *others = moved
            np.multiply(by_own[first], weight[:, None], out=slopes[:, j])
            for i, weight in others:
                slopes[:, j] += by_own[i] * weight[:, None]
        return signal, slopes

    def _by_changed(
        self, signals: FloatArray, time: FloatArray, values: FloatArray
    ) -> tuple[FloatArray, list[FloatArray]]:
        """What the factors make of the input, and its derivative by each of their parameters."""
        parameters = list(np.moveaxis(self.at(time, values), -2, 0))
        whole = _weighted(_product(self._coefficients(parameters)), signals)
        return whole, [
            _weighted(_product(self._coefficients(parameters, by=i)), signals)
            for i in range(len(parameters))
        ]

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


@dataclass(frozen=True)
class Fading(Changing):
    """A channel that fades out, or in, along a sigmoid from none to all.

    Two channels on one input, one before and one after a change, are a pilot who becomes
    another, delay and neuromuscular system included.  That is an approximation: what the pilot
    saw before the change is answered with the dynamics before, what was seen afterwards with
    those after it.  It errs for as long as those dynamics remember, about the delay and
    2/(fnm dnm); docs/adapting.md has figures.

    Attributes
    ----------
    factors
        The channel's gains and leads, constant; they act before it fades.
    course
        The sigmoid, whose middle and rate the two channels share.
    after
        Whether the channel fades in.
    """

    course: Course = SIGMOID
    after: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.course, Sigmoid):
            raise ValueError("what fades goes along a Sigmoid")

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Those of the factors, then the middle and the rate of the change."""
        return (*self.changed, *self.course.parameters(()))

    def ends(self, key: str) -> tuple[str, str]:
        """The parameter itself, twice: it is constant."""
        return key, key

    def constant(self, values: FloatArray) -> FloatArray:
        """See `Changing.constant`."""
        return np.concatenate([values, self.course.constant(values[..., :0])], axis=-1)

    def at(self, time: FloatArray, values: FloatArray) -> FloatArray:
        """The factors' parameters, the same at all times, see `Changing.at`."""
        own = values[..., :-2, None]
        return np.broadcast_to(own, (*own.shape[:-1], time.size))

    def weights(self, time: FloatArray, values: FloatArray) -> list[FloatArray]:
        """What multiplies the input and its derivatives, see `Changing.weights`."""
        share = self.course.at(time, self._shares(values))[..., 0, :]
        return [share * weight for weight in super().weights(time, values)]

    def modulated(
        self, signals: FloatArray, time: FloatArray, values: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """See `Changing.modulated`."""
        given = self._shares(values)
        share = self.course.at(time, given)[:, 0, None]
        whole, by_own = self._by_changed(signals, time, values)
        by_when = [slope[:, None] * whole for ((_, slope),) in self.course.moved(time, given)[2:]]
        slopes = [*(share * part for part in by_own), *by_when]
        return share * whole, np.stack(slopes, axis=1)

    def _shares(self, values: FloatArray) -> FloatArray:
        """Parameters of a sigmoid from 1 to 0, or from 0 to 1."""
        ends = np.broadcast_to([1.0 - self.after, float(self.after)], (*values.shape[:-1], 2))
        return np.concatenate([ends, values[..., -2:]], axis=-1)


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
