"""Things by name: named, named with settings (as text and as JSON), or taken from code.

``arx(memory=none)`` names a thing and the settings that differ from its usual ones.  A value
is a number, ``none``, ``true``, ``false``, a word (in quotes if it has other signs than
letters, digits and ``-``), a list in parentheses, or again a name with settings.

Code of the user's own goes along to other processes.  A digest tells whether it has changed.
"""

from __future__ import annotations

import ast
import dataclasses
import hashlib
import importlib
import json
import os
import pickle
import pickletools
import re
import sys
from collections import ChainMap
from collections.abc import Iterable, Mapping
from contextlib import suppress
from keyword import iskeyword
from pathlib import Path
from types import ModuleType
from typing import Any, get_args, get_type_hints

from pilotid.support.numbers import require_settings
from pilotid.support.types import InputError, reason

CALL = re.compile(r"(?P<name>(.{2,}:)?[^()]*?)\s*(\((?P<settings>.*)\))?", re.DOTALL)
#: What a word without quotes means where it is no text.
CONSTANTS = {"none": None, "true": True, "false": False, "inf": float("inf"), "-inf": -float("inf")}


def split_list(text: str) -> list[str]:
    """The names in a text between commas outside parentheses, empty ones left out."""
    parts: list[str] = []
    for part in text.split(","):
        if parts and parts[-1].count("(") > parts[-1].count(")"):
            parts[-1] += f",{part}"
        else:
            parts.append(part)
    return [part.strip() for part in parts if part.strip()]


def with_settings(thing: Any, text: str | None, given: str) -> Any:
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
        values = _values(kind, _parsed(text)) if text else {}
        if kind is thing:
            thing = thing(**values)
        elif values:
            thing = dataclasses.replace(thing, **values)
        require_settings(thing)
        return thing
    except Exception as error:
        names = ", ".join(field.name for field in _fields(kind)) or "none"
        why = str(error).rstrip(".") or type(error).__name__
        raise InputError(f"{given}: {why}; its settings are {names}") from error


