"""What an analysis has done already: one SQLite file beside its tables.

It saves work and nothing else: each entry's key says all that its content follows from
(recording, model, methods, settings, code), so that whatever changes is done again, and a file
that is damaged costs the time to do it again.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from pilotid.types import InputError

STORE = "analysis.sqlite"


class Done:
    """The entries of an analysis in a folder.

    Parameters
    ----------
    folder
        The analysis's folder, which exists.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / STORE
        try:
            self._base = self._opened()
        except sqlite3.DatabaseError:  # no such file as this tool writes
            self.path.unlink(missing_ok=True)
            self._base = self._opened()

    def _opened(self) -> sqlite3.Connection:
        try:
            base = sqlite3.connect(self.path, isolation_level=None)
            base.execute("PRAGMA journal_mode=WAL")
            base.execute("CREATE TABLE IF NOT EXISTS done (key TEXT PRIMARY KEY, content TEXT)")
        except sqlite3.OperationalError as error:
            raise InputError(
                f"{self.path}: cannot be written ({error}); check the folder, its rights and the "
                "room on its disk"
            ) from error
        return base

    def __enter__(self) -> Done:
        return self

    def __exit__(self, *_: object) -> None:
        self._base.close()

    def get(self, keys: Iterable[str]) -> dict[str, Any]:
        """The contents that are held of these keys."""
        found = {}
        for key in keys:
            row = self._base.execute("SELECT content FROM done WHERE key = ?", (key,)).fetchone()
            if row is not None:
                found[key] = json.loads(row[0])
        return found

    def put(self, key: str, content: Any) -> None:
        """Keep a content, complete or not at all."""
        text = json.dumps(content)
        try:
            self._base.execute("INSERT OR REPLACE INTO done VALUES (?, ?)", (key, text))
        except sqlite3.OperationalError as error:
            raise InputError(
                f"{self.path}: cannot be written ({error}); check the room on its disk"
            ) from error
