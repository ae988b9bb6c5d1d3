"""What several studies hold, each under a name of its own."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from pilotid.study.comparison import Comparison, comparison_of
from pilotid.study.entries import MethodEntry, ScenarioEntry
from pilotid.study.store import Store
from pilotid.types import InputError


@dataclass(frozen=True, eq=False)
class StudyData:
    """One study.

    Attributes
    ----------
    name
        What pages call it: its folder's name.
    folder
        Its folder.
    about
        Facts on it, see `pilotid.study.study`.
    methods
        Its methods by their labels.
    study
        Its fits.
    """

    name: str
    folder: Path
    about: Mapping[str, str]
    methods: Mapping[str, MethodEntry]
    study: Comparison

    @property
    def fits(self) -> int:
        """Number of its fits."""
        return sum(len(each.results) for each in self.study.cells)


def read_study(folder: Path, name: str = "") -> StudyData:
    """Read the study of a folder.

    Parameters
    ----------
    folder
        What `pilotid compare` wrote.
    name
        What pages call it; empty for the folder's name.

    Raises
    ------
    InputError
        If the folder holds none, or one that cannot be read.
    """
    with Store(folder) as store:
        study = comparison_of(store)
        return StudyData(name or folder.name, folder, store.about(), store.methods(), study)


def names_for(folders: Sequence[Path], taken: Sequence[str] = ()) -> list[str]:
    """A name for each folder that pages and files can be called by.

    Parameters
    ----------
    folders
        The folders; where two have the same name, that of the folder above goes before it.
    taken
        Names that are not free.

    Raises
    ------
    InputError
        If a folder is named twice.
    """
    places = [folder.resolve() for folder in folders]
    twice = next((f for f, place in zip(folders, places, strict=True) if places.count(place) > 1),
                 None)  # fmt: skip
    if twice is not None:
        raise InputError(f"{twice}: is named twice; name every study once")
    names = [_plain(place.name) for place in places]
    longer = [_plain(f"{place.parent.name}-{place.name}") for place in places]
    names = [
        long if names.count(name) > 1 else name for name, long in zip(names, longer, strict=True)
    ]
    found: list[str] = []
    for name in names:
        free = (n for n in (name, *(f"{name}-{i}" for i in range(2, 999))) if n not in found)
        found.append(next(n for n in free if n not in taken))
    return found


def _plain(name: str) -> str:
    return re.sub(r"[^\w-]+", "-", name).strip("-") or "study"


def difference(ours: ScenarioEntry, theirs: ScenarioEntry) -> str:
    """Why fits of two scenarios of the same name cannot be set side by side; empty if they can.

    Bounds may differ, which follow from truth and settings by a computation that may be mended.
    """
    if ours.population != theirs.population:
        return "one is a population"
    if [p.parameter for p in ours.parameters] != [p.parameter for p in theirs.parameters]:
        return "other parameters"
    pairs = zip(ours.parameters, theirs.parameters, strict=True)
    if any(abs(a.truth - b.truth) > 1e-9 * abs(a.truth) for a, b in pairs):
        return "another truth"
    return "" if ours.settings == theirs.settings else "other settings"