def named(text: str, known: Mapping[str, Any], kind: str, place: str) -> Any:
    """The thing of a catalogue, or in code, that a text names, with the settings behind it.

    A class in code is made: with these settings, and its usual ones for the rest.  A thing of a
    catalogue whose settings change has the text for a name, if it has one to change.

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
    match = CALL.fullmatch(text.strip())
    name, settings = (match["name"], match["settings"]) if match else (text, None)
    if place_in_code := PLACE.fullmatch(name):
        return with_settings(_taken(place_in_code), settings, text)
    if name not in known:
        there = f"choose from {', '.join(known)}, or name file.py:{place}"
        raise InputError(f"unknown {kind} '{name}': {there}")
    usual = known[name]
    thing = with_settings(usual, settings, text)
    renamed = "name" in vars(usual) and thing != usual and thing.name == usual.name
    return dataclasses.replace(thing, name=name_of(text)) if renamed else thing


def name_of(text: str) -> str:
    """A text as a name that files and links may have."""
    return re.sub(r"[^\w.]+", "-", text, flags=re.ASCII).strip("-")[:100]


def require_name(name: object, kind: str) -> None:
    """Refuse a name that tables, links and files cannot have."""
    if not isinstance(name, str) or not re.fullmatch(r"\w[\w.+-]{0,100}", name, re.ASCII):
        raise InputError(f"{kind} {name!r}: a name must be of letters, digits and . + -")


def _parsed(text: str) -> ast.Call:
    """The settings of a text as the arguments of a call."""
    with suppress(SyntaxError, ValueError, MemoryError, RecursionError):
        call = ast.parse(f"_({text})", mode="eval").body
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and not call.args:
            return call
    raise ValueError(f"'{text}' is not SETTING=VALUE, ...; check brackets, put words in quotes")


def _values(kind: type, call: ast.Call) -> dict[str, object]:
    """The values of settings by their names, as the class declares them.

    A whole number may be a float, and nothing else another type.
    """
    from pydantic import ConfigDict, TypeAdapter, ValidationError

    hints = get_type_hints(kind)
    parts = [*kind.__mro__, *(part for hint in hints.values() for part in (hint, *get_args(hint)))]
    modules = [sys.modules.get(getattr(part, "__module__", "")) for part in parts]
    known = ChainMap(*(vars(module) for module in modules if module))
    strictly = ConfigDict(strict=True, arbitrary_types_allowed=True)
    values: dict[str, object] = {}
    for setting in call.keywords:
        name, typed = str(setting.arg), _value(setting.value, known)
        if name not in {field.name for field in _fields(kind)}:
            raise ValueError(f"there is no setting '{name}'")
        one: Any = tuple[hints[name]]  # type: ignore[valid-type]  # a dataclass takes no config
        try:
            (values[name],) = TypeAdapter(one, config=strictly).validate_python((typed,))
        except ValidationError as error:
            raise ValueError(f"{name}={as_typed(typed)}: {error.errors()[0]['msg']}") from None
    return values


def _value(node: ast.expr, known: Mapping[str, Any]) -> object:
    """What was typed as an object; a dataclass is one known where a declared type is written."""
    if isinstance(node, ast.Tuple | ast.List):
        return tuple(_value(entry, known) for entry in node.elts)
    if isinstance(node, ast.Call):
        kind = known.get(ast.unparse(node.func))
        if not (isinstance(kind, type) and dataclasses.is_dataclass(kind)):
            raise ValueError(f"{ast.unparse(node.func)}(...) is not known there")
        return kind(**_values(kind, node))
    with suppress(ValueError):
        return ast.literal_eval(node)
    word = ast.unparse(node).replace(" ", "")  # one-sided reads as a difference
    return CONSTANTS.get(word.lower(), word)


def _fields(kind: type) -> list[dataclasses.Field[Any]]:
    """The settings of a class; only a dataclass has any."""
    return [f for f in dataclasses.fields(kind) if f.init] if dataclasses.is_dataclass(kind) else []


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
    for field in _fields(type(thing)):
        value = as_typed(getattr(thing, field.name))
        make = field.default_factory
        default = make() if callable(make) else field.default  # MISSING may be a copy of itself
        if as_typed(getattr(usual, field.name, default)) != value:
            changed.append(f"{field.name}={value}")
    return f"{name}({', '.join(changed)})" if changed else name


def as_typed(value: object) -> str:
    """A value as a user would type it, where it can be typed; also one that `to_jsonable` made."""
    match value:
        case None | bool() | int() | float():
            return str(value).lower().removesuffix(".0")
        case str():
            is_word = value.isidentifier() and value.isascii() and not iskeyword(value)
            return value if is_word and value.lower() not in CONSTANTS else repr(value)
        case list() | tuple():
            return f"({', '.join(map(as_typed, value))}{',' if len(value) == 1 else ''})"
        case dict():
            inner = [f"{key}={as_typed(entry)}" for key, entry in value.items() if key != "class"]
            return f"{value.get('class', '')}({', '.join(inner)})"
    return as_typed(to_jsonable(value))


def to_jsonable(value: object) -> Any:
    """A value as plain objects for JSON; equal settings give equal objects.

    A dataclass becomes a mapping of its fields, with its name under ``class``, which no field
    can be called.  Numbers keep all their digits; what is neither number, text, list, mapping nor
    dataclass is what it is called.
    """
    text = json.dumps(value, default=_plain)
    return json.loads(text, parse_constant=lambda constant: str(float(constant)))


def _plain(value: object) -> object:
    """What JSON has in the place of an object."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}
        return {"class": type(value).__qualname__, **fields}
    if hasattr(value, "tolist"):  # a number or an array of numpy's
        return value.tolist()
    return str(getattr(value, "__qualname__", "") or repr(value))


# ------------------------------------------------------------------------- objects taken from code


