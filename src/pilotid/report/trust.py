"""What simulations of a recording say of its fit, as tables and sentences of `trust.json`."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pilotid.numbers import NONE, number, plus_minus, share
from pilotid.report.content import Block, Bullets, Column, Section, Table, Text, entries
from pilotid.study.trust import TRUST


def read_trust(folder: Path) -> dict[str, Any] | None:
    """The `trust.json` of a folder; None where there is none, or none that is complete."""
    try:
        told = json.loads((folder / TRUST).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return told if isinstance(told, dict) and "parameters" in told else None


def trust_table(told: Mapping[str, Any]) -> Table:
    """Claimed and corrected intervals, bias and coverage of each parameter."""
    columns = [
        Column("parameter", text=True),
        Column("value"),
        Column("claimed 95 %", hint="interval that the method gives for the recording"),
        Column("corrected 95 %", hint="its length multiplied so that 95 % hold the truth here"),
        Column("length times"),
        Column("bias", hint="mean error on simulations, with its Monte Carlo error"),
        Column("bias / claim", hint="in claimed standard errors"),
        Column("coverage %", hint="of the claimed intervals, with its 95 % interval"),
    ]
    return Table(
        f"`{told['method']}` on pilots like this one, {Path(told['recording']).name}",
        columns,
        entries(_row(p) for p in told["parameters"].values()),
    )


def _row(p: Mapping[str, Any]) -> list[str]:
    def known(held: float | None) -> float:
        return math.nan if held is None else held

    def between(name: str) -> str:
        low, high = map(known, p[name])
        return f"{number(low)} to {number(high)}"

    low, high = map(known, p["coverage_95"])
    return [
        f"{p['parameter']} {p['unit']}".strip(),
        number(known(p["value"])),
        between("interval_95"),
        between("corrected_95") if math.isfinite(known(p["factor"])) else NONE,
        number(known(p["factor"]), 2),
        plus_minus(*map(known, p["bias"])),
        plus_minus(*map(known, p["bias_claimed"])),
        share(known(p["coverage"]), (low, high)),
    ]


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
