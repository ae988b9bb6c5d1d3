"""What is stored of benchmarks; see tests/benchmarks."""

from __future__ import annotations

import math
import platform
import sys
from importlib.metadata import version
from typing import Any


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


def _rounded(value: float) -> float:
    """Four digits."""
    return float(f"{value:.4g}") if math.isfinite(value) else value
