"""What changed from one study to another of the same scenarios: two versions of a method.

Losses and errors are relative to the Cramér-Rao bound that the first study noted.  Where both
studies have one seed their recordings are the same and are compared one by one; only what both
tried counts then.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from pilotid.study.comparison import ALL, Comparison, MethodResults, Numbers, comparison_of
from pilotid.study.entries import ScenarioEntry
from pilotid.study.judge import LEVEL, judge
from pilotid.study.scores import mean_difference
from pilotid.study.store import Store
from pilotid.types import FloatArray, InputError

UNITS = {"loss": "", "bias": "bound", "coverage": "share", "failures": "share", "time": "s"}
YesNo = Literal["yes", "no"]
#: Factor between times from which a change counts.
SLOWER = 1.25
#: Relative difference up to which two numbers are the same: stores may keep six digits.
SAME = 1e-5


class Change(NamedTuple):
    """One score of one method in one scenario, in both studies: a row of the table.

    The parameter may be ``all``, and the score is a key of `UNITS`.  If `paired`, recordings were
    compared one by one.  `change` is the second less the first, of times the factor between them;
    `p` is the probability that chance makes a change as large, and a change of times also has to
    matter to count as `changed`.
    """

    scenario: str
    method: str
    parameter: str
    score: str
    unit: str
    paired: YesNo
    n_first: int
    n_second: int
    first: float
    second: float
    change: float
    change_se: float
    p: float
    changed: YesNo
    better: YesNo
    verdict_first: str
    verdict_second: str


#: Columns of the table of all comparisons.
COLUMNS = Change._fields


@dataclass(frozen=True, eq=False)
class Changes:
    """All comparisons between two studies.

    Attributes
    ----------
    first, second
        The studies.
    all
        The comparisons.
    same, fits
        Fits of both studies that are the same to the digits that stores keep, and all that were
        compared one by one.
    notes
        What was left out, and what else must be known, a sentence each.
    """

    first: Comparison
    second: Comparison
    all: Sequence[Change]
    same: int
    fits: int
    notes: Sequence[str]

    @property
    def changed(self) -> list[Change]:
        """Those that count."""
        return [change for change in self.all if change.changed == "yes"]

    def to_dict(self) -> dict[str, object]:
        """All comparisons as plain objects."""
        return {
            "first": {"folder": str(self.first.folder), **self.first.about},
            "second": {"folder": str(self.second.folder), **self.second.about},
            "level": LEVEL,
            "fits_paired": self.fits,
            "fits_same": self.same,
            "notes": list(self.notes),
            "words": self.words,
            "comparisons": [change._asdict() for change in self.all],
        }

    @property
    def words(self) -> str:
        """The end of it in a sentence or two."""
        if not self.all:
            return "Nothing to compare: no fits of both studies count."
        count = len(self.all)
        if self.fits and self.same == self.fits:
            return f"Nothing changed: all {self.fits} fits are the same."
        if not self.changed:
            told = f", though only {self.same} of {self.fits} fits are the same" * bool(self.fits)
            return f"No significant change ({count} comparisons){told}."
        return (
            f"{len(self.changed)} of {count} comparisons changed at p <= {LEVEL:g}; chance alone "
            f"would change {LEVEL * count:.1f}."
        )


def _yes(true: bool) -> YesNo:
    return "yes" if true else "no"


def find_changes(first: Comparison, second: Comparison) -> Changes:
    """Compare two studies.

    Parameters
    ----------
    first, second
        The studies, in this order.

    Raises
    ------
    InputError
        If they have no scenario and method in common.
    """
    one_seed = first.about.get("seed") == second.about.get("seed")
    common, notes = _common(first, second)
    if not common:
        raise InputError(
            f"{second.folder}: has no scenario and method in common with {first.folder}"
            + "".join(f"; {note[0].lower()}{note[1:].rstrip('.')}" for note in notes)
        )
    if not one_seed:
        seeds = (first.about.get("seed", "?"), second.about.get("seed", "?"))
        notes.append(f"Seeds differ ({seeds[0]}, {seeds[1]}): recordings are not paired.")
    found: list[Change] = []
    same = fits = 0
    for ours, theirs in common:
        paired = one_seed and _same_pilots(ours, theirs)
        if one_seed and not paired:
            notes.append(f"Other pilots were drawn in {ours.scenario.name}: no pairs.")
        if paired or not ours.scenario.population:
            theirs = _with_bounds_of(ours, theirs)
        verdicts = (judge(ours.scores).words, judge(theirs.scores).words)
        ours, theirs = _tried(ours, theirs, paired=paired)
        found += _changes(ours, theirs, verdicts, paired=paired)
        if paired:
            fits += len(ours.results)
            same += _count_same(ours, theirs)
    moved = [
        ours.scenario.name
        for ours, theirs in common
        if not np.allclose(_bounds(ours), _bounds(theirs), rtol=SAME, equal_nan=True)
    ]
    if moved:
        notes.append(f"Bounds differ in {_listed(moved)}: those of the first study count.")
    return Changes(first, second, found, same, fits, list(dict.fromkeys(notes)))


def _tried(
    ours: MethodResults, theirs: MethodResults, *, paired: bool
) -> tuple[MethodResults, MethodResults]:
    """Fits of recordings that the method can treat; if paired, of those that both have."""
    tried = [{r.unit.replication: r for r in cell.attempts} for cell in (ours, theirs)]
    if paired:
        tried = [{n: own[n] for n in tried[0] if n in tried[1]} for own in tried]
    first, second = (tuple(own.values()) for own in tried)
    return replace(ours, results=first), replace(theirs, results=second)


def _changes(
    ours: MethodResults, theirs: MethodResults, verdicts: tuple[str, str], *, paired: bool
) -> Iterator[Change]:
    """All comparisons of one method in one scenario."""
    keys = [key for key in ours.keys if key in theirs.keys]
    first, second = _by_recording(ours, keys), _by_recording(theirs, keys)
    for parameter, score in first:
        a, b = first[parameter, score], second[parameter, score]
        if paired:
            both = np.isfinite(a) & np.isfinite(b)
            a, b = a[both], b[both]
            # What is the same to the digits that stores keep is the same.
            b = np.where(np.isclose(b, a, rtol=SAME, atol=SAME), a, b)
        a, b = a[np.isfinite(a)], b[np.isfinite(b)]
        if not a.size or not b.size:
            continue
        change, error, p = mean_difference(a, b, paired=paired)
        before, after = float(np.mean(a)), float(np.mean(b))
        if score == "time":  # of logarithms
            before, after = math.exp(float(np.median(a))), math.exp(float(np.median(b)))
            change, error = math.exp(change), math.exp(change) * error
        matters = score != "time" or max(change, 1.0 / change) > SLOWER
        wanted = 0.95 if score == "coverage" else 0.0
        is_better = abs(after - wanted) < abs(before - wanted)
        head = (ours.scenario.name, ours.method, parameter, score, UNITS[score], _yes(paired))
        row = *head, a.size, b.size, before, after, change, error, p
        yield Change(*row, _yes(matters and p <= LEVEL), _yes(is_better), *verdicts)


def _by_recording(cell: MethodResults, keys: Sequence[str]) -> dict[tuple[str, str], FloatArray]:
    """What is compared, a number for each recording, by parameter and score."""
    counted = cell.counted
    found = {
        (ALL, "failures"): 1.0 - counted.astype(float),
        (ALL, "time"): np.array([math.log(r.seconds or math.nan) for r in cell.results]),
    }
    if cell.scenario.one_recording:
        return found
    columns = [cell.keys.index(key) for key in keys]
    known = Numbers(*(table[:, columns] for table in cell.numbers))
    losses = cell.losses[:, columns]
    given = counted[:, None] & np.isfinite(known.lower) & np.isfinite(known.upper)
    hits = (known.lower <= known.truth) & (known.truth <= known.upper)
    found[ALL, "loss"] = _together(losses)
    for k, key in enumerate(keys):
        error = (known.value[:, k] - known.truth[:, k]) / known.bound[:, k]
        found[key, "loss"] = losses[:, k]
        found[key, "bias"] = np.where(counted, error, math.nan)
        found[key, "coverage"] = np.where(given[:, k], hits[:, k] * 1.0, math.nan)
    return found


def _with_bounds_of(ours: MethodResults, theirs: MethodResults) -> MethodResults:
    """The second study's fits with the bounds that the first noted."""
    known = {r.unit.replication: r.draw for r in ours.results}
    results = tuple(
        replace(r, draw=known.get(r.unit.replication, r.draw)) if r.draw else r
        for r in theirs.results
    )
    return replace(theirs, scenario=ours.scenario, results=results)


