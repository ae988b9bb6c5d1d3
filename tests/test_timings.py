"""What is stored of benchmarks, on numbers worked out by hand."""

from __future__ import annotations

from timings import SLOWER, compared, summary_of


def test_times_are_stored_in_units_and_without_names_of_hosts() -> None:
    notes = {"necessary": 10.0, "megabytes": 3}
    report = summary_of({"arx_search": ("search", 0.01, notes)}, 1e-4)
    row = report["times"]["arx_search"]
    assert row == {"group": "search", "ms": 10.0, "units": 100.0, "floors": 10.0, "megabytes": 3}
    assert report["unit_us"] == 100.0
    assert set(report) == {"unit_us", "versions", "platform", "times"}


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
