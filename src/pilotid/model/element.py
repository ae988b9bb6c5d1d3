"""Controlled elements: the dynamics that the pilot controls, x = Hc (u + fd)."""

from __future__ import annotations

import ast
import re
from dataclasses import dataclass
from functools import reduce
from math import factorial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pilotid.support.types import ComplexArray, FloatArray, InputError

if TYPE_CHECKING:
    import control


#: Numerator and denominator coefficients, highest power of s first.
Rational = tuple[list[float], list[float]]

LONGEST = 200  # characters
HIGHEST = 12  # degree of a polynomial

#: Other signs for the same things; brackets of all kinds are round ones.
SAME = str.maketrans(
    {
        "\N{MINUS SIGN}": "-",
        "\N{MIDDLE DOT}": "*",
        "\N{MULTIPLICATION SIGN}": "*",
        "\N{SUPERSCRIPT TWO}": "^2",
        "\N{SUPERSCRIPT THREE}": "^3",
        **dict.fromkeys("[{", "("),
        **dict.fromkeys("]}", ")"),
    }
)


class NotTransferFunctionError(Exception):
    """A text is no transfer function; says where and why, without the text."""


@dataclass(frozen=True, eq=False)
class Ratio:
    """A ratio of polynomials with a pure delay.

    Attributes
    ----------
    top, bottom
        Coefficients, highest power of s first, shapes (m + 1,) and (n + 1,).
    delay
        In seconds; negative inside an expression only.
    """

    top: FloatArray
    bottom: FloatArray
    delay: float = 0.0


def transfer_function(text: str) -> Ratio:
    """The ratio of polynomials, and the delay, that a text describes.

    What stands before an equals sign, as in ``Hc(s) = 4/s^2``, is left out.

    Raises
    ------
    NotTransferFunctionError
        If it is none that a controlled element can have.
    """
    if len(text) > LONGEST:
        raise NotTransferFunctionError(f"it is longer than {LONGEST} characters")
    source = text.rpartition("=")[2].translate(SAME).lower().replace("^", "**")
    if not source.strip():
        raise NotTransferFunctionError("it is empty")
    found = _evaluate(_parse(source))
    if not found.top.any():
        raise NotTransferFunctionError("it is zero")
    if len(found.top) > len(found.bottom):
        raise NotTransferFunctionError("it has more zeros than poles, which no element has")
    if found.delay < 0.0:
        raise NotTransferFunctionError("its delay is negative: write exp(-0.1s) for one of 0.1 s")
    return found


def _parse(source: str) -> ast.expr:
    """The expression in a text: `b()` stands for brackets, `@` between factors side by side."""
    allowed = re.match(r"(?:exp|[-+*/().\s0-9es])*", source)
    if allowed is not None and allowed.end() < len(source):
        strange = _written(source[allowed.end() :])
        raise NotTransferFunctionError(f"{strange} is nothing that a transfer function of s has")
    source = re.sub(r"(?<=[\d.s)])\s*(?=exp|e\s*\*\*|s|\()", "@", source)
    source = re.sub(r"(?<!exp)\(", "b(", re.sub(r"(?<![\d.])0+(?=\d)", "", source))
    try:
        return ast.parse(source.strip(), mode="eval").body
    except (SyntaxError, MemoryError) as error:
        rest = source.strip()[(getattr(error, "offset", None) or 1) - 1 :]
        raise NotTransferFunctionError(
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
            return _ratio(np.array([float(value)]), np.ones(1))
        case ast.Name(id="s"):
            return Ratio(np.array([1.0, 0.0]), np.ones(1))
        case ast.UnaryOp(op=sign, operand=part):
            return _times(_evaluate(part), SIGNS[type(sign)])
        case (
            ast.Call(func=ast.Name(id="exp"), args=[part])
            | ast.BinOp(left=ast.Name("e"), op=ast.Pow(), right=ast.Call(ast.Name("b"), [part]))
        ):
            return _delay(_evaluate(part))
        case ast.Call(func=ast.Name(id="b"), args=[part]):
            return _evaluate(part)
        case ast.BinOp(left=left, op=ast.Pow(), right=right):
            return _power(_evaluate(left), _evaluate(right), right)
        case ast.BinOp(left=ast.BinOp(op=ast.Div()), op=ast.MatMult(), right=right):
            raise NotTransferFunctionError(
                f"{_written(ast.unparse(right))} may be meant above or below the fraction line: "
                "put what is below it in brackets"
            )
        case ast.BinOp(left=left, op=ast.Mult() | ast.MatMult(), right=right):
            return _times(_evaluate(left), _evaluate(right))
        case ast.BinOp(left=left, op=ast.Div(), right=right):
            return _times(_evaluate(left), _inverse(_evaluate(right)))
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub() as sign, right=right):
            return _plus(_evaluate(left), _times(_evaluate(right), SIGNS[type(sign)]))
    raise NotTransferFunctionError(f"{_written(ast.unparse(node))} is no number, s or bracket")


