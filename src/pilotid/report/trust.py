"""What simulations of a recording say of its fit, as tables and sentences of `trust.json`."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pilotid.study.trust import TRUST
from pilotid.support.document import Block, Bullets, Section, Table, Text, table_of
from pilotid.support.numbers import NONE, number, plus_minus, share


def read_trust(folder: Path) -> dict[str, Any] | None:
    """The `trust.json` of a folder; None where there is none, or none that is complete."""
    try:
        told = json.loads((folder / TRUST).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return told if isinstance(told, dict) and "parameters" in told else None


def trust_table(told: Mapping[str, Any]) -> Table[Any]:
    """Claimed and corrected intervals, bias and coverage of each parameter."""

    def known(held: Any) -> Any:
        if isinstance(held, list):
            return tuple(map(known, held))
        return math.nan if held is None else held

    def between(low: float, high: float) -> str:
        return f"{number(low)} to {number(high)}" if math.isfinite(low) else NONE

    parameters = [
        {name: known(value) for name, value in own.items()} for own in told["parameters"].values()
    ]
    rows = [
        (
            *(f"{p['parameter']} {p['unit']}".strip(), p["value"]),
            *(p["interval_95"], p["corrected_95"], (p["factor"], 2)),
            *(p["bias"], p["bias_claimed"], (p["coverage"], p["coverage_95"])),
        )
        for p in parameters
    ]
    heads = [
        *(("parameter",), ("value", number)),
        ("claimed 95 %", between, "as the method gives it"),
        ("corrected 95 %", between, "so that 95 % hold the truth here"),
        ("length times", number),
        ("bias", plus_minus, "mean error on simulations, with its own error"),
        ("bias / claim", plus_minus, "in claimed standard errors"),
        ("coverage %", share, "of the claimed intervals, with its 95 % interval"),
    ]
    return table_of(f"`{told['method']}` on pilots like this one, {Path(told['recording']).name}",
                    heads, rows)  # fmt: skip


def advice(told: Mapping[str, Any]) -> list[str]:
    """What to do about the intervals of the fit, in sentences."""
    sound = f"The intervals of {told['method']} cover 95 % here, within Monte Carlo error."
    return told["sentences"] or [sound]


def trust_section(told: Mapping[str, Any]) -> Section:
    """The section in front of the comparison."""
    blocks: list[Block] = [Bullets(advice(told)), trust_table(told), Text(told["unknown"])]
    return Section("trust", "What the fit is worth", blocks)
