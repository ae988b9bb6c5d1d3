"""Transfer functions as people write them: ``4 exp(-0.05s)/(s(1+s/30)^2)``.

The text is put into Python's syntax, parsed by `ast` and walked; nothing is evaluated.
"""

from __future__ import annotations

import ast
import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pilotid.types import FloatArray

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
