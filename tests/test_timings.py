"""What is stored of benchmarks, on numbers worked out by hand."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from timings import RATIOS, SLOWER, compared, exponents, summary_of

ROOT = Path(__file__).parents[1]


def test_times_are_stored_in_units_and_without_names_of_hosts() -> None:
    slow, fast = RATIOS["a loop over lstsq / ARX search"]
    notes = {"necessary": 10.0, "megabytes": 3}
    report = summary_of({slow: ("search", 0.5, {}), fast: ("search", 0.01, notes)}, 1e-4)
    assert report["ratios"] == {"a loop over lstsq / ARX search": 50.0}
    row = report["times"][fast]
    assert row == {"group": "search", "ms": 10.0, "units": 100.0, "floors": 10.0, "megabytes": 3}
    assert report["unit_us"] == 100.0
    assert set(report) == {"unit_us", "versions", "platform", "ratios", "exponents", "times"}


def test_what_became_slower_is_said_in_units() -> None:
    before = {"a": {"units": 100.0}, "b": {"units": 100.0}, "c": {"units": 1.0}}
    now = {"a": {"units": 100.0 * 1.01 * SLOWER}, "b": {"units": 110.0}, "new": {"units": 5.0}}
    slower, missing = compared(now, before)
    assert slower.startswith("a: 1.26 times slower (100 units before")
    assert missing == "not timed now: c"
    assert compared(now | {"a": {"units": 50.0}}, {"a": {"units": 100.0}}) == [
        "a: 2.00 times faster (100 units before, 50 now)"
    ]
    assert "nothing became slower" in compared(before, before)[0]


@pytest.mark.parametrize("power", [0.5, 1.0, 2.0])
def test_exponents_are_those_of_the_large_end(power: float) -> None:
    def row(samples: int) -> dict[str, object]:
        work = samples * math.log(samples)
        return {
            "axis": "runs",
            "method": "mle",
            "value": samples / 4096,
            "samples": samples,
            "ms": 7.0 + 0.0 * work if samples < 10_000 else 1e-3 * work**power,
        }

    times = {str(n): row(n) for n in (4096, 40_960, 409_600)} | {"other": {"ms": 1.0}}
    assert exponents(times) == {"mle, runs": power}
