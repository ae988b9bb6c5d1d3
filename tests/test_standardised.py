"""Scores over recordings of different pilots, on numbers worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pilotid.study import standardised
from pilotid.study.entries import Draw
from pilotid.study.standardised import Share
from pilotid.study.strata import strata_of

ONE = np.array([3, 3, 5, 5])  # recordings of four values


def test_a_mean_s_error_is_that_of_recordings() -> None:
    values = np.array([1.0, 3.0, 2.0, 6.0])
    # Mean 3; sums of deviations -2 and 2: their squares, 8, times 2/1, rooted, over 4.
    assert standardised.mean(values, ONE) == Share(3.0, 1.0)
    # Each value for itself: deviations -2, 0, -1, 3: the usual standard error.
    alone = standardised.mean(values, np.arange(4))
    assert alone.error == pytest.approx(np.std(values, ddof=1) / 2.0)
    assert math.isnan(standardised.mean(values[:2], ONE[:2]).error)
    assert math.isnan(standardised.mean(values[:0], ONE[:0]).value)


def test_root_mean_squares() -> None:
    z = np.array([1.0, -1.0, 2.0, -2.0])
    # Squares 1, 1, 4, 4: mean 2.5; sums of deviations -3 and 3: 6/4 = 1.5; over 2 sqrt(2.5).
    found = standardised.root_mean_square(z, ONE)
    assert found.value == pytest.approx(math.sqrt(2.5))
    assert found.error == pytest.approx(1.5 / (2.0 * math.sqrt(2.5)))
    assert standardised.typical(z) == pytest.approx(1.5 / 0.674490)
    assert standardised.beyond(np.array([3.1, -3.1, 3.0, 0.0]), ONE).value == 0.5


def test_the_trimmed_score_leaves_out_the_farthest() -> None:
    z = np.concatenate([np.tile([1.0, -1.0], 100), [50.0, -60.0]])
    clusters = np.arange(z.size)
    assert standardised.trimmed(z, clusters).value == pytest.approx(1.0)  # 2 of 202 are left out
    assert standardised.trimmed(z[:60], clusters[:60]).value == pytest.approx(1.0)
    few = np.array([1.0, 7.0])
    assert standardised.trimmed(few, np.arange(2)).value == pytest.approx(5.0)  # none is left out
    normal = np.random.default_rng(1).normal(size=200_000)
    found = standardised.trimmed(normal, np.arange(normal.size))
    # 1 - 2 q phi(q) / 0.99 for the quantile q = 2.5758, rooted.
    assert found.value == pytest.approx(0.9616, abs=0.004)
    many = [standardised.trimmed(part, np.arange(500)) for part in normal.reshape(-1, 500)]
    scatter = np.std([m.value for m in many], ddof=1)
    assert np.mean([m.error for m in many]) == pytest.approx(scatter, rel=0.2)


def test_coverage_has_an_interval_of_as_many_as_the_recordings_are_worth() -> None:
    hits = np.array([True, True, False, False])
    share, (low, high) = standardised.coverage(hits, ONE)
    # Sums of deviations 1 and -1: sqrt(2 * 2) / 4; a quarter over its square is worth one.
    assert share == Share(0.5, 0.5)
    assert (low, high) == pytest.approx((0.0547, 0.9453), abs=1e-3)  # Wilson's for 1/2 of 1
    every, (low, high) = standardised.coverage(np.ones(4, dtype=bool), ONE)
    assert every == Share(1.0, 0.0)
    assert (low, high) == pytest.approx((0.3424, 1.0), abs=1e-3)  # Wilson's for 2 of 2
    none, interval = standardised.coverage(np.zeros(0, dtype=bool), ONE[:0])
    assert math.isnan(none.value)
    assert all(map(math.isnan, interval))


def draw(model: str, **facts: float | str) -> Draw:
    return Draw(model, (), {"element": "K", "runs": 1, "dt": 0.02, "run_in": 0.0, **facts})


def test_strata_hold_every_recording_once() -> None:
    levels = np.linspace(0.05, 0.3, 9)
    draws = {
        r: draw("rate" if r % 3 else "multi", remnant_level=float(x), duration=30.0 + 1e-15 * r,
                dt=0.02 if r < 4 else 0.005)
        for r, x in enumerate(levels)
    }  # fmt: skip
    strata = strata_of(draws)
    for name, stratum in strata.items():
        members = [r for own in stratum.values() for r in own]
        assert sorted(members) == list(range(9)), name
    assert strata["model"] == {"multi": frozenset({0, 3, 6}), "rate": frozenset({1, 2, 4, 5, 7, 8})}
    assert list(strata["rate"]) == ["50 Hz", "200 Hz"]
    assert strata["rate"]["50 Hz"] == frozenset(range(4))
    assert list(strata["length"]) == ["30 to 30 s"]
    assert [len(own) for own in strata["level"].values()] == [3, 3, 3]
    assert next(iter(strata["level"])) == "5 to 13 %"
    assert strata_of({})["level"] == {}
