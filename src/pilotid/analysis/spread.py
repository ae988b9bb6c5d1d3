"""From run to run: how much runs differ, against what their standard errors claim.

A claimed error says what the same pilot, doing the same again, would scatter.  People do not do
the same again: where the runs of one recording differ by more than their errors, the pilot varied,
and an interval of the runs fitted together that should hold for the pilot, not for these runs
alone, is wider than claimed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pilotid.analysis.combine import NAN, Ratio, random_effects, ratio_of
from pilotid.analysis.rows import Row, grouped
from pilotid.support.numbers import Z95
from pilotid.support.types import FloatArray

#: Chance of a run being left out though it is like the others, for each recording and parameter.
LEFT_OUT = 0.01
#: Fewer runs than these cannot tell which of them is the odd one.
FEWEST_TO_JUDGE = 4


@dataclass(frozen=True)
class RunSpread(Row):
    """The runs of one recording, fitted one by one, in one parameter.

    As a row it is that of the fit of all runs together, with the variation from run to run in
    `std_error` and the interval: the claimed variance plus the variance between runs over their
    number, Student's t of one less than that.  Where the runs differ no more than claimed, what was
    claimed; NaN where there is none.

    Attributes
    ----------
    claimed_error
        The claimed standard error of the fit of all runs together.
    runs
        Numbers of the runs that are compared.
    chi_squared
        Squares of the runs' distances from their weighted mean, over their claimed variances,
        summed; its expectation is the number of runs less one if they differ as claimed.
    between_runs
        Standard deviation of the true values of the runs, apart from the errors of estimation.
    notes
        Runs that are left out, and why.
    """

    claimed_error: float = NAN
    runs: tuple[int, ...] = ()
    chi_squared: float = NAN
    between_runs: float = NAN
    notes: tuple[str, ...] = ()

    @property
    def freedom(self) -> int:
        """Degrees of freedom of chi-squared."""
        return max(len(self.runs) - 1, 0)

    @property
    def ratio(self) -> Ratio:
        """How many times as much as claimed the runs differ."""
        return ratio_of(self.chi_squared, self.freedom)


@dataclass(frozen=True)
class ConditionSpread:
    """How much the runs differ over the subjects of a condition, in one parameter.

    Attributes
    ----------
    first
        That of the first subject, which says what was fitted.
    spreads
        Those of the subjects with runs that can be compared.
    """

    first: RunSpread
    spreads: tuple[RunSpread, ...]

    @property
    def runs(self) -> int:
        """Number of runs compared."""
        return sum(len(spread.runs) for spread in self.spreads)

    @property
    def ratio(self) -> Ratio:
        """How many times as much as claimed the runs of a recording differ."""
        total = math.fsum(spread.chi_squared for spread in self.spreads)
        return ratio_of(total, sum(spread.freedom for spread in self.spreads))


def run_spreads(rows: Sequence[Row]) -> list[RunSpread]:
    """The spread of runs of every recording, model, method and parameter that has such fits."""
    pooled = {_place(row): row for row in rows if row.run is None}
    single = grouped((row for row in rows if row.run is not None), _place)
    return [_spread_of(mine, pooled.get(place)) for place, mine in single.items()]


def _place(row: Row) -> tuple[str, str, str, str]:
    return row.file, row.model, row.method, row.parameter


def with_variation(rows: Sequence[Row], spreads: Sequence[RunSpread]) -> list[Row]:
    """Rows whose errors and intervals include the variation from run to run, where it is known.

    Parameters
    ----------
    rows
        Rows of any fits; those of single runs stay as they are.
    spreads
        What `run_spreads` makes of them.
    """
    known = {_place(spread): spread for spread in spreads if math.isfinite(spread.std_error)}
    result = []
    for row in rows:
        spread = known.get(_place(row))
        if spread is not None and row.run is None:
            row = replace(row, std_error=spread.std_error, lower=spread.lower, upper=spread.upper)
        result.append(row)
    return result


def condition_spreads(spreads: Sequence[RunSpread]) -> list[ConditionSpread]:
    """The spread of runs over the subjects of every condition."""
    groups = grouped(spreads, lambda s: (s.stratum, s.condition, s.model, s.method, s.parameter))
    return [
        ConditionSpread(own[0], tuple(spread for spread in own if spread.freedom))
        for own in groups.values()
    ]


def spread_sentence(spreads: Sequence[ConditionSpread]) -> str:
    """The spread of runs in one condition over all parameters, in words for a report.

    Parameters
    ----------
    spreads
        Those of one condition, model and method.

    Returns
    -------
    A sentence; empty where no recording has two runs that can be compared.
    """
    known = [spread for spread in spreads if math.isfinite(spread.ratio.value)]
    if not known:
        return ""
    least, most = (pick(known, key=lambda s: s.ratio.value) for pick in (min, max))
    span = f"{least.ratio.value:.1f} ({least.first.parameter})"
    if most is not least:
        span += f" to {most.ratio.value:.1f} ({most.first.parameter})"
    where = f"in {most.first.condition}, " if most.first.condition else ""
    varied = ", ".join(s.first.parameter for s in known if s.ratio.lower > 1.0)
    told = f"overdispersion significant for {varied}" if varied else "not significant"
    return f"{where}between-run scatter is {span} times the reported standard errors: {told}"


def _spread_of(rows: Sequence[Row], pooled: Row | None) -> RunSpread:
    notes, sound = [], []
    for row in sorted(rows, key=lambda row: row.run or 0):
        known = math.isfinite(row.value) and math.isfinite(row.std_error) and row.std_error > 0.0
        if row.usable and known:
            sound.append(row)
        else:
            notes.append(f"run {row.run} left out: {row.outcome if not row.usable else 'no error'}")
    odd = _odd_one(*_arrays(sound)) if len(sound) >= FEWEST_TO_JUDGE else None
    if odd is not None:
        row = sound.pop(odd)
        notes.append(f"run {row.run} left out: its {row.parameter}, {row.value:.3g}, is far off")
    values, errors = _arrays(sound)
    chi_squared = between = NAN
    if len(sound) > 1:
        weights = errors**-2
        chi_squared = float(np.sum(weights * (values - np.average(values, weights=weights)) ** 2))
        between = random_effects(values, errors).between
    fit = replace(rows[0], value=NAN, std_error=NAN, lower=NAN, upper=NAN)
    claimed = NAN
    if pooled is not None and pooled.usable:
        fit, claimed = _widened(pooled, between, len(sound)), pooled.std_error
    numbers = tuple(row.run or 0 for row in sound)
    return RunSpread(
        **vars(fit),
        claimed_error=claimed,
        runs=numbers,
        chi_squared=chi_squared,
        between_runs=between,
        notes=tuple(notes),
    )


def _arrays(rows: Sequence[Row]) -> tuple[FloatArray, FloatArray]:
    return np.array([row.value for row in rows]), np.array([row.std_error for row in rows])


def _odd_one(values: FloatArray, errors: FloatArray) -> int | None:
    """The one run that is not like the others, if there is one.

    Each is set against the weighted mean of the others, in units of their own scatter, or of what
    is claimed where that is larger: Student's t, with Bonferroni's correction for the runs.
    """
    from scipy.special import stdtrit

    count = len(values)
    distances = []
    for i in range(count):
        others = np.arange(count) != i
        weights = errors[others] ** -2
        centre = np.average(values[others], weights=weights)
        scatter = np.sum(weights * (values[others] - centre) ** 2) / (count - 2)
        claimed = math.sqrt(errors[i] ** 2 + 1.0 / np.sum(weights))
        distances.append(abs(values[i] - centre) / claimed / math.sqrt(max(1.0, scatter)))
    farthest = int(np.argmax(distances))
    limit = stdtrit(count - 2, 1.0 - 0.5 * LEFT_OUT / count)
    return farthest if distances[farthest] > limit else None


def _widened(row: Row, between: float, runs: int) -> Row:
    """An estimate with the variation from run to run in its standard error and interval."""
    from scipy.special import stdtrit

    value, claim = row.value, row.std_error
    if not (claim > 0.0 and math.isfinite(between)):
        return replace(row, std_error=NAN, lower=NAN, upper=NAN)
    if between == 0.0:
        return row
    error = math.sqrt(claim**2 + between**2 / runs)
    # The interval keeps its shape: profile intervals are longer on one side.
    longer = error / claim * float(stdtrit(runs - 1, 0.975)) / Z95
    low, high = value - longer * (value - row.lower), value + longer * (row.upper - value)
    return replace(row, std_error=error, lower=low, upper=high)
