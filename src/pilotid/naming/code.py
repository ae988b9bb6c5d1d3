"""Objects taken from code: from a file, or from a module that Python finds.

Code of the user's own goes along to other processes.  A digest tells whether it has changed.
"""

from __future__ import annotations

import copyreg
import dataclasses
import hashlib
import importlib
import inspect
import io
import os
import pickle
import re
import sys
from collections.abc import Iterable
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

from pilotid.naming.settings import split_call, with_settings
from pilotid.support.types import InputError, reason

#: ``file.py:NAME`` or ``package.module:NAME``; a drive letter is no such thing.
PLACE = re.compile(r"(?P<module>.{2,}):(?P<name>[^\W\d]\w*(\.[^\W\d]\w*)*)", re.DOTALL)
#: Path and content of modules that are read from a file.
FILES: dict[str, tuple[str, bytes]] = {}
#: What is there anyway: a store notes the version of what numbers depend on.
LIBRARIES = {"numpy", "scipy", "control", "pysindy", "emcee", "cloudpickle"}
KNOWN = {"pilotid", *sys.stdlib_module_names, *LIBRARIES}

# A constant that is told by its identity, which cloudpickle does not know.
copyreg.pickle(type(dataclasses.MISSING), lambda _: "MISSING")


def is_place(text: str) -> bool:
    """Whether a text says where in which code something is, rather than naming it."""
    return PLACE.fullmatch(split_call(text)[0]) is not None


def load_object(text: str) -> Any:
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
    return with_settings(thing, settings, text)


def _module(where: str) -> ModuleType:
    """A module by its name, or from its file."""
    path = Path(where)
    is_file = path.suffix == ".py" or len(path.parts) > 1
    try:
        if is_file:
            return _run(str(path.resolve()), path.read_bytes())
        _import_from(Path.cwd())
        return importlib.import_module(where)
    except KeyboardInterrupt:
        raise
    except OSError as error:
        why = f"{path}: {error.strerror or error}"
        raise InputError(f"{why}; name a file of Python code before the colon") from None
    except BaseException as error:  # code of others may do anything, even leave
        why = f"{where}: cannot be imported ({reason(error)})"
        raise InputError(f"{why}; check its name and its imports") from error


def _import_from(folder: Path) -> None:
    """Import from a folder as well; last, so that it hides nothing."""
    sys.path += [str(folder)] if str(folder) not in sys.path else []


def _run(path: str, content: bytes) -> ModuleType:
    """A file as a module, whose name changes with its content."""
    name = f"pilotid_file_{hashlib.sha256(os.fsencode(path) + content).hexdigest()[:12]}"
    if name not in sys.modules:
        _import_from(Path(path).parent)  # what lies beside it
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
    content, _ = _pickled(thing)
    return pickle.dumps(([file for n, file in FILES.items() if n.encode() in content], content))


def unpacked(content: bytes) -> Any:
    """What `packed` was given."""
    files, thing = pickle.loads(content)
    for path, source in files:
        _run(path, source)
    return pickle.loads(thing)


def _pickled(thing: object) -> tuple[bytes, set[Any]]:
    """An object as bytes, and all classes and functions that it is made of."""
    import cloudpickle

    stream, found = io.BytesIO(), set[Any]()

    class Pickler(cloudpickle.Pickler):  # type: ignore[misc]
        def persistent_id(self, part: Any) -> None:
            kind = part if isinstance(part, type | FunctionType) else type(part)
            found.update(getattr(kind, "__mro__", (kind,)))

    try:
        Pickler(stream).dump(thing)
    except Exception as error:
        raise InputError(
            f"a setting cannot be handed to another process ({reason(error)}); let settings be "
            "numbers, words and dataclasses"
        ) from error
    return stream.getvalue(), found


def code_digest(thing: object) -> str:
    """A short digest of the files that an object's classes are from, empty if all are ours.

    Raises
    ------
    InputError
        If it is of a class that was typed in where nobody can read it again.
    """
    sources: dict[str, bytes] = {}
    for kind in _pickled(thing)[1]:
        module = sys.modules.get(kind.__module__)
        if module is not None and kind.__module__.partition(".")[0] not in KNOWN:
            file = getattr(module, "__file__", None)
            sources[file or kind.__qualname__] = _source(kind, file)
    return _digest(source for _, source in sorted(sources.items())) if sources else ""


def _digest(sources: Iterable[bytes]) -> str:
    return hashlib.sha256(b"\0".join(sources)).hexdigest()[:12]


def _source(kind: type | FunctionType, file: str | None) -> bytes:
    """The file of a class, or its functions as a notebook has them."""
    if file and Path(file).is_file():
        return Path(file).read_bytes()
    parts = [kind, *vars(kind).values()]
    own = [f for f in parts if isinstance(f, FunctionType) and f.__code__.co_filename != "<string>"]
    try:
        return "".join(map(inspect.getsource, own)).encode()
    except OSError:
        raise InputError(
            f"{kind.__qualname__}: was typed in, and nobody could tell later whether it has "
            "changed; write it to a file"
        ) from None
