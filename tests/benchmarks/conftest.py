"""The benchmarks' closing line."""

from __future__ import annotations

from typing import Any

import pytest

FAST, SLOW = "test_mle_white", "test_what_a_user_would_write"


@pytest.hookimpl(trylast=True)
def pytest_terminal_summary(
    terminalreporter: pytest.TerminalReporter, config: pytest.Config
) -> None:
    """Say how much faster the package's fit is than the plain one."""
    session: Any = getattr(config, "_benchmarksession", None)
    median = {b.name: b.stats.median for b in session.benchmarks if b.stats} if session else {}
    if {FAST, SLOW} <= median.keys():
        terminalreporter.write_line(
            f"mle-white {1e3 * median[FAST]:.1f} ms; python-control, forced_response and finite "
            f"differences {1e3 * median[SLOW]:.0f} ms: {median[SLOW] / median[FAST]:.0f} times"
        )
