"""Where results may go: never over what is read."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path

from pilotid.disk import make_folder
from pilotid.types import InputError

#: Files that are written over unasked: an option names the one that it makes.
RESULTS = (".json", ".html")
#: Files that make a folder one of results, which is written into again.
STORES = ("study.sqlite", "trust.json", "design.json", "report.html")


def require_free(
    targets: Iterable[Path], inputs: Iterable[Path] = (), *, force: bool = False
) -> None:
    """Refuse, before any work is done, files to write that must stay as they are.

    Parameters
    ----------
    targets
        Files to write, whose folders exist.
    inputs
        Files that are read: they are never written over.
    force
        Whether files may be written over that are no `RESULTS`.
    """
    read = {_identity(path): path for path in inputs}
    taken: dict[object, Path] = {}
    for target in targets:
        own = _identity(target)
        if own in read:
            raise InputError(f"{target}: is read by this command; write to another file")
        if own in taken:
            raise InputError(f"{target}: is to hold two results; name a file for each")
        taken[own] = target
        if not os.path.isdir(target.parent):
            raise InputError(f"{target}: there is no folder {target.parent}; make it first")
        if os.path.isdir(target):
            raise InputError(f"{target}: is a folder; name a file in it")
        if not (os.path.exists(target) or os.access(target.parent, os.W_OK | os.X_OK)):
            raise InputError(f"{target}: cannot be written; check the rights of its folder")
        if not force and target.suffix not in RESULTS and os.path.isfile(target):
            raise _is_there(target)


def require_folder(
    folder: Path, names: Sequence[str], inputs: Iterable[Path] = (), *, force: bool = False
) -> None:
    """The same for files of these names in a folder, which is made."""
    targets = [folder / name for name in names]
    ours = any(os.path.exists(folder / name) for name in STORES)
    there = [path for path in targets if os.path.isfile(path)]
    make_folder(folder)
    require_free(targets, inputs, force=True)
    if there and not (ours or force):
        raise _is_there(there[0])


def _is_there(target: Path) -> InputError:
    return InputError(
        f"{target}: is there already; name another place, or write over it with --force"
    )


def _identity(path: Path) -> object:
    """What tells a file from others, by whichever name or link."""
    try:
        info = path.stat()
        return info.st_dev, info.st_ino
    except OSError:
        return os.path.join(_identity_of_folder(path.parent), path.name)


def _identity_of_folder(folder: Path) -> str:
    try:
        return os.path.realpath(folder)
    except OSError:  # the current folder was deleted
        return str(folder)
