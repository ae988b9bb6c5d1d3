"""Courses: how the parameters of a pilot who changes go over time.

A `Changing` says which parameters vary, its course how: along one sigmoid that all share, or
along splines, one for each.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np

from pilotid.pilot.factors import Parameter
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


class Course(Protocol):
    """How parameters go over time; it must be hashable (a frozen dataclass)."""

    @property
    def when(self) -> tuple[str, ...]:
        """Keys of middle and rate of a change; empty where the course has none."""
        ...

    def parameters(self, changed: tuple[Parameter, ...]) -> tuple[Parameter, ...]:
        """The parameters that describe how some parameters go over time."""
        ...

    def ends(self, key: str) -> tuple[str, str]:
        """Keys of what a parameter is at the beginning and at the end."""
        ...

    def over(self, seconds: float) -> Course:
        """The course over a measurement window of so many seconds."""
        ...

    def at(self, time: FloatArray, values: FloatArray) -> FloatArray:
        """What varies at some times, shape (..., changed, n).

        Parameters
        ----------
        time
            Times from the start of the measurement window [s], shape (n,).
        values
            Sets of the course's parameters, shape (..., parameters).
        """
        ...

    def moved(self, time: FloatArray, values: FloatArray) -> list[Moved]:
        """The derivatives of `at` by each parameter, `values` of shape (sets, parameters)."""
        ...

    def elsewhere(self, values: FloatArray) -> list[FloatArray]:
        """Other parameter sets near which an optimum may be, from one of shape (parameters,)."""
        ...

    def constant(self, values: FloatArray) -> FloatArray:
        """The parameters of what does not vary, (..., parameters), from (..., changed)."""
        ...

    @property
    def roughness(self) -> FloatArray | None:
        """What is penalised, of each parameter that varies: see `Spline.roughness`."""
        ...


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
        """How much of the change has passed, 0 to 1, shape (..., n); see `Course.at`."""
        middle, rate = values[..., -2, None], values[..., -1, None]
        return np.asarray(0.5 + 0.5 * np.tanh(0.5 * rate * (time - middle)))

    def at(self, time: FloatArray, values: FloatArray) -> FloatArray:
        """See `Course.at`."""
        before, after = values[..., :-2:2, None], values[..., 1:-2:2, None]
        share = self.share(time, values)[..., None, :]
        return np.asarray(before + (after - before) * share)

    def moved(self, time: FloatArray, values: FloatArray) -> list[Moved]:
        """See `Course.moved`."""
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

    How smooth the curve is the recording says, see `pilotid.time_domain.smoothness`: what is
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
        """See `Course.at`."""
        logs = np.log(values).reshape(*values.shape[:-1], -1, self.intervals + 1)
        return np.asarray(np.exp(logs @ self.basis(time)))

    def moved(self, time: FloatArray, values: FloatArray) -> list[Moved]:
        """See `Course.moved`."""
        basis = self.basis(time)
        own = np.exp(np.log(values).reshape(len(values), -1, self.intervals + 1) @ basis)
        count = self.intervals + 1
        return [
            [(j // count, own[:, j // count] * basis[j % count] / values[:, j, None])]
            for j in range(values.shape[1])
        ]
