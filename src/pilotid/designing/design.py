"""Forcing functions and recording time that give the precision wanted.

The powers of the lines are the optimum of a convex problem, see `pilotid.designing.optimum`;
phases are chosen after them, for bounds on errors do not depend on phases, and peaks do.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple
from zlib import crc32

import numpy as np

from pilotid.datasets.forcing import Multisine
from pilotid.datasets.remnant import TabulatedRemnant
from pilotid.datasets.scenarios import Scenario
from pilotid.designing.limits import Limits, linear
from pilotid.designing.lines import (
    SIGNALS,
    Lines,
    Loop,
    loop_of,
    powers_of,
    reference_lines,
    sines_of,
    widening,
    with_held_remnant,
    with_shared_remnant,
)
from pilotid.designing.optimum import Aim, Optimum, Over, gains_of, goal_of, minimise_within
from pilotid.ranges import Range, in_range
from pilotid.seeds import DEFAULT_SEED, draw_rng
from pilotid.types import ComplexArray, FloatArray, InputError

WISH = Range(1e-6, 1.0)
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
    for name, at in lines.signals:
        numbers = np.array(lines.target if name == "ft" else lines.disturbance, dtype=float)
        amplitudes = np.sqrt(2.0 * powers[at])
        phases = low_crest(numbers, amplitudes, rng)
        sines = tuple(map(int, numbers)), tuple(amplitudes.tolist()), tuple(phases.tolist())
        made[name] = Multisine(*sines, lines.period)
        old = sines_of(scenario, name)
        crest[name] = crest_of(made[name]), math.nan if old is None else crest_of(old)
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


#: Line of a table: relative standard errors by parameter.
Errors = dict[str, float]
OFF = 0.25  # share by which one parameter of `wrong_pilots` is another
#: What the remnant's power does when forcing functions change: nothing, or it keeps its share of
#: the control's.
RemnantPower = Literal["held", "share"]


@dataclass(frozen=True, eq=False)
class Design:
    """A design, and what it is expected to give.

    Attributes
    ----------
    scenario
        The experiment, ready to be simulated; its remnant has the power, or the share of the
        control's power, that it has under the reference's forcing functions.
    reference
        The scenario that the design started from.
    minimise, wanted, limits, over, remnant
        What was asked for.
    lines, powers
        Lines and the variance of each sine, the target's first, shape (lines,).
    errors, reference_errors
        Predicted standard errors as shares of the true values, with the design and with the
        reference's forcing functions in a window of the same length: bounds, and the share that
        the finite length adds to the errors of `mle`.
    errors_if_held, errors_if_scaled
        Errors of the design if the remnant has the power, or the share of the control's power,
        that it has with the reference; one of them is `errors`.
    costs
        Variances of e, u, x and their rates over those of the reference.
    rms
        Root mean squares of the same signals.
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
    remnant: RemnantPower
    lines: Lines
    powers: FloatArray
    errors: Errors
    reference_errors: Errors
    errors_if_held: Errors
    errors_if_scaled: Errors
    costs: dict[str, float]
    rms: dict[str, float]
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
    remnant: RemnantPower = "held",
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
    remnant
        Whether the remnant's power is held, or is a share of the control's: for one pilot.
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
    _require_told_apart(scenario, known, lines)
    if remnant == "share" and len(pilots) > 1:
        raise InputError(
            "a remnant that is a share of the control's power is for one pilot: leave out "
            "--pilots, or let the remnant be held"
        )
    if remnant == "share" and isinstance(scenario.remnant, TabulatedRemnant):
        raise InputError(
            f"scenario {scenario.name}: its remnant has an estimated spectrum, and can only be "
            "held; leave out --remnant share"
        )
    everyone = tuple(pilots) or (scenario,)
    loops = [loop_of(pilot, lines) for pilot in everyone]
    references = loops if lines == known else [loop_of(pilot, known) for pilot in everyone]
    own = loop_of(scenario, lines) if pilots else loops[0]
    before = loop_of(scenario, known) if pilots else references[0]
    control = before.variance("u", usual)
    grown = own.sharing(control)
    if remnant == "share":
        loops = [loop.sharing(control) for loop in loops]
        references = [loop.sharing(control) for loop in references]

    unit = np.ones(lines.omega.size)
    for name, at in lines.signals:
        unit[at] = usual[dict(known.signals)[name]].sum()
    for key, share in (wanted or {}).items():
        in_range(share, WISH, f"the standard error wanted of {key}, as a share,")
    aim = Aim(minimise, wanted or {}, over)
    goal = goal_of(aim, loops, references, usual, unit)
    rows = linear(limits, loops, references, usual, over=over)
    rows = [replace(row, gradient=row.gradient * unit) for row in rows]
    forced = loops[0].gains["u"] * unit if remnant == "share" else None
    optimum = minimise_within(goal, rows, forced, control)
    powers = np.asarray(optimum.powers * unit)

    unrounded = _window(scenario, optimum.value) if wanted else scenario.duration
    duration = scenario.duration
    if wanted:
        duration = math.ceil(unrounded / lines.period - 1e-9) * lines.period
        _require_time(wanted, unrounded, at_most, scenario, optimum)
    # Bounds fall with the root of the length.
    longer = math.sqrt(scenario.duration / duration * widening(scenario.runs, duration))

    def by_key(errors: FloatArray) -> Errors:
        return dict(zip(scenario.model.keys, (longer * errors).tolist(), strict=True))

    as_it_is = with_shared_remnant if remnant == "share" else with_held_remnant
    made, crest = with_signals(as_it_is(scenario), lines, powers, duration, seed)
    if_held, if_scaled = by_key(own.errors(powers)), by_key(grown.errors(powers))
    costing = grown if remnant == "share" else own
    return Design(
        scenario=made,
        reference=scenario,
        minimise=minimise,
        wanted=dict(wanted or {}),
        limits=limits,
        over=over,
        remnant=remnant,
        lines=lines,
        powers=powers,
        errors=if_scaled if remnant == "share" else if_held,
        reference_errors=by_key(before.errors(usual)),
        errors_if_held=if_held,
        errors_if_scaled=if_scaled,
        costs={s: costing.variance(s, powers) / before.variance(s, usual) for s in SIGNALS},
        rms={s: math.sqrt(costing.variance(s, powers)) for s in SIGNALS},
        crest=crest,
        optimum=optimum,
        gap=_gap(optimum, minimise if not wanted else ""),
        gains=gains_of(aim, loops, references, usual, powers),
        unrounded=unrounded,
        loops=loops,
        references=references,
        seed=seed,
    )