def _together(losses: FloatArray) -> FloatArray:
    """The loss of all parameters, the geometric mean of theirs, as a mean over recordings.

    To first order a recording adds to it by its losses relative to the parameters' means.
    """
    known = losses[:, np.isfinite(losses).any(axis=0)]
    if not known.size:
        return np.full(len(losses), math.nan)
    means = np.nanmean(known, axis=0)
    relative = np.where(np.isfinite(known), known / means, 1.0)
    return np.asarray(np.exp(np.mean(np.log(means))) * np.mean(relative, axis=1))


def _common(
    first: Comparison, second: Comparison
) -> tuple[list[tuple[MethodResults, MethodResults]], list[str]]:
    """What both studies tried on the same scenarios, and what is left out."""
    ours, theirs = (
        {(c.scenario.name, c.method): c for c in study.cells} for study in (first, second)
    )
    notes = []
    for which, mine, yours in (("first", ours, theirs), ("second", theirs, ours)):
        names, methods = map(set, zip(*yours, strict=True)) if yours else (set(), set())
        alone = [
            name
            if name not in names
            else method
            if method not in methods
            else f"{method} on {name}"
            for name, method in mine
            if (name, method) not in yours
        ]
        if alone:
            notes.append(f"In the {which} study alone: {_listed(alone)}.")
    unlike = {
        name: why
        for (name, method), cell in ours.items()
        if (name, method) in theirs
        and (why := difference(cell.scenario, theirs[name, method].scenario))
    }
    if unlike:
        told = [f"{name} ({why})" for name, why in unlike.items()]
        notes.append(f"Left out, since they differ: {_listed(told)}.")
    shared = [key for key in ours if key in theirs and key[0] not in unlike]
    return [(ours[key], theirs[key]) for key in shared], notes


