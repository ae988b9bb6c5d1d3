"""Objects taken from code: from a file, or from a module that Python finds.

Code of the user's own goes along to other processes, which run what was read here, wherever
they are and whatever happens to the file.  A digest of it tells whether it has changed.
"""

from __future__ import annotations

import ast
import dataclasses
import functools
import hashlib
import importlib
import inspect
import io
import os
import pickle
import re
import sys
from collections import ChainMap
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, ClassVar
from zlib import crc32

from pilotid.naming.settings import configured, split_call
from pilotid.support.types import InputError

#: ``file.py:NAME`` or ``package.module:NAME``; a drive letter is no such thing.
PLACE = re.compile(r"(?P<module>.{2,}):(?P<name>[^\W\d]\w*(\.[^\W\d]\w*)*)", re.DOTALL)
#: How the names of modules begin that are read from a file.
FROM_FILE = "pilotid_file_"
OWN = "pilotid"
#: What is there anyway: a store notes the version of what numbers depend on.
KNOWN = {OWN, *sys.stdlib_module_names, "numpy", "scipy", "control", "pysindy", "emcee"}


class PluginWarning(UserWarning):
    """Code of another package that is left out; the message is a sentence for the user."""


def is_place(text: str) -> bool:
    """Whether a text says where in which code something is, rather than naming it."""
    return PLACE.fullmatch(split_call(text)[0]) is not None


def taken(text: str) -> Any:
    """What stands at ``file.py:NAME`` or ``package.module:NAME``, with the settings behind it.

    A class is made: with these settings, and its usual ones for the rest.

    Raises
    ------
    InputError
        If the code cannot be imported, holds no such name, or refuses the settings.
    """
    place, settings = split_call(text)
    parts = PLACE.fullmatch(place)
    if parts is None:
        raise InputError(f"{text}: is not file.py:NAME or package.module:NAME")
    module = _module(parts["module"])
    thing: Any = module
    for name in parts["name"].split("."):
        if not hasattr(thing, name):
            there = [known for known in vars(module) if not known.startswith("_")]
            raise InputError(f"{place}: holds no '{name}'; it has {', '.join(there[-20:])}")
        thing = getattr(thing, name)
    return configured(thing, settings, text)


def place_of(thing: type) -> str:
    """Where a class is, as `taken` understands it."""
    where = thing.__module__
    if where.startswith(FROM_FILE):
        file = Path(sys.modules[where].__file__ or "")
        where = os.path.relpath(file) if file.is_relative_to(Path.cwd()) else str(file)
    return f"{where}:{thing.__qualname__}"


def reason(error: BaseException) -> str:
    """An exception in words, whatever its own words do."""
    try:
        said = str(error)
    except Exception:
        said = ""
    name = type(error).__name__
    return f"{name}: {said}" if said else name


def _module(where: str) -> ModuleType:
    is_file = where.endswith(".py") or "/" in where or os.sep in where
    try:
        if is_file:
            return _from_file(Path(where))
        _find_beside(Path.cwd())
        return importlib.import_module(where)
    except (InputError, KeyboardInterrupt):
        raise
    except BaseException as error:  # code of others may do anything, even leave
        remedy = "check its imports" if is_file else "check its name, or name the file instead"
        raise InputError(f"{where}: cannot be imported ({reason(error)}); {remedy}") from error


def _from_file(path: Path) -> ModuleType:
    """A file as a module, whose name changes with its content."""
    try:
        content = path.read_bytes()
    except OSError as error:
        why = "there is no such file" if isinstance(error, FileNotFoundError) else error.strerror
        raise InputError(f"{path}: {why}; name a file of Python code before the colon") from None
    path = path.resolve()
    _find_beside(path.parent)
    stem = re.sub(r"\W", "_", path.stem)
    name = f"{FROM_FILE}{stem}_{crc32(os.fsencode(path) + bytes(1) + content):08x}"
    if name in sys.modules:
        return sys.modules[name]
    module = ModuleType(name)
    module.__file__ = str(path)
    sys.modules[name] = module  # before it runs: dataclasses look their module up
    try:
        exec(compile(content, path, "exec"), vars(module))
    except BaseException:
        del sys.modules[name]
        raise
    return module


def _find_beside(folder: Path) -> None:
    """Let code import what lies beside it; at the end, so that nothing is put in the shade."""
    if str(folder) not in sys.path:
        sys.path.append(str(folder))


# ------------------------------------------------------------------- to other processes


