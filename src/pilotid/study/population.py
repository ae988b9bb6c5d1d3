"""What a method did on the recordings of a population, each of which has its own truth."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pilotid.estimates.estimate import Outcome
from pilotid.study import standardised
from pilotid.study.attempts import Attempts
from pilotid.study.entries import Draw, Result
from pilotid.study.standardised import Share
from pilotid.study.strata import Stratum
from pilotid.types import BoolArray, FloatArray, IntArray

#: A fit ends in a wrong optimum if its criterion exceeds that of a search from the truth by
#: more.
WRONG = 4.0
NO_TRY = Outcome.NOT_APPLICABLE.slug
#: What stands for all parameters, and for all recordings.
ALL = "all"

#: Columns of population.csv behind scenario and method.
POPULATION_COLUMNS = (
    *("stratum", "value", "parameter", "recordings", "n"),
    *("coverage_95", "coverage_se", "mean_z", "mean_z_se", "rms_z", "rms_z_se"),
    *("rms_z_trimmed", "rms_z_trimmed_se", "beyond_3", "beyond_3_se"),
    *("rmse_over_bound", "rmse_over_bound_se", "median_over_bound"),
    *("failures", "not_applicable", "wrong_optima", "optima"),
)


@dataclass(frozen=True, eq=False)
class Errors:
    """Every parameter of every fit that counts, one after the other.

    Attributes
    ----------
    recording
        Replication of each, shape (values,).
    key
        Parameter of each.
    error, claimed, bound
        Error, claimed standard error and bound, in the parameter's unit, NaN where there is
        none.
    given, hit
        Whether there is an interval, and whether it holds the truth.
    """

    recording: IntArray
    key: tuple[str, ...]
    error: FloatArray
    claimed: FloatArray
    bound: FloatArray
    given: BoolArray
    hit: BoolArray

    @cached_property
    def keys(self) -> np.ndarray:
        """The parameters as an array."""
        return np.array(self.key, dtype=object)


@dataclass(frozen=True)
class Standing:
    """Standardised scores of some fits; see `pilotid.study.standardised`.

    Attributes
    ----------
    recordings
        Recordings that the method could try.
    failures, objections
        Fits that failed, and recordings that the method objects to.
    n
        Parameters of fits that count.
    coverage, coverage_interval
        Share of the 95 % intervals that hold the truth, and its own 95 % interval.
    mean, rms, trimmed, beyond
        Of error over claimed error: mean, root mean square, the same with 1 % left out, and
        share beyond 3.
    ratio, typical
        Root mean square of error over bound, and its counterpart of the median.
    wrong, optima
        Fits that end in a wrong optimum, of those for which that is known.
    """

    recordings: int
    failures: int
    objections: int
    n: int
    coverage: Share
    coverage_interval: tuple[float, float]
    mean: Share
    rms: Share
    trimmed: Share
    beyond: Share
    ratio: Share
    typical: float
    wrong: int
    optima: int


@dataclass(frozen=True, eq=False)
class PopulationCell(Attempts):
    """All fits of one population by one method.

    Attributes
    ----------
    scenario, method, results
        See `Attempts`.
    strata
        Replications by the values of each fact that was drawn, by the fact's name.
    """

    strata: Mapping[str, Stratum]

    @cached_property
    def keys(self) -> tuple[str, ...]:
        """Parameters of any model of the population, those of large models in their order."""
        models = {r.draw.model: r.draw for r in self.results if r.draw is not None}
        ordered = sorted(models.values(), key=lambda draw: (-len(draw.parameters), draw.model))
        keys = [p.parameter for draw in ordered for p in draw.parameters]
        return tuple(dict.fromkeys(keys))

    @cached_property
    def values(self) -> Errors:
        """Errors of the fits that count."""
        rows = [
            (result.unit.replication, p, own)
            for result in self.results
            if result.usable and result.draw is not None
            for p, own in zip(result.draw.parameters, result.estimates, strict=True)
        ]
        numbers = np.array([own[1:] for *_, own in rows], dtype=float).reshape(-1, 4)
        truth = np.array([p.truth for _, p, _ in rows], dtype=float)
        value, claimed, low, high = numbers.T
        return Errors(
            np.array([replication for replication, *_ in rows], dtype=np.intp),
            tuple(p.parameter for _, p, _ in rows),
            value - truth,
            np.where(claimed > 0.0, claimed, math.nan),
            np.array([p.bound or math.nan for _, p, _ in rows], dtype=float),
            np.isfinite(low) & np.isfinite(high),
            (low <= truth) & (truth <= high),
        )

    @cached_property
    def overall(self) -> Standing:
        """Scores of all parameters of all recordings."""
        return self.standing()

    def standing(self, key: str = ALL, members: frozenset[int] | None = None) -> Standing:
        """Scores of a parameter, or of all, in some of the recordings, or in all.

        Parameters
        ----------
        key
            A parameter: only recordings of pilots who have it count.
        members
            Replications; None for all.
        """
        results = [r for r in self.results if _concerns(r, key, members)]
        tried = [r for r in results if r.outcome != NO_TRY]
        known = [r.excess for r in tried if r.excess is not None]
        v = self.values
        mine = np.ones(v.recording.size, dtype=bool) if key == ALL else v.keys == key
        if members is not None:
            mine &= np.isin(v.recording, sorted(members))
        claims, bounded = mine & np.isfinite(v.claimed), mine & np.isfinite(v.bound)
        z, of = v.error[claims] / v.claimed[claims], v.recording[claims]
        ratio = v.error[bounded] / v.bound[bounded]
        given = mine & v.given
        share, interval = standardised.coverage(v.hit[given], v.recording[given])
        return Standing(
            recordings=len(tried),
            failures=sum(not r.usable for r in tried),
            objections=len(results) - len(tried),
            n=int(np.sum(mine)),
            coverage=share,
            coverage_interval=interval,
            mean=standardised.mean(z, of),
            rms=standardised.root_mean_square(z, of),
            trimmed=standardised.trimmed(z, of),
            beyond=standardised.beyond(z, of),
            ratio=standardised.root_mean_square(ratio, v.recording[bounded]),
            typical=standardised.typical(ratio),
            wrong=sum(excess > WRONG for excess in known),
            optima=len(known),
        )

    def rows(self) -> Iterator[list[object]]:
        """`POPULATION_COLUMNS` of all recordings and of each stratum, by parameter and for all."""
        parts: list[tuple[str, str, frozenset[int] | None]] = [(ALL, ALL, None)]
        parts += [(name, value, m) for name, own in self.strata.items() for value, m in own.items()]
        for name, value, members in parts:
            for key in (ALL, *self.keys):
                yield [name, value, key, *_numbers(self.standing(key, members))]


def _concerns(result: Result, key: str, members: frozenset[int] | None) -> bool:
    """Whether a fit is of a recording that a score is about."""
    if members is not None and result.unit.replication not in members:
        return False
    return key == ALL or (result.draw is not None and key in keys_of(result.draw))


def keys_of(draw: Draw) -> tuple[str, ...]:
    """The parameters of a draw's pilot."""
    return tuple(p.parameter for p in draw.parameters)


def _numbers(s: Standing) -> list[object]:
    shares = (s.coverage, s.mean, s.rms, s.trimmed, s.beyond, s.ratio)
    pairs = [number for share in shares for number in (share.value, share.error)]
    wrong = [s.wrong, s.optima] if s.optima else [math.nan, 0]
    return [s.recordings, s.n, *pairs, s.typical, s.failures, s.objections, *wrong]
