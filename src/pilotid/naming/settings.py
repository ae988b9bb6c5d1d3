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
import types
from collections.abc import Callable, Iterator, Mapping, Sequence
from difflib import get_close_matches
from functools import partial
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from pilotid.support.numbers import require_settings
from pilotid.support.types import InputError

T = TypeVar("T")
NOTHING = dataclasses.MISSING
NESTING = 50  # brackets within brackets: more are nonsense, and would end Python's recursion
CONSTANTS = {"none": None, "true": True, "false": False}
PAIRS = {")": "(", "]": "["}
#: How pydantic begins, and what it calls a thing that users have another word for.
EXPECTED = "Input should be "
WORDS = {
    "bool_type": "true or false",
    "int_type": "a whole number",
    "float_type": "a number",
    "string_type": "a word",
    "tuple_type": "a list in parentheses",
    "list_type": "a list in parentheses",
}
PLAIN = (type(None), bool, int, float, str, tuple, list, set, frozenset)
CONTAINERS = (tuple, list, set, frozenset, Sequence)


class SettingError(ValueError):
    """Says what is wrong with the text of a setting, without the text."""


# ------------------------------------------------------------------------- text in pieces


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
    commas = [place for place, sign in _outside_brackets(text, names) if sign == ","]
    ends = zip([-1, *commas], [*commas, len(text)], strict=True)
    parts = (text[start + 1 : end].strip() for start, end in ends)
    return [part for part in parts if part]


def split_call(text: str) -> tuple[str, str | None]:
    """A name, and the settings in the parentheses at its end, None if there are none."""
    text = text.strip()
    opened = [place for place, sign in _outside_brackets(text, True) if sign == "("]
    if not opened or not text.endswith(")"):
        return text, None
    return text[: opened[-1]].rstrip(), text[opened[-1] + 1 : -1]


def _outside_brackets(text: str, names: bool) -> Iterator[tuple[int, str]]:
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


# ------------------------------------------------------------------------------- from text


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
    kind = type(thing) if not isinstance(thing, type) else thing
    try:
        values = _values(kind, text or "")
        if isinstance(thing, type):
            made = thing(**values)
        else:
            made = dataclasses.replace(thing, **values) if values else thing
        require_settings(made)
        return made
    except Exception as error:
        fields = _settings(kind).items()
        usual = ((n, _usual(f) if kind is thing else getattr(thing, n)) for n, f in fields)
        shown = [_with_value(name, value) for name, value in usual]
        there = f"its settings are {', '.join(shown)}" if shown else "it has no settings"
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
        raise InputError(
            f"unknown {kind} '{name}': choose from {', '.join(known)}, or name file.py:{place}"
        )
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


def _with_value(name: str, value: object) -> str:
    """A setting and its value, where that is short."""
    text = "" if value is NOTHING else f"={shown(value)}"
    return f"{name}{text}" if len(text) < 30 else name


def _values(kind: type, text: str) -> dict[str, object]:
    """The values of settings by their names, as the class declares them."""
    known, hints = _settings(kind), _hints(kind)
    values: dict[str, object] = {}
    for part in split_list(text):
        name, equals, value = (piece.strip() for piece in part.partition("="))
        if not equals:
            raise SettingError(f"'{part}' is not SETTING=VALUE")
        if name not in known:
            near = [f", did you mean '{n}'?" for n in get_close_matches(name, known, 1)]
            raise SettingError(f"there is no setting '{name}'{''.join(near)}")
        if name in values:
            raise SettingError(f"the setting '{name}' is given twice")
        hint = hints.get(name, Any)
        try:
            values[name] = _value(value, hint, partial(_nested, kind, hint))
        except SettingError as wrong:
            raise SettingError(f"{name} {wrong}") from None
    return values


def _value(text: str, hint: Any, build: Callable[[str, str], object]) -> object:
    """A typed value as the declared type has it: words as what they look like, or as words."""
    from pydantic import ConfigDict, TypeAdapter, ValidationError

    config = ConfigDict(strict=True, arbitrary_types_allowed=True)
    adapter = TypeAdapter[Any](_checked_type(hint), config=config)
    try:
        return adapter.validate_python(_read(text, build, _parse_word))
    except ValidationError as wrong:
        try:
            return adapter.validate_python(_read(text, build, str))
        except ValidationError:
            raise SettingError(_describe_errors(wrong.errors(), hint, text)) from None


def _describe_errors(errors: list[Any], hint: Any, text: str) -> str:
    """What pydantic says against a value, in a user's words."""
    messages = [WORDS.get(error["type"], str(error["msg"])) for error in errors]
    if not all(m in WORDS.values() or m.startswith(EXPECTED) for m in messages):
        return f"cannot be {text} ({'; '.join(messages)})"
    messages += ["none"] if type(None) in get_args(hint) else []
    wanted = dict.fromkeys(message.removeprefix(EXPECTED) for message in messages)
    return f"must be {' or '.join(wanted)}, not {text}"


