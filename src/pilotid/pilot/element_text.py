"""Transfer functions as people write them: ``4 exp(-0.05s)/(s(1+s/30)^2)``.

A small parser by recursive descent.  Its grammar, from the loosest binding to the tightest::

    sum     = [sign] product {("+" | "-") product}
    product = power {["*" | "/"] power}        juxtaposition multiplies: 2s(s+1)
    power   = atom ["^" [sign] digits]         ** is ^
    atom    = number | "s" | "(" sum ")" | "exp" "(" sum ")" | "e" "^" "(" sum ")"
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pilotid.types import FloatArray

LONGEST = 200  # characters
HIGHEST = 12  # degree of a polynomial
DEEPEST = 20  # brackets inside one another

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
_TOKEN = re.compile(
    r"\s*(?P<word>(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+(?![.\d]))?|exp|e(?=\s*(?:\^|\*\*))|s|\*\*|[-+*/^()]|$)"
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

    def times(self, other: Ratio) -> Ratio:
        """The product of two."""
        return _ratio(
            np.polymul(self.top, other.top),
            np.polymul(self.bottom, other.bottom),
            self.delay + other.delay,
        )

    def inverse(self) -> Ratio:
        """One over it."""
        if not self.top.any():
            raise NotTransferFunctionError("it divides by zero")
        return Ratio(self.bottom, self.top, -self.delay)

    def plus(self, other: Ratio, sign: float) -> Ratio:
        """Their sum, or difference."""
        if self.delay != other.delay:
            raise NotTransferFunctionError("terms of a sum have different delays")
        if np.array_equal(self.bottom, other.bottom):
            return _ratio(np.polyadd(self.top, sign * other.top), self.bottom, self.delay)
        top = np.polyadd(
            np.polymul(self.top, other.bottom), sign * np.polymul(other.top, self.bottom)
        )
        return _ratio(top, np.polymul(self.bottom, other.bottom), self.delay)

    def power(self, exponent: int) -> Ratio:
        """It to a whole power."""
        base = self if exponent >= 0 else self.inverse()
        result = _constant(1.0)
        for _ in range(abs(exponent)):
            result = result.times(base)
        return result


def _constant(value: float) -> Ratio:
    return Ratio(np.array([value]), np.ones(1))


def _ratio(above: NDArray[Any], below: NDArray[Any], delay: float) -> Ratio:
    top, bottom = (np.atleast_1d(np.asarray(p, dtype=float)) for p in (above, below))
    if max(len(top), len(bottom)) > HIGHEST + 1:
        raise NotTransferFunctionError(f"it has powers of s above {HIGHEST}")
    if not (np.isfinite(top).all() and np.isfinite(bottom).all()):
        raise NotTransferFunctionError("a number is too large")
    return Ratio(top, bottom, delay)


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
    blanks = " " * len(before + sign)
    found = _Reader(blanks + rest.translate(SAME).lower()).whole()
    if not found.top.any():
        raise NotTransferFunctionError("it is zero")
    if len(found.top) > len(found.bottom):
        raise NotTransferFunctionError("it has more zeros than poles, which no element has")
    if found.delay < 0.0:
        raise NotTransferFunctionError("its delay is negative: write exp(-0.1s) for one of 0.1 s")
    return found


class _Reader:
    """A text that is read from left to right."""

    def __init__(self, text: str) -> None:
        self.text = text.rstrip()
        self.at = 0  # where the next word begins
        self.deep = 0
        self.word = ""  # the next word, empty at the end
        self.end = 0  # of the next word
        self.advance()

    def advance(self) -> str:
        """Go one word further and return the one left behind."""
        behind, self.at = self.word, self.end
        match = _TOKEN.match(self.text, self.at)
        if match is None:
            self.at += len(self.text[self.at :]) - len(self.text[self.at :].lstrip())
            raise self.fault("is nothing that a transfer function of s has")
        self.at, self.word, self.end = match.start("word"), match["word"], match.end()
        return behind

    def fault(self, what: str) -> NotTransferFunctionError:
        """A sentence that shows the place."""
        if self.at >= len(self.text):
            return NotTransferFunctionError("it ends where a number, s or a bracket is needed")
        rest = self.text[self.at : self.at + 12]
        return NotTransferFunctionError(f"at character {self.at + 1}, '{rest}' {what}")

    def need(self, word: str) -> None:
        if self.word != word:
            if self.at >= len(self.text):
                raise NotTransferFunctionError(f"at its end, '{word}' is missing")
            raise self.fault(f"stands where '{word}' is needed")
        self.advance()

    def whole(self) -> Ratio:
        if not self.word:
            raise NotTransferFunctionError("it is empty")
        found = self.sum()
        if self.word:
            raise self.fault("has no bracket that it closes" if self.word == ")" else "is too much")
        return found

    def sum(self) -> Ratio:
        sign = 1.0
        if self.word in ("+", "-"):
            sign = -1.0 if self.advance() == "-" else 1.0
        found = self.product().times(_constant(sign))
        while self.word in ("+", "-"):
            sign = -1.0 if self.advance() == "-" else 1.0
            found = found.plus(self.product(), sign)
        return found

    def product(self) -> Ratio:
        found, divided = self.power(), False
        while self.word and self.word not in ("+", "-", ")"):
            if self.word in ("*", "/"):
                divided = self.advance() == "/"
                factor = self.power()
                found = found.times(factor.inverse() if divided else factor)
                continue
            if divided:
                raise self.fault(
                    "may be meant above or below the fraction line: put what is below it in "
                    "brackets"
                )
            if self.word[0].isdigit() or self.word[0] == ".":
                raise self.fault("is a number where a sign is needed")
            found = found.times(self.power())
        return found

    def power(self) -> Ratio:
        base = self.atom()
        if self.word not in ("^", "**"):
            return base
        self.advance()
        bracket = self.word == "("
        if bracket:
            self.advance()
        sign = -1 if self.word == "-" else 1
        if self.word in ("+", "-"):
            self.advance()
        if not self.word.isdigit() or int(self.word) > HIGHEST:
            raise self.fault(f"is no whole exponent up to {HIGHEST}")
        exponent = sign * int(self.advance())
        if bracket:
            self.need(")")
        if self.word in ("^", "**"):
            raise self.fault("is a second exponent")
        return base.power(exponent)

    def atom(self) -> Ratio:
        if self.word == "(":
            return self.bracket()
        if self.word == "s":
            self.advance()
            return Ratio(np.array([1.0, 0.0]), np.ones(1))
        if self.word == "exp":
            self.advance()
            return self.exponential()
        if self.word == "e":
            self.advance()
            self.advance()  # the sign for a power, without which e is no word
            return self.exponential()
        if self.word[:1].isdigit() or self.word[:1] == ".":
            value = float(self.word)
            if not np.isfinite(value):
                raise self.fault("is too large a number")
            self.advance()
            return _constant(value)
        raise self.fault("stands where a number, s or a bracket is needed")

    def bracket(self) -> Ratio:
        self.deep += 1
        if self.deep > DEEPEST:
            raise self.fault("has too many brackets about it")
        self.need("(")
        found = self.sum()
        self.need(")")
        self.deep -= 1
        return found

    def exponential(self) -> Ratio:
        """What follows exp, or e^: a number of seconds times s, in brackets."""
        if self.word != "(":
            raise self.fault("must be in brackets, as in exp(-0.1s)")
        begin = self.at
        power = self.bracket()
        top = np.trim_zeros(power.top, "f")
        if len(power.bottom) > 1 or power.delay or len(top) > 2 or (top.size and power.top[-1]):
            self.at = begin
            raise self.fault("is no number of seconds times s, as in exp(-0.1s)")
        delay = -float(top[0] / power.bottom[0]) if top.size else 0.0
        return Ratio(np.ones(1), np.ones(1), delay)
