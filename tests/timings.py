"""What is stored of benchmarks, and what two runs of them say; see tests/benchmarks."""

from __future__ import annotations

import math
import platform
import sys
from importlib.metadata import version
from typing import Any

#: A time counts as longer if it exceeds what was stored by this factor.
SLOWER = 1.25


def summary_of(times: dict[str, tuple[str, float, dict[str, Any]]], unit: float) -> dict[str, Any]:
    """What is stored: times in milliseconds and in units, versions; no names of hosts.

    Of several rounds the shortest counts: what else a machine does only ever adds to a time.

    Parameters
    ----------
    times
        Group, shortest time [s] and notes of each benchmark.
    unit
        Seconds of the unit, see `floor.unit`.
    """
    rows = {}
    for key, (group, least, notes) in times.items():
        rows[key] = {"group": group, "ms": _rounded(1e3 * least), "units": _rounded(least / unit)}
        if "necessary" in notes:
            rows[key]["floors"] = _rounded(least / unit / notes["necessary"])
        rows[key] |= {k: v for k, v in notes.items() if k != "necessary"}
    versions = {n: version(n) for n in ("pilotid", "numpy", "scipy", "emcee", "control")}
    return {
        "unit_us": _rounded(1e6 * unit),
        "versions": {"python": platform.python_version(), **versions},
        "platform": sys.platform,
        "times": rows,
    }


def compared(now: dict[str, Any], before: dict[str, Any]) -> list[str]:
    """What became slower or faster, a line each, in units, so that machines do not matter."""
    lines = []
    for key, row in now.items():
        if key not in before:
            continue
        factor = row["units"] / before[key]["units"]
        if factor > SLOWER or factor < 1.0 / SLOWER:
            word = "slower" if factor > 1.0 else "faster"
            lines.append(
                f"{key}: {max(factor, 1.0 / factor):.2f} times {word} "
                f"({before[key]['units']:g} units before, {row['units']:g} now)"
            )
    missing = [key for key in before if key not in now]
    lines += [f"not timed now: {', '.join(missing)}"] if missing else []
    return lines or [f"nothing became slower or faster by more than {SLOWER:g} times"]


def _rounded(value: float) -> float:
    """Four digits."""
    return float(f"{value:.4g}") if math.isfinite(value) else value
