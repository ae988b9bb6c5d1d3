"""Files and folders that are written: complete or not there."""

from __future__ import annotations

import os
from pathlib import Path

from pilotid.types import InputError


def write_file(path: Path, content: bytes) -> None:
    """Write a file that is complete or not there, whatever happens meanwhile.

    Raises
    ------
    InputError
        If it cannot be written.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        try:
            part.write_bytes(content)
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written ({error.strerror or error}); check the folder and its "
            "rights"
        ) from error


def make_folder(folder: Path) -> None:
    """Make the folder of the results."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{folder}: cannot be made ({error.strerror}); name another folder with --out"
        ) from error
