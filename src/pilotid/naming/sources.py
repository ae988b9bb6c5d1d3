"""Digests of the code that objects are from, so that a store notices when it has changed."""

from __future__ import annotations

import ast
import dataclasses
import hashlib
import sys
from collections.abc import Iterable, Iterator, Mapping
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from types import ModuleType

from pilotid.naming.code import FromText

OWN = "pilotid"
#: What is there anyway: a store notes the version of what numbers depend on.
KNOWN = {OWN, *sys.stdlib_module_names, "numpy", "scipy", "control", "pysindy", "emcee"}
SUFFIXES = (".py", *EXTENSION_SUFFIXES)


def package_digest(folders: Iterable[str]) -> str:
    """A short digest of the source in folders."""
    digest = hashlib.sha256()
    for folder in folders:
        for file in sorted(Path(folder).rglob("*.py")):
            place = file.relative_to(folder).as_posix()
            digest.update(place.encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()[:12]


def code_digest(thing: object) -> str:
    """A short digest of the code that an object is from, empty if it is all of this package.

    It covers the package of each class that the object is made of, or the file and the files
    beside it that it imports, in whatever function.
    """
    found: dict[str, bytes] = {}
    for name in sorted(set(_modules(thing))):
        module = sys.modules.get(name)
        if module is not None and name.partition(".")[0] not in KNOWN:
            found.update(_sources(module))
    digest = hashlib.sha256()
    for place, content in sorted(found.items()):
        digest.update(place.encode("utf-8", "replace") + b"\0" + content + b"\0")
    return digest.hexdigest()[:12] if found else ""


def _modules(thing: object, depth: int = 0) -> Iterator[str]:
    """Names of the modules of all classes and functions that an object is made of."""
    if depth > 20:
        return
    if isinstance(thing, type) or callable(thing):
        yield str(getattr(thing, "__module__", ""))
    for kind in (thing if isinstance(thing, type) else type(thing)).__mro__:
        yield kind.__module__
    inner: Iterable[object] = ()
    if isinstance(thing, Mapping):
        inner = thing.values()
    elif isinstance(thing, list | tuple | set | frozenset):
        inner = thing
    elif dataclasses.is_dataclass(thing) and not isinstance(thing, type):
        inner = [getattr(thing, f.name) for f in dataclasses.fields(thing)]
    for part in inner:
        yield from _modules(part, depth + 1)


def _sources(module: ModuleType) -> dict[str, bytes]:
    """Files by their places in the package that a module belongs to, or beside it."""
    root = _root(module)
    if folders := list(getattr(root, "__path__", ())):
        return {
            f"{root.__name__}/{file.relative_to(folder).as_posix()}": file.read_bytes()
            for folder in folders
            for file in _code_in(Path(folder))
        }
    loader = getattr(module, "__loader__", None)
    file = getattr(module, "__file__", None)
    if file is None:
        return {}
    path = Path(file)
    content = loader.text.encode() if isinstance(loader, FromText) else path.read_bytes()
    found = {path.name: content}
    if path.suffix == ".py" and path.parent.name not in ("site-packages", "dist-packages"):
        _add_beside(found, content, path.parent)
    return found


def _root(module: ModuleType) -> ModuleType:
    """The outermost package that a module is in; one that only bundles packages is none."""
    parts = module.__name__.split(".")
    for count in range(1, len(parts) + 1):
        outer = sys.modules.get(".".join(parts[:count]))
        if outer is not None and getattr(outer, "__file__", None):
            return outer
    return module


def _code_in(folder: Path) -> list[Path]:
    return sorted(f for f in folder.rglob("*") if f.name.endswith(SUFFIXES) and f.is_file())


def _add_beside(found: dict[str, bytes], content: bytes, folder: Path) -> None:
    """Add what a file imports that lies beside it, and what that imports."""
    for name in _imported(content):
        beside = [folder / f"{name}.py", *_code_in(folder / name)]
        for path in beside:
            place = path.relative_to(folder).as_posix()
            if place not in found and path.is_file():
                found[place] = path.read_bytes()
                _add_beside(found, found[place], folder)


def _imported(content: bytes) -> set[str]:
    """First names of the modules that a file imports."""
    try:
        nodes = list(ast.walk(ast.parse(content)))
    except (SyntaxError, ValueError):
        return set()
    names = {alias.name for n in nodes if isinstance(n, ast.Import) for alias in n.names}
    names |= {n.module or "" for n in nodes if isinstance(n, ast.ImportFrom) and not n.level}
    return {name.partition(".")[0] for name in names} - KNOWN - {""}
