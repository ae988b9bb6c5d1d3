"""What simulations of a recording say of its fit, as a section of the report of their study."""

from __future__ import annotations

from pilotid.numbers import NONE, number, plus_minus, share
from pilotid.report.content import Bullets, Column, Section, Table, Text, entries
from pilotid.study.trust import UNKNOWN, Trust, Trusted


def trust_table(trust: Trust) -> Table:
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
        f"`{trust.trial.label}` on pilots like this one, {trust.trial.recording}",
        columns,
        entries(_row(p) for p in trust.parameters),
    )


def _row(p: Trusted) -> list[str]:
    def between(ends: tuple[float, float]) -> str:
        return f"{number(ends[0])} to {number(ends[1])}"

    return [
        f"{p.parameter} {p.unit}".strip(),
        number(p.value),
        between(p.interval_95),
        between(p.corrected_95) if p.factor == p.factor else NONE,
        number(p.factor, 2),
        plus_minus(*p.bias),
        plus_minus(*p.bias_claimed),
        share(p.coverage, p.coverage_95),
    ]


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
