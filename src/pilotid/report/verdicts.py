"""Which method to trust: what the rules make of a study's numbers, in words."""

from __future__ import annotations

import enum
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from pilotid.numbers import signed
from pilotid.report.rules import ENOUGH, FAILURES, MAGNITUDES, Rules
from pilotid.study.comparison import Cell
from pilotid.study.score import Score

#: A method wastes information if its rmse exceeds the bound by this factor in some parameter.
WASTE = 1.5
#: Recordings beyond which it does not matter how many there would have to be.
MANY = 100_000

CODES = (
    "B: number of parameters whose bias counts; N: number of parameters whose intervals are too "
    "narrow; F: % of fits that failed; open: not yet good, for lack of recordings; n/a: not "
    "applicable; few: too few fits for a verdict"
)


class Grade(enum.Enum):
    """What a method's numbers in one scenario amount to; the value marks cells of tables."""

    GOOD = "good"
    PARTLY = "partly"
    POOR = "poor"
    OPEN = "open"
    NONE = "none"


@dataclass(frozen=True, eq=False)
class Verdict:
    """What the rules make of one method in one scenario.

    Attributes
    ----------
    cell
        The method's numbers.
    biased, narrow
        Parameters whose bias counts, and those whose intervals are too narrow.
    unsettled
        Parameters of which the recordings do not tell enough.
    needed
        About how many recordings would, 0 if these do.
    """

    cell: Cell
    biased: tuple[Score, ...]
    narrow: tuple[Score, ...]
    unsettled: tuple[Score, ...]
    needed: int

    @property
    def failures(self) -> int:
        """Fits that failed, of those that the method could try."""
        return self.cell.tried - self.cell.usable

    @property
    def fails(self) -> bool:
        """Whether it fails too often."""
        return self.failures > FAILURES * self.cell.tried

    @property
    def judged(self) -> bool:
        """Whether there are enough fits for a verdict."""
        return self.cell.usable >= ENOUGH

    @property
    def grade(self) -> Grade:
        """The verdict as a mark."""
        if not self.cell.tried:
            return Grade.NONE
        if self.cell.tried >= ENOUGH and self.failures > 0.5 * self.cell.tried:
            return Grade.POOR
        if not self.judged:
            return Grade.NONE
        if not (self.biased or self.narrow or self.fails):
            return Grade.OPEN if self.needed else Grade.GOOD
        # Values without bias are worth having, even if the intervals are too narrow.
        return Grade.PARTLY if self.few_biased else Grade.POOR

    @property
    def few_biased(self) -> bool:
        """Whether the bias counts in at most a third of the parameters."""
        return 3 * len(self.biased) <= len(self.cell.percent)

    @property
    def words(self) -> str:
        """The verdict in a few words, for a table's cell."""
        if not self.cell.tried:
            return "not applicable"
        fails = [f"fails {_percent(self.failures / self.cell.tried)}"] if self.fails else []
        if not self.judged:
            return ", ".join([*fails, f"{self.cell.usable} fits"])
        count = len(self.cell.percent)
        biased = [f"biased {len(self.biased)}/{count}"] if self.biased else []
        narrow = [f"narrow {len(self.narrow)}/{count}"] if self.narrow else []
        fine = f"open: needs {_recordings(self.needed)}" if self.needed else "good"
        return ", ".join([*biased, *narrow, *fails]) or fine

    @property
    def code(self) -> str:
        """The same in a few signs, which `CODES` explains."""
        if not self.cell.tried:
            return "n/a"
        fails = [f"F{100.0 * self.failures / self.cell.tried:.0f}"] if self.fails else []
        if not self.judged:
            return " ".join([*fails, "few"])
        biased = [f"B{len(self.biased)}"] if self.biased else []
        narrow = [f"N{len(self.narrow)}"] if self.narrow else []
        return " ".join([*biased, *narrow, *fails]) or ("open" if self.needed else "good")


def judge(cell: Cell, rules: Rules) -> Verdict:
    """Apply a report's rules to one method in one scenario."""
    scores = cell.percent if cell.usable >= ENOUGH else ()
    needed = {s: rules.needed(s) for s in scores}
    return Verdict(
        cell,
        biased=tuple(s for s in scores if rules.biased(s)),
        narrow=tuple(s for s in scores if rules.narrow(s)),
        unsettled=tuple(s for s in scores if needed[s]),
        needed=max(needed.values(), default=0),
    )


