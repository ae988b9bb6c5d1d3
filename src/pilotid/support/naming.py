"""Things by name: named, named with settings (as text and as JSON), or taken from code.

``arx(memory=none)`` names a thing and the settings that differ from its usual ones.  A value
is a number, ``none``, ``true``, ``false``, a word (in quotes if it has other signs than
letters, digits and ``.+-``), a list in parentheses, or again a name with settings.

Code of the user's own goes along to other processes.  A digest tells whether it has changed.
"""

from __future__ import annotations

import ast
import copyreg
import dataclasses
import hashlib
import importlib
import math
import os
import pickle
import pickletools
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Any, get_args, get_type_hints

from pilotid.support.numbers import require_settings
from pilotid.support.types import InputError, reason

CALL = re.compile(r"(?P<name>(.{2,}:)?[^()]*?)\s*(\((?P<settings>.*)\))?", re.DOTALL)
#: A text in quotes, or a word without: neither a setting's name nor that of a class.
WORD = re.compile(
    r"""('(?:[^'\\]|\\.)*'|"(?:[^"\\]|\\.)*")|(?<![\w.])([A-Za-z_][\w.+-]*)(?!\s*[=(\w.+-])"""
)
CONSTANTS = {"none": "None", "true": "True", "false": "False", "inf": "1e999"}


def split_list(text: str) -> list[str]:
    """The names in a text between commas outside parentheses, empty ones left out."""
    parts: list[str] = []
    for part in text.split(","):
        if parts and parts[-1].count("(") > parts[-1].count(")"):
            parts[-1] += f",{part}"
        else:
            parts.append(part)
    return [part.strip() for part in parts if part.strip()]


def split_call(text: str) -> tuple[str, str | None]:
    """A name, and the settings in the parentheses at its end, None if there are none."""
    match = CALL.fullmatch(text.strip())
    return (match["name"], match["settings"]) if match else (text.strip(), None)


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
    name, settings = split_call(text)
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
        raise InputError(
            f"a {kind} has the name {name!r}; it must be of letters, digits and the signs . + -"
        )


def _parsed(text: str) -> ast.Call:
    """The settings of a text as the arguments of a call, with words in quotes."""
    words = WORD.sub(lambda m: m[1] or CONSTANTS.get(m[2].lower(), repr(m[2])), text)
    with suppress(SyntaxError, ValueError, MemoryError, RecursionError):
        call = ast.parse(f"_({words})", mode="eval").body
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and not call.args:
            return call
    raise ValueError(
        f"'{text}' is not SETTING=VALUE, ...; check brackets, and put words with other signs in "
        "quotes"
    )


def _values(kind: type, call: ast.Call) -> dict[str, object]:
    """The values of settings by their names, as the class declares them.

    A whole number may be a float, and nothing else another type.
    """
    from pydantic import ConfigDict, TypeAdapter, ValidationError

    hints = get_type_hints(kind)
    parts = [*kind.__mro__, *(part for hint in hints.values() for part in (hint, *get_args(hint)))]
    modules = [sys.modules.get(getattr(part, "__module__", "")) for part in parts]
    places = [vars(module) for module in modules if module]
    typed = {str(setting.arg): _value(setting.value, places) for setting in call.keywords}
    for name in sorted(typed.keys() - {field.name for field in _fields(kind)}):
        raise ValueError(f"there is no setting '{name}'")
    types: Any = tuple[tuple(hints[name] for name in typed)]  # type: ignore[misc]
    strictly = ConfigDict(strict=True, arbitrary_types_allowed=True)
    try:
        values = TypeAdapter(types, config=strictly).validate_python(tuple(typed.values()))
    except ValidationError as error:
        fault = error.errors()[0]
        name, why = list(typed)[int(fault["loc"][0])], fault["msg"]
        raise ValueError(f"{name}={as_typed(typed[name])}: {why[:1].lower()}{why[1:]}") from None
    return dict(zip(typed, values, strict=True))


def _value(node: ast.expr, places: Sequence[Mapping[str, Any]]) -> object:
    """What was typed as an object; a dataclass is one known where a declared type is written."""
    if isinstance(node, ast.Tuple | ast.List):
        return tuple(_value(entry, places) for entry in node.elts)
    if not isinstance(node, ast.Call):
        return ast.literal_eval(node)
    name = ast.unparse(node.func)
    for kind in (place.get(name) for place in places):
        if isinstance(kind, type) and dataclasses.is_dataclass(kind):
            return kind(**_values(kind, node))
    raise ValueError(f"{name}(...) is not known there")


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
        factory = field.default_factory
        default = field.default if factory is dataclasses.MISSING else factory()
        value = as_typed(getattr(thing, field.name))
        if as_typed(getattr(usual, field.name, default)) != value:
            changed.append(f"{field.name}={value}")
    return f"{name}({', '.join(changed)})" if changed else name


