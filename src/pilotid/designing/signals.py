"""The forcing functions of a design: amplitudes from powers, and phases that keep peaks low.

The p-norm of the signal over a period is lowered for growing p, from the phases of Schroeder
(IEEE Trans. Information Theory 16, 1970) and from random ones (Guillaume, Schoukens, Pintelon
and Kollar, IEEE Trans. Instrumentation and Measurement 40, 1991).
"""

from __future__ import annotations

import math
from dataclasses import replace
from zlib import crc32

import numpy as np

from pilotid.datasets.forcing import Multisine
from pilotid.datasets.scenarios import Scenario
from pilotid.designing.lines import Lines, multisine
from pilotid.seeds import draw_rng
from pilotid.types import ComplexArray, FloatArray

NORMS = (4, 16, 64, 256)
STEPS = 40  # for each norm
STARTS = 4
GRID_PER_LINE = 8  # samples for a period of the highest line


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


def crest_factor(lines: FloatArray, amplitudes: FloatArray, phases: FloatArray) -> float:
    """Peak over root mean square of sum_i A_i sin(k_i w0 t + phi_i) over a period."""
    signal = _signal(_turns(lines, 64), amplitudes, phases)
    return float(np.max(np.abs(signal)) / np.sqrt(0.5 * np.sum(amplitudes**2)))


def low_crest(
    lines: FloatArray, amplitudes: FloatArray, rng: np.random.Generator, starts: int = STARTS
) -> FloatArray:
    """Phases with a low crest factor, the best of several descents, shape (lines,) [rad].

    Parameters
    ----------
    lines
        Whole multiples of the base frequency, shape (lines,).
    amplitudes
        Shape (lines,).
    rng
        For the random starts.
    starts
        Number of descents; the first begins at Schroeder's phases.
    """
    from scipy.optimize import minimize

    turns = _turns(lines, GRID_PER_LINE)
    cosines, sines = np.ascontiguousarray(turns.real), np.ascontiguousarray(turns.imag)
    size = amplitudes / np.sqrt(0.5 * np.sum(amplitudes**2))
    share = np.cumsum(np.concatenate([[0.0], 0.5 * size[:-1] ** 2]))
    schroeder = -2.0 * np.pi * np.cumsum(share)
    begins = [schroeder, *rng.uniform(-np.pi, np.pi, (starts - 1, lines.size))]

    def norm(phases: FloatArray, power: int) -> tuple[float, FloatArray]:
        along, across = size * np.cos(phases), size * np.sin(phases)
        signal = along @ sines + across @ cosines
        peak = np.max(np.abs(signal))
        scaled = signal / peak
        weight = np.abs(scaled) ** (power - 2) * scaled
        mean = float(np.mean(weight * scaled))
        slopes = (along * (cosines @ weight) - across * (sines @ weight)) / signal.size
        # ln(norm) has the same minimum, and a scale that does not depend on the power.
        return float(np.log(peak) + np.log(mean) / power), slopes / (peak * mean)

    best, least = schroeder, np.inf
    for start in begins:
        phases = start
        for power in NORMS:
            phases = minimize(
                norm, phases, (power,), "BFGS", jac=True, options={"maxiter": STEPS}
            ).x
        crest = crest_factor(lines, amplitudes, phases)
        if crest < least:
            best, least = phases, crest
    return np.asarray(np.angle(np.exp(1j * best)))


def _turns(lines: FloatArray, density: int) -> ComplexArray:
    """exp(j k w0 t) over a period, shape (lines, times)."""
    count = int(density * np.max(lines))
    return np.asarray(np.exp(2j * np.pi * np.outer(lines, np.arange(count)) / count))


def _signal(turns: ComplexArray, amplitudes: FloatArray, phases: FloatArray) -> FloatArray:
    return np.asarray(np.imag((amplitudes * np.exp(1j * phases)) @ turns))
