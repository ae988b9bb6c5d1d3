"""What simulations of a recording say of its fit, as a section of the report of their study."""

from __future__ import annotations

import math

from pilotid.document import Bullets, Column, Section, Table, Text
from pilotid.numbers import number, plus_minus, share
from pilotid.study.trust import UNKNOWN, Trust, Trusted


def trust_table(trust: Trust) -> Table[Trusted]:
    """Claimed and corrected intervals, bias and coverage of each parameter."""

    def between(low: float, high: float) -> str:
        return f"{number(low)} to {number(high)}"

    columns: list[Column[Trusted]] = [
        Column("parameter", lambda p: f"{p.parameter} {p.unit}".strip()),
        Column("value", lambda p: p.value, number),
        Column(
            "claimed 95 %",
            lambda p: p.interval_95,
            between,
            "interval that the method gives for the recording",
        ),
        Column(
            "corrected 95 %",
            lambda p: None if math.isnan(p.factor) else p.corrected_95,
            between,
            "its length multiplied so that 95 % hold the truth here",
        ),
        Column("length times", lambda p: (p.factor, 2), number),
        Column(
            "bias",
            lambda p: p.bias,
            plus_minus,
            "mean error on simulations, with its Monte Carlo error",
        ),
        Column("bias / claim", lambda p: p.bias_claimed, plus_minus, "in claimed standard errors"),
        Column(
            "coverage %",
            lambda p: (p.coverage, p.coverage_95),
            share,
            "of the claimed intervals, with its 95 % interval",
        ),
    ]
    caption = f"`{trust.trial.label}` on pilots like this one, {trust.trial.recording}"
    return Table(caption, columns, trust.parameters)


def advice(trust: Trust) -> list[str]:
    """What to do about the intervals of the fit, in sentences."""
    sound = f"The intervals of {trust.trial.label} cover 95 % here, within Monte Carlo error."
    return trust.sentences or [sound]


def trust_section(trust: Trust) -> Section:
    """The section in front of the comparison."""
    return Section(
        "trust",
        "What the fit is worth",
        [Bullets(advice(trust)), trust_table(trust), Text(UNKNOWN)],
    )