def _delay(power: Ratio) -> Ratio:
    """The delay that is e to some power."""
    top = np.trim_zeros(power.top, "f")
    if len(power.bottom) > 1 or power.delay or len(top) > 2 or (top.size and top[-1]):
        raise NotTransferFunctionError(
            "a delay is e to a number of seconds times s, as in exp(-0.1s)"
        )
    return Ratio(np.ones(1), np.ones(1), -float(top[0] / power.bottom[0]) if top.size else 0.0)


def _ratio(above: NDArray[Any], below: NDArray[Any], delay: float = 0.0) -> Ratio:
    top, bottom = (np.atleast_1d(np.asarray(p, dtype=float)) for p in (above, below))
    if max(len(top), len(bottom)) > HIGHEST + 1:
        raise NotTransferFunctionError(f"it has powers of s above {HIGHEST}")
    if not (np.isfinite(top).all() and np.isfinite(bottom).all()):
        raise NotTransferFunctionError("a number is too large")
    return Ratio(top, bottom, delay)


def _times(a: Ratio, b: Ratio) -> Ratio:
    return _ratio(np.polymul(a.top, b.top), np.polymul(a.bottom, b.bottom), a.delay + b.delay)


def _inverse(a: Ratio) -> Ratio:
    if not a.top.any():
        raise NotTransferFunctionError("it divides by zero")
    return Ratio(a.bottom, a.top, -a.delay)


def _power(base: Ratio, power: Ratio, node: ast.expr) -> Ratio:
    exponent = float(power.top[0] / power.bottom[0])
    number = len(power.top) == len(power.bottom) == 1 and not power.delay
    if not (number and exponent.is_integer() and abs(exponent) <= HIGHEST):
        told = f"{_written(ast.unparse(node))} is no whole exponent up to {HIGHEST}"
        raise NotTransferFunctionError(told)
    base = base if exponent >= 0 else _inverse(base)
    return reduce(_times, [base] * int(abs(exponent)), SIGNS[ast.UAdd])


def _plus(a: Ratio, b: Ratio) -> Ratio:
    if a.delay != b.delay:
        raise NotTransferFunctionError("terms of a sum have different delays")
    if np.array_equal(a.bottom, b.bottom):
        return _ratio(np.polyadd(a.top, b.top), a.bottom, a.delay)
    top = np.polyadd(np.polymul(a.top, b.bottom), np.polymul(b.top, a.bottom))
    return _ratio(top, np.polymul(a.bottom, b.bottom), a.delay)


#: What a sign multiplies by.
SIGNS: dict[type[ast.AST], Ratio] = {
    kind: Ratio(np.array([value]), np.ones(1))
    for kind, value in {ast.Add: 1.0, ast.UAdd: 1.0, ast.Sub: -1.0, ast.USub: -1.0}.items()
}


