"""Files and folders: what is read, and what is written, complete or not at all."""

from __future__ import annotations

import csv
import io
import json
import math
import os
import stat
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from pilotid.support.types import InputError, printable

if TYPE_CHECKING:
    from pandas import DataFrame

LONGEST_PATH = 300  # characters in messages


def path_shown(path: str | os.PathLike[str]) -> str:
    """A path for messages and reports: printable, and cut in the middle where it is very long."""
    text = printable(str(path))
    return text if len(text) <= LONGEST_PATH else f"{text[:100]}...{text[-100:]}"


def require_file(path: Path) -> None:
    """Refuse what cannot be read; pipes and devices, which may wait for ever, without opening them.

    Raises
    ------
    InputError
        If there is no such file, or it is none.
    """
    source = path_shown(path)
    try:
        about = path.stat()
        why = "it is empty" if about.st_size == 0 else ""
        why = why if stat.S_ISREG(about.st_mode) else "it is a folder or a device, say"
        if not why:
            path.open("rb").close()
    except (OSError, ValueError) as error:
        why = str(getattr(error, "strerror", None) or error)
    if why:
        raise InputError(f"{source}: cannot be read ({why}); check name, folder and rights")


def require_suffix(path: Path, source: str, known: Collection[str], cure: str) -> str:
    """The suffix of a file in small letters; refused where it is none of those known."""
    suffix = path.suffix.lower()
    if suffix not in known:
        raise InputError(f"{source}: does not end in {' '.join(known)}; {cure}")
    return suffix


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
    writer.writerows([_cell(cell) for cell in row] for row in rows)
    return text.getvalue().encode()


def frame_bytes(frame: DataFrame) -> bytes:
    """A frame as CSV; what is missing is an empty cell."""
    gaps = frame.columns[frame.isna().any()]
    filled = {name: frame[name].astype(object).where(frame[name].notna(), "") for name in gaps}
    rows = frame.assign(**filled).itertuples(index=False, name=None)
    return table_bytes([*frame], rows)


def _cell(cell: object) -> object:
    return printable(cell) if isinstance(cell, str) else "" if cell != cell else cell


#: Files that are written over unasked: an option names the one that it makes.
RESULTS = (".json", ".html")
#: Files that make a folder one of results, which is written into again.
STORES = ("study.sqlite", "trust.json", "design.json", "report.html")


def require_free(
    targets: Iterable[Path],
    inputs: Iterable[Path] = (),
    *,
    force: bool = False,
    unasked: Sequence[str] = RESULTS,
) -> None:
    """Refuse, before any work is done, files to write that must stay as they are.

    Parameters
    ----------
    targets
        Files to write, whose folders exist.
    inputs
        Files that are read: they are never written over.
    force
        Whether files may be written over of any suffix.
    unasked
        Suffixes of files that are written over in any case.
    """
    taken = {path.resolve() for path in inputs}
    for target in targets:
        place = target.resolve()
        if place in taken:
            raise InputError(f"{target}: is read, or read as notes, or written; name another file")
        taken.add(place)
        if target.is_dir() or not (target.exists() or os.access(target.parent, os.W_OK | os.X_OK)):
            raise InputError(f"{target}: cannot be written; name a file in a folder that is there")
        if not force and target.suffix not in unasked and target.is_file():
            raise InputError(f"{target}: is there already; name another place, or remove it")


def require_folder(folder: Path, names: Sequence[str], inputs: Iterable[Path] = ()) -> None:
    """The same for files of these names in a folder, which is made."""
    ours = any((folder / name).exists() for name in STORES)
    make_folder(folder)
    targets = [folder / name for name in names]
    require_free(targets, inputs, force=ours, unasked=())