def _require_told_apart(scenario: Scenario, known: Lines, lines: Lines) -> None:
    """Refuse lines of both signals where no runs tell the two answers apart."""
    if known.shared and not scenario.alternating:
        raise InputError(
            f"scenario {scenario.name}: its ft and fd have lines in common within each run, and "
            "what they tell depends on phases; start from lines of their own"
        )
    if lines.shared and scenario.runs % 2:
        raise InputError(
            "lines that ft and fd share are told apart by runs in which fd has the other sign: "
            "that takes an even number of runs; add --runs 2"
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


class Wrong(NamedTuple):
    """A pilot with one other parameter, and what the design is worth for him.

    Attributes
    ----------
    key, share
        The parameter, and by what share it differs.
    errors
        Standard errors over those with the reference's forcing functions, by parameter; none
        where the loop is unstable.
    costs
        Variances of e and u over those with the reference's forcing functions.
    """

    key: str
    share: float
    errors: list[float]
    costs: tuple[float, float]


def wrong_pilots(made: Design) -> Iterator[Wrong]:
    """Each parameter lower and higher, the remnant as the design takes it."""
    reference = with_held_remnant(made.reference)
    keys = reference.model.keys
    usual = powers_of(reference)
    known = made.references[0].lines
    for i, key in enumerate(keys):
        for share in (-OFF, OFF):
            truth = np.array(reference.truth)
            truth[i] *= 1.0 + share
            pilot = replace(reference, truth=tuple(truth.tolist()))
            try:
                before, after = loop_of(pilot, known), loop_of(pilot, made.lines)
            except InputError:
                yield Wrong(key, share, [], (math.nan, math.nan))
                continue
            if made.remnant == "share":
                control = before.variance("u", usual)
                before, after = before.sharing(control), after.sharing(control)
            error, control = (
                after.variance(s, made.powers) / before.variance(s, usual) for s in "eu"
            )
            ratio = after.errors(made.powers) / before.errors(usual)
            yield Wrong(key, share, ratio.tolist(), (error, control))