def _read(
    text: str,
    build: Callable[[str, str], object],
    word: Callable[[str], object],
    depth: int = 0,
) -> object:
    """What was typed as an object; `word` makes one of a word without quotes."""
    text = text.strip()
    if depth > NESTING:
        raise SettingError("has too many brackets")
    if not text:
        raise SettingError("has no value")
    if text[0] in "\"'":
        try:
            return ast.literal_eval(text)
        except (SyntaxError, ValueError):
            raise SettingError(f"cannot be {text}, whose quotes are not in order") from None
    if text[0] in "([" and text[-1] in ")]":
        return tuple(_read(part, build, word, depth + 1) for part in split_list(text[1:-1]))
    name, settings = split_call(text)
    if settings is not None and name.isidentifier():
        return build(name, settings)
    if re.search(r"[\s()\[\]\"'=,]", text):
        raise SettingError(f"cannot be {text}; put words with such signs in quotes")
    return word(text)


def _parse_word(word: str) -> object:
    """A word as what it looks like: a constant, a number, or itself."""
    if word.lower() in CONSTANTS:
        return CONSTANTS[word.lower()]
    if re.fullmatch(r"[+-]?inf", word, re.IGNORECASE):
        return float(word)
    try:
        value = ast.literal_eval(word)
    except (SyntaxError, ValueError, MemoryError, RecursionError):
        return word
    return value if isinstance(value, int | float) else word


def _checked_type(hint: Any) -> Any:
    """A declared type as pydantic checks it: classes of our own and of others by themselves."""
    from pydantic import AfterValidator, PlainValidator

    origin, inner = get_origin(hint), get_args(hint)
    if hint in (Any, object) or origin in (Literal, Annotated):
        return Any if hint is object else hint
    if origin in (Union, types.UnionType):
        return Union[tuple(_checked_type(each) for each in inner)]  # noqa: UP007  (made of a tuple)
    if origin in CONTAINERS:
        return origin[tuple(each if each is Ellipsis else _checked_type(each) for each in inner)]
    if hint in PLAIN:
        return hint
    if isinstance(hint, type) and issubclass(hint, enum.Enum):
        names = Literal[tuple(hint.__members__)]  # type: ignore[valid-type]  # made of a tuple
        return Annotated[names, AfterValidator(hint.__getitem__)]
    return Annotated[Any, PlainValidator(partial(_instance, hint))]


def _instance(kind: Any, value: object) -> object:
    """An object of a class, where that can be told: protocols are not asked."""
    from pydantic_core import PydanticCustomError

    a_class = isinstance(kind, type) and dataclasses.is_dataclass(kind)
    if isinstance(value, kind if a_class else PLAIN) is not a_class:
        name = getattr(kind, "__name__", kind)
        raise PydanticCustomError("setting", EXPECTED + "{name}(...)", {"name": name})
    return value


def _nested(kind: type, hint: Any, name: str, settings: str) -> object:
    """A dataclass within the settings, of a name known where they or their type are written."""
    places = [base.__module__ for base in (*kind.__mro__, *_types_in(hint))]
    known = (vars(sys.modules[place]).get(name) for place in places if place in sys.modules)
    inner = next((k for k in known if isinstance(k, type) and dataclasses.is_dataclass(k)), None)
    if inner is None:
        raise SettingError(f"cannot be {name}(...), which is not known there")
    try:
        return inner(**_values(inner, settings))
    except Exception as error:
        raise SettingError(f"cannot be {name}({settings}), for {error}") from error


def _types_in(hint: Any) -> list[type]:
    """The classes in a declared type."""
    inner = [kind for part in get_args(hint) for kind in _types_in(part)]
    return [hint, *inner] if isinstance(hint, type) else inner


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
            return _number(value)
        case str():
            bare = re.fullmatch(r"[A-Za-z_][\w.+-]*", value, re.ASCII)
            return value if bare and value.lower() not in CONSTANTS else repr(value)
        case list() | tuple():
            entries = [shown(entry) for entry in value]
            return f"({', '.join(entries)}{',' if len(entries) == 1 else ''})"
        case dict():
            inner = [f"{key}={shown(entry)}" for key, entry in value.items() if key != "class"]
            return f"{value.get('class', '')}({', '.join(inner)})"
    held = plain(value)
    return repr(held) if type(held) is type(value) else shown(held)


def _number(value: float) -> str:
    """A number with all its digits, and no more."""
    return str(int(value)) if value.is_integer() and abs(value) < 1e15 else repr(value)


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
