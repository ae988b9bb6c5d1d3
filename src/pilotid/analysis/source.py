"""A recording that is still in its files."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace

from pilotid.analysis.pattern import Part
from pilotid.recordings.files import Reading
from pilotid.recordings.recording import Recording
from pilotid.recordings.text import sidecar_path
from pilotid.types import InputError


@dataclass(frozen=True)
class Source:
    """Where a recording is, and how it is read.

    Attributes
    ----------
    part
        Its files.
    reading
        How they are read.
    """

    part: Part
    reading: Reading

    def recording(self, run: int | None = None) -> Recording:
        """The recording, or one run of it alone, counted from 1.

        Raises
        ------
        InputError
            If a file cannot be used.
        """
        (whole,), _ = self.reading.all(self.part.files, joint=True)
        return whole if run is None else alone(whole, run)

    def digest(self) -> str:
        """A digest of all that is read.

        Raises
        ------
        InputError
            If a file cannot be read.
        """
        digest = hashlib.sha256(repr(self).encode("utf-8", "replace"))
        for file in self.part.files:
            try:
                digest.update(file.read_bytes())
                side = sidecar_path(file)
                digest.update(side.read_bytes() if side.exists() else b"")
            except OSError as error:
                raise InputError(
                    f"{file}: cannot be read ({error.strerror or error}); check the file and its "
                    "rights"
                ) from error
        return digest.hexdigest()


def alone(recording: Recording, run: int) -> Recording:
    """One run of a recording, counted from 1."""
    return _of_runs(recording, [run - 1], f"run {run}")


def without(recording: Recording, run: int) -> Recording:
    """All runs of a recording but one, counted from 1."""
    rows = [place for place in range(recording.runs) if place != run - 1]
    return _of_runs(recording, rows, f"without run {run}")


def _of_runs(recording: Recording, rows: list[int], words: str) -> Recording:
    return replace(
        recording,
        e=recording.e[rows],
        u=recording.u[rows],
        x=recording.x[rows],
        ft=None if recording.ft is None else recording.ft[rows],
        fd=None if recording.fd is None else recording.fd[rows],
        source=f"{recording.source}, {words}",
    )
