"""What is stored of benchmarks, and what two runs of them say; see tests/benchmarks."""

from __future__ import annotations

import math
import platform
import sys
from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

#: A time counts as longer if it exceeds what was stored by this factor.
SLOWER = 1.25
#: What one time is as a multiple of another, by the benchmarks' names.
RATIOS = {
    "a user's own script / mle-white": ("what_a_user_would_write", "fit[mle-white-multi-1]"),
    "a grey box simulated by scipy / mle-white": ("grey_box", "fit[mle-white-multi-1]"),
    "a user's own script / mle": ("what_a_user_would_write", "fit[mle-multi-1]"),
    "scipy's least_squares on our residuals / ours": ("scipy_least_squares", "our_least_squares"),
    "a loop over lstsq / ARX search": ("arx_by_a_loop", "arx_search"),
    "emcee, one likelihood at a time / all walkers at once": ("emcee_one_by_one", "emcee_at_once"),
    "posterior by emcee / by importance sampling": (
        "posterior[emcee]",
        "posterior[importance]",
    ),
}


def summary_of(times: dict[str, tuple[str, float, dict[str, Any]]], unit: float) -> dict[str, Any]:
    """What is stored: times in milliseconds and in units, ratios, versions; no names of hosts.

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
    ratios = {
        what: _rounded(times[slow][1] / times[fast][1])
        for what, (slow, fast) in RATIOS.items()
        if slow in times and fast in times
    }
    versions = {n: version(n) for n in ("pilotid", "numpy", "scipy", "emcee", "control")}
    return {
        "unit_us": _rounded(1e6 * unit),
        "versions": {"python": platform.python_version(), **versions},
        "platform": sys.platform,
        "ratios": ratios,
        "exponents": exponents(rows),
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


def scaling(times: Mapping[str, Any]) -> dict[str, dict[str, list[tuple[float, float, int]]]]:
    """Value, milliseconds and samples by what is varied and by method."""
    found: dict[str, dict[str, list[tuple[float, float, int]]]] = {}
    for row in times.values():
        if "axis" in row:
            own = found.setdefault(row["axis"], {}).setdefault(row["method"], [])
            own.append((row["value"], row["ms"], row["samples"]))
    return {a: {m: sorted(rows) for m, rows in by.items()} for a, by in found.items()}


def exponents(times: Mapping[str, Any]) -> dict[str, float]:
    """How the time grows with the number of samples N, relative to N log N, at the large end.

    One is as N log N; the slope is between the two largest recordings of each axis.
    """
    result = {}
    for axis, by_method in scaling(times).items():
        for method, rows in by_method.items():
            ordered = sorted(rows, key=lambda row: row[2])
            if len(ordered) < 2:
                continue
            (_, before, fewer), (_, after, more) = ordered[-2:]
            work = math.log(more * math.log(more) / (fewer * math.log(fewer)))
            result[f"{method}, {axis}"] = float(f"{math.log(after / before) / work:.2f}")
    return result
