"""Values as a user types them, read by the types that a class declares."""

from __future__ import annotations

import ast
import re
import types
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, is_dataclass
from enum import Enum
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pilotid.types import InputError

NESTING = 50  # brackets within brackets: more are nonsense, and would end Python's recursion
CONSTANTS = {"none": None, "true": True, "false": False}
PAIRS = {")": "(", "]": "["}


class TextError(ValueError):
    """A text that cannot be a value; without a message, one of another type was declared."""


@dataclass(frozen=True)
class Word:
    """A value that is no list and no call: a number, a constant or a word."""

    text: str
    quoted: bool = False


@dataclass(frozen=True)
class Call:
    """A name with settings in parentheses."""

    name: str
    settings: str


Token = Word | Call | tuple["Token", ...]


def split_list(text: str, *, names: bool = False) -> list[str]:
    """The parts of a text between commas that stand outside brackets, empty ones left out.

    Parameters
    ----------
    text
        Settings, values or names.
    names
        Whether it is names, where a quote outside brackets is an apostrophe in a path.

    Raises
    ------
    InputError
        If a bracket or a quote is not closed.
    """
    commas = [place for place, sign in _outside(text, names) if sign == ","]
    ends = zip([-1, *commas], [*commas, len(text)], strict=True)
    parts = (text[start + 1 : end].strip() for start, end in ends)
    return [part for part in parts if part]


def split_call(text: str) -> tuple[str, str | None]:
    """A name, and the settings in the parentheses at its end, None if there are none."""
    text = text.strip()
    opened = [place for place, sign in _outside(text, True) if sign == "("]
    if not opened or not text.endswith(")"):
        return text, None
    return text[: opened[-1]].rstrip(), text[opened[-1] + 1 : -1]


def _outside(text: str, names: bool) -> Iterator[tuple[int, str]]:
    """The signs outside brackets and quotes, with their places; brackets that open included."""
    waiting: list[str] = []
    quote = before = ""
    for place, sign in enumerate(text):
        if quote:
            quote = "" if sign == quote and before != "\\" else quote
        elif sign in "\"'" and (waiting or not names):
            quote = sign
        elif sign in PAIRS:
            if not waiting or waiting.pop() != PAIRS[sign]:
                raise InputError(f"{text}: '{sign}' closes nothing; check the brackets")
        else:
            if not waiting:
                yield place, sign
            if sign in "([":
                waiting.append(sign)
        before = "" if before == sign == "\\" else sign
    if waiting or quote:
        left = quote or waiting[-1]
        raise InputError(f"{text}: '{left}' is not closed; check brackets and quotes")


def read(text: str, depth: int = 0) -> Token:
    """A typed value, not yet of any type."""
    text = text.strip()
    if depth > NESTING:
        raise TextError("has too many brackets")
    if not text:
        raise TextError("has no value")
    if text[0] in "\"'":
        try:
            word = ast.literal_eval(text)
        except (SyntaxError, ValueError):
            word = None
        if not isinstance(word, str):
            raise TextError(f"cannot be {text}, whose quotes are not in order")
        return Word(word, quoted=True)
    if text[0] in "([" and text[-1] in ")]":
        return tuple(read(part, depth + 1) for part in split_list(text[1:-1]))
    if text[-1] == ")":
        name, settings = split_call(text)
        if name.isidentifier() and settings is not None:
            return Call(name, settings)
    if re.search(r"[\s()\[\]\"'=,]", text):
        raise TextError(f"cannot be {text}; put words with such signs in quotes")
    return Word(text)


def convert(token: Token, hint: Any, build: Callable[[Call], object]) -> object:
    """A typed value as the type that a class declares for it.

    Parameters
    ----------
    token
        What was typed.
    hint
        The declared type; what is not known to this function takes any value.
    build
        Makes a dataclass of a name with settings.

    Raises
    ------
    TextError
        If it cannot be that type.
    """
    origin = get_origin(hint)
    if origin is Annotated:
        return convert(token, get_args(hint)[0], build)
    if origin in (Union, types.UnionType):
        return _first(token, sorted(get_args(hint), key=_specific), build)
    if origin is Literal:
        return _choice(token, get_args(hint))
    if (origin or hint) in (tuple, list, Sequence, frozenset, set):
        return _list(token, origin or hint, get_args(hint), build)
    if isinstance(token, Call):
        made = build(token)
        if is_dataclass(hint) and isinstance(hint, type) and not isinstance(made, hint):
            raise TextError
        if hint in (bool, int, float, str, type(None)):
            raise TextError
        return made
    if isinstance(token, Word) and hint in _READERS:
        return _READERS[hint](token)
    if isinstance(hint, type) and issubclass(hint, Enum) and isinstance(token, Word):
        for member in hint:
            if token.text.lower() in (member.name.lower(), str(member.value).lower()):
                return member
        raise TextError
    if hint is Any or hint is object:
        return _natural(token, build)
    if is_dataclass(hint):
        raise TextError
    raise TextError(f"cannot be typed as {words_of(hint)}; set it in Python, or leave it out")


