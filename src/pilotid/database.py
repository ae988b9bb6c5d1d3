"""SQLite files that survive whatever stops the process, and sentences where one cannot be used.

Every transaction is complete or not there, in write-ahead mode: a process that is killed, a
power cut or a full disk cost at most the last of them.  Damage is found when a file is opened,
and by the checksums that its rows have.
"""

from __future__ import annotations

import json
import re
import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from hashlib import blake2b
from pathlib import Path
from tempfile import TemporaryDirectory

from pilotid.types import InputError

PATIENCE = 60.0  # seconds to wait for another process
# Primary result codes, which are the low byte of what SQLite says.
BUSY, LOCKED, FULL = 5, 6, 13
DAMAGED = (11, 26)  # malformed, no database
READ_ONLY = (3, 8, 14)  # no permission, read-only, cannot be opened
LARGEST_ROW = 2**26  # bytes
#: The triggers that a store may have: they count its rows.
TRIGGERS = (
    """CREATE TRIGGER added AFTER INSERT ON rows BEGIN
        UPDATE counts SET rows = rows + 1 WHERE kind = NEW.kind; END""",
    """CREATE TRIGGER removed AFTER DELETE ON rows BEGIN
        UPDATE counts SET rows = rows - 1 WHERE kind = OLD.kind; END""",
)
#: What a plain table has not.
COMPUTES = re.compile(r"\b(CHECK|AS|GENERATED|DEFAULT|VIRTUAL|TRIGGER)\b", re.IGNORECASE)


class DamagedError(InputError):
    """A file was changed by something else than this tool."""


def damaged(path: Path, why: object) -> DamagedError:
    """What to raise where a file is damaged."""
    return DamagedError(
        f"{path}: is damaged ({why}); `pilotid report {path.parent} --salvage` keeps what is whole"
    )


@contextmanager
def in_words(path: Path) -> Iterator[None]:
    """Say in a sentence what SQLite cannot do with a file."""
    try:
        yield
    except (sqlite3.Error, UnicodeError, OSError) as error:
        code = _code(error)
        if code in DAMAGED or isinstance(error, UnicodeError):  # in what SQLite says of it
            raise damaged(path, error) from error
        if code in (BUSY, LOCKED):
            raise InputError(
                f"{path}: is in use by another process ({error}); run the same command again"
            ) from error
        if code == FULL:
            raise InputError(
                f"{path}: cannot be written ({error}); make room, and run the same command again: "
                "what is done is kept"
            ) from error
        raise InputError(
            f"{path}: is no store of results or cannot be written ({error}); check the folder, "
            "its rights and the room on its disk, or name another one with --out"
        ) from error


def open_to_write(path: Path) -> sqlite3.Connection:
    """A file that can be written, and is made if there is none."""
    with in_words(path):
        base = _check(path, connect(path, "rwc"))
        base.execute("PRAGMA journal_mode=WAL")
        base.execute("PRAGMA synchronous=NORMAL")
        return base


def open_to_read(path: Path) -> sqlite3.Connection:
    """A file that is only read, and may lie where nothing can be written."""
    with in_words(path):
        try:
            return _check(path, connect(path, "rw"))
        except sqlite3.OperationalError as error:
            if _code(error) not in READ_ONLY:
                raise
        # SQLite can read a file with a log only where it can write.
        with TemporaryDirectory() as folder:
            copy = Path(folder) / path.name
            shutil.copyfile(path, copy)
            with suppress(FileNotFoundError):
                shutil.copyfile(beside(path, "-wal"), beside(copy, "-wal"))
            memory = sqlite3.connect(":memory:", isolation_level=None)
            with closing(_check(path, connect(copy, "rw"))) as base:
                base.backup(memory)
        return memory


def checksum(*content: object) -> int:
    """64 bits, with a sign as SQLite has it."""
    text = json.dumps(content, default=repr, separators=(",", ":"))
    return int.from_bytes(blake2b(text.encode(), digest_size=8).digest(), "big", signed=True)


def connect(path: Path, mode: str) -> sqlite3.Connection:
    """A connection in autocommit mode, whose transactions are opened and closed by name."""
    base = sqlite3.connect(
        f"{path.resolve().as_uri()}?mode={mode}", uri=True, isolation_level=None, timeout=PATIENCE
    )
    base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LARGEST_ROW)
    base.text_factory = lambda content: content.decode("utf-8", "surrogateescape")
    return base


def beside(path: Path, ending: str) -> Path:
    """A file beside a file, such as its write-ahead log."""
    return path.with_name(path.name + ending)


def _check(path: Path, base: sqlite3.Connection) -> sqlite3.Connection:
    """A connection to a file that is not damaged, and that holds plain tables alone.

    What else a schema may have computes when it is read or written, without end or memory.
    """
    try:
        for kind, sql in base.execute("SELECT type, sql FROM sqlite_master WHERE sql IS NOT NULL"):
            if kind not in ("table", "trigger") or (COMPUTES.search(sql) and sql not in TRIGGERS):
                raise InputError(f"{path}: is no store of results; name another file")
        if base.execute("PRAGMA quick_check(1)").fetchone() != ("ok",):
            raise damaged(path, "SQLite's check fails")
    except BaseException:
        base.close()
        raise
    return base


def _code(error: Exception) -> int:
    """SQLite's primary result code, 0 if the error is not SQLite's own."""
    return int(getattr(error, "sqlite_errorcode", 0)) & 0xFF
