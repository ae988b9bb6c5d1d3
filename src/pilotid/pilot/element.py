"""Controlled elements: the dynamics that the pilot controls, x = Hc (u + fd)."""

from __future__ import annotations

import ast
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pilotid.types import ComplexArray, FloatArray, InputError

if TYPE_CHECKING:
    import control


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
TOKEN = re.compile(
    r"\s*((?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+(?![.\d]))?|exp|e(?=\s*(?:\^|\*\*))|s|\*\*|[-+*/^()])"
)
NEEDED = "stands where a number, s or a bracket is needed"
IN_BRACKETS = "must be in brackets, as in exp(-0.1s)"
NO_DELAY = "is no number of seconds times s, as in exp(-0.1s)"


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
    before, sign, rest = text.rpartition("=")
    found = _Text((" " * len(before + sign) + rest.translate(SAME).lower()).rstrip()).ratio()
    if not found.top.any():
        raise NotTransferFunctionError("it is zero")
    if len(found.top) > len(found.bottom):
        raise NotTransferFunctionError("it has more zeros than poles, which no element has")
    if found.delay < 0.0:
        raise NotTransferFunctionError("its delay is negative: write exp(-0.1s) for one of 0.1 s")
    return found


class _Text:
    """A text, the same in Python's syntax, and the place in it of each sign of that."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.source = ""
        self.places: list[int] = []
        before, at = "", 0
        divided = [False]  # by brackets that are open: whether the last sign was one of division
        while at < len(text):
            match = TOKEN.match(text, at)
            if match is None:
                at += len(text[at:]) - len(text[at:].lstrip())
                raise self.fault(at, "is nothing that a transfer function of s has")
            word, at = match[1], match.start(1)
            if re.fullmatch(r"[\d.].*|s|\)", before) and re.fullmatch(r"[\d.].*|exp|[se(]", word):
                if word[0] in ".0123456789":
                    raise self.fault(at, "is a number where a sign is needed")
                if divided[-1]:
                    raise self.fault(
                        at,
                        "may be meant above or below the fraction line: put what is below it in "
                        "brackets",
                    )
                self._add("*", at)
            if self.source.endswith("e ** ") and word != "(":
                raise self.fault(at, IN_BRACKETS)
            if word in ("/", "*", "+", "-"):
                divided[-1] = word == "/"
            if word in "()":
                divided = [*divided, False] if word == "(" else divided[:-1] or [False]
            self._add(str(int(word)) if word.isdigit() else word.replace("^", "**"), at)
            before, at = word, match.end()
        if not before:
            raise NotTransferFunctionError("it is empty")
        if before in ("+", "-", "*", "/", "^", "**"):
            raise NotTransferFunctionError("it ends where a number, s or a bracket is needed")

    def _add(self, word: str, place: int) -> None:
        self.source += f"{word} "
        self.places += [place] * (len(word) + 1)

    def fault(self, place: int, what: str) -> NotTransferFunctionError:
        """A sentence that shows the place."""
        rest = self.text[place : place + 12]
        return NotTransferFunctionError(f"at character {place + 1}, '{rest}' {what}")

    def ratio(self) -> Ratio:
        """The ratio that it describes."""
        try:
            return self.walk(ast.parse(self.source, mode="eval").body)
        except SyntaxError as error:
            place = self.places[min(error.offset or 1, len(self.places)) - 1]
            what = NEEDED if error.msg == "invalid syntax" else f"({error.msg})"
            raise self.fault(place, what) from None

    def walk(self, node: ast.expr) -> Ratio:
        """The ratio of a part."""
        match node:
            case ast.Constant(value=int() | float() as value):
                if not np.isfinite(value):
                    raise self.fault(self.places[node.col_offset], "is too large a number")
                return _constant(float(value))
            case ast.Name(id="s"):
                return Ratio(np.array([1.0, 0.0]), np.ones(1))
            case ast.UnaryOp(op=ast.USub() | ast.UAdd() as sign, operand=part):
                return _times(_constant(_sign(sign)), self.walk(part))
            case ast.BinOp(left=ast.Name(id="e"), op=ast.Pow(), right=part):
                return self.exponential(part)
            case ast.Call(func=ast.Name(id="exp"), args=[part]):
                return self.exponential(part)
            case ast.BinOp(left=left, op=ast.Pow(), right=right):
                return _power(self.walk(left), self.exponent(right))
            case ast.BinOp(left=left, op=ast.Mult(), right=right):
                return _times(self.walk(left), self.walk(right))
            case ast.BinOp(left=left, op=ast.Div(), right=right):
                return _times(self.walk(left), _inverse(self.walk(right)))
            case ast.BinOp(left=left, op=ast.Add() | ast.Sub() as sign, right=right):
                return _plus(self.walk(left), self.walk(right), _sign(sign))
        what = IN_BRACKETS if isinstance(node, ast.Name) else NEEDED
        raise self.fault(self.places[node.col_offset], what)

    def exponent(self, node: ast.expr) -> int:
        """A whole exponent."""
        match node:
            case ast.Constant(value=int() as value) if value <= HIGHEST:
                return value
            case ast.UnaryOp(op=ast.USub() | ast.UAdd() as sign, operand=part):
                return int(_sign(sign)) * self.exponent(part)
        raise self.fault(self.places[node.col_offset], f"is no whole exponent up to {HIGHEST}")

    def exponential(self, node: ast.expr) -> Ratio:
        """What follows exp, or e^: a number of seconds times s."""
        power = self.walk(node)
        top = np.trim_zeros(power.top, "f")
        if len(power.bottom) > 1 or power.delay or len(top) > 2 or (top.size and top[-1]):
            raise self.fault(self.places[node.col_offset], NO_DELAY)
        delay = -float(top[0] / power.bottom[0]) if top.size else 0.0
        return Ratio(np.ones(1), np.ones(1), delay)


def _sign(operator: ast.AST) -> float:
    return -1.0 if isinstance(operator, ast.Sub | ast.USub) else 1.0


def _constant(value: float) -> Ratio:
    return Ratio(np.array([value]), np.ones(1))


def _ratio(above: NDArray[Any], below: NDArray[Any], delay: float) -> Ratio:
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


def _power(base: Ratio, exponent: int) -> Ratio:
    base = base if exponent >= 0 else _inverse(base)
    result = _constant(1.0)
    for _ in range(abs(exponent)):
        result = _times(result, base)
    return result


def _plus(a: Ratio, b: Ratio, sign: float) -> Ratio:
    if a.delay != b.delay:
        raise NotTransferFunctionError("terms of a sum have different delays")
    if np.array_equal(a.bottom, b.bottom):
        return _ratio(np.polyadd(a.top, sign * b.top), a.bottom, a.delay)
    top = np.polyadd(np.polymul(a.top, b.bottom), sign * np.polymul(b.top, a.bottom))
    return _ratio(top, np.polymul(a.bottom, b.bottom), a.delay)


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

        from pilotid.pilot.factors import pade

        top, bottom = pade(self.delay, pade_order)
        return control.TransferFunction(
            np.polymul(self.numerator, top), np.polymul(self.denominator, bottom)
        )


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


def from_control(system: control.TransferFunction, delay: float = 0.0) -> ControlledElement:
    """Any continuous single-input single-output transfer function of python-control.

    Parameters
    ----------
    system
        A transfer function, or a state space.
    delay
        Pure time delay in series with it [s].
    """
    if not system.issiso() or (system.dt not in (0, None)):
        raise ValueError("the controlled element must be continuous, with one input and one output")
    import control

    system = control.tf(system)  # from a state space too
    return ControlledElement(
        tuple(float(c) for c in system.num[0][0]),
        tuple(float(c) for c in system.den[0][0]),
        delay,
        "user-defined",
    )


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

    See `pilotid.pilot.element` for what can be written.
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
