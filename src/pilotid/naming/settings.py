"""Settings as text and as JSON: what a user types, what tables show, what a store keeps.

``arx(memory=none)`` names a thing and the settings that differ from its usual ones.  A value
is a number, ``none``, ``true``, ``false``, a word (in quotes if it has other signs than
letters, digits and ``.+-``), a list in parentheses, or again a name with settings.
"""

from __future__ import annotations

import dataclasses
import enum
import hashlib
import math
import pickle
import re
import sys
from collections.abc import Mapping
from functools import partial
from typing import Any, TypeVar, get_args, get_type_hints

import numpy as np

from pilotid.naming.text import Call, TextError, convert, read, split_list, words_of
from pilotid.types import InputError

T = TypeVar("T")
NOTHING = dataclasses.MISSING

# ------------------------------------------------------------------------------- from text


def configured(thing: T, text: str | None, given: str) -> T:
    """A thing with the settings of a text; the others stay.

    Parameters
    ----------
    thing
        A dataclass, or anything if there are no settings to set.
    text
        Such as ``memory=none, poles=3``; None for no settings.
    given
        What the user typed, for the message.

    Raises
    ------
    InputError
        If there is no such setting, or if it cannot have that value.
    """
    here = {name: getattr(thing, name) for name in _settings(type(thing))}
    if not split_list(text or ""):
        return thing
    with _Refusal(given, here):
        return dataclasses.replace(thing, **_values(type(thing), text or ""))  # type: ignore[type-var]


def made(kind: type[T], text: str | None, given: str) -> T:
    """A class's object with the settings of a text; see `configured`."""
    with _Refusal(given, {name: _usual(field) for name, field in _settings(kind).items()}):
        return kind(**_values(kind, text or ""))


class _Refusal:
    """Turns whatever goes wrong with settings into a sentence that lists those there are."""

    def __init__(self, given: str, known: Mapping[str, object]) -> None:
        self.given, self.known = given, known

    def __enter__(self) -> None:
        pass

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        if not isinstance(error, Exception):
            return
        shown = [_with_value(name, value) for name, value in self.known.items()]
        there = f"its settings are {', '.join(shown)}" if shown else "it has no settings"
        why = str(error) or type(error).__name__
        raise InputError(f"{self.given}: {why.rstrip('.')}; {there}") from error


def _with_value(name: str, value: object) -> str:
    """A setting and its value, where that is short."""
    text = "" if value is NOTHING else f"={written(value)}"
    return f"{name}{text}" if len(text) < 30 else name


def _values(kind: type, text: str) -> dict[str, object]:
    """The values of settings by their names, as the class declares them."""
    known, hints = _settings(kind), _hints(kind)
    values: dict[str, object] = {}
    for part in split_list(text):
        name, equals, value = (piece.strip() for piece in part.partition("="))
        if not equals:
            raise TextError(f"'{part}' is not SETTING=VALUE")
        if name not in known:
            raise TextError(f"there is no setting '{name}'")
        if name in values:
            raise TextError(f"the setting '{name}' is given twice")
        hint = hints.get(name, Any)
        try:
            values[name] = convert(read(value), hint, partial(_nested, kind, hint))
        except TextError as wrong:
            why = str(wrong) or f"must be {words_of(hint)}, not {value}"
            raise TextError(f"{name} {why}") from None
    return values


def _nested(kind: type, hint: Any, call: Call) -> object:
    """A dataclass within the settings, of a name known where they or their type are written."""
    places = [base.__module__ for base in kind.__mro__] + _written_in(hint)
    known = (vars(sys.modules[place]).get(call.name) for place in places if place in sys.modules)
    inner = next((k for k in known if isinstance(k, type) and dataclasses.is_dataclass(k)), None)
    if inner is None:
        raise TextError(f"cannot be {call.name}(...), which is not known there")
    try:
        return inner(**_values(inner, call.settings))
    except Exception as error:
        raise TextError(f"cannot be {call.name}({call.settings}), for {error}") from error


