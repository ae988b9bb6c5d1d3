"""The store of a study or of an analysis: one SQLite file, one table, a row of JSON for each fit.

The file is in write-ahead mode and every row is written at once: a process that is killed, a power
cut or a full disk cost the fits under way, and the same command goes on.
"""

from __future__ import annotations

import json
import math
import sqlite3
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, Self

from pilotid.support.types import InputError, one_line

STORE = "study.sqlite"
SCHEMA = (
    "CREATE TABLE rows (scenario TEXT, method TEXT, replication INTEGER, content TEXT, "
    "PRIMARY KEY (scenario, method, replication))"
)
KEY = "scenario = ? AND method = ? AND replication = ?"
PATIENCE = 60.0  # seconds to wait for another process

#: Scenario, method and replication.
Key = tuple[str, str, int]


class Rows:
    """Rows in a folder's file, each of a type that says what it holds.

    Parameters
    ----------
    folder
        Where the file is.
    create
        Whether the file is made if there is none.

    Attributes
    ----------
    path
        The file.

    Raises
    ------
    InputError
        If there is no such file, or it is damaged or of another version.
    """

    #: Tells stores of one kind from others; raised when their rows change.
    format = 1

    def __init__(self, folder: Path, *, create: bool = False) -> None:
        self.path = folder / STORE
        if not (create or self.path.exists()):
            raise InputError(
                f"{self.path}: there is no such file; name a folder that `pilotid compare` wrote"
            )
        with self._in_words():
            self._base = self._opened("rwc" if create else "rw")

    def close(self) -> None:
        """Close the file, which then holds everything."""
        self._base.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def put(self, key: Key, thing: Mapping[str, Any], *, again: bool = False) -> None:
        """Keep a thing of JSON; what is known already stays as it is, unless it is put again."""
        text = json.dumps(thing)  # an analysis holds numbers that are not known
        how = "REPLACE" if again else "IGNORE"
        with self._in_words():
            self._base.execute(f"INSERT OR {how} INTO rows VALUES (?, ?, ?, ?)", (*key, text))

    def drop(self, keys: Iterable[Key]) -> None:
        """Forget rows."""
        with self._in_words():
            self._base.executemany(f"DELETE FROM rows WHERE {KEY}", keys)

    def get(self, kind: Any, key: Key) -> Any:
        """The thing of a kind under a key, None if there is none."""
        return next(iter(self.every(kind, KEY, *key)), None)

    def every(self, kind: Any, where: str, *values: object) -> list[Any]:
        """All things of a kind, which SQL tells from others, in the order of their keys."""
        query = f"SELECT content FROM rows WHERE {where} ORDER BY scenario, method, replication"
        with self._in_words():
            rows = self._base.execute(query, values).fetchall()
            return [_adapter(kind).validate_json(content) for (content,) in rows]

    @contextmanager
    def _in_words(self) -> Iterator[None]:
        """Say in a sentence what SQLite cannot do with the file."""
        try:
            yield
        except (sqlite3.Error, ValueError, OSError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(
                f"{self.path}: cannot be read or written ({one_line(str(error))}); check the "
                "folder, its rights and the room on its disk, and run the same command again: "
                "what is done is kept"
            ) from error

    def _opened(self, mode: str) -> sqlite3.Connection:
        """A connection to a whole file of this schema, in which every statement is a transaction.

        The schema is looked at before anything is computed.
        """
        place, create = f"{self.path.resolve().as_uri()}?mode={mode}", mode == "rwc"
        base = sqlite3.connect(place, uri=True, isolation_level=None, timeout=PATIENCE)
        query = "SELECT sql, user_version FROM sqlite_master, pragma_user_version WHERE sql != ''"
        try:
            formats = base.execute(query).fetchall()
            if formats != [(SCHEMA, self.format)] and (formats or not create):
                raise InputError(
                    f"{self.path}: is of another command (compare, analyse) or another version of "
                    "pilotid; name another folder"
                )
            fault = base.execute("PRAGMA quick_check(1)").fetchone()
            if fault != ("ok",):
                raise ValueError(f"it is damaged: {fault[0]}")
            if create:
                base.execute("PRAGMA journal_mode=WAL")
                base.execute("PRAGMA synchronous=NORMAL")
                base.execute("BEGIN IMMEDIATE")
                base.execute(SCHEMA.replace("TABLE", "TABLE IF NOT EXISTS", 1))
                base.execute(f"PRAGMA user_version = {self.format}")
                base.execute("COMMIT")
        except BaseException:
            base.close()
            raise
        return base


def number(value: float) -> float | None:
    """A number for a store, None where it is none."""
    return float(value) if math.isfinite(value) else None


@cache
def _adapter(kind: Any) -> Any:
    from pydantic import TypeAdapter

    return TypeAdapter(kind)
