"""The forcing functions of a design: powers become amplitudes, and phases are chosen."""

from __future__ import annotations

import math
from dataclasses import replace
from zlib import crc32

import numpy as np

from pilotid.datasets.forcing import Multisine
from pilotid.datasets.scenarios import Scenario
from pilotid.designing.lines import Lines, multisine
from pilotid.designing.phases import crest_factor, low_crest
from pilotid.seeds import draw_rng
from pilotid.types import FloatArray


def with_signals(
    scenario: Scenario, lines: Lines, powers: FloatArray, duration: float, seed: int
) -> tuple[Scenario, dict[str, tuple[float, float]]]:
    """The scenario with the forcing functions of a design, and crest factors.

    Parameters
    ----------
    scenario
        The reference, with the remnant that the design is to have.
    lines, powers
        The lines, and the variance of each sine, the target's first.
    duration
        Length of the window [s].
    seed
        Of the phases' random starts.

    Returns
    -------
    The scenario, and by signal its crest factor and that of the reference.
    """
    rng = draw_rng(seed, "phases")
    made: dict[str, Multisine] = {}
    crest: dict[str, tuple[float, float]] = {}
    usual = {"ft": scenario.target, "fd": scenario.disturbance}
    for name, at in lines.signals:
        numbers = np.array(lines.target if name == "ft" else lines.disturbance, dtype=float)
        amplitudes = np.sqrt(2.0 * powers[at])
        phases = low_crest(numbers, amplitudes, rng)
        made[name] = Multisine(
            tuple(int(n) for n in numbers),
            tuple(amplitudes.tolist()),
            tuple(phases.tolist()),
            lines.period,
        )
        old = multisine(scenario, usual[name])
        before = math.nan if old is None else crest_of(old)
        crest[name] = crest_factor(numbers, amplitudes, phases), before
    digest = crc32(repr(made).encode() + repr(scenario).encode())
    return replace(
        scenario,
        name=f"design-{scenario.name}-{digest:08x}",
        description=f"forcing functions designed for {scenario.name}",
        target=made.get("ft"),
        disturbance=made.get("fd"),
        duration=duration,
        alternating=lines.shared,
        family="",
        varied="",
    ), crest


def crest_of(forcing: Multisine) -> float:
    """Crest factor of a sum of sines."""
    numbers = np.array(forcing.lines, dtype=float)
    return crest_factor(numbers, np.array(forcing.amplitudes), np.array(forcing.phases))