def _listed(names: Sequence[str]) -> str:
    return ", ".join(dict.fromkeys(names))


def _bounds(cell: MethodResults) -> list[float]:
    return [p.bound or math.nan for p in cell.scenario.parameters]


def _same_pilots(first: MethodResults, second: MethodResults) -> bool:
    """Whether both studies drew the same pilots of a population."""
    held = {r.unit.replication: r.draw for r in second.results if r.draw is not None}
    return all(
        r.draw.same(held[r.unit.replication])
        for r in first.results
        if r.draw is not None and r.unit.replication in held
    )


def _count_same(ours: MethodResults, theirs: MethodResults) -> int:
    """How many fits are the same, to the digits that stores keep, but for times and remarks."""
    if ours.keys != theirs.keys:
        return 0
    first, second = (np.stack(cell.numbers[:4], axis=-1) for cell in (ours, theirs))
    apart = ~np.isclose(first, second, rtol=SAME, atol=0.0, equal_nan=True)
    pairs = zip(ours.results, theirs.results, apart, strict=True)
    return sum(a.outcome == b.outcome and not own.any() for a, b, own in pairs)


def read_study(folder: Path, name: str = "") -> Comparison:
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
        return replace(study, name=name or study.name)


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
    names = [_plain(place.name) for place in places]
    found: list[str] = []
    for folder, place, name in zip(folders, places, names, strict=True):
        if places.count(place) > 1:
            raise InputError(f"{folder}: is named twice; name every study once")
        if names.count(name) > 1:
            name = _plain(f"{place.parent.name}-{name}")
        found.append(free_name(name, [*found, *taken]))
    return found


def free_name(name: str, taken: Sequence[str]) -> str:
    """A name, with a number behind it where it is taken."""
    return next(n for n in (name, *(f"{name}-{i}" for i in range(2, 999))) if n not in taken)


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
