"""Remarks: sentences for users, each with a stable code to ask for and a grade."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal, Self

from pilotid.support.types import one_line

Grade = Literal["wrong", "doubt", "note"]
GRADES: tuple[Grade, ...] = ("wrong", "doubt", "note")

#: Code of what a method says in words of its own.
OTHER = "other"

#: Every code: its grade (wrong: do not use the numbers; doubt: look; note: for information), and
#: what it says.
CODES: dict[str, tuple[Grade, str]] = {
    # of a recording
    "preprocessed": ("note", "the recording was detrended, cut to whole periods, or the like"),
    "motionless": ("wrong", "e or x does not move, or hardly above the noise of the recorder"),
    "wrong-sign": ("wrong", "a signal has the wrong sign"),
    "wrong-unit": ("wrong", "a signal is not as large as the others say, or u includes fd"),
    "not-the-error": ("wrong", "e is not ft - x"),
    "exchanged": ("wrong", "e and x seem to be exchanged"),
    "output-unrelated": ("wrong", "x is not the answer to u (and fd)"),
    "drift": ("doubt", "u drifts, which neither loop nor model explains"),
    "copied-run": ("wrong", "a run is a copy of another"),
    "element-differs": ("doubt", "the controlled element is not the one named, or not always one"),
    # of a recording, by what a recorder leaves in signals
    "low-pass": ("doubt", "a filter, or slower samples held or interpolated, ends a band"),
    "lost-samples": ("wrong", "samples are lost, held or spiked, or several runs are one"),
    "rounded": ("doubt", "a signal has coarse steps, or u is often at its ends"),
    "late-signal": ("wrong", "a signal is recorded late or early against another"),
    # of an estimate, by any method
    "misspecified": ("wrong", "the estimate contradicts the recording"),
    "little-explained": ("wrong", "the model explains next to nothing of the control"),
    "inseparable": ("note", "parameters, channels, answers or optima cannot be told apart"),
    "not-determined": ("note", "a parameter's interval is wide or ends at a bound"),
    "outside-range": ("doubt", "a value lies outside the range of pilots"),
    # of an estimate, by the tests of some methods
    "element-unknown": ("doubt", "the loop cannot be closed, and noise counts as signal"),
    "held-control": ("doubt", "u often keeps its value from one sample to the next"),
    "pilot-changes": ("doubt", "parts of the recording differ"),
    "residual-not-white": ("doubt", "the prediction errors are not white"),
    "gain-element": ("note", "the controlled element is a gain: all rests on the remnant"),
    "slow-lag": ("note", "a lag is long beside the pre-history: its free decay is fitted too"),
    OTHER: ("note", "what a method says in words of its own"),
}


class Remark(str):
    """A sentence that a user must know, with its code.

    Attributes
    ----------
    code
        One of `CODES`.
    grade
        ``wrong``: do not use the numbers; ``doubt``: look; ``note``: for information.
    """

    code: str
    grade: Grade

    def __new__(cls, code: str, sentence: str, grade: Grade | None = None) -> Self:
        """A remark of the grade that its code has, unless another is given."""
        remark = super().__new__(cls, sentence)
        remark.code, remark.grade = code, grade or CODES[code][0]
        return remark

    def line(self, about: str) -> str:
        """Grade, code, what it is about, and the sentence, as terminals and reports show them."""
        return f"{self.grade} [{self.code}] {about}: {self}"

    def __getnewargs__(self) -> tuple[str, str, Grade]:  # type: ignore[override]
        """What copies and other processes make it of."""
        return self.code, str(self), self.grade


def remarks_json(remarks: Iterable[str]) -> dict[str, list[str]]:
    """Sentences and codes, as JSON has them."""
    sentences = list(remarks)
    return {"remarks": [str(remark) for remark in sentences], "codes": codes_of(sentences)}


def codes_of(remarks: Iterable[str]) -> list[str]:
    """The codes of remarks, of plain sentences as well."""
    return [getattr(remark, "code", OTHER) for remark in remarks]


def gravest_first(remarks: Iterable[Remark]) -> tuple[Remark, ...]:
    """Remarks by grade, those of one grade in the order they were in."""
    return tuple(sorted(remarks, key=lambda remark: GRADES.index(remark.grade)))


def counted_grades(remarks: Iterable[Remark]) -> str:
    """How many remarks there are of each grade, in words; empty for none."""
    grades = [remark.grade for remark in remarks]
    counted = ((grades.count(grade), grade) for grade in GRADES if grade in grades)
    return ", ".join(f"{n} {grade}{'s' * (n > 1 and grade != 'wrong')}" for n, grade in counted)


def remark_of(sentence: str) -> Remark:
    """A sentence as a remark, on one line; a method may say plain ones."""
    code, grade = getattr(sentence, "code", OTHER), getattr(sentence, "grade", None)
    return Remark(code, one_line(sentence), grade)
