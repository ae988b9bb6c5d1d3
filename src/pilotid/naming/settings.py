"""Settings as text and as JSON: what a user types, what tables show, what a store keeps.

``arx(memory=none)`` names a thing and the settings that differ from its usual ones.  A value
is a number, ``none``, ``true``, ``false``, a word (in quotes if it has other signs than
letters, digits and ``.+-``), a list in parentheses, or again a name with settings.
"""

from __future__ import annotations

import ast
import dataclasses
import enum
import hashlib
import math
import pickle
import re
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from difflib import get_close_matches
from types import UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from pilotid.support.numbers import require_settings
from pilotid.support.types import InputError

T = TypeVar("T")
NOTHING = dataclasses.MISSING
CALL = re.compile(r"(?P<name>(.{2,}:)?[^()]*?)\s*(\((?P<settings>.*)\))?", re.DOTALL)
#: A text in quotes, or a word without: neither a setting's name nor that of a class.
WORD = re.compile(
    r"""('(?:[^'\\]|\\.)*'|"(?:[^"\\]|\\.)*")|(?<![\w.])([A-Za-z_][\w.+-]*)(?!\s*[=(\w.+-])"""
)
CONSTANTS = {"none": "None", "true": "True", "false": "False", "inf": "1e999"}
WANTED = {float: "a number", int: "a whole number", bool: "true or false", str: "a word"}
SIMPLE = (type(None), bool, int, float, str, tuple)


class SettingError(ValueError):
    """Says what is wrong with a setting."""


def split_list(text: str) -> list[str]:
    """The names in a text between commas outside brackets, empty ones left out.

    Raises
    ------
    InputError
        If a bracket is not closed.
    """
    parts, depth = [""], 0
    for sign in text:
        depth += (sign in "([") - (sign in ")]")
        if depth < 0:
            break
        if sign == "," and not depth:
            parts.append("")
        else:
            parts[-1] += sign
    if depth:
        raise InputError(f"{text}: a bracket is not closed, or closes nothing; check the brackets")
    return [part.strip() for part in parts if part.strip()]


def split_call(text: str) -> tuple[str, str | None]:
    """A name, and the settings in the parentheses at its end, None if there are none."""
    match = CALL.fullmatch(text.strip())
    return (match["name"], match["settings"]) if match else (text.strip(), None)


def configured(thing: Any, text: str | None, given: str) -> Any:
    """A thing with the settings of a text; the others stay, or are the usual ones of a class.

    Parameters
    ----------
    thing
        An object of a dataclass, or a class, of which one is made; anything if there are no
        settings to set.
    text
        Such as ``memory=none, poles=3``; None for no settings.
    given
        What the user typed, for the message.

    Raises
    ------
    InputError
        If there is no such setting, or if it cannot have that value.
    """
    kind = thing if isinstance(thing, type) else type(thing)
    try:
        values = _values(kind, _parsed(text or ""))
        made = thing(**values) if kind is thing else thing
        made = dataclasses.replace(made, **values) if values and kind is not thing else made
        require_settings(made)
        return made
    except Exception as error:
        usual = {n: _usual(f) if kind is thing else getattr(thing, n) for n, f in _fields(kind)}
        words = [
            n if v is NOTHING or len(shown(v)) > 28 else f"{n}={shown(v)}" for n, v in usual.items()
        ]
        there = f"its settings are {', '.join(words)}" if words else "it has no settings"
        why = str(error) or type(error).__name__
        raise InputError(f"{given}: {why.rstrip('.')}; {there}") from error


def from_catalogue(text: str, known: Mapping[str, T], kind: str, place: str) -> tuple[str, T]:
    """A name, and the thing of that name with the settings behind it.

    Parameters
    ----------
    text
        A name, with or without settings.
    known
        Things by name.
    kind, place
        What they are, and how one is named in code, for messages.

    Raises
    ------
    InputError
        If there is none of that name, or if it refuses the settings.
    """
    name, settings = split_call(text)
    if name not in known:
        there = f"choose from {', '.join(known)}, or name file.py:{place}"
        raise InputError(f"unknown {kind} '{name}': {there}")
    return name, configured(known[name], settings, text)


