"""Objects taken from code: from a file, or from a module that Python finds.

Code of the user's own goes along to other processes, which run what was read here, wherever
they are and whatever happens to the file.  A digest of it tells whether it has changed.
"""

from __future__ import annotations

import copyreg
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
from importlib.util import find_spec
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any
from zlib import crc32

from pilotid.naming.settings import configured, split_call
from pilotid.support.types import InputError

#: ``file.py:NAME`` or ``package.module:NAME``; a drive letter is no such thing.
PLACE = re.compile(r"(?P<module>.{2,}):(?P<name>[^\W\d]\w*(\.[^\W\d]\w*)*)", re.DOTALL)
#: How the names of modules begin that are read from a file.
FROM_FILE = "pilotid_file_"
#: Path and content of such modules.
FILES: dict[str, tuple[str, bytes]] = {}
#: What is there anyway: a store notes the version of what numbers depend on.
LIBRARIES = {"numpy", "scipy", "control", "pysindy", "emcee", "cloudpickle"}
KNOWN = {"pilotid", *sys.stdlib_module_names, *LIBRARIES}

# A constant that is told by its identity, which cloudpickle does not know.
copyreg.pickle(type(dataclasses.MISSING), lambda _: "MISSING")


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
    module = thing = _module(parts["module"])
    for name in parts["name"].split("."):
        if not hasattr(thing, name):
            there = [known for known in vars(module) if not known.startswith("_")]
            raise InputError(f"{place}: holds no '{name}'; it has {', '.join(there[-20:])}")
        thing = getattr(thing, name)
    return configured(thing, settings, text)


def place_of(thing: type) -> str:
    """Where a class is, as `taken` understands it."""
    where = thing.__module__
    if where in FILES:
        file = Path(FILES[where][0])
        where = os.path.relpath(file) if file.is_relative_to(Path.cwd()) else str(file)
    return f"{where}:{thing.__qualname__}"


def reason(error: BaseException) -> str:
    """An exception in words."""
    return f"{type(error).__name__}: {error}".removesuffix(": ")


def _module(where: str) -> Any:
    """A module by its name, or from its file."""
    path = Path(where)
    is_file = path.suffix == ".py" or len(path.parts) > 1
    try:
        # What lies beside it is imported, too; last, so that it hides nothing.
        folder = str(path.resolve().parent if is_file else Path.cwd())
        sys.path += [folder] if folder not in sys.path else []
        if not is_file:
            return importlib.import_module(where)
        return _run(str(path.resolve()), path.read_bytes())
    except KeyboardInterrupt:
        raise
    except OSError as error:
        why = f"{path}: {error.strerror or error}"
        raise InputError(f"{why}; name a file of Python code before the colon") from None
    except BaseException as error:  # code of others may do anything, even leave
        why = f"{where}: cannot be imported ({reason(error)})"
        raise InputError(f"{why}; check its name and its imports") from error


def _run(path: str, content: bytes) -> ModuleType:
    """A file as a module, whose name changes with its content."""
    stem = re.sub(r"\W", "_", Path(path).stem)
    name = f"{FROM_FILE}{stem}_{crc32(os.fsencode(path) + bytes(1) + content):08x}"
    if name not in sys.modules:
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
    """An object for another process, with the code that no other process could import."""
    import cloudpickle

    content = cloudpickle.dumps(thing)
    return pickle.dumps(([file for n, file in FILES.items() if n.encode() in content], content))


def unpacked(content: bytes) -> Any:
    """What `packed` was given."""
    files, thing = pickle.loads(content)
    for path, source in files:
        sys.path += [folder] if (folder := str(Path(path).parent)) not in sys.path else []
        _run(path, source)
    return pickle.loads(thing)


@functools.cache
def own_digest() -> str:
    """A short digest of this package's source."""
    found = [find_spec(name) for name in ("pilotid", "pilotid.methods", "pilotid.datasets")]
    folders = [f for spec in found if spec for f in spec.submodule_search_locations or ()]
    digest = hashlib.sha256()
    for folder in map(Path, folders):
        for file in sorted(folder.rglob("*.py")):
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
        package = Path(getattr(sys.modules[top], "__file__", None) or file)
        if not file.is_file():
            found[kind.__qualname__] = _typed_in(kind)
            continue
        inside = package.name == "__init__.py"
        files = package.parent.rglob("*.py") if inside else _with_imports(file)
        folder = package.parent
        found |= {f.relative_to(folder).as_posix(): f.read_bytes() for f in files}
    digest = hashlib.sha256()
    for place, content in sorted(found.items()):
        digest.update(place.encode("utf-8", "replace") + b"\0" + content + b"\0")
    return digest.hexdigest()[:12] if found else ""


def _classes(thing: object) -> set[Any]:
    """All classes and functions that an object is made of."""
    import cloudpickle

    found: set[Any] = set()

    class Recorder(cloudpickle.Pickler):  # type: ignore[misc]
        def persistent_id(self, part: Any) -> None:
            kind = part if isinstance(part, type | FunctionType) else type(part)
            found.update(getattr(kind, "__mro__", (kind,)))

    try:
        Recorder(io.BytesIO()).dump(thing)
    except Exception as error:
        raise InputError(
            f"{type(thing).__qualname__}: cannot be handed to another process ({reason(error)}); "
            "let its settings be numbers, words and dataclasses"
        ) from error
    return found


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
        text = path.read_text("utf-8", "replace")
        lines = re.findall(r"^\s*(?:from|import)\s(.*)", text, re.MULTILINE)
        for name in set(re.findall(r"\w+", " ".join(lines))) - KNOWN:
            waiting += [file.parent / f"{name}.py", *(file.parent / name).rglob("*.py")]
    return found
