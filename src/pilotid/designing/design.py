"""Forcing functions and recording time that give the precision wanted.

The powers of the lines are the optimum of a convex problem, see `pilotid.designing.solver`;
phases are chosen after them, for bounds on errors do not depend on phases, and peaks do.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from zlib import crc32

import numpy as np

from pilotid.datasets.forcing import Multisine
from pilotid.datasets.scenarios import Scenario
from pilotid.designing.limits import Limits, linear
from pilotid.designing.lines import Lines, multisine, reference_lines
from pilotid.designing.loop import (
    SIGNALS,
    Loop,
    loop_of,
    powers_of,
    widening,
    with_held_remnant,
)
from pilotid.designing.objectives import Over, gains_of, goal_of
from pilotid.designing.phases import crest_factor, low_crest
from pilotid.designing.solver import Optimum, minimised
from pilotid.seeds import DEFAULT_SEED, draw_rng
from pilotid.types import FloatArray, InputError

#: Line of a table: relative standard errors by parameter.
Errors = dict[str, float]


@dataclass(frozen=True, eq=False)
class Design:
    """A design, and what it is expected to give.

    Attributes
    ----------
    scenario
        The experiment, ready to be simulated, its remnant held at the power that it has under
        the reference's forcing functions.
    reference
        The scenario that the design started from.
    minimise, wanted, limits, over
        What was asked for.
    lines, powers
        Lines and the variance of each sine, the target's first.
    errors, reference_errors
        Predicted standard errors as shares of the true values, with the design and with the
        reference's forcing functions in a window of the same length: bounds, and the share that
        the finite length adds to the errors of `mle`.
    errors_if_scaled
        The same if the remnant's power is a share of the control's, as large as with the
        reference.
    costs
        Variance of e, u and their rates over that of the reference.
    crest
        Crest factors of ft and fd, and those of the reference.
    optimum
        The answer of the solver, in its units.
    gap
        By how much, at the most, another design within the limits is better, as a share of the
        variance that is minimised.
    gains
        For each pilot of a robust design, the objective over that of the reference.
    unrounded
        For wishes, the shortest window [s]; that of `scenario` is whole periods.
    loops, references
        The loops of the pilots, with the lines of the design and those of the reference.
    seed
        Of the phases' random starts, and of pilots.
    """

    scenario: Scenario
    reference: Scenario
    minimise: str
    wanted: Mapping[str, float]
    limits: Limits
    over: Over
    lines: Lines
    powers: FloatArray
    errors: Errors
    reference_errors: Errors
    errors_if_scaled: Errors
    costs: dict[str, float]
    crest: dict[str, tuple[float, float]]
    optimum: Optimum
    gap: float
    gains: tuple[float, ...]
    unrounded: float
    loops: Sequence[Loop] = field(repr=False)
    references: Sequence[Loop] = field(repr=False)
    seed: int = DEFAULT_SEED

    @property
    def better(self) -> int:
        """For how many pilots the design is better than the reference, by more than 0.1 %."""
        return sum(gain < 0.999 for gain in self.gains)

    @property
    def binding(self) -> tuple[str, ...]:
        """Names of the limits that keep the design from being better, dearest first."""
        return tuple(name for name, _ in self.optimum.prices)


def design(
    scenario: Scenario,
    minimise: str = "A",
    *,
    wanted: Mapping[str, float] | None = None,
    limits: Limits | None = None,
    lines: Lines | None = None,
    pilots: Sequence[Scenario] = (),
    over: Over = "mean",
    at_most: float | None = None,
    seed: int = DEFAULT_SEED,
) -> Design:
    """The best forcing functions within limits.

    Parameters
    ----------
    scenario
        Pilot, controlled element, remnant, window and runs; its forcing functions are the
        reference, and set the power of the remnant.
    minimise
        ``A`` (mean relative variance), ``D`` (volume), ``E`` (longest axis), or parameters as
        in ``Kvis,tlead``.
    wanted
        Relative standard errors by parameter, such as ``{"tdvest": 0.03}``: the shortest time
        is sought instead.
    limits
        What is to be kept.
    lines
        The lines; None for the reference's.
    pilots
        Scenarios like `scenario` of the pilots that the design is to suit; none for the
        scenario's own.
    over
        Whether the mean over pilots counts, or the worst of them, each over its value with the
        reference.
    at_most
        Longest window [s] of a design by `wanted`.
    seed
        Seed of random phases.

    Raises
    ------
    InputError
        If limits exclude one another, or wishes take longer than `at_most`; the sentence says
        which limit binds.
    """
    limits = limits or Limits()
    known = reference_lines(scenario)
    lines = lines or known
    usual = powers_of(scenario)
    periods = scenario.duration / lines.period
    if abs(periods - round(periods)) > 1e-9 or round(periods) < 1:
        raise InputError(
            f"a window of {scenario.duration:g} s is no whole number of periods of "
            f"{lines.period:g} s; choose another --period or --seconds"
        )
    everyone = tuple(pilots) or (scenario,)
    loops = [loop_of(pilot, lines) for pilot in everyone]
    references = loops if lines == known else [loop_of(pilot, known) for pilot in everyone]

    unit = np.ones(lines.omega.size)
    for name, at in lines.signals:
        unit[at] = usual[dict(known.signals)[name]].sum()
    goal = goal_of(minimise, wanted or {}, loops, references, usual, unit, over)
    rows = linear(limits, loops, references, usual, over=over)
    optimum = minimised(goal, [replace(row, gradient=row.gradient * unit) for row in rows])
    powers = np.asarray(optimum.powers * unit)

    unrounded = _window(scenario, optimum.value) if wanted else scenario.duration
    duration = scenario.duration
    if wanted:
        duration = math.ceil(unrounded / lines.period - 1e-9) * lines.period
        _require_time(wanted, unrounded, at_most, scenario, optimum)
    # Bounds fall with the root of the length.
    longer = math.sqrt(scenario.duration / duration * widening(scenario.runs, duration))
    own = loop_of(scenario, lines) if pilots else loops[0]
    before = loop_of(scenario, known) if pilots else references[0]
    forced = float(before.gains["u"] @ usual)
    scaled = own.information.scaled_to_control(powers, own.gains["u"], forced)

    def by_key(errors: FloatArray) -> Errors:
        return dict(zip(scenario.model.keys, (longer * errors).tolist(), strict=True))

    made, crest = _scenario(scenario, lines, powers, duration, seed)
    return Design(
        scenario=made,
        reference=scenario,
        minimise=minimise,
        wanted=dict(wanted or {}),
        limits=limits,
        over=over,
        lines=lines,
        powers=powers,
        errors=by_key(own.errors(powers)),
        reference_errors=by_key(before.errors(usual)),
        errors_if_scaled=by_key(np.sqrt(np.diag(scaled))),
        costs={s: own.variance(s, powers) / before.variance(s, usual) for s in SIGNALS},
        crest=crest,
        optimum=optimum,
        gap=_gap(optimum, minimise if not wanted else ""),
        gains=gains_of(minimise, wanted or {}, loops, references, usual, powers),
        unrounded=unrounded,
        loops=loops,
        references=references,
        seed=seed,
    )


def _gap(optimum: Optimum, minimise: str) -> float:
    """How much less the variance could be at the most, as a share of it."""
    if minimise == "D":  # a mean of logarithms
        return math.expm1(optimum.value - optimum.lower)
    return (optimum.value - optimum.lower) / optimum.lower


def _window(scenario: Scenario, excess: float) -> float:
    """The window in which a variance that is too large by a factor is as wished for [s]."""
    long = excess * scenario.duration  # but for the price of a finite length
    short = widening(scenario.runs, 1.0) - 1.0
    return 0.5 * (long + math.sqrt(long * long + 4.0 * long * short))


def _require_time(
    wanted: Mapping[str, float],
    needed: float,
    at_most: float | None,
    scenario: Scenario,
    optimum: Optimum,
) -> None:
    if at_most is None or needed <= at_most:
        return
    wish = ", ".join(f"{key} to {100.0 * share:g} %" for key, share in wanted.items())
    binding = [n for n, _ in optimum.prices]
    what = f"the limit that binds most is {binding[0]}" if binding else "no limit binds"
    runs = f" in each of {scenario.runs} runs" if scenario.runs > 1 else ""
    raise InputError(f"{wish} takes {needed:.0f} s{runs}, more than {at_most:g} s; {what}")


def _scenario(
    scenario: Scenario, lines: Lines, powers: FloatArray, duration: float, seed: int
) -> tuple[Scenario, dict[str, tuple[float, float]]]:
    """The scenario with the forcing functions of a design, and their crest factors."""
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
    held = with_held_remnant(scenario)
    return replace(
        held,
        name=f"design-{scenario.name}-{digest:08x}",
        description=f"forcing functions designed for {scenario.name}",
        target=made.get("ft"),
        disturbance=made.get("fd"),
        duration=duration,
        family="",
        varied="",
    ), crest


def crest_of(forcing: Multisine) -> float:
    """Crest factor of a sum of sines."""
    numbers = np.array(forcing.lines, dtype=float)
    return crest_factor(numbers, np.array(forcing.amplitudes), np.array(forcing.phases))
