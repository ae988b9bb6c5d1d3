"""What counts: rules that allow for how much a report compares and how little it may know.

A report compares every parameter of every method in every scenario, so that some method that
is right will look wrong somewhere.  The rules call none so unless chance would do that to any
of them in at most one of 20 whole reports; `nox -s check -- verdicts` simulates such reports.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from pilotid.study.comparison import Cell
from pilotid.study.score import Score
from pilotid.study.scores import skewed_t

#: Fewer fits than this allow no verdict.
ENOUGH = 10
#: A bias matters if it exceeds both.
BIAS_PERCENT, BIAS_BOUNDS = 1.0, 0.25
#: Parameters that a recording tells to an order of magnitude at best; the mean of such estimates
#: is that of the largest few, so that intervals alone are judged.
MAGNITUDES = ("rate",)
#: Intervals are too narrow if they hold the truth less often.
COVERAGE = 0.90
#: What no verdict may overlook: intervals that hold the truth no more often than this.
HIDDEN_COVERAGE = 0.85
#: Share of failures that a method may have.
FAILURES = 0.05
#: Probability with which anything right in a report is called wrong.
FAMILY = 0.05
#: Probability of overlooking what matters; and of not settling it with the recordings asked for.
OVERLOOKED, UNSETTLED = 0.05, 0.1
#: How many times more accurate an estimate is asked for at most, so that a bias which by chance
#: lies where it starts to matter does not ask for millions of recordings.
MOST = 2.0


@dataclass(frozen=True)
class Rules:
    """The rules of one report.

    Attributes
    ----------
    comparisons
        Tests in the whole report: two, of bias and of coverage, for each parameter of each
        method in each scenario.
    """

    comparisons: int

    @property
    def level(self) -> float:
        """Probability that chance passes one test, by Sidak's formula."""
        return -math.expm1(math.log1p(-FAMILY) / max(self.comparisons, 1))

    def biased(self, score: Score) -> bool:
        """Whether a bias counts: it is certain to be one that matters."""
        from scipy.special import stdtr

        beyond = abs(score.bias) - matters(score)
        if not beyond > 0.0 or score.parameter in MAGNITUDES:
            return False
        t = skewed_t(math.copysign(beyond, score.bias), score.std, score.skew, score.n)
        return bool(stdtr(score.n - 1, -abs(t)) <= self.level)

    def narrow(self, score: Score) -> bool:
        """Whether intervals hold the truth too seldom."""
        from scipy.special import bdtr

        if not score.coverage < COVERAGE:
            return False
        return bool(bdtr(round(score.coverage * score.n), score.n, 0.95) <= self.level)

    def needed(self, score: Score) -> int:
        """About how many recordings would settle what this many leave open; 0 if nothing."""
        return max(self._needed_for_bias(score), _needed_for_coverage(score))

    def _needed_for_bias(self, score: Score) -> int:
        from scipy.special import ndtri, stdtrit

        found, limit = abs(score.bias), matters(score)
        if score.parameter in MAGNITUDES:
            return 0
        if found - stdtrit(score.n - 1, OVERLOOKED) * score.bias_se <= limit:
            return 0
        # To prove small; or, if it is as large as found, to be certain in all comparisons.
        errors = -(ndtri([OVERLOOKED, self.level]) + ndtri(UNSETTLED))
        wanted = errors[0] / limit
        if found > limit:
            wanted = max(wanted, min(errors[1] / (found - limit), MOST * wanted))
        return _about((wanted * score.std) ** 2, score.n)

    @property
    def words(self) -> str:
        """The rules as the report prints them."""
        return " ".join(
            (
                f"A bias matters if it exceeds {BIAS_PERCENT:.0f} % of the true value and a "
                "quarter of the Cramér-Rao bound; it counts if chance hardly makes one like it of "
                "a smaller one (Student's t, corrected for skewness by Hall's transformation). "
                f"That of {' and '.join(MAGNITUDES)} does not, which a recording tells to an order "
                "of magnitude at best. "
                f"Intervals are too narrow if fewer than {100 * COVERAGE:.0f} % of the 95 % "
                "intervals hold the truth, and chance hardly makes honest ones fall that short. "
                f"Hardly: this report makes {self.comparisons} such comparisons, and each has the "
                f"level {self.level:.1e}, so that at most one of {1 / FAMILY:.0f} whole reports "
                "calls anything wrong that is right.",
                f"A method fails if more than {100 * FAILURES:.0f} % of its fits do.",
                "It is **good** if none of this holds for any parameter, and if the recordings "
                "suffice to say so: for every parameter a bias that matters, and intervals that "
                f"hold the truth in {100 * HIDDEN_COVERAGE:.0f} % or less, are excluded with "
                f"{100 * (1 - OVERLOOKED):.0f} % confidence. Otherwise it is **open**, with about "
                "the number of recordings that would tell. It is good in part if the bias counts "
                "in at most a third of the parameters and half of its fits succeed. No verdict on "
                f"fewer than {ENOUGH} fits.",
            )
        )


def rules_for(cells: Iterable[Cell]) -> Rules:
    """The rules of a report on these cells; those of a single recording are not judged."""
    judged = (c for c in cells if c.usable >= ENOUGH and not c.scenario.one_recording)
    return Rules(2 * sum(len(cell.percent) for cell in judged))


def matters(score: Score) -> float:
    """Size from which a bias matters [%]; without a bound, a share of the true value alone."""
    small = BIAS_BOUNDS * score.bound if math.isfinite(score.bound) else 0.0
    return max(BIAS_PERCENT, small)


def _needed_for_coverage(score: Score) -> int:
    from scipy.special import bdtrc, ndtri

    if not math.isfinite(score.coverage):
        return 0
    # More than that many intervals that do not hold less often than is said to be excluded.
    if bdtrc(round(score.coverage * score.n) - 1, score.n, HIDDEN_COVERAGE) <= OVERLOOKED:
        return 0
    spreads = [
        -float(ndtri(chance)) * math.sqrt(share * (1.0 - share))
        for chance, share in ((OVERLOOKED, HIDDEN_COVERAGE), (UNSETTLED, 0.95))
    ]
    return _about((sum(spreads) / (0.95 - HIDDEN_COVERAGE)) ** 2, score.n)


def _about(recordings: float, had: int) -> int:
    """A number of recordings to one digit, rounded up, at least twice those that did not do."""
    wanted = max(recordings, 2.0 * had)
    unit = int(10 ** math.floor(math.log10(wanted)))
    return math.ceil(wanted / unit) * unit