def sized(cell: Cell) -> tuple[Score, ...]:
    """Scores in % of the parameters whose errors mean something on average."""
    return tuple(score for score in cell.percent if score.parameter not in MAGNITUDES)


def extremes(
    scores: Sequence[Score], value: Callable[[Score], float]
) -> tuple[Score | None, Score | None]:
    """Scores of the lowest and the highest finite value, None if there is none."""
    finite = [s for s in scores if math.isfinite(value(s))]
    return min(finite, key=value, default=None), max(finite, key=value, default=None)


def sentence(verdict: Verdict) -> str:
    """What a busy reader should know of a method in a scenario."""
    cell = verdict.cell
    name = f"**`{cell.method}`**"
    if not cell.tried:
        return f"{name}: not applicable here ({cell.results[0].message})."
    if verdict.grade is Grade.NONE:
        return f"{name}: {cell.usable} of {cell.tried} fits count: too few for a verdict."
    if not verdict.judged:
        return f"{name}: {verdict.failures} of {cell.tried} fits failed: do not use it here."
    facts = [_bias_words(verdict), _scatter_words(cell), _interval_words(verdict)]
    if verdict.grade is Grade.OPEN:
        facts.append(f"open: {_names(verdict.unsettled)}")
    facts.append(f"{verdict.failures} of {cell.tried} fits failed")
    return f"{name}: {_advice(verdict)}. " + _capital("; ".join(f for f in facts if f)) + "."


def _advice(verdict: Verdict) -> str:
    if verdict.grade is Grade.OPEN:
        return f"nothing against it, but it takes {_recordings(verdict.needed)} to tell"
    if verdict.grade is Grade.GOOD:
        _, worst = extremes(sized(verdict.cell), lambda s: s.ratio)
        wasteful = worst is not None and worst.ratio > WASTE
        return "use it, though it is not efficient" if wasteful else "use it"
    parts = []
    if verdict.biased:
        mind = f"mind its bias in {_names(verdict.biased)}"
        parts.append(mind if verdict.few_biased else "do not rely on its values")
    if verdict.narrow:
        few = 3 * len(verdict.narrow) <= len(verdict.cell.percent)
        narrow = f" of {_names(verdict.narrow)}" if few else ""
        values = "" if verdict.biased else "use its values, but "
        parts.append(f"{values}do not believe its intervals{narrow}")
    if verdict.fails:
        parts.append("expect failures")
    return " and ".join(parts)


def _bias_words(verdict: Verdict) -> str:
    if not verdict.biased:
        return "no bias that counts in any parameter"
    worst = sorted(verdict.biased, key=lambda s: -abs(s.bias) / s.bound)
    parts = [f"{s.parameter} {signed(s.bias)} %" for s in worst[:3]]
    more = f" and {len(worst) - 3} more" if len(worst) > 3 else ""
    return f"biased in {', '.join(parts)}{more}"


def _scatter_words(cell: Cell) -> str:
    low, high = extremes(sized(cell), lambda s: s.ratio)
    if low is None or high is None:
        return ""
    return f"rmse {low.ratio:.2g} to {high.ratio:.2g} times the bound"


def _interval_words(verdict: Verdict) -> str:
    low, high = extremes(verdict.cell.percent, lambda s: s.coverage)
    if low is None or high is None:
        return "no intervals"
    shares = f"{100 * low.coverage:.0f} to {_percent(high.coverage)}"
    return f"95 % intervals hold the truth in {shares} of the fits, by parameter"


def _names(scores: Sequence[Score]) -> str:
    return ", ".join(s.parameter for s in scores)


def _recordings(count: int) -> str:
    """A number of recordings, in words where nobody would make so many."""
    return f"about {count} recordings" if count <= MANY else f"more than {MANY} recordings"


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def in_short(verdicts: Sequence[Verdict]) -> str:
    """One sentence that says which methods to use."""
    words = {
        Grade.GOOD: "good",
        Grade.PARTLY: "good in part",
        Grade.OPEN: "open for lack of recordings",
        Grade.POOR: "not to be relied on",
        Grade.NONE: "without a verdict",
    }
    parts = []
    for grade, word in words.items():
        names = [f"`{v.cell.method}`" for v in verdicts if v.grade is grade]
        if names:
            parts.append(f"{word}: {', '.join(names)}")
    return _capital("; ".join(parts)) + "."
