"""How files of recordings are read, all of them in one way."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from pilotid.recordings.files import load_recording, parse_mapping
from pilotid.recordings.recording import LEAD_IN, Recording, joined
from pilotid.recordings.treatment import detrended
from pilotid.types import InputError


@dataclass(frozen=True)
class Reading:
    """How files are read.

    Attributes
    ----------
    mapping
        Texts such as ``u=stick,e=err``.
    dt
        Sampling interval of files without times [s].
    detrend
        Whether a straight line is taken out of the control.
    lead_in
        See `Recording.lead_in`.
    """

    mapping: tuple[str, ...] = ()
    dt: float | None = None
    detrend: bool = False
    lead_in: float = LEAD_IN

    def one(self, file: Path) -> Recording:
        """The recording in a file."""
        names = parse_mapping(",".join(self.mapping)) if self.mapping else None
        if self.dt is not None and not 0.0 < self.dt < 1.0:
            raise InputError(f"--dt {self.dt:g}: give seconds between samples, as in --dt 0.01")
        recording = replace(load_recording(file, names, self.dt), lead_in=self.lead_in)
        return detrended(recording) if self.detrend else recording

    def all(self, files: Sequence[Path], *, joint: bool) -> tuple[list[Recording], list[str]]:
        """The recordings in files, as one if they are runs of one, and why others are refused.

        One bad file of several does not cost the others; where none is good, or all are runs of
        one recording, there is nothing to go on with.
        """
        recordings, refused = [], []
        for file in files:
            try:
                recordings.append(self.one(file))
            except InputError as error:
                if joint or len(files) == 1:
                    raise
                refused.append(str(error))
        if not recordings:
            raise InputError("; ".join(refused))
        return ([joined(recordings)] if joint and len(files) > 1 else recordings), refused
