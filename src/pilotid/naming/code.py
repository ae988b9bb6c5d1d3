"""Objects taken from code: from a file, or from a module that Python finds.

A file's module is known by a name of its own, under which its text goes along to other
processes: they run what was read here, wherever they are and whatever happens to the file.
"""

from __future__ import annotations

import importlib
import os
import pickle
import re
import sys
from importlib.abc import InspectLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any
from zlib import crc32

from pilotid.naming.settings import configured, made
from pilotid.naming.text import split_call
from pilotid.types import InputError


class PluginWarning(UserWarning):
    """Code of another package that is left out; the message is a sentence for the user."""


#: ``file.py:NAME`` or ``package.module:NAME``; a drive letter is no such thing.
PLACE = re.compile(r"(?P<module>.{2,}):(?P<name>[^\W\d]\w*(\.[^\W\d]\w*)*)", re.DOTALL)


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
            raise InputError(f"{place}: holds no '{name}'; {_what_there_is(module)}")
        thing = getattr(thing, name)
    return (
        made(thing, settings, text)
        if isinstance(thing, type)
        else configured(thing, settings, text)
    )


def place_of(thing: type) -> str:
    """Where a class is, as `taken` understands it."""
    module = sys.modules.get(thing.__module__)
    loader = getattr(module, "__loader__", None)
    where = loader.path if isinstance(loader, FromText) else thing.__module__
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
    try:
        text = path.read_bytes().decode("utf-8")
    except OSError as error:
        why = "there is no such file" if isinstance(error, FileNotFoundError) else error.strerror
        raise InputError(f"{path}: {why}; name a file of Python code before the colon") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: is no text in UTF-8; name a file of Python code") from None
    _find_beside(path.resolve().parent)
    where = os.path.relpath(path) if path.resolve().is_relative_to(Path.cwd()) else str(path)
    stem = re.sub(r"\W", "_", path.stem)
    digest = crc32(f"{path.resolve()}\0{text}".encode("utf-8", "surrogatepass"))
    return _from_text(f"pilotid_file_{stem}_{digest:08x}", text, where)


def _find_beside(folder: Path) -> None:
    """Let code import what lies beside it; at the end, so that nothing is put in the shade."""
    if str(folder) not in sys.path:
        sys.path.append(str(folder))


class FromText(InspectLoader):
    """Loads a module from a text that was read before."""

    def __init__(self, text: str, path: str) -> None:
        self.text, self.path = text, path

    def get_source(self, fullname: str) -> str:
        """The text."""
        return self.text

    def get_code(self, fullname: str) -> CodeType:
        """The compiled text, with its file's name in tracebacks."""
        return self.source_to_code(self.text, self.path)

    def is_package(self, fullname: str) -> bool:
        """A file is no package."""
        return False


def _from_text(name: str, text: str, path: str) -> ModuleType:
    if name in sys.modules:
        return sys.modules[name]
    loader = FromText(text, path)
    spec = spec_from_loader(name, loader, origin=path)
    assert spec is not None
    module = module_from_spec(spec)
    module.__file__ = path
    sys.modules[name] = module  # before it runs: dataclasses look their module up
    try:
        loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


def _what_there_is(module: ModuleType) -> str:
    own = [
        name
        for name, thing in vars(module).items()
        if not name.startswith("_")
        and not isinstance(thing, ModuleType)
        and (not isinstance(thing, type | FunctionType) or thing.__module__ == module.__name__)
    ]
    return f"it defines {', '.join(own[:20])}" if own else "it defines nothing"


# ------------------------------------------------------------------- to other processes


def packed(thing: object) -> bytes:
    """An object for another process, with the text of the files that its code is from."""
    content = pickle.dumps(thing)
    texts = {
        name: (module.__loader__.text, module.__loader__.path)
        for name, module in list(sys.modules.items())
        if name.startswith("pilotid_file_")
        and isinstance(module.__loader__, FromText)
        and name.encode() in content
    }
    return pickle.dumps((texts, content))


def unpacked(content: bytes) -> Any:
    """What `packed` was given."""
    texts, inner = pickle.loads(content)
    for name, (text, path) in texts.items():
        _from_text(name, text, path)
    return pickle.loads(inner)
