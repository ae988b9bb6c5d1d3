"""Forms that a controlled element may have, their parameters and their names."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pilotid.pilot.element import ControlledElement
from pilotid.support.types import ComplexArray, FloatArray

LONG = 9  # decimals, or zeros, that are written out
DIFFERENCE = 1e-7  # relative step of the differences


@dataclass(frozen=True)
class Form:
    """K (s + z) e^{-delay s} / (s^k (s^d + a1 s^(d-1) + ..) (1 + s/b)^2), or parts of it.

    Attributes
    ----------
    integrators
        k.
    free
        Degree d of the free polynomial.
    lags
        Whether there are two equal lags.
    zero
        Whether there is a zero.
    """

    integrators: int
    free: int = 0
    lags: bool = False
    zero: bool = False

    @property
    def units(self) -> dict[str, str]:
        """Parameters, the delay last, and their units but for that of the gain."""
        zero, lags = {"z": "rad/s"} if self.zero else {}, {"b": "rad/s"} if self.lags else {}
        powers = ["rad/s", *(f"rad^{n}/s^{n}" for n in range(2, self.free + 1))][: self.free]
        free = {f"a{n}" if self.free > 1 else "a": unit for n, unit in enumerate(powers, 1)}
        return {"K": "", **zero, **free, **lags, "delay": "s"}

    def polynomials(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Numerator and denominator, highest power first."""
        begin = 1 + self.zero
        bottom = np.array([1.0, *values[begin : begin + self.free]])
        if self.lags:
            b = values[-2]
            bottom = np.convolve(bottom, [1.0 / b**2, 2.0 / b, 1.0])
        top = values[0] * np.array([1.0, *values[1:begin]])
        return top, np.concatenate([bottom, np.zeros(self.integrators)])

    def response(self, values: FloatArray, omega: FloatArray) -> ComplexArray:
        """Frequency response at `omega` [rad/s], shape (n,)."""
        top, bottom = (np.polyval(p, 1j * omega) for p in self.polynomials(values))
        return np.asarray(top / bottom * np.exp(-1j * omega * values[-1]))

    def response_error(
        self, values: FloatArray, covariance: FloatArray, omega: FloatArray
    ) -> FloatArray:
        """Relative standard error of the frequency response, shape (n,)."""
        response = self.response(values, omega)
        slopes = differences(lambda v: self.response(v, omega), values, response) / response
        power = np.einsum("in,ij,jn->n", slopes.conj(), covariance, slopes)
        return np.asarray(np.sqrt(np.abs(power.real)))

    def element(self, values: FloatArray, digits: tuple[int, ...]) -> ControlledElement:
        """The element with a name that `element_named` reads.

        Parameters
        ----------
        values
            The parameters, with a delay that is not negative.
        digits
            Decimals of each, negative for zeros before the point.
        """
        numbers = [_number(v, d) for v, d in zip(values.tolist(), digits, strict=True)]
        rounded = np.array([float(n) for n in numbers])
        shown = dict(zip(self.units, numbers, strict=True))
        top, bottom = self.polynomials(rounded)
        return ControlledElement(
            tuple(top.tolist()), tuple(bottom.tolist()), float(rounded[-1]), self._name(shown)
        )

    def _name(self, shown: dict[str, str]) -> str:
        delay, powers = shown["delay"], [f"s^{n}" if n > 1 else "s" * n for n in range(6)]
        top = shown["K"] + (f"(s{_signed(shown['z'])})" if self.zero else "")
        top += f"exp(-{delay}s)" if float(delay) else ""
        keys = [key for key in self.units if key.startswith("a")]
        terms = [_signed(shown[k]) + powers[self.free - n] for n, k in enumerate(keys, 1)]
        free = f"({powers[self.free]}{''.join(terms)})" if self.free else ""
        lags = f"(1+s/{shown['b']})^2" if self.lags else ""
        bottom = powers[self.integrators] + free + lags
        alone = bottom in ("", powers[self.integrators], free)
        return top + (bottom and f"/{bottom}" if alone else f"/({bottom})")

    def __str__(self) -> str:
        return self._name({**{key: key for key in self.units}, "delay": "0"})


def differences(
    function: Callable[[FloatArray], ComplexArray], values: FloatArray, there: ComplexArray
) -> ComplexArray:
    """Derivatives by each value, shape (values, n), of a function that is `there` (n,) at them."""
    steps = DIFFERENCE * np.maximum(np.abs(values), 1e-2) * np.eye(len(values))
    return np.array([(function(values + step) - there) / step.sum() for step in steps])


def _number(value: float, decimals: int) -> str:
    """A number with so many decimals, an exponent where it would be long."""
    if not -LONG <= decimals <= LONG:
        return f"{value:.6g}"
    text = f"{round(value, decimals):.{max(decimals, 0)}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def _signed(number: str) -> str:
    return number if number.startswith("-") else f"+{number}"


#: From the simplest on.
FORMS = (
    *(Form(k, free) for k, free in ((0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (2, 1))),
    *(Form(k, free) for k, free in ((0, 2), (1, 2), (0, 3))),
    *(Form(k, free, lags=True) for k, free in ((0, 0), (1, 0), (2, 0), (0, 1), (0, 2))),
    *(Form(k, free, zero=True) for k, free in ((1, 0), (2, 0), (0, 1), (1, 1))),
    *(Form(k, free, zero=True) for k, free in ((0, 2), (1, 2), (0, 3))),
)
