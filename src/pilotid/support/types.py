"""Array types and the one error class that carries a sentence for the user."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]

LONGEST_MESSAGE = 1000  # characters
SIGNAL_NAME = "a letter, then letters and digits, 20 characters at most"


def is_signal_name(text: object) -> bool:
    """Whether a text can name a signal; columns of runs have an underscore and a number behind."""
    return isinstance(text, str) and re.fullmatch("[A-Za-z][A-Za-z0-9]{0,19}", text) is not None


def printable(text: str) -> str:
    """A text with escapes for what would act on a terminal or cannot be written.

    These are control characters, line breaks, marks of direction and lone surrogates: a file's
    name may hold them all.
    """
    if text.isprintable():
        return text
    return "".join(
        c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text
    )


def one_line(text: str) -> str:
    """A text that any table and file can hold: on one line, of printable signs, not too long."""
    if not text.isprintable():
        text = printable(" ".join(text.split()))
    return text if len(text) <= LONGEST_MESSAGE else f"{text[:LONGEST_MESSAGE]} ..."


def reason(error: BaseException) -> str:
    """An exception in words."""
    return f"{type(error).__name__}: {error}".removesuffix(": ")


class InputError(ValueError):
    """The user's input cannot be used; the message says what, where and what to do.

    The command line prints it as one sentence and leaves with exit status 2.  The message is made
    printable here, so that whoever writes it need not care.
    """

    def __init__(self, sentence: str) -> None:
        super().__init__(printable(sentence))


def several(given: Any) -> list[Any]:
    """A list of things, also of one that the caller did not put into a list."""
    return [given] if isinstance(given, str) or not isinstance(given, Iterable) else [*given]
