"""Stores what was timed, in units of the processor's own floor, and says what became slower."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from floor import unit
from timings import compared, summary_of

STORED = Path(__file__).parents[2] / "results" / "timings.json"


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--compare",
        nargs="?",
        const=str(STORED),
        metavar="FILE",
        help="say what became slower than in a stored run (results/timings.json)",
    )
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


def pytest_configure(config: pytest.Config) -> None:
    """Refuse what cannot be compared with before anything is timed."""
    given = config.getoption("--compare")
    if given and not Path(given).is_file():
        raise pytest.UsageError(f"{given}: no stored times; make them with --store first")


@pytest.hookimpl(trylast=True)
def pytest_terminal_summary(
    terminalreporter: pytest.TerminalReporter, config: pytest.Config
) -> None:
    """Show what became slower, and store all if that was asked."""
    session: Any = getattr(config, "_benchmarksession", None)
    timed = [b for b in session.benchmarks if b.stats] if session else []
    if not timed:
        return
    report = summary_of({name(b): (b.group, b.stats.min, b.extra_info) for b in timed}, unit())
    write = terminalreporter.write_line
    if given := config.getoption("--compare"):
        for line in compared(report["times"], json.loads(Path(given).read_text())["times"]):
            write(line)
    if config.getoption("--store"):
        STORED.write_text(json.dumps(report, indent=1) + "\n")
        write(f"stored in results/{STORED.name}")


def name(benchmark: Any) -> str:
    """A benchmark's name without what pytest puts before it."""
    return str(benchmark.name).removeprefix("test_")