def _written_in(hint: Any) -> list[str]:
    """Modules of the types in a declared type."""
    inner = [name for part in get_args(hint) for name in _written_in(part)]
    return [str(getattr(hint, "__module__", "")), *inner]


def _settings(kind: type) -> dict[str, dataclasses.Field[Any]]:
    if not dataclasses.is_dataclass(kind):
        return {}
    return {f.name: f for f in dataclasses.fields(kind) if f.init}


def _hints(kind: type) -> dict[str, Any]:
    """Declared types; none where a class imports them for type checkers only."""
    try:
        return get_type_hints(kind)
    except Exception:
        return {}


def _usual(field: dataclasses.Field[Any]) -> object:
    return field.default if field.default_factory is NOTHING else field.default_factory()


# --------------------------------------------------------------------------------- to text


def labelled(name: str, thing: object, usual: object = None) -> str:
    """A name, and the settings that differ from the usual ones, as a user would type them.

    Parameters
    ----------
    name
        The thing's name.
    thing
        The thing; only a dataclass has settings.
    usual
        The thing of that name without settings; None for that with the class's defaults.
    """
    changed = []
    for key, field in _settings(type(thing)).items():
        value = written(getattr(thing, key))
        default = _usual(field) if usual is None else getattr(usual, key)
        if default is NOTHING or written(default) != value:
            changed.append(f"{key}={value}")
    return f"{name}({', '.join(changed)})" if changed else name


def written(value: object) -> str:
    """A value as a user would type it, where it can be typed."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        text = labelled(type(value).__name__, value)
        return text if text.endswith(")") else f"{text}()"
    if isinstance(value, list | tuple):
        return _bracketed([written(entry) for entry in value])
    if isinstance(value, float | np.floating):
        return _number(float(value))
    return shown(plain(value))


def shown(held: object) -> str:
    """What `plain` made of a value, in the syntax of `written` and with all settings."""
    match held:
        case None:
            return "none"
        case bool():
            return str(held).lower()
        case float():
            return _number(held)
        case str():
            bare = re.fullmatch(r"[A-Za-z_][\w.+-]*", held, re.ASCII)
            return held if bare and held.lower() not in ("none", "true", "false") else repr(held)
        case list():
            return _bracketed([shown(entry) for entry in held])
        case dict():
            inner = [f"{key}={shown(entry)}" for key, entry in held.items() if key != "class"]
            return f"{held.get('class', '')}({', '.join(inner)})"
        case _:
            return repr(held)


def _number(value: float) -> str:
    """A number with all its digits, and no more."""
    return str(int(value)) if value.is_integer() and abs(value) < 1e15 else repr(value)


def _bracketed(entries: list[str]) -> str:
    return f"({', '.join(entries)}{',' if len(entries) == 1 else ''})"


# --------------------------------------------------------------------------------- to JSON


def plain(value: object) -> Any:
    """A value as plain objects for JSON; equal settings give equal objects.

    A dataclass becomes a mapping of its fields, with its name under ``class``, which no field
    can be called.  Numbers keep all their digits.
    """
    if value is None or isinstance(value, bool | str):
        return value
    if isinstance(value, enum.Enum):
        return value.name
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, int):
        return int(value)
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else str(float(value))
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        own = {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
        return {"class": type(value).__qualname__, **own}
    if isinstance(value, np.ndarray):
        return {"class": "array", "values": plain(value.tolist())}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, set | frozenset):
        return sorted((plain(entry) for entry in value), key=repr)
    return _other(value)


def _other(value: object) -> str:
    """Anything else: what it shows of itself, or a digest where that is but an address."""
    text = str(getattr(value, "__qualname__", "") or repr(value))
    if not re.search(r" at 0x|<locals>|<lambda>", text):
        return text
    try:
        digest = hashlib.sha256(pickle.dumps(value)).hexdigest()[:8]
    except Exception:
        return f"{type(value).__qualname__} ?"  # it cannot cross to another process either
    return f"{type(value).__qualname__} {digest}"
