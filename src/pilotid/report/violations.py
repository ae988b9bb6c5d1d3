"""The chapter on violations: what methods say when their assumptions do not hold."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Sequence

import numpy as np

from pilotid.numbers import NONE, plus_minus, share
from pilotid.report.chapters import VIOLATION, Chapter
from pilotid.report.content import Column, Entry, Table, Text, entries
from pilotid.report.rules import ENOUGH
from pilotid.report.verdicts import Grade
from pilotid.study import standardised
from pilotid.study.comparison import Cell, Comparison
from pilotid.study.score import Score

KEY = "violations"
CONTROL = "nominal"
#: Coverage of a parameter below which intervals do not hold, and share of warnings above which
#: a user is warned.
HELD, WARNED = 0.90, 0.5
LONGEST_WORDS = 60  # characters of a remark that the table shows

TEXT = (
    "Not in the paper: the nominal case with one assumption violated, in the loop or in the "
    "recorder; `nominal` itself, where the study has it, is the control: a method that is silent "
    "there is so without any violation. Truth and bound are those of the pilot without it. "
    "**Bias / claim** is the mean error of a parameter over the mean standard error that the "
    "method claims, of the parameter where it is largest. **Told** counts the recordings of "
    "which a user of `pilotid fit` would be warned: a remark against the recording or the "
    "estimate, or that the fit failed; behind it stand the first words of the commonest remarks, "
    "and how often they came."
)
RULES = (
    f"Rules: **covered** if no parameter's coverage is certain (95 %) to lie below "
    f"{100 * HELD:.0f} %; else **warned** if at least {100 * WARNED:.0f} % of the recordings are "
    "told of; else **silent**: a user would believe what is wrong."
)


def violation_chapters(study: Comparison) -> list[Chapter]:
    """The chapter on violations; nothing if the study has none."""
    own = tuple(n for n in study.names if study.entry(n).family == VIOLATION)
    if not own:
        return []
    names = (*(n for n in study.names if n == CONTROL), *own)
    return [
        Chapter(
            KEY,
            "When the assumptions do not hold",
            TEXT,
            names,
            [_table(study, names), Text(RULES)],
            own,
        )
    ]


def _table(study: Comparison, names: Sequence[str]) -> Table:
    columns = [
        Column("scenario", text=True),
        Column("method", text=True),
        Column("grade", text=True, hint="by the rules beneath"),
        Column("failed", hint="fits that failed, of those tried"),
        Column("bias / claim", text=True, hint="largest, with its Monte Carlo standard error"),
        Column(
            "coverage %", hint="of the 95 % intervals of all parameters, with its 95 % interval"
        ),
        Column("lowest %", text=True, hint="coverage of the parameter where it is lowest"),
        Column("told", hint="recordings with a remark or a failure, of those tried"),
        Column("first words", text=True, hint="of the commonest remarks"),
    ]
    rows = [_row(cell) for name in names for cell in study.of(name) if cell.tried]
    return Table("Violations and what the methods say", columns, entries(rows), heads=2)


def _row(cell: Cell) -> list[str | Entry]:
    lowest = min(_known(cell), key=lambda s: s.coverage, default=None)
    grade = _grade(cell)
    return [
        cell.scenario.name,
        cell.method,
        Entry(*grade) if grade else NONE,
        f"{cell.tried - cell.usable} of {cell.tried}",
        _largest(cell),
        _coverage(cell),
        NONE if lowest is None else f"{100.0 * lowest.coverage:.0f} {lowest.parameter}",
        f"{told(cell)} of {cell.tried}",
        _words(cell),
    ]


def _grade(cell: Cell) -> tuple[str, str] | None:
    """Covered, warned or silent, and the mark of it; None for too few fits."""
    if cell.tried < ENOUGH:
        return None
    known = _known(cell)
    if known and all(score.coverage_interval[1] >= HELD for score in known):
        return "covered", Grade.GOOD.value
    if told(cell) >= WARNED * cell.tried:
        return "warned", Grade.PARTLY.value
    return "silent", Grade.POOR.value


def told(cell: Cell) -> int:
    """Recordings that the method can treat of which a user is told something."""
    return sum(bool(r.remarks) or not r.usable for r in cell.attempts)


def _known(cell: Cell) -> list[Score]:
    return [score for score in cell.percent if math.isfinite(score.coverage)]


def _largest(cell: Cell) -> str:
    known = [s for s in cell.percent if s.claimed > 0.0 and math.isfinite(s.bias)]
    if not known:
        return NONE
    worst = max(known, key=lambda s: abs(s.bias) / s.claimed)
    return (
        f"{plus_minus(worst.bias / worst.claimed, worst.bias_se / worst.claimed)} {worst.parameter}"
    )


def _coverage(cell: Cell) -> str:
    """Coverage over all parameters, which depend on one another within a recording."""
    numbers = cell.numbers[:, cell.counted]
    truth = np.array([p.truth for p in cell.scenario.parameters])[:, None]
    low, high = numbers[..., 2], numbers[..., 3]
    given = np.isfinite(low) & np.isfinite(high)
    clusters = np.broadcast_to(np.arange(numbers.shape[1]), given.shape)
    value, interval = standardised.coverage(
        ((low <= truth) & (truth <= high))[given], clusters[given]
    )
    return share(value.value, interval) if given.any() else NONE


def _words(cell: Cell) -> str:
    """The first words of the two commonest remarks, and how often they came."""
    every = [remark for r in cell.attempts for remark in r.remarks.split(" | ") if remark]
    kinds = Counter(map(_kind, every))
    ranked = sorted(kinds, key=lambda kind: (-kinds[kind], kind))[:2]
    return "; ".join(f"{_short(kind, every)} ({kinds[kind]})" for kind in ranked) or NONE


def _short(kind: str, every: Sequence[str]) -> str:
    words = next(remark for remark in every if _kind(remark) == kind)
    return (
        words if len(words) <= LONGEST_WORDS else f"{words[:LONGEST_WORDS].rsplit(' ', 1)[0]} ..."
    )


def _kind(remark: str) -> str:
    """The first words without numbers, which differ from recording to recording."""
    return " ".join(re.sub(r"[-+.e\d]*\d[-+.e\d]*", "", remark).split()[:6])