#: ``file.py:NAME`` or ``package.module:NAME``; a drive letter is no such thing.
PLACE = re.compile(r"(?P<module>.{2,}):(?P<name>[^\W\d]\w*)", re.DOTALL)
#: Path and content of modules that are read from a file.
FILES: dict[str, tuple[str, bytes]] = {}
#: What numbers depend on: a store notes the versions.
LIBRARIES = ("numpy", "scipy", "control", "pysindy", "emcee")
#: What is there anyway.
KNOWN = {"pilotid", "cloudpickle", *sys.stdlib_module_names, *LIBRARIES}


def _taken(place: re.Match[str]) -> Any:
    """What stands at a place in code."""
    path = Path(place["module"])
    try:
        if path.suffix == ".py" or len(path.parts) > 1:
            module = _run(str(path.resolve()), path.read_bytes())
        else:
            sys.path.append(str(Path.cwd()))  # last, so that it hides nothing
            module = importlib.import_module(str(path))
    except (Exception, SystemExit) as error:  # code of others may do anything, even leave
        why = f"{path}: cannot be imported ({reason(error)})"
        raise InputError(f"{why}; check its name and its imports") from error
    if not hasattr(module, place["name"]):
        raise InputError(f"{path}: holds no '{place['name']}'; check the name")
    return getattr(module, place["name"])


def _run(path: str, content: bytes) -> ModuleType:
    """A file as a module, whose name changes with its content."""
    name = f"pilotid_file_{digest_of([os.fsencode(path), content])}"
    if name not in FILES:
        sys.path.append(str(Path(path).parent))  # what lies beside it
        module = ModuleType(name)
        module.__file__ = path
        sys.modules[name] = module  # before it runs: dataclasses look their module up
        exec(compile(content, path, "exec"), vars(module))
        FILES[name] = path, content
    return sys.modules[name]


def packed(thing: object) -> bytes:
    """An object for another process, with the code that no other process could import.

    Raises
    ------
    InputError
        If it holds what no other process can have, such as an open file.
    """
    content = _pickled(thing)
    return pickle.dumps(([file for n, file in FILES.items() if n.encode() in content], content))


def unpacked(content: bytes) -> Any:
    """What `packed` was given."""
    files, thing = pickle.loads(content)
    for path, source in files:
        _run(path, source)
    return pickle.loads(thing)


def _pickled(thing: object) -> bytes:
    import cloudpickle

    try:
        return bytes(cloudpickle.dumps(thing))
    except Exception as error:
        raise InputError(f"a setting cannot be pickled ({reason(error)}); use numbers") from error


def code_digest(thing: object) -> str:
    """A short digest of the files that an object's classes are from, empty if all are ours.

    What a file imports from its own folder counts as well.

    Raises
    ------
    InputError
        If it is of a class that is in no file.
    """
    words = {text for _, text, _ in pickletools.genops(_pickled(thing)) if isinstance(text, str)}
    modules = [n for n in words & sys.modules.keys() if n.partition(".")[0] not in KNOWN]
    files = [Path(getattr(sys.modules[name], "__file__", None) or "") for name in modules]
    if not all(file.is_file() for file in files):
        raise InputError(f"a class of {', '.join(modules)} was typed in; write it to a file")
    for file in files:  # their number grows
        files += [other for other in _imported_beside(file) if other not in files]
    return digest_of(file.read_bytes() for file in sorted(files)) if files else ""


def _imported_beside(file: Path) -> list[Path]:
    """The files of its own folder that a file of Python imports."""
    nodes = ast.walk(ast.parse(file.read_bytes())) if file.suffix == ".py" else ()
    imports = [node for node in nodes if isinstance(node, ast.Import | ast.ImportFrom)]
    names = {getattr(n, "module", None) or alias.name for n in imports for alias in n.names}
    beside = {file.parent / f"{name.partition('.')[0]}.py" for name in names}
    return sorted(path for path in beside if path.is_file())


def digest_of(sources: Iterable[bytes]) -> str:
    """A short digest of code."""
    return hashlib.sha256(b"\0".join(sources)).hexdigest()[:12]