def as_typed(value: object) -> str:
    """A value as a user would type it, where it can be typed; also one that `to_jsonable` made."""
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
            return f"({', '.join(map(as_typed, value))}{',' if len(value) == 1 else ''})"
        case dict():
            inner = [f"{key}={as_typed(entry)}" for key, entry in value.items() if key != "class"]
            return f"{value.get('class', '')}({', '.join(inner)})"
    return str(to_jsonable(value))


def to_jsonable(value: object) -> Any:
    """A value as plain objects for JSON; equal settings give equal objects.

    A dataclass becomes a mapping of its fields, with its name under ``class``, which no field
    can be called.  Numbers keep all their digits; what is neither number, text, list, mapping nor
    dataclass is what it is called.
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {f.name: to_jsonable(getattr(value, f.name)) for f in dataclasses.fields(value)}
        return {"class": type(value).__qualname__, **fields}
    if hasattr(value, "tolist"):  # a number or an array of numpy's
        return to_jsonable(value.tolist())
    match value:
        case None | bool() | int() | str():
            return value
        case float():
            return value if math.isfinite(value) else str(value)
        case list() | tuple():
            return [to_jsonable(entry) for entry in value]
        case Mapping():
            return {str(key): to_jsonable(entry) for key, entry in value.items()}
    return str(getattr(value, "__qualname__", "") or repr(value))


# ------------------------------------------------------------------------- objects taken from code


#: ``file.py:NAME`` or ``package.module:NAME``; a drive letter is no such thing.
PLACE = re.compile(r"(?P<module>.{2,}):(?P<name>[^\W\d]\w*(\.[^\W\d]\w*)*)", re.DOTALL)
#: Path and content of modules that are read from a file.
FILES: dict[str, tuple[str, bytes]] = {}
#: What numbers depend on: a store notes the versions.
LIBRARIES = ("numpy", "scipy", "control", "pysindy", "emcee")
#: What is there anyway.
KNOWN = {"pilotid", "cloudpickle", *sys.stdlib_module_names, *LIBRARIES}

# A constant that is told by its identity, which cloudpickle does not know.
copyreg.pickle(type(dataclasses.MISSING), lambda _: "MISSING")


def _taken(place: re.Match[str]) -> Any:
    """What stands at a place in code."""
    module = thing = _module(place["module"])
    for name in place["name"].split("."):
        if not hasattr(thing, name):
            there = [known for known in vars(module) if not known.startswith("_")]
            raise InputError(f"{place[0]}: holds no '{name}'; it has {', '.join(there[-20:])}")
        thing = getattr(thing, name)
    return thing


def _module(where: str) -> ModuleType:
    """A module by its name, or from its file."""
    path = Path(where)
    try:
        if path.suffix == ".py" or len(path.parts) > 1:
            return _run(str(path.resolve()), path.read_bytes())
        sys.path.append(str(Path.cwd()))  # last, so that it hides nothing
        return importlib.import_module(where)
    except (Exception, SystemExit) as error:  # code of others may do anything, even leave
        why = f"{where}: cannot be imported ({reason(error)})"
        raise InputError(f"{why}; check its name and its imports") from error


def _run(path: str, content: bytes) -> ModuleType:
    """A file as a module, whose name changes with its content."""
    name = f"pilotid_file_{hashlib.sha256(os.fsencode(path) + content).hexdigest()[:12]}"
    if name not in sys.modules:
        sys.path.append(str(Path(path).parent))  # what lies beside it
        module = ModuleType(name)
        module.__file__ = path
        sys.modules[name] = module  # before it runs: dataclasses look their module up
        try:
            exec(compile(content, path, "exec"), vars(module))
        except BaseException:
            del sys.modules[name]
            raise
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
        raise InputError(
            f"a setting cannot be handed to another process ({reason(error)}); let settings be "
            "numbers, words and dataclasses"
        ) from error


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
    todo, sources = [_file_of(name) for name in modules], dict[Path, bytes]()
    while todo:
        file = todo.pop()
        if file not in sources:
            sources[file] = file.read_bytes()
            todo += _imported_beside(file)
    return digest_of(source for _, source in sorted(sources.items())) if sources else ""


def _file_of(module: str) -> Path:
    """The file that a module is from."""
    file = Path(getattr(sys.modules[module], "__file__", None) or "")
    if not file.is_file():
        raise InputError(f"a class of {module} was typed in; write it to a file")
    return file


def _imported_beside(file: Path) -> list[Path]:
    """The files of its own folder that a file of Python imports."""
    nodes = [*ast.walk(ast.parse(file.read_bytes()))] if file.suffix == ".py" else []
    names = [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
    names += [node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)]
    beside = {file.parent / f"{name.partition('.')[0]}.py" for name in names}
    return sorted(path for path in beside if path.is_file())


def digest_of(sources: Iterable[bytes]) -> str:
    """A short digest of code."""
    return hashlib.sha256(b"\0".join(sources)).hexdigest()[:12]