def name_of(text: str) -> str:
    """A text as a name that files and links may have."""
    return re.sub(r"[^\w.]+", "-", text, flags=re.ASCII).strip("-")[:100]


def require_name(name: object, kind: str) -> None:
    """Refuse a name that tables, links and files cannot have."""
    if not isinstance(name, str) or not re.fullmatch(r"\w[\w.+-]{0,100}", name, re.ASCII):
        raise InputError(
            f"a {kind} has the name {name!r}; it must be of letters, digits and the signs . + -"
        )


def _parsed(text: str) -> ast.Call:
    """The settings of a text as the arguments of a call, with words in quotes."""
    words = WORD.sub(lambda m: m[1] or CONSTANTS.get(m[2].lower(), repr(m[2])), text)
    try:
        call = ast.parse(f"_({words})", mode="eval").body
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Name):
            return call
    except (SyntaxError, ValueError, MemoryError, RecursionError):
        pass
    raise SettingError(
        f"'{text}' is not SETTING=VALUE, ...; check brackets, and put words with other signs than "
        "letters, digits and .+- in quotes"
    )


def _values(kind: type, call: ast.Call) -> dict[str, object]:
    """The values of settings by their names, as the class declares them."""
    known, values = dict(_fields(kind)), dict[str, object]()
    hints = {}
    with suppress(Exception):  # a class may import its types for type checkers only
        hints = get_type_hints(kind)
    if call.args:
        raise SettingError(f"'{ast.unparse(call.args[0])}' is not SETTING=VALUE")
    for keyword in call.keywords:
        name, hint = str(keyword.arg), hints.get(str(keyword.arg), Any)
        if name not in known:
            near = [f", did you mean '{n}'?" for n in get_close_matches(name, known, 1)]
            raise SettingError(f"there is no setting '{name}'{''.join(near)}")
        if name in values:
            raise SettingError(f"the setting '{name}' is given twice")
        value = _value(keyword.value, [*kind.__mro__, *_types_in(hint)])
        try:
            values[name] = _converted(value, hint)
        except SettingError:
            wrong = f"{name} must be {_wanted(hint)}, not {shown(value)}"
            raise SettingError(wrong) from None
    return values


def _value(node: ast.expr, kinds: Sequence[type]) -> object:
    """What was typed as an object; a dataclass is one known where one of the classes is written."""
    if isinstance(node, ast.Tuple | ast.List):
        return tuple(_value(entry, kinds) for entry in node.elts)
    if not isinstance(node, ast.Call):
        try:
            return ast.literal_eval(node)
        except ValueError:
            raise SettingError(f"'{ast.unparse(node)}' is no value of a setting") from None
    name = ast.unparse(node.func)
    places = (vars(sys.modules[kind.__module__]) for kind in kinds)
    inner = next((p[name] for p in places if dataclasses.is_dataclass(p.get(name))), None)
    if inner is None:
        raise SettingError(f"{name}(...) is not known there")
    return inner(**_values(inner, node))


def _types_in(hint: Any) -> list[type]:
    """The classes in a declared type."""
    inner = [kind for part in get_args(hint) for kind in _types_in(part)]
    return [hint, *inner] if isinstance(hint, type) else inner


def _converted(value: Any, hint: Any) -> Any:
    """A value as the declared type has it; of classes dataclasses alone are asked.

    Raises
    ------
    SettingError
        If the value is of another type.
    """
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        for kind in inner:
            with suppress(SettingError):
                return _converted(value, kind)
    elif hint in (Any, object):
        return value
    elif origin is Literal:
        if any(value == known and type(value) is type(known) for known in inner):
            return value
    elif origin in (tuple, list, Sequence):
        kinds = inner if origin is tuple and ... not in inner else inner[:1] * len(value)
        if isinstance(value, tuple) and len(value) == len(kinds):
            return (list if origin is list else tuple)(map(_converted, value, kinds))
    elif isinstance(hint, enum.EnumType):
        if value in hint.__members__:
            return hint[value]
    elif hint is float and type(value) is int:
        return float(value)
    elif (
        type(value) is hint
        if hint in SIMPLE or isinstance(value, SIMPLE)
        else (
            not (isinstance(hint, type) and dataclasses.is_dataclass(hint))
            or isinstance(value, hint)
        )
    ):
        return value
    raise SettingError


