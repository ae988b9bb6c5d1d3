"""The building blocks of a pilot model.

A channel of a pilot model is a signed product of factors.  A factor knows its parameters and
its frequency response; the *log-derivative* (the derivative of the logarithm of the response)
by each parameter is numeric unless it gives that too.  Responses multiply and log-derivatives
add, so that the Jacobian of any product follows by itself.  A factor of one's own derives from
`Factor`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from pilotid.model.element import ControlledElement, Rational, pade
from pilotid.support.types import ComplexArray, FloatArray, InputError

#: Parameters of a factor: one array each, which broadcasts against s, so that many
#: parameter sets are evaluated at once with arrays of shape (sets, 1).
Values = Sequence[FloatArray]

#: A response or log-derivative; real where it does not depend on s.
Response = ComplexArray | FloatArray

#: Response of a factor, and its log-derivative by each of its parameters.
Evaluated = tuple[Response, tuple[Response, ...]]


@dataclass(frozen=True)
class Parameter:
    """One free parameter of a pilot model.

    Attributes
    ----------
    key
        Name in tables and files; parameters with equal keys are one parameter.
    unit
        Unit as printed, empty for a dimensionless parameter.
    lower, upper
        Bounds of the search.
    start
        Default initial guess, strictly inside the bounds.
    usual
        Range in which published values lie; random starts are drawn from it.
    positive
        Starts far from the default are drawn on a logarithmic scale.
    linear
        The response is proportional to this parameter, which lets a search
        solve for it instead of guessing it.
    delay
        It is a time delay, which a pilot cannot have negative.
    last
        It stands behind the others in tables and files, as neuromuscular parameters do.
    """

    key: str
    unit: str
    lower: float
    upper: float
    start: float
    usual: tuple[float, float]
    positive: bool = True
    linear: bool = False
    delay: bool = False
    last: bool = False

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[^\W\d_]\w{0,39}", self.key):
            raise ValueError(
                f"parameter {self.key!r}: the key must be a letter, followed by letters, digits "
                "and underscores"
            )
        least, most = self.usual
        inside = self.lower < self.start < self.upper and not (self.positive and self.lower <= 0.0)
        if not (inside and self.lower <= least < most <= self.upper):
            raise ValueError(
                f"parameter {self.key}: the start {self.start:g} and the usual range must lie "
                f"inside the bounds ({self.lower:g}, {self.upper:g}), and all of a positive one "
                "above zero"
            )


#: Step of central differences, as a share of the parameter: the cube root of the precision; and
#: the least value that it is a share of.
STEP, LEAST_VALUE = 6e-6, 1e-4


class Factor:
    """What a channel is a product of: a transfer function of some parameters.

    A factor of one's own derives from this class and must be hashable (a frozen dataclass).  It
    gives `parameters`, `response` and `rational`; the rest has defaults.
    """

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Free parameters, in the order in which `values` are passed."""
        return ()

    @property
    def fixed_poles(self) -> tuple[float, ...]:
        """Real poles that do not depend on parameters [rad/s, negative]."""
        return ()

    @property
    def ahead(self) -> str:
        """Key of the parameter that says how far the factor looks ahead [s], empty for none."""
        return ""

    @property
    def derivative(self) -> int:
        """Order n of a factor s^n: the channel acts on the n-th derivative of its input."""
        return 0

    def response(self, s: ComplexArray, values: Values) -> Response:
        """Transfer function at `s` [rad/s].

        Parameters
        ----------
        s
            Laplace variable [rad/s], shape (n,).
        values
            One array for each parameter, which broadcasts against `s`.

        Returns
        -------
        ComplexArray or FloatArray
            The response, of a shape that broadcasts to that of `s`.
        """
        raise NotImplementedError

    def rational(self, values: Sequence[float], pade_order: int) -> Rational:
        """Polynomials of the transfer function; a delay becomes a Pade approximant.

        Parameters
        ----------
        values
            A number for each parameter.
        pade_order
            Order of the approximant.

        Returns
        -------
        numerator, denominator
            Coefficients, highest power of s first.
        """
        raise NotImplementedError

    def seconds(self, values: Values) -> FloatArray | None:
        """T [s] of a factor e^{-T s}, which no rational function is; None for others.

        It has the shape of its parameter.
        """
        return None

    def response_and_slopes(self, s: ComplexArray, values: Values) -> Evaluated:
        """Response, and its log-derivative by each parameter: central differences.

        Parameters
        ----------
        s
            Laplace variable [rad/s], shape (n,).
        values
            One array for each parameter, which broadcasts against `s`.
        """
        response, slopes = self.response(s, values), []
        # Where there is no response, as of a washout at rest, its logarithm has no slope.
        inverse = 1.0 / np.where(response == 0.0, 1.0, response)
        for i, value in enumerate(values):
            step = STEP * np.maximum(np.abs(value), LEAST_VALUE)
            ahead, behind = (
                self.response(s, [*values[:i], value + offset, *values[i + 1 :]])
                for offset in (step, -step)
            )
            slopes.append((ahead - behind) * (inverse / (2.0 * step)))
        return response, tuple(slopes)


