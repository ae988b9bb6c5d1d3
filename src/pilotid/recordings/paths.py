"""Names of files in messages, and files that are no files."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from pilotid.types import InputError, printable

LONGEST = 300  # characters of a path in messages
KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


def path_shown(path: str | os.PathLike[str]) -> str:
    """A path for messages and reports: printable, and cut in the middle where it is very long."""
    text = printable(str(path))
    return text if len(text) <= LONGEST else f"{text[:100]}...{text[-100:]}"


def file_size(path: Path, most: int) -> int:
    """The size [bytes] of a file that can be read.

    Pipes and devices are refused before they are opened: they may wait or go on for ever.

    Raises
    ------
    InputError
        If there is no such file, it is none, or it is larger than `most`.
    """
    source = path_shown(path)
    try:
        info = path.stat()
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(
            f"{source}: there is no such file; check the name and the folder"
        ) from None
    except (OSError, ValueError) as error:
        raise InputError(
            f"{source}: cannot be read ({getattr(error, 'strerror', None) or error}); check the "
            "name and the rights"
        ) from None
    if not stat.S_ISREG(info.st_mode):
        kind = KINDS.get(stat.S_IFMT(info.st_mode), "something else")
        raise InputError(f"{source}: cannot be read (it is {kind}, not a file); name a file")
    if info.st_size > most:
        raise InputError(
            f"{source}: is {info.st_size / 1e6:.4g} MB large but at most {most / 1e6:.4g} MB are "
            "read; leave out what is no recording, or thin it out in time"
        )
    return info.st_size