@dataclass(frozen=True)
class ControlledElement:
    """A rational transfer function with an optional pure delay.

    Attributes
    ----------
    numerator, denominator
        Polynomial coefficients, highest power of s first.
    delay
        Pure time delay [s].
    name
        As printed in reports.
    """

    numerator: tuple[float, ...]
    denominator: tuple[float, ...]
    delay: float = 0.0
    name: str = ""

    def __post_init__(self) -> None:
        if len(self.numerator) > len(self.denominator) or self.denominator[0] == 0.0:
            raise ValueError(f"controlled element {self.name}: must be a proper transfer function")
        if self.delay < 0.0:
            raise ValueError(f"controlled element {self.name}: a delay cannot be negative")

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


def position_control(gain: float) -> ControlledElement:
    """K: the output follows the control."""
    return ControlledElement((gain,), (1.0,), name=f"{gain:g}")


def single_integrator(gain: float) -> ControlledElement:
    """K/s: rate control."""
    return ControlledElement((gain,), (1.0, 0.0), name=f"{gain:g}/s")


def double_integrator(gain: float) -> ControlledElement:
    """K/s^2: acceleration control."""
    return ControlledElement((gain,), (1.0, 0.0, 0.0), name=f"{gain:g}/s^2")


def integrator_with_lag(gain: float, break_frequency: float) -> ControlledElement:
    """K/(s (s + a)), with a in rad/s: between rate and acceleration control.

    Parameters
    ----------
    gain
        K, in units of x over those of u, times rad^2/s^2.
    break_frequency
        a [rad/s].
    """
    return ControlledElement(
        (gain,), (1.0, break_frequency, 0.0), name=f"{gain:g}/(s(s{break_frequency:+g}))"
    )


def second_order(gain: float, frequency: float, damping: float) -> ControlledElement:
    """K/(s^2 + 2 z w s + w^2), with its natural frequency w in rad/s and its damping z.

    Parameters
    ----------
    gain
        K, in units of x over those of u, times rad^2/s^2.
    frequency
        w [rad/s].
    damping
        z [-].
    """
    bottom = (1.0, 2.0 * damping * frequency, frequency**2)
    name = f"{gain:g}/(s^2{bottom[1]:+g}s{bottom[2]:+g})"
    return ControlledElement((gain,), bottom, name=name)


def _well_known(found: Ratio) -> ControlledElement | None:
    """One of the forms that have a function of their own here, so that its name is theirs."""
    top, bottom = found.top.tolist(), found.bottom.tolist()
    if len(top) > 1 or bottom[0] != 1.0 or found.delay:
        return None
    match bottom[1:]:
        case []:
            return position_control(top[0])
        case [0.0]:
            return single_integrator(top[0])
        case [0.0, 0.0]:
            return double_integrator(top[0])
        case [a, 0.0]:
            return integrator_with_lag(top[0], a)
    return None


def parsed_element(text: str) -> ControlledElement | None:
    """The controlled element that a text describes; None for any other text.

    See `pilotid.model.element` for what can be written.
    """
    try:
        return element_named(text)
    except InputError:
        return None


def element_named(text: str) -> ControlledElement:
    """As `parsed_element`; `InputError` for a text that is none, which says where."""
    try:
        found = transfer_function(text)
    except NotTransferFunctionError as error:
        raise InputError(
            f"the controlled element '{text}' cannot be read: {error}; write for example 4/s^2 or "
            "4 exp(-0.05s)/(s(1+s/30)^2)"
        ) from None
    known = _well_known(found)
    if known is not None:
        return known
    name = re.sub(r"\s", "", text.rpartition("=")[2])
    top, bottom = found.top.tolist(), found.bottom.tolist()
    return ControlledElement(tuple(top), tuple(bottom), found.delay, name)


def as_element(element: ControlledElement | str) -> ControlledElement:
    """A controlled element, or the one that a text names."""
    return element_named(element) if isinstance(element, str) else element