@dataclass(frozen=True)
class Held(Factor):
    """A factor some of whose parameters have fixed values, see `PilotModel.with_fixed`.

    Attributes
    ----------
    factor
        The factor.
    held
        The parameters that are not free, and their values.
    """

    factor: Factor
    held: tuple[tuple[Parameter, float], ...]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return tuple(p for p in self.factor.parameters if p not in dict(self.held))

    @property
    def fixed_poles(self) -> tuple[float, ...]:
        return self.factor.fixed_poles

    @property
    def ahead(self) -> str:
        return self.factor.ahead

    @cached_property
    def _constants(self) -> tuple[FloatArray | None, ...]:
        """The value of each parameter of the factor that is held, None of those that are free."""
        known = {parameter: np.asarray(value) for parameter, value in self.held}
        return tuple(map(known.get, self.factor.parameters))

    def _all(self, values: Sequence[Any]) -> list[Any]:
        """The values of all parameters."""
        free = iter(values)
        return [next(free) if constant is None else constant for constant in self._constants]

    def response(self, s: ComplexArray, values: Values) -> Response:
        return self.factor.response(s, self._all(values))

    def seconds(self, values: Values) -> FloatArray | None:
        return self.factor.seconds(self._all(values))

    def rational(self, values: Sequence[float], pade_order: int) -> Rational:
        return self.factor.rational([float(v) for v in self._all(values)], pade_order)


@dataclass(frozen=True)
class Gain(Factor):
    """A constant gain; its sign belongs to the channel, so it is positive.

    Attributes
    ----------
    key
        Key of the parameter.
    start
        Initial guess.
    unit
        Its unit, empty for none.
    bounds
        Bounds of the search.
    """

    key: str
    start: float = 1.0
    unit: str = ""
    bounds: tuple[float, float] = (1e-9, 1e9)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        usual = (0.1 * self.start, 10.0 * self.start)
        return (Parameter(self.key, self.unit, *self.bounds, self.start, usual, linear=True),)

    def response(self, s: ComplexArray, values: Values) -> FloatArray:
        return values[0]

    def response_and_slopes(self, s: ComplexArray, values: Values) -> Evaluated:
        return values[0], (1.0 / values[0],)

    def rational(self, values: Sequence[float], pade_order: int) -> Rational:
        return [float(values[0])], [1.0]


@dataclass(frozen=True)
class TimeFactor(Factor):
    """A factor with one parameter in seconds: `Lead`, `Lag`, `Delay`, `LookAhead`.

    Attributes
    ----------
    key
        Key of the parameter.
    start
        Initial guess [s].
    bounds, usual
        Bounds of the search, and the range of published values [s].
    """

    key: str
    start: float
    bounds: tuple[float, float]
    usual: tuple[float, float]
    is_delay: ClassVar[bool] = False

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        kind = {"positive": self.bounds[0] > 0.0 and not self.is_delay, "delay": self.is_delay}
        return (Parameter(self.key, "s", *self.bounds, self.start, self.usual, **kind),)


