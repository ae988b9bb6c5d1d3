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
from pilotid.analysis.rows import CONDITION, Row, Stratum
from pilotid.chance import Z95
from pilotid.types import FloatArray

#: Chance of a run being left out though it is like the others, for each recording and parameter.
LEFT_OUT = 0.01
#: Fewer runs than these cannot tell which of them is the odd one.
FEWEST_TO_JUDGE = 4


@dataclass(frozen=True)
class RunSpread:
    """The runs of one recording, fitted one by one, in one parameter.

    Attributes
    ----------
    file, stratum, condition, model, method, parameter, unit
        What was fitted.
    runs
        Numbers of the runs that are compared.
    chi_squared
        Squares of the runs' distances from their weighted mean, over their claimed variances,
        summed; its expectation is the number of runs less one if they differ as claimed.
    between_runs
        Standard deviation of the true values of the runs, apart from the errors of estimation.
    value, claimed_error
        The estimate from all runs together, and its claimed standard error; NaN where there is
        none.
    std_error, lower, upper
        Its standard error and 95 % interval with the variation from run to run: the claimed
        variance plus the variance between runs over their number, Student's t of one less than
        that.  Where the runs differ no more than claimed, what was claimed.
    notes
        Runs that are left out, and why.
    """

    file: str
    stratum: Stratum
    condition: str
    model: str
    method: str
    parameter: str
    unit: str
    runs: tuple[int, ...]
    chi_squared: float
    between_runs: float
    value: float
    claimed_error: float
    std_error: float
    lower: float
    upper: float
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
    """How much the runs differ over the subjects of a condition, by one model and method.

    Attributes
    ----------
    stratum, condition, model, method, parameter
        What was fitted.
    files, runs
        Recordings and runs compared.
    ratio
        How many times as much as claimed the runs of a recording differ.
    notes
        Runs that are left out, and why.
    """

    stratum: Stratum
    condition: str
    model: str
    method: str
    parameter: str
    files: int
    runs: int
    ratio: Ratio
    notes: tuple[str, ...] = ()


def run_spreads(rows: Sequence[Row]) -> list[RunSpread]:
    """The spread of runs of every recording, model, method and parameter that has such fits."""
    single: dict[tuple[str, str, str, str], list[Row]] = {}
    pooled: dict[tuple[str, str, str, str], Row] = {}
    for row in rows:
        key = (row.file, row.model, row.method, row.parameter)
        if row.run is None:
            pooled[key] = row
        else:
            single.setdefault(key, []).append(row)
    return [_spread_of(mine, pooled.get(key)) for key, mine in single.items()]


def with_variation(rows: Sequence[Row], spreads: Sequence[RunSpread]) -> list[Row]:
    """Rows whose errors and intervals include the variation from run to run, where it is known.

    Parameters
    ----------
    rows
        Rows of any fits; those of single runs stay as they are.
    spreads
        What `run_spreads` makes of them.
    """
    known = {
        (spread.file, spread.model, spread.method, spread.parameter): spread
        for spread in spreads
        if math.isfinite(spread.std_error)
    }
    result = []
    for row in rows:
        spread = known.get((row.file, row.model, row.method, row.parameter))
        if spread is not None and row.run is None:
            row = replace(row, std_error=spread.std_error, lower=spread.lower, upper=spread.upper)
        result.append(row)
    return result


def condition_spreads(spreads: Sequence[RunSpread]) -> list[ConditionSpread]:
    """The spread of runs over the subjects of every condition."""
    groups: dict[tuple[Stratum, str, str, str, str], list[RunSpread]] = {}
    for spread in spreads:
        key = (spread.stratum, spread.condition, spread.model, spread.method, spread.parameter)
        groups.setdefault(key, []).append(spread)
    return [_over_subjects(mine) for mine in groups.values()]


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
    span = f"{least.ratio.value:.1f} ({least.parameter})"
    if most is not least:
        span += f" to {most.ratio.value:.1f} ({most.parameter})"
    where = f"in {most.condition}, " if most.condition else ""
    varied = ", ".join(s.parameter for s in known if s.ratio.lower > 1.0)
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
    first = rows[0]
    value = claim = error = lower = upper = NAN
    if pooled is not None and pooled.usable:
        value, claim = pooled.value, pooled.std_error
        error, lower, upper = _widened(pooled, between, len(sound))
    return RunSpread(
        first.file,
        first.stratum,
        first.field(CONDITION),
        first.model,
        first.method,
        first.parameter,
        first.unit,
        tuple(row.run or 0 for row in sound),
        chi_squared,
        between,
        value,
        claim,
        error,
        lower,
        upper,
        tuple(notes),
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


def _widened(row: Row, between: float, runs: int) -> tuple[float, float, float]:
    """Standard error and interval of an estimate with the variation from run to run."""
    from scipy.special import stdtrit

    value, claim = row.value, row.std_error
    if not (claim > 0.0 and math.isfinite(between)):
        return NAN, NAN, NAN
    if between == 0.0:
        return claim, row.lower, row.upper
    error = math.sqrt(claim**2 + between**2 / runs)
    # The interval keeps its shape: profile intervals are longer on one side.
    longer = error / claim * float(stdtrit(runs - 1, 0.975)) / Z95
    return error, value - longer * (value - row.lower), value + longer * (row.upper - value)


def _over_subjects(spreads: Sequence[RunSpread]) -> ConditionSpread:
    used = [spread for spread in spreads if spread.freedom]
    total = math.fsum(spread.chi_squared for spread in used)
    first = spreads[0]
    return ConditionSpread(
        first.stratum,
        first.condition,
        first.model,
        first.method,
        first.parameter,
        len(used),
        sum(len(spread.runs) for spread in used),
        ratio_of(total, sum(spread.freedom for spread in used)),
        tuple(f"{spread.file}: {note}" for spread in spreads for note in spread.notes),
    )
