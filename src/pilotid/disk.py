"""Files and folders: what can be read, what is written complete or not at all; JSON, tables."""

from __future__ import annotations

import csv
import io
import json
import math
import os
import stat
from collections.abc import Iterable, Sequence
from pathlib import Path

from pilotid.types import InputError, printable

LONGEST_PATH = 300  # characters in messages


def path_shown(path: str | os.PathLike[str]) -> str:
    """A path for messages and reports: printable, and cut in the middle where it is very long."""
    text = printable(str(path))
    return text if len(text) <= LONGEST_PATH else f"{text[:100]}...{text[-100:]}"


def require_file(path: Path, most: int) -> None:
    """Refuse what cannot be read before it is opened: pipes and devices may wait for ever.

    Raises
    ------
    InputError
        If there is no such file, it is none, or it has more than `most` bytes.
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
        raise InputError(
            f"{source}: cannot be read (it is a folder, a pipe or a device); name a file"
        )
    if info.st_size > most:
        raise InputError(
            f"{source}: is {info.st_size / 1e6:.4g} MB large but at most {most / 1e6:.4g} MB are "
            "read; leave out what is no recording, or thin it out in time"
        )


def write_file(path: Path, content: bytes) -> None:
    """Write a file that is complete or not there, whatever happens meanwhile.

    The target of a symbolic link is replaced, not the link; devices and pipes are written into.

    Raises
    ------
    InputError
        If it cannot be written.
    """
    try:
        if path.exists() and (not path.is_file() or path.is_relative_to("/dev")):
            with path.open("ab", buffering=0) as stream:
                stream.write(content)
            return
        path = Path(os.path.realpath(path))
        part = path.with_name(f".{path.name}.{os.getpid()}.part")
        try:
            part.write_bytes(content)
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written ({error.strerror or error}); check the folder, its "
            "rights and the room on its disk"
        ) from error


def make_folder(folder: Path) -> None:
    """Make the folder of the results."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{folder}: cannot be made ({error.strerror}); name another folder with --out"
        ) from error


def strict_json(value: object) -> str:
    """JSON text; what is not finite becomes null, since JSON has no word for it."""
    return json.dumps(_finite(value), indent=2, allow_nan=False) + "\n"


def _finite(value: object) -> object:
    if isinstance(value, dict):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def table_bytes(head: Sequence[str], rows: Iterable[Sequence[object]]) -> bytes:
    """A table as CSV; NaN is an empty cell, and texts are printable."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(head)
    writer.writerows([[_cell(cell) for cell in row] for row in rows])
    return text.getvalue().encode()


def _cell(cell: object) -> object:
    return printable(cell) if isinstance(cell, str) else "" if cell != cell else cell