@dataclass(frozen=True)
class Lead(TimeFactor):
    """First-order lead 1 + T s."""

    key: str = "tlead"
    start: float = 1.0
    bounds: tuple[float, float] = (0.01, 30.0)
    usual: tuple[float, float] = (0.2, 5.0)

    def response(self, s: ComplexArray, values: Values) -> ComplexArray:
        return 1.0 + values[0] * s

    def response_and_slopes(self, s: ComplexArray, values: Values) -> Evaluated:
        response = self.response(s, values)
        return response, (s / response,)

    def rational(self, values: Sequence[float], pade_order: int) -> Rational:
        return [float(values[0]), 1.0], [1.0]


@dataclass(frozen=True)
class Lag(TimeFactor):
    """First-order lag 1 / (1 + T s)."""

    key: str = "tlag"
    start: float = 0.5
    bounds: tuple[float, float] = (1e-4, 30.0)
    usual: tuple[float, float] = (0.2, 5.0)

    def response(self, s: ComplexArray, values: Values) -> ComplexArray:
        return 1.0 / (1.0 + values[0] * s)

    def response_and_slopes(self, s: ComplexArray, values: Values) -> Evaluated:
        response = self.response(s, values)
        return response, (-s * response,)

    def rational(self, values: Sequence[float], pade_order: int) -> Rational:
        return [1.0], [float(values[0]), 1.0]


STRIDE = 32  # of the coarse grid of `exponential`


def exponential(seconds: FloatArray, s: ComplexArray) -> ComplexArray:
    """exp(seconds s), of the shapes (..., 1) and (n,).

    On an even grid, as that of a transform, a coarse and a fine grid are multiplied, for a product
    takes a tenth of the time of an exponential.
    """
    if s.size < 8 * STRIDE:
        return np.exp(seconds * s)
    steps = np.diff(s)
    if np.abs(steps - steps[0]).max() > 1e-9 * abs(steps[0]):
        return np.exp(seconds * s)
    coarse, fine = np.exp(seconds * s[::STRIDE]), np.exp(seconds * (steps[0] * np.arange(STRIDE)))
    products = coarse[..., :, None] * fine[..., None, :]
    return np.asarray(products.reshape(*coarse.shape[:-1], -1)[..., : s.size])


@dataclass(frozen=True)
class Delay(TimeFactor):
    """Pure time delay e^{-T s}, exact in frequency responses."""

    key: str = "tdvis"
    start: float = 0.25
    bounds: tuple[float, float] = (0.0, 1.0)
    usual: tuple[float, float] = (0.1, 0.5)
    is_delay = True

    def seconds(self, values: Values) -> FloatArray:
        return values[0]

    def response(self, s: ComplexArray, values: Values) -> ComplexArray:
        return exponential(-values[0], s)

    def response_and_slopes(self, s: ComplexArray, values: Values) -> Evaluated:
        return exponential(-values[0], s), (-s,)

    def rational(self, values: Sequence[float], pade_order: int) -> Rational:
        return pade(float(values[0]), pade_order)


@dataclass(frozen=True)
class LookAhead(TimeFactor):
    """What is seen T seconds before it comes: e^{+T s}, for targets displayed ahead.

    The upper bound is how much of the recording's end is not scored, for what was seen beyond it
    was not recorded.
    """

    key: str = "tlook"
    start: float = 0.5
    bounds: tuple[float, float] = (0.0, 2.0)
    usual: tuple[float, float] = (0.1, 1.2)

    @property
    def ahead(self) -> str:
        return self.key

    def seconds(self, values: Values) -> FloatArray:
        return -values[0]

    def response(self, s: ComplexArray, values: Values) -> ComplexArray:
        return exponential(values[0], s)

    def response_and_slopes(self, s: ComplexArray, values: Values) -> Evaluated:
        return exponential(values[0], s), (s,)

    def rational(self, values: Sequence[float], pade_order: int) -> Rational:
        raise InputError(
            "what is seen ahead has no transfer function: no system answers before its input"
        )


