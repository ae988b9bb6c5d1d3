"""Which method to trust with any pilot: rules on what methods do on a population."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from pilotid.numbers import number
from pilotid.report.content import Entry
from pilotid.report.verdicts import Grade
from pilotid.study.comparison import Comparison
from pilotid.study.population import PopulationCell, Standing

#: Fewer fits than this allow no verdict, and make no stratum worth a word.
FEWEST = 10
#: Least coverage of a good method, and of one that is good in part.
COVERAGE, COVERAGE_IN_PART = 0.92, 0.85
#: Share of failures, and trimmed root mean square of errors over claims, of a good method.
FAILURES, CLAIMS = 0.05, 1.2
#: Monte Carlo errors that a number must be off by: a report has many verdicts.
ERRORS = 3.0

RULES = (
    f"On a population a method covers too little if fewer than {100 * COVERAGE:.0f} % of its 95 % "
    "intervals hold the truth, over all parameters and recordings; it claims too much if the root "
    "mean square of error over claimed error, with the largest 1 % left out, exceeds "
    f"{CLAIMS:g}; it fails if more than {100 * FAILURES:.0f} % of its fits do. It is good if none "
    f"of this holds, good in part if {100 * COVERAGE_IN_PART:.0f} % of the intervals hold the "
    "truth and half of its fits succeed. It is open if the first two numbers are within "
    f"{ERRORS:.0f} Monte Carlo errors of those of an honest method and nothing else is wrong. No "
    f"verdict on fewer than {FEWEST} fits."
)
CODES = (
    "On populations C: % of 95 % intervals that hold the truth, where that is too few; S: error "
    "over claimed error, where that is too large; with a question mark where the recordings are "
    "too few to be certain"
)


class Finding(NamedTuple):
    """What is wrong with a method, in words and in a few signs, and whether that is certain."""

    words: str
    code: str
    certain: bool


@dataclass(frozen=True, eq=False)
class PopulationVerdict:
    """What the rules make of one method on one population."""

    cell: PopulationCell

    @property
    def _own(self) -> Standing:
        return self.cell.overall

    @property
    def _fails(self) -> float:
        return self._own.failures / self._own.recordings

    @property
    def judged(self) -> bool:
        """Whether there are enough fits for a verdict."""
        return self.cell.usable >= FEWEST

    @property
    def grade(self) -> Grade:
        """The verdict as a mark."""
        own = self._own
        if own.recordings >= FEWEST and self._fails > 0.5:
            return Grade.POOR
        if not self.judged:
            return Grade.NONE
        if not self.findings:
            return Grade.GOOD
        if not any(finding.certain for finding in self.findings):
            return Grade.OPEN
        return Grade.PARTLY if own.coverage.value >= COVERAGE_IN_PART else Grade.POOR

    @cached_property
    def findings(self) -> list[Finding]:
        """What is wrong, or may be; nothing on too few fits to say."""
        own = self._own
        covered, claims, found = own.coverage, own.trimmed, []
        if self.judged and not covered.value >= COVERAGE:
            percent = f"{100.0 * covered.value:.0f}"
            certain = covered.value + ERRORS * covered.error < 0.95
            found.append(Finding(f"covers {percent} %", f"C{percent}", certain))
        if self.judged and not claims.value <= CLAIMS:
            times = number(claims.value, 2)
            certain = claims.value - ERRORS * claims.error > 1.0
            found.append(Finding(f"errors {times} times its claims", f"S{times}", certain))
        if own.recordings and self._fails > FAILURES:
            percent = f"{100.0 * self._fails:.0f}"
            found.append(Finding(f"fails {percent} %", f"F{percent}", True))
        return found

    @property
    def words(self) -> str:
        """The verdict in a few words."""
        if not self._own.recordings:
            return "not applicable"
        doubt = self.findings and not any(finding.certain for finding in self.findings)
        parts = [finding.words for finding in self.findings]
        parts += [] if self.judged else [f"{self.cell.usable} fits"]
        return ("open: " if doubt else "") + (", ".join(parts) or "good")

    @property
    def code(self) -> str:
        """The same in a few signs, which `CODES` explains."""
        if not self._own.recordings:
            return "n/a"
        parts = [f.code + ("" if f.certain else "?") for f in self.findings]
        return " ".join(parts + ([] if self.judged else ["few"])) or "good"


def population_verdicts(study: Comparison) -> dict[tuple[str, str], Entry]:
    """The verdict on each method on each population, as entries of a table."""
    verdicts = {(c.scenario.name, c.method): PopulationVerdict(c) for c in study.populations}
    return {place: Entry(v.code, v.grade.value) for place, v in verdicts.items()}
