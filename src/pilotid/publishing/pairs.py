"""What a method did in two studies of one scenario, put side by side."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence, Sized
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pilotid.study import differences
from pilotid.study.attempts import Attempts
from pilotid.study.differences import Difference
from pilotid.study.entries import ParameterTruth, Result
from pilotid.types import BoolArray, FloatArray

#: A change counts from this size on: of bias and rmse in bounds, of shares; times by a factor.
LEAST = {"bias": 0.01, "rmse": 0.01, "coverage": 0.0, "failures": 0.0, "time": 1.25}
#: Relative difference up to which two numbers are the same: stores may keep six digits.
SAME = 1e-5


@dataclass(frozen=True)
class Change:
    """One score of one method in one scenario, in both studies.

    Attributes
    ----------
    scenario, method, parameter
        What it is of; failures and times are of no parameter.
    score, unit
        Which one, a key of `LEAST`, and its unit.
    paired
        Whether recordings were compared one by one.
    counts
        Number of fits in both studies.
    numbers
        The scores and their difference.
    """

    scenario: str
    method: str
    parameter: str
    score: str
    unit: str
    paired: bool
    counts: tuple[int, int]
    numbers: Difference

    @property
    def better(self) -> bool:
        """Whether the second is the better one."""
        first, second = self.numbers.first, self.numbers.second
        if self.score == "coverage":
            return abs(second - 0.95) < abs(first - 0.95)
        return abs(second) < abs(first)


@dataclass(frozen=True, eq=False)
class Pair:
    """What a method did in both studies.

    Attributes
    ----------
    first, second
        Its fits.
    paired
        Whether both studies had the same recordings; fits of others are left out then.
    """

    first: Attempts
    second: Attempts
    paired: bool

    @cached_property
    def sides(self) -> tuple[list[Result], list[Result]]:
        """Fits of recordings that the method can treat; if paired, one by one."""
        first, second = list(self.first.attempts), list(self.second.attempts)
        if self.paired:
            held = [{r.unit.replication: r for r in side} for side in (first, second)]
            both = [number for number in held[0] if number in held[1]]
            first, second = ([own[number] for number in both] for own in held)
        return first, second

    @property
    def same(self) -> int:
        """Fits of the same recordings that are the same, to the digits that stores keep."""
        return sum(map(_same_fit, *self.sides)) if self.paired else 0

    @property
    def fits(self) -> int:
        """Fits that were compared one by one."""
        return len(self.sides[0]) if self.paired else 0

    def changes(self) -> Iterator[Change]:
        """All comparisons."""
        first, second = self.sides
        if not first or not second:
            return
        if not self.first.scenario.one_recording:
            yield from self._of_parameters()
        failed = [np.array([not r.usable for r in side]) for side in self.sides]
        yield self._shares("", "failures", failed[0], failed[1])
        took = [np.array([r.seconds or math.nan for r in side]) for side in self.sides]
        before, after = self._known(took[0], took[1])
        if before.size and after.size:
            numbers = differences.times(before, after, LEAST["time"], paired=self.paired)
            yield self._change("", "time", "s", before, after, numbers)

    def _of_parameters(self) -> Iterator[Change]:
        first, second = (_errors(side, _truths(self.first)) for side in self.sides)
        for key in (key for key in first if key in second):
            a, b = self._known(first[key].errors, second[key].errors)
            if not a.size or not b.size:
                continue
            for score, compare in (("bias", differences.bias), ("rmse", differences.rmse)):
                numbers = compare(a, b, paired=self.paired)
                yield self._change(key, score, first[key].unit, a, b, numbers)
            a, b = self._known(first[key].hits, second[key].hits)
            if a.size and b.size:
                yield self._shares(key, "coverage", a > 0.5, b > 0.5)

    def _known(self, first: FloatArray, second: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What is finite, on both sides where they belong together."""
        known = np.isfinite(first), np.isfinite(second)
        if self.paired:
            both = known[0] & known[1]
            known = both, both
        return first[known[0]], second[known[1]]

    def _shares(self, key: str, score: str, first: BoolArray, second: BoolArray) -> Change:
        numbers = differences.share(first, second, paired=self.paired)
        return self._change(key, score, "share", first, second, numbers)

    def _change(
        self, key: str, score: str, unit: str, first: Sized, second: Sized, numbers: Difference
    ) -> Change:
        name, counts = self.first.scenario.name, (len(first), len(second))
        return Change(name, self.first.method, key, score, unit, self.paired, counts, numbers)


@dataclass(frozen=True, eq=False)
class _Errors:
    """Errors of one parameter by fit, NaN where there is none, and whether intervals hit."""

    errors: FloatArray
    hits: FloatArray
    unit: str


#: Truths and bounds by replication; of a scenario that has one truth, by None.
Truths = Mapping[int | None, Sequence[ParameterTruth]]


def _truths(attempts: Attempts) -> Truths:
    if not attempts.scenario.population:
        return {None: attempts.scenario.parameters}
    return {r.unit.replication: r.draw.parameters for r in attempts.results if r.draw is not None}


def _errors(results: Sequence[Result], truths: Truths) -> dict[str, _Errors]:
    """Errors by parameter in units of the bound, or in % of the truth where there is none."""
    every = truths.values()
    keys = list(dict.fromkeys(p.parameter for known in every for p in known))
    bounded = all(p.bound for known in every for p in known)
    rows = [_row(result, keys, truths, bounded=bounded) for result in results]
    table = np.array(rows, dtype=float).reshape(len(results), len(keys), 2)
    unit = "bound" if bounded else "% of truth"
    return {
        key: _Errors(table[:, place, 0], table[:, place, 1], unit) for place, key in enumerate(keys)
    }


def _row(
    result: Result, keys: Sequence[str], truths: Truths, *, bounded: bool
) -> list[tuple[float, float]]:
    """Error and hit of each parameter; NaN for what is not there."""
    own = truths.get(None) or truths.get(result.unit.replication)
    if own is None:  # a recording that the first study does not have
        own = result.draw.parameters if result.draw is not None else ()
    known = {p.parameter: p for p in own} if result.usable else {}
    estimates = {key: numbers for key, *numbers in result.estimates}
    row = []
    for key in keys:
        value, _, low, high = estimates.get(key, (None,) * 4)
        if key not in known or value is None:
            row.append((math.nan, math.nan))
            continue
        truth, bound = known[key].truth, known[key].bound
        unit = bound if bounded and bound else 0.01 * abs(truth) or 1.0
        hit = math.nan if low is None or high is None else float(low <= truth <= high)
        row.append(((value - truth) / unit, hit))
    return row


def same_pilots(first: Attempts, second: Attempts) -> bool:
    """Whether both studies drew the same pilots of a population."""
    held = {r.unit.replication: r.draw for r in second.results if r.draw is not None}
    return all(
        r.draw.same(held[r.unit.replication])
        for r in first.results
        if r.draw is not None and r.unit.replication in held
    )


def _same_fit(first: Result, second: Result) -> bool:
    """Whether two fits are the same but for times and what is said of them."""
    if (first.outcome, len(first.estimates)) != (second.outcome, len(second.estimates)):
        return False
    pairs = zip(first.estimates, second.estimates, strict=True)
    return all(a[0] == b[0] and all(map(close, a[1:], b[1:])) for a, b in pairs)


def close(a: float | None, b: float | None) -> bool:
    """Whether two numbers of stores are the same to the digits that are kept."""
    return a is b if a is None or b is None else math.isclose(a, b, rel_tol=SAME)