@dataclass(frozen=True)
class Differentiator(Factor):
    """s to a power: the channel sees a derivative of its input (2: acceleration).

    Attributes
    ----------
    order
        The power of s.
    """

    order: int = 1

    @property
    def derivative(self) -> int:
        return self.order

    def response(self, s: ComplexArray, values: Values) -> ComplexArray:
        return np.asarray(s**self.order)

    def rational(self, values: Sequence[float], pade_order: int) -> Rational:
        return [1.0] + [0.0] * self.order, [1.0]


class Fixed(Factor):
    """A transfer function without parameters, see `ratio`."""

    @property
    def ratio(self) -> Rational:
        """Numerator and denominator coefficients, highest power of s first."""
        raise NotImplementedError

    def response(self, s: ComplexArray, values: Values) -> ComplexArray:
        top, bottom = self.ratio
        return np.asarray(np.polyval(top, s) / np.polyval(bottom, s))

    def rational(self, values: Sequence[float], pade_order: int) -> Rational:
        return self.ratio


@dataclass(frozen=True)
class Canals(Fixed):
    """Semicircular canals (1 + tv1 s) / (1 + tv2 s), with fixed time constants.

    The defaults, 0.1 s and 6 s, are those of AIAA 2008-7109, Eq. (1).

    Attributes
    ----------
    tv1, tv2
        Time constants of lead and lag [s].
    """

    tv1: float = 0.1
    tv2: float = 6.0

    @property
    def fixed_poles(self) -> tuple[float, ...]:
        return (-1.0 / self.tv2,)

    @property
    def ratio(self) -> Rational:
        return [self.tv1, 1.0], [self.tv2, 1.0]


#: Pole in place of an integrator [rad/s], which no recording is long enough to tell from one.
ALMOST_INTEGRATOR = 0.01


@dataclass(frozen=True)
class Inverse(Fixed):
    """1/(s Hc(s)): what makes an integrator of a controlled element, but for its delay.

    Attributes
    ----------
    element
        The controlled element; None until a recording names it, and 1/s so long.
    """

    element: ControlledElement | None = None

    def __post_init__(self) -> None:
        if self.element is not None and any(np.real(np.roots(self.element.numerator)) >= 0.0):
            raise InputError(
                f"the inverse of {self.element.name or 'the controlled element'} is unstable, so "
                "that no pilot makes an integrator of it; choose a model that is given a form"
            )

    @property
    def ratio(self) -> Rational:
        if self.element is None:
            return [1.0], [1.0]
        top, bottom = list(self.element.denominator), list(self.element.numerator)
        if top[-1] == 0.0:
            return top[:-1], bottom
        return top, np.polymul(bottom, [1.0, ALMOST_INTEGRATOR]).tolist()

    @property
    def fixed_poles(self) -> tuple[float, ...]:
        is_gain = self.element is not None and self.element.denominator[-1] != 0.0
        return (-ALMOST_INTEGRATOR,) if is_gain else ()


@dataclass(frozen=True)
class Neuromuscular(Factor):
    """Second-order neuromuscular dynamics f^2 / (f^2 + 2 d f s + s^2).

    Attributes
    ----------
    frequency_key, damping_key
        Keys of the parameters; `PilotModel.overrides` changes their bounds and starts.
    """

    frequency_key: str = "fnm"
    damping_key: str = "dnm"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (
            Parameter(self.frequency_key, "rad/s", 2.0, 40.0, 10.0, (6.0, 20.0), last=True),
            Parameter(self.damping_key, "", 0.02, 3.0, 0.25, (0.1, 0.8), last=True),
        )

    def response(self, s: ComplexArray, values: Values) -> ComplexArray:
        f, d = values
        return f * f / (f * f + s * (s + 2.0 * d * f))

    def response_and_slopes(self, s: ComplexArray, values: Values) -> Evaluated:
        f, d = values
        ratio = s / f
        response = 1.0 / (1.0 + ratio * (ratio + 2.0 * d))
        by_damping = response * ratio
        by_damping *= -2.0
        return response, (by_damping * ((ratio + d) * (-1.0 / f)), by_damping)

    def rational(self, values: Sequence[float], pade_order: int) -> Rational:
        f, d = float(values[0]), float(values[1])
        return [f * f], [1.0, 2.0 * d * f, f * f]
