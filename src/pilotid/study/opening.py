"""Opening a store's file: new, read-only, in use by another process, or damaged.

A damaged file is never written to.  What is whole in it goes into a new file when the
study goes on, or into memory when it is only read.
"""

from __future__ import annotations

import os
import shutil
import sqlite3
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeVar

from pilotid.study import tables
from pilotid.study.tables import (
    BUSY,
    DAMAGED,
    FORMAT,
    FULL,
    LOCKED,
    PASSING,
    READ_ONLY,
    code_of,
)
from pilotid.types import InputError

PATIENCE = 60.0  # seconds to wait for another process

EMPTY = "it is empty"
COLUMNS_BEFORE = (10, 11, 13)  # of the table of fits in earlier formats

T = TypeVar("T")
Opened = tuple[sqlite3.Connection, str]


@contextmanager
def in_words(path: Path) -> Iterator[None]:
    """Say in a sentence what SQLite cannot do with a file."""
    try:
        yield
    except (sqlite3.Error, UnicodeError, OSError) as error:
        code = code_of(error) if isinstance(error, sqlite3.Error) else 0
        if code == FULL:
            words = (
                f"cannot be written ({error}); make room, and give the same command again: what "
                "is done is kept"
            )
        elif code in DAMAGED:
            words = f"was damaged ({error}); the same command keeps what is whole"
        else:
            words = (
                f"is no store of results or cannot be written ({error}); check the folder, its "
                "rights and the room on its disk, or name another one with --out"
            )
        raise InputError(f"{path}: {words}") from error


def open_to_write(path: Path) -> Opened:
    """A store that can be written, and what is to be told; it is made or mended if need be."""
    told = ""
    if _size(path):
        told = _patiently(lambda: _mended(path))
    return _patiently(lambda: _made(path)), told


def open_to_read(path: Path) -> Opened:
    """A store that is only read, and what is to be told."""
    return _patiently(lambda: _read(path))


def in_memory() -> sqlite3.Connection:
    """A new store that no file holds."""
    memory = _connected_to_memory()
    with memory:
        tables.create(memory)
    return memory


def merge(base: sqlite3.Connection) -> None:
    """Bring the write-ahead log into the file, which is then the whole store.

    SQLite does so when the last connection closes.  Of two that close in one moment each takes
    the other for the last, and the log would stay with results in it.
    """
    with suppress(sqlite3.Error):  # nothing is lost: whoever opens the file next reads the log
        base.execute("PRAGMA busy_timeout = 1000")
        base.execute("PRAGMA wal_checkpoint(TRUNCATE)")


def _patiently(action: Callable[[], T]) -> T:
    """Do what another process may be in the way of.

    SQLite waits by itself, but not where two processes change the journal at once.
    """
    end = time.monotonic() + PATIENCE
    while True:
        try:
            return action()
        except sqlite3.Error as error:
            if code_of(error) not in (BUSY, LOCKED) or time.monotonic() > end:
                raise
        time.sleep(0.02)


def _made(path: Path) -> sqlite3.Connection:
    base = _connected(path, "rwc")
    try:
        base.execute("PRAGMA journal_mode=WAL")
        base.execute("PRAGMA synchronous=NORMAL")
        base.execute("BEGIN IMMEDIATE")
        with base:
            if not _names(base):
                tables.create(base)
    except BaseException:
        base.close()
        raise
    return base


def _read(path: Path) -> Opened:
    base, wrong = _looked_at(path)
    if not wrong:
        return base, ""
    memory = in_memory()
    with memory:
        fits = _rescue(path, base, memory)
    base.close()
    if not fits:
        raise InputError(
            f"{path}: is no store of results, or too damaged to be read ({wrong}); name another "
            "folder, or compare again"
        )
    return memory, (
        f"{path} is damaged ({wrong}): this is of the {fits} fits that are whole; "
        "`pilotid compare` with the options of the study fits the others again"
    )


def _mended(path: Path) -> str:
    """Put a new store in the place of a damaged one; says so, or nothing if it is whole."""
    before = path.stat().st_ino
    base, wrong = _looked_at(path)
    base.close()
    if wrong in ("", EMPTY):  # or another process is making it
        return ""
    new, lock = _beside(path, ".new"), _beside(path, ".lock")
    try:
        # A lock that SQLite holds ends with the process, whatever ends that.
        with closing(_connected(lock, "rwc")) as held:
            try:
                held.execute("BEGIN EXCLUSIVE")
            except sqlite3.Error as error:  # the other has ended and taken the lock's file away
                if code_of(error) in (BUSY, LOCKED):
                    raise
            if path.stat().st_ino != before:  # another process has mended it
                return ""
            base, wrong = _looked_at(path)
            new.unlink(missing_ok=True)
            with closing(_connected(new, "rwc")) as copy:
                copy.execute("BEGIN IMMEDIATE")
                with copy, closing(base):
                    tables.create(copy)
                    fits = _rescue(path, base, copy)
            aside = _set_aside(path)
            new.replace(path)
    except OSError as error:
        raise InputError(
            f"{path}: is damaged ({wrong}) and cannot be mended ({error.strerror or error}); "
            "name another folder with --out"
        ) from error
    finally:
        lock.unlink(missing_ok=True)
    return (
        f"{path} was damaged ({wrong}): {fits} fits are whole and kept, and this command fits "
        f"the others again; the damaged file is {aside.name}"
    )


