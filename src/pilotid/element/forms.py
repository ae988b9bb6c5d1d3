"""Forms that a controlled element may have, their parameters and their names."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pilotid.pilot.element import ControlledElement
from pilotid.types import FloatArray

LONG = 9  # decimals, or zeros, that are written out


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
    def order(self) -> int:
        """Degree of the denominator."""
        return self.integrators + self.free + 2 * self.lags

    @property
    def keys(self) -> tuple[str, ...]:
        """Names of the parameters; the delay is the last."""
        free = tuple(f"a{i + 1}" for i in range(self.free)) if self.free > 1 else ("a",)
        return (
            "K",
            *(("z",) if self.zero else ()),
            *(free if self.free else ()),
            *(("b",) if self.lags else ()),
            "delay",
        )

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the parameters but for that of the gain, which depends on the recording's."""
        free = ("rad/s", "rad^2/s^2", "rad^3/s^3", "rad^4/s^4")[: self.free]
        return ("", *(("rad/s",) * self.zero), *free, *(("rad/s",) * self.lags), "s")

    def split(self, values: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Numerator, free polynomial and lags, each from its highest power down."""
        begin = 1 + self.zero
        top = values[0] * np.array([1.0, values[1]]) if self.zero else values[:1]
        free = np.concatenate(([1.0], values[begin : begin + self.free]))
        b = values[begin + self.free] if self.lags else 1.0
        lags = np.array([1.0 / b**2, 2.0 / b, 1.0]) if self.lags else np.ones(1)
        return top, free, lags

    def polynomials(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Numerator and denominator, highest power first."""
        top, free, lags = self.split(values)
        bottom = np.convolve(np.convolve(free, lags), [1.0] + [0.0] * self.integrators)
        return top, bottom

    def slopes(self, values: FloatArray) -> tuple[list[FloatArray], list[FloatArray]]:
        """Derivatives of both polynomials by each parameter but the delay.

        Those of the numerator are by the first parameters, those of the denominator by the
        rest.
        """
        top, free, lags = self.split(values)
        above = [top / values[0]] + ([np.array([0.0, values[0]])] if self.zero else [])
        power = np.array([1.0] + [0.0] * self.integrators)
        below = []
        for i in range(self.free):
            one = np.zeros(self.free + 1)
            one[i + 1] = 1.0
            below.append(np.convolve(np.convolve(one, lags), power))
        if self.lags:
            b = values[1 + self.zero + self.free]
            slope = np.array([-2.0 / b**3, -2.0 / b**2, 0.0])
            below.append(np.convolve(np.convolve(free, slope), power))
        return above, below

    def response_error(
        self, values: FloatArray, covariance: FloatArray, omega: FloatArray
    ) -> FloatArray:
        """Relative standard error of the frequency response, shape (n,)."""
        s = 1j * omega
        top, bottom = (np.polyval(p, s) for p in self.polynomials(values))
        above, below = self.slopes(values)
        slopes = [np.polyval(p, s) / top for p in above] + [
            -np.polyval(p, s) / bottom for p in below
        ]
        gradient = np.array([*slopes, -s])
        power = np.einsum("in,ij,jn->n", gradient.conj(), covariance, gradient)
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
        shown = dict(zip(self.keys, numbers, strict=True))
        top, bottom = self.polynomials(rounded)
        return ControlledElement(
            tuple(top.tolist()), tuple(bottom.tolist()), float(rounded[-1]), self._name(shown)
        )

    def _name(self, shown: dict[str, str]) -> str:
        delay = shown["delay"]
        top = shown["K"] + (f"(s{_signed(shown['z'])})" if self.zero else "")
        top += f"exp(-{delay}s)" if float(delay) else ""
        parts = []
        if self.integrators:
            parts.append("s" if self.integrators == 1 else f"s^{self.integrators}")
        if self.free:
            powers = [f"s^{n}" if n > 1 else "s" * n for n in range(self.free, -1, -1)]
            keys = self.keys[1 + self.zero : 1 + self.zero + self.free]
            terms = [_signed(shown[k]) + p for k, p in zip(keys, powers[1:], strict=True)]
            parts.append(f"({powers[0]}{''.join(terms)})")
        if self.lags:
            parts.append(f"(1+s/{shown['b']})^2")
        if not parts:
            return top
        alone = len(parts) == 1 and not (self.lags and not self.integrators and not self.free)
        return f"{top}/{parts[0]}" if alone else f"{top}/({''.join(parts)})"

    def __str__(self) -> str:
        keys = {key: key for key in self.keys}
        return self._name({**keys, "delay": "0"})


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