def _natural(token: Token, build: Callable[[Call], object]) -> object:
    """What a value is by itself, where no type is declared."""
    if isinstance(token, tuple):
        return tuple(_natural(entry, build) for entry in token)
    return _first(token, (type(None), bool, int, float, str), build)


def _first(token: Token, hints: Sequence[Any], build: Callable[[Call], object]) -> object:
    said: list[TextError] = []
    for hint in hints:
        try:
            return convert(token, hint, build)
        except TextError as wrong:
            said.append(wrong)
    raise next((wrong for wrong in said if str(wrong) and isinstance(token, Call)), TextError())


def _specific(hint: Any) -> int:
    """Place of a type in the order in which types are tried: words, which all are, last."""
    order = (type(None), bool, int, float)
    return order.index(hint) if hint in order else len(order) + (hint is str)


def _choice(token: Token, options: Sequence[object]) -> object:
    for option in options:
        if isinstance(token, Word) and isinstance(option, str) and token.text == option:
            return option
        if isinstance(token, Word) and not isinstance(option, str):
            try:
                if _READERS[type(option)](token) == option:
                    return option
            except (TextError, KeyError):
                continue
    raise TextError


def _list(token: Token, kind: Any, inner: Sequence[Any], build: Callable[[Call], object]) -> object:
    if not isinstance(token, tuple):
        raise TextError
    if kind is tuple and inner and inner[-1] is not Ellipsis:
        if len(inner) != len(token):
            raise TextError
        return tuple(convert(t, h, build) for t, h in zip(token, inner, strict=True))
    each = inner[0] if inner else Any
    values = tuple(convert(entry, each, build) for entry in token)
    return values if kind is Sequence else kind(values)


def _constant(token: Word) -> object:
    if token.quoted or token.text.lower() not in CONSTANTS:
        raise TextError
    return CONSTANTS[token.text.lower()]


def _none(token: Word) -> None:
    if _constant(token) is not None:
        raise TextError


def _bool(token: Word) -> bool:
    value = _constant(token)
    if not isinstance(value, bool):
        raise TextError
    return value


def _int(token: Word) -> int:
    if token.quoted or not re.fullmatch(r"[+-]?\d{1,300}", token.text, re.ASCII):
        raise TextError
    return int(token.text)


def _float(token: Word) -> float:
    number = r"[+-]?(inf|(\d+\.?\d*|\.\d+)(e[+-]?\d+)?)"
    if token.quoted or not re.fullmatch(number, token.text, re.ASCII | re.IGNORECASE):
        raise TextError
    return float(token.text)


def _str(token: Word) -> str:
    return token.text


_READERS: dict[Any, Callable[[Word], object]] = {
    type(None): _none,
    bool: _bool,
    int: _int,
    float: _float,
    str: _str,
}
_NAMES: dict[Any, str] = {
    type(None): "none",
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "a word",
    Any: "a value",
}


def words_of(hint: Any) -> str:
    """A declared type in words."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return words_of(inner[0])
    if origin in (Union, types.UnionType):
        return " or ".join(words_of(h) for h in sorted(inner, key=lambda h: h is type(None)))
    if origin is Literal:
        return " or ".join(str(option) for option in inner)
    if origin or hint in (tuple, list):
        return "a list in parentheses"
    if hint in _NAMES:
        return _NAMES[hint]
    if isinstance(hint, type) and issubclass(hint, Enum):
        return " or ".join(member.name.lower() for member in hint)
    name = getattr(hint, "__name__", str(hint))
    return f"{name}(...)" if is_dataclass(hint) else f"a {name}"