def _wanted(hint: Any) -> str:
    """A declared type in words."""
    inner = get_args(hint)
    if get_origin(hint) in (Union, UnionType):
        return " or ".join(map(_wanted, inner))
    if get_origin(hint) is Literal or isinstance(hint, enum.EnumType):
        return " or ".join(map(repr, inner or hint.__members__))
    if inner:
        return f"({', '.join('...' if kind is ... else _wanted(kind) for kind in inner)})"
    known = {**WANTED, type(None): "none", tuple: "a list in parentheses"}
    return known.get(hint) or f"{getattr(hint, '__name__', hint)}(...)"


def _fields(kind: type) -> list[tuple[str, dataclasses.Field[Any]]]:
    """The settings of a class; only a dataclass has any."""
    known = dataclasses.fields(kind) if dataclasses.is_dataclass(kind) else ()
    return [(field.name, field) for field in known if field.init]


def _usual(field: dataclasses.Field[Any]) -> object:
    return field.default if field.default_factory is NOTHING else field.default_factory()


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
    for key, field in _fields(type(thing)):
        value = shown(getattr(thing, key))
        default = _usual(field) if usual is None else getattr(usual, key)
        if default is NOTHING or shown(default) != value:
            changed.append(f"{key}={value}")
    return f"{name}({', '.join(changed)})" if changed else name


def shown(value: object) -> str:
    """A value as a user would type it, where it can be typed; also one that `plain` made."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        text = labelled(type(value).__name__, value)
        return text if text.endswith(")") else f"{text}()"
    match value:
        case None | bool():
            return str(value).lower()
        case float():
            return str(int(value)) if value.is_integer() and abs(value) < 1e15 else repr(value)
        case str():
            bare = re.fullmatch(r"[A-Za-z_][\w.+-]*", value, re.ASCII)
            return value if bare and value.lower() not in CONSTANTS else repr(value)
        case list() | tuple():
            return f"({', '.join(map(shown, value))}{',' if len(value) == 1 else ''})"
        case dict():
            inner = [f"{key}={shown(entry)}" for key, entry in value.items() if key != "class"]
            return f"{value.get('class', '')}({', '.join(inner)})"
    held = plain(value)
    return repr(held) if type(held) is type(value) else shown(held)


def plain(value: object) -> Any:
    """A value as plain objects for JSON; equal settings give equal objects.

    A dataclass becomes a mapping of its fields, with its name under ``class``, which no field
    can be called.  Numbers keep all their digits.
    """
    match value:
        case None | bool() | str():
            return value
        case enum.Enum():
            return value.name
        case np.generic():
            return plain(value.item())
        case int():
            return int(value)
        case float():
            return float(value) if math.isfinite(value) else str(float(value))
        case np.ndarray():
            return {"class": "array", "values": plain(value.tolist())}
        case list() | tuple():
            return [plain(entry) for entry in value]
        case Mapping():
            return {str(key): plain(entry) for key, entry in value.items()}
        case set() | frozenset():
            return sorted((plain(entry) for entry in value), key=repr)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
        return {"class": type(value).__qualname__, **fields}
    text = str(getattr(value, "__qualname__", "") or repr(value))
    if not re.search(r" at 0x|<locals>|<lambda>", text):
        return text
    try:  # what it shows of itself is but an address
        return f"{type(value).__qualname__} {hashlib.sha256(pickle.dumps(value)).hexdigest()[:8]}"
    except Exception:
        return f"{type(value).__qualname__} ?"  # it cannot cross to another process either
