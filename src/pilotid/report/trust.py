"""What simulations of a recording say of its fit, as tables and sentences of `trust.json`."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pilotid.document import Block, Bullets, Column, Section, Table, Text
from pilotid.numbers import NONE, number, plus_minus, share
from pilotid.study.trust import TRUST


def read_trust(folder: Path) -> dict[str, Any] | None:
    """The `trust.json` of a folder; None where there is none, or none that is complete."""
    try:
        told = json.loads((folder / TRUST).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return told if isinstance(told, dict) and "parameters" in told else None


def trust_table(told: Mapping[str, Any]) -> Table[Mapping[str, Any]]:
    """Claimed and corrected intervals, bias and coverage of each parameter."""

    def known(held: float | None) -> float:
        return math.nan if held is None else held

    def between(low: float, high: float) -> str:
        return f"{number(low)} to {number(high)}" if math.isfinite(low) else NONE

    def pair(key: str) -> Callable[[Mapping[str, Any]], tuple[float, ...]]:
        return lambda p: tuple(map(known, p[key]))

    def coverage(p: Mapping[str, Any]) -> tuple[float, tuple[float, ...]]:
        return known(p["coverage"]), pair("coverage_95")(p)

    columns: list[Column[Mapping[str, Any]]] = [
        Column("parameter", lambda p: f"{p['parameter']} {p['unit']}".strip()),
        Column("value", lambda p: p["value"], number),
        Column("claimed 95 %", pair("interval_95"), between, "as the method gives it"),
        Column("corrected 95 %", pair("corrected_95"), between, "so that 95 % hold the truth here"),
        Column("length times", lambda p: (known(p["factor"]), 2), number),
        Column("bias", pair("bias"), plus_minus, "mean error on simulations, with its own error"),
        Column("bias / claim", pair("bias_claimed"), plus_minus, "in claimed standard errors"),
        Column("coverage %", coverage, share, "of the claimed intervals, with its 95 % interval"),
    ]
    caption = f"`{told['method']}` on pilots like this one, {Path(told['recording']).name}"
    return Table(caption, columns, list(told["parameters"].values()))


def advice(told: Mapping[str, Any]) -> list[str]:
    """What to do about the intervals of the fit, in sentences."""
    sound = f"The intervals of {told['method']} cover 95 % here, within Monte Carlo error."
    return told["sentences"] or [sound]


def trust_blocks(told: Mapping[str, Any]) -> list[Block]:
    """Sentences and table of one fit, without what cannot be known."""
    return [Bullets(advice(told)), trust_table(told)]


def trust_section(told: Mapping[str, Any]) -> Section:
    """The section in front of the comparison."""
    return Section("trust", "What the fit is worth", [*trust_blocks(told), Text(told["unknown"])])