def _set_aside(path: Path) -> Path:
    """Keep a damaged file under another name too; its log goes with it."""
    aside, number = _beside(path, ".damaged"), 2
    while aside.exists():
        aside, number = _beside(path, f".damaged{number}"), number + 1
    try:
        os.link(path, aside)
    except OSError:  # not every file system has links
        shutil.copyfile(path, aside)
    for ending in ("-wal", "-shm"):
        with suppress(FileNotFoundError):  # another process takes its own away
            _beside(path, ending).replace(_beside(aside, ending))
    return aside


def _looked_at(path: Path) -> tuple[sqlite3.Connection, str]:
    """A store for reading, and what is wrong with it."""
    base = _source(path)
    try:
        names = _names(base)
        if not names:
            return base, EMPTY
        if not names & set(tables.NAMES):
            raise InputError(f"{path}: is no store of results; name another folder with --out")
        _require_this_format(path, base)
        return base, tables.fault(base)
    except UnicodeError as error:  # in what SQLite says of it
        return base, str(error)
    except sqlite3.Error as error:
        if code_of(error) not in PASSING:
            return base, str(error)
        base.close()
        raise
    except BaseException:
        base.close()
        raise


def _rescue(path: Path, base: sqlite3.Connection, copy: sqlite3.Connection) -> int:
    """Copy what is whole in a damaged store; returns the number of fits."""
    fits = _copied(base, copy)
    if not fits:
        with closing(_connected_to_memory()) as again:
            again.deserialize(tables.with_page_one(path.read_bytes()))
            fits = _copied(again, copy)
    return fits


def _copied(base: sqlite3.Connection, copy: sqlite3.Connection) -> int:
    """Copy what is whole; fits count for nothing if what was fitted with what is lost.

    Nor do they if it is lost what a population drew for them.
    """
    try:
        about, whole = tables.facts(base)
    except (sqlite3.Error, TypeError, UnicodeError):
        return 0
    if not whole:
        return 0
    tables.describe(copy, about)
    kept: dict[str, list[tables.Held]] = {"scenarios": [], "methods": [], "draws": []}
    for table, found in kept.items():
        for each in tables.held(base, table, reader=tables.readable_rows):
            if each.whole:
                tables.put(copy, table, each.row, each.parts)
                found.append(each)
    populations = {each.row[0] for each in kept["scenarios"] if not each.parts}
    drawn = {each.row[:2] for each in kept["draws"]}
    fits = 0
    for pair in ((s.row[0], m.row[0]) for s in kept["scenarios"] for m in kept["methods"]):
        where = "WHERE scenario = ? AND method = ?"
        for each in tables.held(base, "fits", where, pair, tables.readable_rows):
            scenario, _, replication = each.row[:3]
            if each.whole and (scenario not in populations or (scenario, replication) in drawn):
                tables.put(copy, "fits", each.row, each.parts)
                fits += 1
    return fits


def _require_this_format(path: Path, base: sqlite3.Connection) -> None:
    try:
        about, whole = tables.facts(base)
        count = "SELECT count(*) FROM pragma_table_info('fits')"
        (columns,) = base.execute(count).fetchone()
    except (sqlite3.Error, TypeError, UnicodeError):
        return  # damaged, and then it is not known
    older = not whole and columns in COLUMNS_BEFORE
    if about.get("format") != str(FORMAT) and (whole or older):
        raise InputError(
            f"{path}: was written by another version of pilotid, whose tables differ; "
            "name another folder with --out"
        )


def _size(path: Path) -> int:
    """Bytes of a file, 0 where there is none: another process may take it away at any time."""
    try:
        return path.stat().st_size
    except FileNotFoundError:
        return 0


def _source(path: Path) -> sqlite3.Connection:
    """A connection for reading, whatever the rights; the file itself stays as it is."""
    log = _beside(path, "-wal")
    has_log = _size(log) > 0
    try:
        # Who may write makes no leftovers; who may not does not merge the log on closing.
        return _proven(_connected(path, "ro" if has_log else "rw"))
    except sqlite3.Error as error:
        if code_of(error) not in READ_ONLY:
            raise
    if not has_log:
        return _proven(_connected(path, "ro&immutable=1"))
    with TemporaryDirectory() as folder:
        copy = Path(folder) / path.name
        for file, target in ((path, copy), (log, _beside(copy, "-wal"))):
            shutil.copyfile(file, target)
        memory = _connected_to_memory()
        with closing(_proven(_connected(copy, "rw"))) as base:
            base.backup(memory)
    return memory


def _connected(path: Path, mode: str) -> sqlite3.Connection:
    # Autocommit: every transaction is opened and closed by name.
    base = sqlite3.connect(
        f"{path.resolve().as_uri()}?mode={mode}", uri=True, isolation_level=None, timeout=PATIENCE
    )
    base.text_factory = _text
    return base


def _connected_to_memory() -> sqlite3.Connection:
    base = sqlite3.connect(":memory:", isolation_level=None)
    base.text_factory = _text
    return base


def _proven(base: sqlite3.Connection) -> sqlite3.Connection:
    """The connection, once something was read through it."""
    try:
        base.execute("SELECT count(*) FROM sqlite_master").fetchone()
    except sqlite3.Error as error:
        if code_of(error) in PASSING:
            base.close()
            raise
    except UnicodeError:  # in what SQLite says of a damaged file
        pass
    return base


def _names(base: sqlite3.Connection) -> set[str]:
    return {name for (name,) in base.execute("SELECT name FROM sqlite_master")}


def _text(content: bytes) -> str:
    """Text, though bytes of it may have been changed."""
    return content.decode("utf-8", "surrogateescape")


def _beside(path: Path, ending: str) -> Path:
    return path.with_name(path.name + ending)