def packed(thing: object) -> bytes:
    """An object for another process, with the code that no other process could import."""
    import cloudpickle

    for name, module in list(sys.modules.items()):
        if name.startswith(FROM_FILE):
            cloudpickle.register_pickle_by_value(module)

    class Pickler(cloudpickle.Pickler):  # type: ignore[misc]
        # What cloudpickle does not know: a constant that is told by its identity, and caches.
        dispatch_table: ClassVar[Any] = ChainMap(
            {
                type(dataclasses.MISSING): lambda _: "MISSING",
                functools._lru_cache_wrapper: _cache_again,
            },
            cloudpickle.Pickler.dispatch_table,
        )

    stream = io.BytesIO()
    Pickler(stream).dump(thing)
    return stream.getvalue()


def _cache_again(function: Any) -> str | tuple[object, ...]:
    """How another process makes a function with a cache."""
    if not function.__module__.startswith((FROM_FILE, "__main__")):
        return str(function.__qualname__)  # it can import it
    return functools.lru_cache(**function.cache_parameters()), (function.__wrapped__,)


def unpacked(content: bytes) -> Any:
    """What `packed` was given."""
    return pickle.loads(content)


# -------------------------------------------------------------------- whether code changed


@functools.cache
def own_digest() -> str:
    """A short digest of this package's source."""
    found = [find_spec(name) for name in (OWN, f"{OWN}.methods", f"{OWN}.datasets")]
    digest = hashlib.sha256()
    for folder in [f for spec in found if spec for f in spec.submodule_search_locations or ()]:
        for file in sorted(Path(folder).rglob("*.py")):
            place = file.relative_to(folder).as_posix()
            digest.update(place.encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()[:12]


def code_digest(thing: object) -> str:
    """A short digest of the code that an object is from, empty if it is all of this package.

    It covers the package of each class that the object is made of, or the file and the files
    beside it that it imports, in whatever function.

    Raises
    ------
    InputError
        If it is of a class that was typed in where nobody can read it again.
    """
    found: dict[str, bytes] = {}
    for kind in _classes(thing):
        top, *_ = str(kind.__module__).split(".")
        if top in KNOWN or kind.__module__ not in sys.modules:
            continue
        file = Path(getattr(sys.modules[kind.__module__], "__file__", None) or "")
        if not file.is_file():
            found[kind.__qualname__] = _typed_in(kind)
        elif package := getattr(sys.modules[top], "__file__", None):
            folder = Path(package).parent
            inside = hasattr(sys.modules[top], "__path__")
            files = folder.rglob("*.py") if inside else _with_imports(file)
            found |= {f.relative_to(folder).as_posix(): f.read_bytes() for f in files}
        else:  # it only bundles packages
            found |= {f.name: f.read_bytes() for f in file.parent.glob("*.py")}
    digest = hashlib.sha256()
    for place, content in sorted(found.items()):
        digest.update(place.encode("utf-8", "replace") + b"\0" + content + b"\0")
    return digest.hexdigest()[:12] if found else ""


def _classes(thing: object) -> list[Any]:
    """All classes and functions that an object is made of."""
    found: dict[int, object] = {}
    waiting = [thing]
    while waiting:
        part = waiting.pop()
        if id(part) in found:
            continue
        found[id(part)] = part
        waiting += part.__mro__ if isinstance(part, type) else [type(part)]
        if dataclasses.is_dataclass(part) and not isinstance(part, type):
            waiting += [getattr(part, f.name) for f in dataclasses.fields(part)]
        elif isinstance(part, Mapping):
            waiting += part.values()
        elif isinstance(part, list | tuple | set | frozenset):
            waiting += part
    return [part for part in found.values() if isinstance(part, type | FunctionType)]


def _typed_in(kind: type | FunctionType) -> bytes:
    """The source of a class's functions, as a notebook has it."""
    parts = [kind, *vars(kind).values()]
    own = [f for f in parts if isinstance(f, FunctionType) and f.__code__.co_filename != "<string>"]
    try:
        return "".join(map(inspect.getsource, own)).encode()
    except OSError:
        raise InputError(
            f"{kind.__qualname__}: was typed in, and nobody could tell later whether it has "
            "changed; write it to a file"
        ) from None


def _with_imports(file: Path) -> set[Path]:
    """A file, and what it imports that lies beside it."""
    found: set[Path] = set()
    waiting = [file]
    while waiting:
        path = waiting.pop()
        if path in found or not path.is_file():
            continue
        found.add(path)
        if file.parent.name in ("site-packages", "dist-packages"):
            break
        for name in _imported(path):
            waiting += [file.parent / f"{name}.py", *(file.parent / name).rglob("*.py")]
    return found


def _imported(path: Path) -> set[str]:
    """First names of the modules that a file imports."""
    try:
        nodes = list(ast.walk(ast.parse(path.read_bytes())))
    except (SyntaxError, ValueError):
        return set()
    names = {alias.name for n in nodes if isinstance(n, ast.Import) for alias in n.names}
    names |= {n.module or "" for n in nodes if isinstance(n, ast.ImportFrom) and not n.level}
    return {name.partition(".")[0] for name in names} - KNOWN - {""}
