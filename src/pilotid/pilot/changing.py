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

from pilotid.pilot.factors import Factor, Parameter, Values
from pilotid.types import FloatArray

#: Rate [1/s] from which on a change is a step: it takes less than half a second.
STEEP = 10.0
#: By how much a search moves a step in time [s].
SHIFTS = (-4.0, -2.8, -2.0, -1.4, -0.8, -0.4, 0.0, 0.4, 0.8, 1.4, 2.0, 2.8, 4.0)


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
    """Factors of a channel whose parameters pass from one value to another along a sigmoid.

    Every parameter P of the factors becomes two, P1 and P2, and is

        P(t) = P1 + (P2 - P1)/(1 + exp(-rate (t - tmid)))

    with a `tmid` and a `rate` that all share (Zaal, JGCD 39(5) 2016).  The time t runs from the
    start of the measurement window.  Where a product of leads varies it is the product of their
    polynomials at each time that acts on the input and its derivatives.

    Attributes
    ----------
    factors
        `Gain`, `Lead`, or others that are a `Polynomial`.
    time_key, rate_key
        Keys of the middle of the change [s] and of its rate [1/s].  Three quarters of the change
        take 4/rate; above 10 1/s it is a step.
    time_bounds, time_usual, time_start
        Bounds, range of the random starts, and default of the middle [s].
    """

    factors: tuple[Factor, ...]
    time_key: str = "tmid"
    rate_key: str = "rate"
    time_bounds: tuple[float, float] = (0.0, 120.0)
    time_usual: tuple[float, float] = (10.0, 70.0)
    time_start: float = 30.0
    fixed_poles = ()

    def __post_init__(self) -> None:
        if not self.factors or not self._changed:
            raise ValueError("a change needs at least one factor with a parameter")
        for factor in self.factors:
            if not isinstance(factor, Polynomial):
                raise ValueError(
                    f"{type(factor).__name__} cannot vary in time: it has a memory of its own; "
                    "only gains and leads can"
                )

    @property
    def _changed(self) -> tuple[Parameter, ...]:
        """The parameters of the factors, before they are doubled."""
        return tuple(p for factor in self.factors for p in factor.parameters)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Each parameter before and after, then the middle and the rate of the change."""
        # The response is proportional to a gain only if no other factor's gain multiplies it.
        single = sum(p.linear for p in self._changed) == 1
        both = [
            replace(p, key=f"{p.key}{end}", linear=p.linear and single)
            for p in self._changed
            for end in (1, 2)
        ]
        middle = Parameter(
            self.time_key, "s", *self.time_bounds, self.time_start, self.time_usual, positive=False
        )
        rate = Parameter(self.rate_key, "1/s", 0.05, 120.0, 2.0, (0.1, 50.0))
        return (*both, middle, rate)

    @property
    def order(self) -> int:
        """Highest derivative of the channel's input that is used."""
        return sum(len(c) - 1 for c in self._coefficients([p.start for p in self._changed]))

    def elsewhere(self, values: FloatArray) -> list[FloatArray]:
        """Parameter sets with the change at other times nearby, as a step.

        How well a step at some time suits depends on what the input happened to do then, so that
        the likelihood has one optimum beside the other.

        Parameters
        ----------
        values
            This factor's parameters, shape (parameters,).
        """
        found = []
        for shift in SHIFTS:
            moved = values.copy()
            moved[-2] = np.clip(values[-2] + shift, *self.time_bounds)
            moved[-1] = STEEP
            found.append(moved)
        return found

    def share(self, time: FloatArray, values: FloatArray) -> FloatArray:
        """How much of the change has passed, 0 to 1.

        Parameters
        ----------
        time
            Times from the start of the measurement window [s], shape (n,).
        values
            Sets of this factor's parameters, shape (..., parameters).

        Returns
        -------
        Array of shape (..., n).
        """
        middle, rate = values[..., -2, None], values[..., -1, None]
        return np.asarray(0.5 + 0.5 * np.tanh(0.5 * rate * (time - middle)))

    def at(self, time: FloatArray, values: FloatArray) -> FloatArray:
        """Parameters of the factors at some times, shape (..., parameters of the factors, n).

        Parameters
        ----------
        time, values
            See `share`.
        """
        before, after = values[..., :-2:2, None], values[..., 1:-2:2, None]
        share = self.share(time, values)[..., None, :]
        return np.asarray(before + (after - before) * share)

    def weights(self, time: FloatArray, values: FloatArray) -> list[FloatArray]:
        """What multiplies the channel's input and its derivatives, each of shape (..., n).

        Parameters
        ----------
        time, values
            See `share`.
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
            See `share`.
        values
            Sets of this factor's parameters, shape (sets, parameters).

        Returns
        -------
        Arrays of shape (sets, runs, n) and (sets, parameters, runs, n).
        """
        parameters = list(np.moveaxis(self.at(time, values), -2, 0))
        whole = self._coefficients(parameters)
        signal = _weighted(_product(whole), signals)
        slopes = np.zeros((len(values), values.shape[1], *signals.shape[1:]))
        share = self.share(time, values)[:, None]
        changed = np.zeros(signal.shape)
        step = values[:, 1:-2:2] - values[:, :-2:2]
        for i in range(len(parameters)):
            by_own = _weighted(_product(self._coefficients(parameters, by=i)), signals)
            np.multiply(by_own, share, out=slopes[:, 2 * i + 1])
            np.subtract(by_own, slopes[:, 2 * i + 1], out=slopes[:, 2 * i])
            changed += step[:, i, None, None] * by_own
        changed *= share * (1.0 - share)
        middle, rate = values[:, -2, None, None], values[:, -1, None, None]
        slopes[:, -2] = -rate * changed
        slopes[:, -1] = (time - middle) * changed
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
