"""Parameters that vary in time: the factors that do, and the time profiles that they follow.

Gain and lead act on the channel's input before delay and neuromuscular system.  Where they vary
in time, what these are given is a sum of the input and its derivatives, each times a function of
time: K(t) (1 + T(t) s) e becomes K(t) e + K(t) T(t) de/dt.  So variation in time is a property
of the model, and any method that predicts in the time domain can take it.  A `Changing` says
which parameters vary, its course how: along one sigmoid that all share, or along splines, one
for each.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from pilotid.pilot.factors import Parameter, Polynomial
from pilotid.types import FloatArray

#: Rate [1/s] from which on a change is a step: it takes less than half a second.
STEEP = 10.0
#: By how much a search moves a step in time [s].
SHIFTS = (-4.0, -2.8, -2.0, -1.4, -0.8, -0.4, 0.0, 0.4, 0.8, 1.4, 2.0, 2.8, 4.0)

#: Derivatives by one parameter of a course: the indices of the parameters over time that it
#: moves, and how much, each of shape (sets, n).
Moved = list[tuple[int, FloatArray]]


class Curve(NamedTuple):
    """A parameter that varies freely, whose roughness is penalised.

    Attributes
    ----------
    key
        The parameter's key.
    indices
        Indices of the parameters that describe it; their logarithms f count.
    matrix
        Its roughness is f' matrix f.
    """

    key: str
    indices: tuple[int, ...]
    matrix: FloatArray


@dataclass(frozen=True)
class Sigmoid:
    """From one value to another along a sigmoid that all parameters share.

    Every parameter P becomes two, P1 and P2, and is

        P(t) = P1 + (P2 - P1)/(1 + exp(-rate (t - tmid)))

    (Zaal, JGCD 39(5) 2016).  The time t runs from the start of the measurement window.

    Attributes
    ----------
    time_key, rate_key
        Keys of the middle of the change [s] and of its rate [1/s].  Three quarters of the change
        take 4/rate; above 10 1/s it is a step.
    time_bounds, time_usual, time_start
        Bounds, range of the random starts, and default of the middle [s].
    """

    time_key: str = "tmid"
    rate_key: str = "rate"
    time_bounds: tuple[float, float] = (0.0, 120.0)
    time_usual: tuple[float, float] = (10.0, 70.0)
    time_start: float = 30.0
    roughness = None

    @property
    def when(self) -> tuple[str, ...]:
        """Keys of the middle and the rate."""
        return (self.time_key, self.rate_key)

    def parameters(self, changed: tuple[Parameter, ...]) -> tuple[Parameter, ...]:
        """Each parameter before and after, then the middle and the rate of the change."""
        # The response is proportional to a gain only if no other factor's gain multiplies it.
        single = sum(p.linear for p in changed) == 1
        both = [
            replace(p, key=key, linear=p.linear and single)
            for p in changed
            for key in self.ends(p.key)
        ]
        middle = Parameter(
            self.time_key, "s", *self.time_bounds, self.time_start, self.time_usual, positive=False
        )
        rate = Parameter(self.rate_key, "1/s", 0.05, 120.0, 2.0, (0.1, 50.0))
        return (*both, middle, rate)

    def ends(self, key: str) -> tuple[str, str]:
        """The keys before and after the change."""
        return f"{key}1", f"{key}2"

    def over(self, seconds: float) -> Sigmoid:
        """Itself: its time is in seconds, however long the window."""
        return self

    def elsewhere(self, values: FloatArray) -> list[FloatArray]:
        """Parameter sets with the change at other times nearby, as a step.

        How well a step at some time suits depends on what the input happened to do then, so that
        the likelihood has one optimum beside the other.
        """
        found = []
        for shift in SHIFTS:
            moved = values.copy()
            moved[-2] = np.clip(values[-2] + shift, *self.time_bounds)
            moved[-1] = STEEP
            found.append(moved)
        return found

    def constant(self, values: FloatArray) -> FloatArray:
        """A change by nothing."""
        when = [p.start for p in self.parameters(())]
        shape = (*values.shape[:-1], len(when))
        return np.concatenate([np.repeat(values, 2, axis=-1), np.broadcast_to(when, shape)], -1)

    def share(self, time: FloatArray, values: FloatArray) -> FloatArray:
        """How much of the change has passed, 0 to 1, shape (..., n); see `at`."""
        middle, rate = values[..., -2, None], values[..., -1, None]
        return np.asarray(0.5 + 0.5 * np.tanh(0.5 * rate * (time - middle)))

    def at(self, time: FloatArray, values: FloatArray) -> FloatArray:
        """What varies at some times, shape (..., changed, n).

        Parameters
        ----------
        time
            Times from the start of the measurement window [s], shape (n,).
        values
            Sets of the course's parameters, shape (..., parameters).
        """
        before, after = values[..., :-2:2, None], values[..., 1:-2:2, None]
        share = self.share(time, values)[..., None, :]
        return np.asarray(before + (after - before) * share)

    def moved(self, time: FloatArray, values: FloatArray) -> list[Moved]:
        """The derivatives of `at` by each parameter, `values` of shape (sets, parameters)."""
        share = self.share(time, values)
        slope = share * (1.0 - share)
        middle, rate = values[:, -2, None], values[:, -1, None]
        step = values[:, 1:-2:2] - values[:, :-2:2]
        found: list[Moved] = []
        for i in range(step.shape[1]):
            found += [[(i, 1.0 - share)], [(i, share)]]
        by_middle, by_rate = -rate * slope, (time - middle) * slope
        for by in (by_middle, by_rate):
            found.append([(i, step[:, i, None] * by) for i in range(step.shape[1])])
        return found


#: What a change is where nobody says how.
SIGMOID = Sigmoid()


@dataclass(frozen=True)
class Spline:
    """Each parameter along a smooth curve of its own, of which nothing else is known.

    The logarithm of a parameter is a natural cubic spline over the measurement window, constant
    beyond its ends.  Its parameters are what the parameter is at the knots, which lie evenly
    from the start of the window to its end: P00, P01, ...

    How smooth the curve is the recording says, see `pilotid.solve.smoothing`: what is
    penalised is the integral of the squared second derivative of the logarithm (Green &
    Silverman, Nonparametric Regression and Generalized Linear Models, 1994, ch. 2).  More knots
    than needed do no harm but take time.

    Attributes
    ----------
    intervals
        Intervals between knots; a change faster than one is smeared over it.
    seconds
        Length of the measurement window [s]; `over` sets it.
    """

    intervals: int = 12
    seconds: float | None = None
    when = ()

    def __post_init__(self) -> None:
        if not 3 <= self.intervals <= 99:
            raise ValueError(f"a spline has 3 to 99 intervals, not {self.intervals}")

    def parameters(self, changed: tuple[Parameter, ...]) -> tuple[Parameter, ...]:
        """Each parameter at each knot."""
        for parameter in changed:
            if not parameter.positive:
                raise ValueError(
                    f"parameter {parameter.key} may be zero or less: it has no logarithm, "
                    "and cannot go along a spline of it"
                )
        return tuple(
            replace(p, key=self._key(p.key, knot), linear=False)
            for p in changed
            for knot in range(self.intervals + 1)
        )

    def _key(self, key: str, knot: int) -> str:
        return f"{key}{knot:02d}"

    def ends(self, key: str) -> tuple[str, str]:
        """The keys of the first and the last knot."""
        return self._key(key, 0), self._key(key, self.intervals)

    def over(self, seconds: float) -> Spline:
        """The spline over a window of so many seconds."""
        return replace(self, seconds=float(seconds))

    def elsewhere(self, values: FloatArray) -> list[FloatArray]:
        """None: one optimum leads to another."""
        return []

    def constant(self, values: FloatArray) -> FloatArray:
        """The same at all knots."""
        return np.repeat(values, self.intervals + 1, axis=-1)

    @property
    def knots(self) -> FloatArray:
        """Times of the knots from the start of the window [s], shape (intervals + 1,)."""
        if self.seconds is None:
            raise ValueError("a spline's knots have times once the model is `over` some seconds")
        return np.linspace(0.0, self.seconds, self.intervals + 1)

    def basis(self, time: FloatArray) -> FloatArray:
        """What each knot's logarithm weighs at some times, shape (knots, n)."""
        from scipy.interpolate import CubicSpline

        knots = self.knots
        spline = CubicSpline(knots, np.eye(len(knots)), bc_type="natural")
        return np.asarray(spline(np.clip(time, knots[0], knots[-1])).T)

    @property
    def roughness(self) -> FloatArray:
        """The matrix K by which f'Kf is the integral of f''^2, the knots' distance being one.

        Shape (knots, knots), f the values at the knots; of rank two less: straight lines have
        none.
        """
        inner = self.intervals - 1
        second = np.diff(np.eye(self.intervals + 1), 2, axis=0)
        between = np.eye(inner) * (2.0 / 3.0)
        between += (np.eye(inner, k=1) + np.eye(inner, k=-1)) / 6.0
        return np.asarray(second.T @ np.linalg.solve(between, second))

    def at(self, time: FloatArray, values: FloatArray) -> FloatArray:
        """See `Sigmoid.at`."""
        logs = np.log(values).reshape(*values.shape[:-1], -1, self.intervals + 1)
        return np.asarray(np.exp(logs @ self.basis(time)))

    def moved(self, time: FloatArray, values: FloatArray) -> list[Moved]:
        """See `Sigmoid.moved`."""
        basis = self.basis(time)
        own = np.exp(np.log(values).reshape(len(values), -1, self.intervals + 1) @ basis)
        count = self.intervals + 1
        return [
            [(j // count, own[:, j // count] * basis[j % count] / values[:, j, None])]
            for j in range(values.shape[1])
        ]


#: How parameters go over time.
Course = Sigmoid | Spline


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
        How their parameters go over time: `Sigmoid` or `Spline` of `pilotid.pilot.timevarying`.
    """

    factors: tuple[Polynomial, ...]
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
        return product_of(self._coefficients(list(np.moveaxis(self.at(time, values), -2, 0))))

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
        whole = _weighted(product_of(self._coefficients(parameters)), signals)
        return whole, [
            _weighted(product_of(self._coefficients(parameters, by=i)), signals)
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
            coefficients = factor.coefficients(own)
            if by is not None and first <= by < last:
                own[by - first] = own[by - first] + 1.0
                further = factor.coefficients(own)
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


def product_of(polynomials: Iterable[Sequence[FloatArray]]) -> list[FloatArray]:
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
