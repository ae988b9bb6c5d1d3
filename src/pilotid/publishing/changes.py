"""What changed from one study to another of the same scenarios: two versions of a method.

Errors are in units of the Cramér-Rao bound that the first study noted, so that those of a
population's recordings can be put together too.  Where both studies have one seed their
recordings are the same and are compared one by one; only what both fitted counts then.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from pilotid.publishing.held import Held, difference
from pilotid.publishing.pairs import LEAST, Change, Pair, close, same_pilots
from pilotid.report.rules import FAMILY, Rules
from pilotid.study.attempts import Attempts
from pilotid.types import InputError

#: Columns of the table of all comparisons.
COLUMNS = (
    *("scenario", "method", "parameter", "score", "unit", "paired", "n_first", "n_second"),
    *("first", "second", "change", "change_se", "p", "changed", "better"),
)


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

    first: Held
    second: Held
    all: Sequence[Change]
    same: int
    fits: int
    notes: Sequence[str]

    @property
    def level(self) -> float:
        """Probability that chance passes one comparison."""
        return Rules(len(self.all)).level

    def counts(self, change: Change) -> bool:
        """Whether a change is certain, and one that matters."""
        least = LEAST[change.score]
        size = abs(change.numbers.change)
        enough = size > least if change.score != "time" else max(size, 1.0 / size) > least
        return enough and change.numbers.p <= self.level

    @property
    def changed(self) -> list[Change]:
        """Those that count."""
        return [change for change in self.all if self.counts(change)]

    def rows(self) -> Iterator[list[object]]:
        """`COLUMNS` of every comparison."""
        for c in self.all:
            head = [c.scenario, c.method, c.parameter, c.score, c.unit, _said(c.paired)]
            tail = [_said(self.counts(c)), _said(c.better)]
            yield [*head, *c.counts, *c.numbers, *tail]

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
            return f"Nothing changed that these recordings can tell ({count} comparisons){told}."
        return (
            f"{len(self.changed)} of {count} comparisons changed, at the level {self.level:.1e} "
            f"each: at most one of {1 / FAMILY:.0f} such tables calls anything changed that is not."
        )


def _said(yes: bool) -> str:
    return "yes" if yes else "no"


def changes(first: Held, second: Held) -> Changes:
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
    paired = first.about.get("seed") == second.about.get("seed")
    common, notes = _common(first, second)
    if not common:
        raise InputError(
            f"{second.folder}: has no scenario and method in common with {first.folder}"
            + "".join(f"; {note[0].lower()}{note[1:].rstrip('.')}" for note in notes)
        )
    if not paired:
        seeds = (first.about.get("seed", "?"), second.about.get("seed", "?"))
        notes.append(f"Seeds differ ({seeds[0]}, {seeds[1]}): recordings are not paired.")
    found: list[Change] = []
    same = fits = 0
    for ours, theirs in common:
        pair = Pair(ours, theirs, paired and same_pilots(ours, theirs))
        if paired and not pair.paired:
            notes.append(f"Other pilots were drawn in {ours.scenario.name}: no pairs.")
        found += pair.changes()
        fits, same = fits + pair.fits, same + pair.same
    moved = [ours.scenario.name for ours, theirs in common if _bounds_moved(ours, theirs)]
    if moved:
        notes.append(f"Bounds differ in {_listed(moved)}: those of the first study count.")
    return Changes(first, second, found, same, fits, list(dict.fromkeys(notes)))


def _common(first: Held, second: Held) -> tuple[list[tuple[Attempts, Attempts]], list[str]]:
    """What both studies tried on the same scenarios, and what is left out."""
    ours, theirs = (
        {(e.scenario.name, e.method): e for e in h.study.every} for h in (first, second)
    )
    names = [list(dict.fromkeys(name for name, _ in held)) for held in (ours, theirs)]
    notes = []
    for which, own, other in (("first", *names), ("second", *reversed(names))):
        if lone := [name for name in own if name not in other]:
            notes.append(f"In the {which} study alone: {_listed(lone)}.")
    unlike = {
        name: why
        for name in names[0]
        if name in names[1]
        and (why := difference(first.study.entry(name), second.study.entry(name)))
    }
    if unlike:
        told = [f"{name} ({why})" for name, why in unlike.items()]
        notes.append(f"Left out, since they differ: {', '.join(told)}.")
    shared = [name for name in names[0] if name in names[1] and name not in unlike]
    for which, mine, yours in (("first", ours, theirs), ("second", theirs, ours)):
        alone = [key for key in mine if key[0] in shared and key not in yours]
        tried = {method for name, method in yours if name in shared}
        whole = [method for _, method in alone if method not in tried]
        rest = [f"{method} on {name}" for name, method in alone if method in tried]
        if alone:
            notes.append(f"In the {which} study alone: {_listed([*whole, *rest])}.")
    pairs = [(own, theirs[key]) for key, own in ours.items() if key in theirs and key[0] in shared]
    return pairs, notes


def _listed(names: Sequence[str]) -> str:
    return ", ".join(dict.fromkeys(names))


def _bounds_moved(ours: Attempts, theirs: Attempts) -> bool:
    pairs = zip(ours.scenario.parameters, theirs.scenario.parameters, strict=True)
    return not all(close(a.bound, b.bound) for a, b in pairs)
