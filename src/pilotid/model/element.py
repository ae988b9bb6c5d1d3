"""Controlled elements: the dynamics that the pilot controls, x = Hc (u + fd)."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, reduce
from math import factorial
from operator import add, mul, sub, truediv
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pilotid.support.types import ComplexArray, FloatArray, InputError

if TYPE_CHECKING:
    import control


#: Numerator and denominator coefficients, highest power of s first.
Rational = tuple[list[float], list[float]]

LONGEST_TEXT = 200  # characters
HIGHEST_POWER = 12  # degree of a polynomial

#: Other signs for the same things; brackets of all kinds are round ones.
OTHER_SIGNS: dict[int, int | str] = {
    **str.maketrans("\N{MINUS SIGN}\N{MIDDLE DOT}\N{MULTIPLICATION SIGN}[{]}", "-**(())"),
    ord("\N{SUPERSCRIPT TWO}"): "^2",
    ord("\N{SUPERSCRIPT THREE}"): "^3",
}


@dataclass(frozen=True, eq=False)
class Ratio:
    """A ratio of polynomials with a pure delay, as far as it is read.

    Attributes
    ----------
    top, bottom
        Coefficients, highest power of s first, shapes (m + 1,) and (n + 1,).
    delay
        In seconds; negative inside an expression only.
    """

    top: NDArray[np.floating[Any]]
    bottom: NDArray[np.floating[Any]]
    delay: float = 0.0

    def __post_init__(self) -> None:
        if max(len(self.top), len(self.bottom)) > HIGHEST_POWER + 1:
            raise ValueError(f"it has powers of s above {HIGHEST_POWER}")
        if not (np.isfinite(self.top).all() and np.isfinite(self.bottom).all()):
            raise ValueError("a number is too large")

    @property
    def constant(self) -> float | None:
        """The number that it is, None if it has s or a delay in it."""
        is_number = len(self.top) == len(self.bottom) == 1 and not self.delay
        return float(self.top[0] / self.bottom[0]) if is_number else None

    def __neg__(self) -> Ratio:
        return Ratio(-self.top, self.bottom, self.delay)

    def __mul__(self, other: Ratio) -> Ratio:
        top, bottom = np.polymul(self.top, other.top), np.polymul(self.bottom, other.bottom)
        return Ratio(top, bottom, self.delay + other.delay)

    def __truediv__(self, other: Ratio) -> Ratio:
        if not other.top.any():
            raise ValueError("it divides by zero")
        return self * Ratio(other.bottom, other.top, -other.delay)

    def __add__(self, other: Ratio) -> Ratio:
        if self.delay != other.delay:
            raise ValueError("terms of a sum have different delays")
        if np.array_equal(self.bottom, other.bottom):
            return Ratio(np.polyadd(self.top, other.top), self.bottom, self.delay)
        mine, theirs = np.polymul(self.top, other.bottom), np.polymul(other.top, self.bottom)
        bottom = np.polymul(self.bottom, other.bottom)
        return Ratio(np.asarray(np.polyadd(mine, theirs), float), bottom, self.delay)

    def __sub__(self, other: Ratio) -> Ratio:
        return self + -other

    def __pow__(self, other: Ratio) -> Ratio:
        power = other.constant
        if power is None or not power.is_integer() or abs(power) > HIGHEST_POWER:
            raise ValueError(f"an exponent is no whole number up to {HIGHEST_POWER}")
        whole = reduce(mul, [self] * int(abs(power)), ONE)
        return whole if power >= 0 else ONE / whole

    def exponential(self) -> Ratio:
        """The delay that is e to this power."""
        top = np.trim_zeros(self.top, "f")
        if len(self.bottom) > 1 or self.delay or len(top) > 2 or (top.size and top[-1]):
            raise ValueError("a delay is e to a number of seconds times s, as in exp(-0.1s)")
        return Ratio(ONE.top, ONE.top, -float(top[0] / self.bottom[0]) if top.size else 0.0)


ONE = Ratio(np.ones(1), np.ones(1))
OPERATIONS: dict[type[ast.operator], Callable[[Ratio, Ratio], Ratio]] = {
    ast.Add: add, ast.Sub: sub, ast.Mult: mul, ast.MatMult: mul, ast.Div: truediv, ast.Pow: pow,
}  # fmt: skip


def transfer_function(text: str) -> ControlledElement:
    """The ratio of polynomials with a delay that a text describes.

    What stands before an equals sign, as in ``Hc(s) = 4/s^2``, is left out.

    Raises
    ------
    ValueError
        If it is none that a controlled element can have; says where and why, without the text.
    """
    if len(text) > LONGEST_TEXT:
        raise ValueError(f"it is longer than {LONGEST_TEXT} characters")
    source = text.rpartition("=")[2].translate(OTHER_SIGNS).lower().replace("^", "**").strip()
    if not source:
        raise ValueError("it is empty")
    ratio = _evaluate(_parse(source))
    if not ratio.top.any():
        raise ValueError("it is zero")
    if ratio.delay < 0.0:
        raise ValueError("its delay is negative: write exp(-0.1s) for one of 0.1 s")
    name = re.sub(r"\s", "", text.rpartition("=")[2])
    top, bottom = tuple(ratio.top.tolist()), tuple(ratio.bottom.tolist())
    return ControlledElement(top, bottom, ratio.delay, name)


def _parse(source: str) -> ast.expr:
    """The expression in a text: `b()` stands for brackets, `@` between factors side by side."""
    source = re.sub(r"e\s*\*\*\s*\(", "exp(", source)
    source = re.sub(r"(?<=[\d.s)])\s*(?=exp|s|\()", "@", source)
    source = re.sub(r"(?<!exp)\(", "b(", source)
    try:
        return ast.parse(source, mode="eval").body
    except (SyntaxError, MemoryError) as error:
        rest = source[(getattr(error, "offset", None) or 1) - 1 :]
        raise ValueError(
            f"a sign, a number or a bracket is missing at {_written(rest) if rest else 'its end'}"
        ) from None


def _written(source: str) -> str:
    """The beginning of a part as users write it."""
    text = source.replace("b(", "(").replace("**", "^").replace("@", "").replace(" ", "")
    return f"'{text[:12]}'"


def _evaluate(node: ast.expr) -> Ratio:
    """What an expression is."""
    match node:
        case ast.Constant(value=int() | float() as value):
            return Ratio(np.array([float(value)]), np.ones(1))
        case ast.Name(id="s"):
            return Ratio(np.array([1.0, 0.0]), np.ones(1))
        case ast.UnaryOp(op=ast.UAdd() | ast.USub() as sign, operand=part):
            return -_evaluate(part) if isinstance(sign, ast.USub) else _evaluate(part)
        case ast.Call(func=ast.Name(id="exp"), args=[part]):
            return _evaluate(part).exponential()
        case ast.Call(func=ast.Name(id="b"), args=[part]):
            return _evaluate(part)
        case ast.BinOp(left=ast.BinOp(op=ast.Div()), op=ast.MatMult(), right=right):
            raise ValueError(
                f"{_written(ast.unparse(right))} may be meant above or below the fraction line: "
                "put what is below it in brackets"
            )
        case ast.BinOp(left=left, op=sign, right=right) if type(sign) in OPERATIONS:
            return OPERATIONS[type(sign)](_evaluate(left), _evaluate(right))
    raise ValueError(f"{_written(ast.unparse(node))} is no number, s or bracket")


@dataclass(frozen=True)
class ControlledElement:
    """A rational transfer function with an optional pure delay.

    Attributes
    ----------
    numerator, denominator
        Polynomial coefficients, highest power of s first.
    delay
        Pure time delay [s]; negative for an element fitted to a control that is late.
    name
        As printed in reports.
    """

    numerator: tuple[float, ...]
    denominator: tuple[float, ...]
    delay: float = 0.0
    name: str = ""

    def __post_init__(self) -> None:
        if len(self.numerator) > len(self.denominator) or self.denominator[0] == 0.0:
            raise ValueError("it has more zeros than poles, or a zero for the highest power of s")

    def response(self, omega: FloatArray) -> ComplexArray:
        """Frequency response at `omega` [rad/s], shape (n,)."""
        s = 1j * np.asarray(omega, dtype=float)
        ratio = np.polyval(self.numerator, s) / np.polyval(self.denominator, s)
        return np.asarray(ratio * np.exp(-self.delay * s))

    def rational(self, pade_order: int = 5) -> control.TransferFunction:
        """As a python-control transfer function; a delay becomes a Pade approximant."""
        import control

        top, bottom = pade(self.delay, pade_order)
        return control.TransferFunction(
            np.polymul(self.numerator, top), np.polymul(self.denominator, bottom)
        )


def pade(delay: float, order: int) -> Rational:
    """Pade approximant of a delay [s], of equal order above and below, as python-control's.

    A negative delay gives the reciprocal approximant, which is unstable.  Source: Golub & Van
    Loan, Matrix Computations, 4th ed., sec. 9.3.1; python-control takes longer to import than a
    fit takes.
    """
    if delay == 0.0:
        return [1.0], [1.0]
    size = abs(delay)
    falling = range(order, -1, -1)
    below = [
        factorial(2 * order - k) / (factorial(k) * factorial(order - k)) * size ** (k - order)
        for k in falling
    ]
    above = [(-1.0) ** k * coefficient for k, coefficient in zip(falling, below, strict=True)]
    return (above, below) if delay > 0.0 else (below, above)


def parsed_element(text: str) -> ControlledElement | None:
    """The controlled element that a text describes; None for any other text.

    See `pilotid.model.element` for what can be written.
    """
    try:
        return element_named(text)
    except InputError:
        return None


@lru_cache(maxsize=64)
def element_named(text: str) -> ControlledElement:
    """As `parsed_element`; `InputError` for a text that is none, which says where."""
    try:
        return transfer_function(text)
    except ValueError as error:
        raise InputError(
            f"the controlled element '{text}' cannot be read: {error}; write for example 4/s^2 or "
            "4 exp(-0.05s)/(s(1+s/30)^2)"
        ) from None


def as_element(element: ControlledElement | str) -> ControlledElement:
    """A controlled element, or the one that a text names."""
    return element_named(element) if isinstance(element, str) else element
