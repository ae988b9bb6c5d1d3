"""Stores what was timed, in units of the processor's own floor."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from floor import unit
from timings import summary_of

STORED = Path(__file__).parents[2] / "results" / "timings.json"


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--method", action="append", default=[], metavar="FILE.py:CLASS", help="time this one, too"
    )
    parser.addoption("--store", action="store_true", help="store the times in results/timings.json")


@pytest.fixture
def necessary(request: pytest.FixtureRequest, benchmark: Any) -> Any:
    """Takes down how many units the work needs at least."""

    def note(units: float) -> None:
        benchmark.extra_info["necessary"] = float(units)

    return note


@pytest.hookimpl(trylast=True)
def pytest_terminal_summary(
    terminalreporter: pytest.TerminalReporter, config: pytest.Config
) -> None:
    """Store all if that was asked."""
    session: Any = getattr(config, "_benchmarksession", None)
    timed = [b for b in session.benchmarks if b.stats] if session else []
    if not timed:
        return
    report = summary_of({name(b): (b.group, b.stats.min, b.extra_info) for b in timed}, unit())
    if config.getoption("--store"):
        STORED.write_text(json.dumps(report, indent=1) + "\n")
        terminalreporter.write_line(f"stored in results/{STORED.name}")


def name(benchmark: Any) -> str:
    """A benchmark's name without what pytest puts before it."""
    return str(benchmark.name).removeprefix("test_")
