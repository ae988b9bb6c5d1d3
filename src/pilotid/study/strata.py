"""Parts of a population that differ in one fact: model, element, remnant, rate, length, ..."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Mapping

import numpy as np

from pilotid.study.entries import Draw

#: Values by replication, in the order of tables and figures.
Stratum = dict[str, frozenset[int]]


def strata_of(draws: Mapping[int, Draw]) -> dict[str, Stratum]:
    """Replications of a population by the value of each fact, by the fact's name.

    Facts that vary in steps have a stratum for each value; remnant level and length are
    divided into thirds of the recordings.

    Parameters
    ----------
    draws
        What was drawn, by replication.
    """
    found = {name: _steps(draws, label) for name, label in LABELS.items()}
    found["length"] = _thirds(draws, "duration", lambda low, high: f"{low:.0f} to {high:.0f} s")
    found["level"] = _thirds(
        draws, "remnant_level", lambda low, high: f"{100 * low:.0f} to {100 * high:.0f} %"
    )
    return {name: found[name] for name in NAMES}


def _runs(draw: Draw) -> str:
    count = int(_number(draw, "runs"))
    return "1 run" if count == 1 else f"{count} runs"


def _number(draw: Draw, name: str) -> float:
    value = draw.facts.get(name)
    return float(value) if isinstance(value, int | float) else math.nan


#: What a stratum is called, for facts that vary in steps.
LABELS: dict[str, Callable[[Draw], str]] = {
    "model": lambda draw: draw.model,
    "element": lambda draw: str(draw.facts.get("element", "?")),
    "remnant": lambda draw: str(draw.facts.get("remnant", "?")),
    "forcing": lambda draw: str(draw.facts.get("forcing", "?")),
    "rate": lambda draw: f"{1.0 / _number(draw, 'dt'):.0f} Hz",
    "run-in": lambda draw: f"{_number(draw, 'run_in'):.0f} s",
    "runs": _runs,
}
#: Names of the strata, in the order of tables and figures.
NAMES = (
    *("model", "element", "remnant", "level", "rate", "length", "run-in", "runs"),
    "forcing",
)


def _steps(draws: Mapping[int, Draw], label: Callable[[Draw], str]) -> Stratum:
    labels = {replication: label(draw) for replication, draw in draws.items()}
    return {
        value: frozenset(r for r, own in labels.items() if own == value)
        for value in sorted(set(labels.values()), key=_in_order)
    }


def _in_order(label: str) -> tuple[float, str]:
    """Numbers by their size, words by the alphabet behind them."""
    first = label.split()[0]
    return (float(first), label) if first.replace(".", "").isdigit() else (math.inf, label)


def _thirds(draws: Mapping[int, Draw], name: str, label: Callable[[float, float], str]) -> Stratum:
    """Thirds of the recordings by a number, fewer where many have the same."""
    every = {replication: round(_number(draw, name), 6) for replication, draw in draws.items()}
    numbers = {replication: x for replication, x in every.items() if math.isfinite(x)}
    if not numbers:
        return {}
    edges = np.quantile(list(numbers.values()), (0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0)).tolist()
    found: Stratum = {}
    for replication, x in numbers.items():
        place = min(bisect_right(edges[1:3], x), 2)
        value = label(edges[place], edges[place + 1])
        found[value] = found.get(value, frozenset()) | {replication}
    return dict(sorted(found.items(), key=lambda item: _in_order(item[0])))
