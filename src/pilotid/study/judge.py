"""What is to be thought of a method in a scenario: one function with fixed limits.

No verdict depends on what else a study or a report holds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from pilotid.study.scores import ALL, skewed_t
from pilotid.support.format import number, signed

if TYPE_CHECKING:
    from pandas import DataFrame

#: Loss of all parameters below which a method is efficient, and below which it is usable.
EFFICIENT, USABLE = 1.25, 2.0
#: Root mean square error over the bound of an efficient method's worst parameter, at the most.
USELESS = 4.0
#: A flag stands for what chance shows this seldom in a method that has no such fault.
CHANCE = 1e-3
#: Share of failed fits that is no fault, and the one beyond which a method is poor.
FAILURES, MOST_FAILURES = 0.01, 0.1
FITS_TO_TEST = 5  # fits of which a mean can be tested
#: What verdicts rest on, for those who explain them.
LIMITS = {
    "efficient": EFFICIENT,
    "usable": USABLE,
    "useless": USELESS,
    "without": round(1.0 / CHANCE),
    "failing": 100.0 * FAILURES,
    "often": 100.0 * MOST_FAILURES,
}


class Flag(NamedTuple):
    """A fault that is certain.

    Attributes
    ----------
    code
        ``biased``, ``too-short``, ``too-long`` or ``fails``.
    parameter
        The parameter where it is worst; of failures all.
    value
        Mean error over claimed error, coverage, or share of failures.
    """

    code: str
    parameter: str
    value: float

    @property
    def words(self) -> str:
        """What the fault is called in a table."""
        fault = self.code.replace("-", " ")
        name = f"intervals {fault}" if self.code.startswith("too-") else fault
        return name if self.parameter == ALL else f"{name} ({self.parameter})"


@dataclass(frozen=True)
class Verdict:
    """What is to be thought of a method in a scenario.

    Attributes
    ----------
    grade
        ``efficient``, ``usable`` or ``poor`` by the loss; ``unscored`` without intervals, or
        ``not applicable``.
    flags
        Faults that are certain.
    """

    grade: str
    flags: tuple[Flag, ...]

    @property
    def words(self) -> str:
        """The grade with the flags."""
        faults = ", ".join(flag.words for flag in self.flags)
        return f"{self.grade}: {faults}" if faults else self.grade


def judge(scores: DataFrame) -> Verdict:
    """Judge a method in a scenario.

    Parameters
    ----------
    scores
        Of all parameters together, and of each; see `pilotid.study.scores.score`.
    """
    rows = list(scores.itertuples())
    overall = rows[0]
    if not overall.recordings:
        return Verdict("not applicable", ())
    grade = "poor"
    if math.isnan(overall.loss):
        grade = "unscored"
    elif overall.loss < USABLE and not fails_often(overall):
        even = not scores.iloc[1:].rmse_over_bound.max() > USELESS
        grade = "efficient" if overall.loss < EFFICIENT and even else "usable"
    flags = (_bias(rows[1:]), _coverage(rows), _failures(overall))
    return Verdict(grade, tuple(flag for flag in flags if flag))


def fails_often(row: Any) -> bool:
    """Whether more than a tenth of the fits failed, of which a row of scores tells."""
    return bool(row.failures > MOST_FAILURES * row.recordings)


def is_ranked(row: Any) -> bool:
    """Whether a method has a loss that ranks it: that of one that fails often does not."""
    return math.isfinite(row.loss) and not fails_often(row)


def _bias(each: list[Any]) -> Flag | None:
    """The largest certain bias, by a t test that allows for skewed errors."""
    from scipy.special import stdtr

    def certain(s: Any) -> bool:
        if s.n < FITS_TO_TEST or not s.mean_z_se > 0.0:
            return False
        t = skewed_t(s.mean_z, s.mean_z_se * math.sqrt(s.n), s.z_skew, s.n)
        return bool(2.0 * stdtr(s.n - 1.0, -abs(t)) < CHANCE)

    worst = max(filter(certain, each), key=lambda s: abs(s.mean_z), default=None)
    return Flag("biased", worst.parameter, worst.mean_z) if worst else None


def _coverage(rows: list[Any]) -> Flag | None:
    """The coverage that is surest not to be 95 %, by the binomial distribution."""
    from scipy.special import bdtr, bdtrc

    found = []
    for s in rows:
        if not s.worth:
            continue
        hits = s.coverage_95 * s.worth
        short = float(bdtr(math.floor(hits + 1e-9), s.worth, 0.95))
        long = float(bdtrc(math.ceil(hits - 1e-9) - 1, s.worth, 0.95)) if hits > 0.0 else 1.0
        if 2.0 * min(short, long) < CHANCE:
            found.append((s, "too-short" if short < long else "too-long"))
    if not found:
        return None
    single = [f for f in found if f[0].parameter != ALL] or found
    worst, code = max(single, key=lambda f: abs(f[0].coverage_95 - 0.95))
    return Flag(code, worst.parameter, worst.coverage_95)


def _failures(overall: Any) -> Flag | None:
    """Failures that are certainly more than a few."""
    from scipy.special import bdtrc

    count, share = overall.recordings, overall.failures / overall.recordings
    if not overall.failures or bdtrc(overall.failures - 1, count, FAILURES) >= CHANCE:
        return None
    return Flag("fails", ALL, share)


def worst_parameter(scores: DataFrame) -> str:
    """The parameter that is farthest off in bounds, in rmse, and its bias; empty for none."""
    own = scores.iloc[1:].dropna(subset="rmse_over_bound")
    if not len(own):
        return ""
    row = own.loc[own.rmse_over_bound.idxmax()]
    words = f"{row.parameter} {number(row.rmse_over_bound, 2)} bounds"
    known = math.isfinite(row.bias_percent)
    return f"{words}, {signed(row.bias_percent)} %" if known else words
