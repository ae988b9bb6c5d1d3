"""Where results may go: never over what is read, nor over what another program wrote."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from pilotid.disk import make_folder
from pilotid.types import InputError

#: What every page of this program has in its head.
GENERATOR = '<meta name="generator" content="pilotid">'
#: How the files begin that users name one by one: JSON by its first key, tables by their heads.
BEGINS = re.compile(
    rb'\A(\[\s*)?\{\s*"(recording|seed|first|command|pilotid)"|scenario,method,parameter,score|'
    + re.escape(GENERATOR.encode())
)
HEAD = 2048  # bytes in which a file says what it is
#: Files that make a folder one of results.
STORES = ("study.sqlite", "trust.json", "design.json")


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
        Whether files may be written over that this program did not write.
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
        if os.path.isfile(target) and not (force or is_ours(target) or not target.stat().st_size):
            raise _foreign(target)


def require_folder(
    folder: Path, names: Sequence[str], inputs: Iterable[Path] = (), *, force: bool = False
) -> None:
    """The same for files of these names in a folder, which is made."""
    targets = [folder / name for name in names]
    marks = [path for path in targets if path.suffix == ".html"]
    ours = any(os.path.exists(folder / name) for name in STORES) or any(map(is_ours, marks))
    foreign = [] if ours or force else [path for path in targets if os.path.isfile(path)]
    make_folder(folder)
    require_free(targets, inputs, force=True)
    if foreign:
        raise _foreign(foreign[0])


def _foreign(target: Path) -> InputError:
    return InputError(
        f"{target}: is there already, and not as this command would write it; name another place, "
        "or write over it with --force"
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


def is_ours(path: Path) -> bool:
    """Whether this program wrote a file."""
    if not os.path.isfile(path):  # a pipe would be waited for
        return False
    try:
        with path.open("rb") as stream:
            head = stream.read(HEAD)
    except OSError:
        return False
    return BEGINS.search(head) is not None
