"""Forcing functions that give the precision wanted, within limits on error and control.

The lines are those of a reference, and so is the remnant's power.  Their powers are the optimum of
a smooth convex problem with linear limits, which has one optimum; phases are chosen after them, for
bounds on errors do not depend on phases, and peaks do.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from zlib import crc32

import numpy as np

from pilotid.datasets.bounds import View, line_information
from pilotid.datasets.experiments import experiment_of, inputs_of
from pilotid.datasets.named import designed_scenario, scenario_json
from pilotid.datasets.scenarios import Scenario
from pilotid.datasets.signals import UNIT_LEVEL, Multisine, samples_of
from pilotid.datasets.simulation import closed_loop, simulate, white_level
from pilotid.likelihood.optimum import BARTLETT_SECONDS
from pilotid.recording.spectra import forcing_sines
from pilotid.support.disk import strict_json, table_bytes, write_file
from pilotid.support.numbers import DEFAULT_SEED, draw_rng
from pilotid.support.types import ComplexArray, FloatArray, InputError

if TYPE_CHECKING:
    from scipy.optimize import LinearConstraint

#: Largest share of a signal's power at a line, or the reference's share where that is more, and
#: the least, of the reference's share: without them few lines have all the power, whose crest
#: factor is high and which a pilot foresees.
LARGEST_SHARE, LEAST_SHARE = 0.14, 0.7
FADE = 2.0  # s
DRAWS = 5000  # of phases, of which that with the lowest crest factor is taken
SAMPLES = 16  # for a period of the highest line, while phases are sought
#: Of the logarithm of the mean variance: where the search for powers ends, and its longest way.
TOLERANCE, ITERATIONS = 1e-11, 500
ROUNDING = 1e-6  # by how much rounding may exceed a limit
REFERENCE = {"e": 1.0, "u": 1.0}


class Design(NamedTuple):
    """A design, and what it is expected to give.

    Attributes
    ----------
    scenario, reference
        The experiment, ready to be simulated, and the scenario that it started from.
    minimise, limits
        What was asked for.
    errors
        Predicted standard errors as shares of the true values: ``errors`` of the design,
        ``reference_errors`` of the reference's forcing functions, and of the design in ``twice``
        the time and in ``five_runs``.  They are bounds, and the share that the finite length adds
        to the errors of `mle`.
    costs
        Variances of e and u over those of the reference.
    crest
        Crest factors of ft and fd, and those of the reference.
    binding
        The limits that are reached.
    """

    scenario: Scenario
    reference: Scenario
    minimise: str
    limits: Mapping[str, float]
    errors: dict[str, dict[str, float]]
    costs: dict[str, float]
    crest: dict[str, tuple[float, float]]
    binding: tuple[str, ...]


def design(
    scenario: Scenario, minimise: str = "A", limits: Mapping[str, float] = REFERENCE
) -> Design:
    """The best forcing functions within limits.

    Neither signal has more power than the reference's, the ratio of both powers is kept, and no
    share of the power above any frequency is larger than the reference's.

    Parameters
    ----------
    scenario
        Pilot, controlled element, remnant, window and runs; its forcing functions are the
        reference, and set the power of the remnant.
    minimise
        ``A`` (mean relative variance), ``D`` (volume), or parameters as in ``Kvis,tlead``.
    limits
        Largest variances of ``e`` and ``u`` over those of the reference.

    Raises
    ------
    InputError
        If limits exclude one another, or the scenario's forcing functions are no sums of sines.
    """
    from scipy.optimize import LinearConstraint

    keys, signals = scenario.model.keys, sines_of(scenario)
    usual = np.concatenate([0.5 * np.array(sines.amplitudes) ** 2 for sines in signals.values()])
    (base, by_line), gains, free = _loop(scenario, signals, usual)
    for name, times in limits.items():
        if name not in gains:
            raise InputError(f"there is no limit on {name}: give e, u or both")
        if not free[name] < times < math.inf:
            raise InputError(
                f"{name}={times:g} cannot be kept: the remnant alone makes {free[name]:.2f}"
            )
    named = list(keys) if minimise in ("A", "D") else [k.strip() for k in minimise.split(",")]
    if unknown := [key for key in named if key not in keys]:
        raise InputError(f"no parameter is '{unknown[0]}': give A, D or of {', '.join(keys)}")
    wholes, shapes = _spectra(signals, usual)
    names = [f"{name}={times:g}" for name, times in limits.items()]
    names += [f"power of {name}" for name in signals]
    left = np.array([*(gains[name] for name in limits), *wholes, *shapes])
    room = [times - free[name] for name, times in limits.items()]
    right = np.array([*room, *np.ones(len(wholes)), *np.zeros(len(shapes))])
    unit = float(np.mean(usual))
    kept = [LinearConstraint(left * unit, -np.inf, right)]
    if len(wholes) > 1:
        kept.append(LinearConstraint(unit * (wholes[:1] - wholes[1:]), 0.0, 0.0))
    weights = np.array([named.count(key) / len(named) for key in keys])
    weights /= float(weights @ np.diag(covariance_with(usual, base, by_line)))
    powers = unit * least(base, unit * by_line, None if minimise == "D" else weights, kept)
    used = left[: len(names)] @ powers / right[: len(names)]
    powers /= max(1.0, float(np.max(used)))  # rounding may leave it just outside
    made = _with_phases(scenario, signals, powers)

    def errors(
        lines: FloatArray, times: float = 1.0, runs: int = scenario.runs
    ) -> dict[str, float]:
        """Bounds fall with the root of the time; those of a short recording are too small."""
        short = 1.0 + BARTLETT_SECONDS / (runs * times * scenario.duration)
        variances = np.diag(covariance_with(lines, base, by_line)) * scenario.runs / (runs * times)
        return dict(zip(keys, np.sqrt(short * variances).tolist(), strict=True))

    crests = zip(signals, map(crest_of, sines_of(made).values()), signals.values(), strict=True)
    return Design(
        scenario=made,
        reference=scenario,
        minimise=minimise,
        limits=limits,
        errors={
            "errors": errors(powers),
            "reference_errors": errors(usual),
            "twice": errors(powers, times=2.0),
            "five_runs": errors(powers, runs=5),
        },
        costs={name: free[name] + float(gains[name] @ powers) for name in gains},
        crest={name: (crest, crest_of(reference)) for name, crest, reference in crests},
        binding=tuple(n for n, share in zip(names, used, strict=True) if share > 0.999),
    )


def sines_of(scenario: Scenario) -> dict[str, Multisine]:
    """The forcing functions by name, ft first.

    Raises
    ------
    InputError
        If they are not sums of sines with whole periods in the window and lines of their own.
    """
    given = {"ft": scenario.target, "fd": scenario.disturbance}
    signals = {name: f for name, f in given.items() if isinstance(f, Multisine)}
    periods = {sines.period for sines in signals.values()}
    lines = [line for sines in signals.values() for line in sines.lines]
    whole = len(periods) == 1 and round(cycles := scenario.duration / min(periods)) >= 1
    if not whole or abs(cycles - round(cycles)) > 1e-9 or len(set(lines)) < len(lines):
        raise InputError(
            f"scenario {scenario.name}: a design starts from sums of sines of one period, with "
            "whole periods in the window and no line in both; name nominal, for example"
        )
    return signals


# --------------------------------------------------------------------------------- powers


def covariance_with(powers: FloatArray, base: FloatArray, by_line: FloatArray) -> FloatArray:
    """Covariance of relative errors with lines of these powers, see `line_information`."""
    return np.asarray(np.linalg.inv(base + np.tensordot(powers, by_line, 1)), dtype=float)


def least(
    base: FloatArray,
    by_line: FloatArray,
    weights: FloatArray | None,
    limits: Sequence[LinearConstraint],
) -> FloatArray:
    """The powers, not below zero, that minimise variances within limits, shape (lines,).

    Parameters
    ----------
    base, by_line
        Information without lines, (parameters, parameters), and of each line with unit power,
        (lines, parameters, parameters).
    weights
        Of the parameters' variances, shape (parameters,); None for the volume.
    limits
        Linear limits on the powers; equalities apart from inequalities.

    Raises
    ------
    InputError
        If no powers keep the limits.
    """
    from scipy.optimize import minimize

    def cost(powers: FloatArray) -> tuple[float, FloatArray]:
        """Logarithm of the mean variance, or of the volume for one parameter, and its slopes."""
        covariance = covariance_with(powers, base, by_line)
        if weights is None:
            value, slopes = np.linalg.slogdet(covariance)[1] / len(base), covariance / len(base)
        else:
            mean = float(weights @ np.diag(covariance))
            value, slopes = math.log(mean), (covariance * weights) @ covariance / mean
        return float(value), -np.tensordot(by_line, slopes, 2)

    start, bounds = np.full(len(by_line), 0.5), [(0.0, None)] * len(by_line)
    how: Any = {"method": "SLSQP", "options": {"maxiter": ITERATIONS, "ftol": TOLERANCE}}
    end = minimize(cost, start, jac=True, bounds=bounds, constraints=limits, **how)
    outside = max(-np.min(limit.residual(end.x)) for limit in limits)
    if not (outside < ROUNDING and math.isfinite(end.fun)):
        raise InputError(f"no powers of the lines keep these limits ({end.message}); widen them")
    return np.asarray(np.maximum(end.x, 0.0))


# ------------------------------------------------------------------------ errors and limits


def _loop(
    scenario: Scenario, signals: dict[str, Multisine], usual: FloatArray
) -> tuple[tuple[FloatArray, FloatArray], dict[str, FloatArray], dict[str, float]]:
    """What the remnant and lines tell, see `line_information`, and what both add to e and u.

    Variances, by lines of unit power and by the remnant, are over those of the reference, whose
    lines have the powers `usual`.
    """
    experiment, parts = experiment_of(scenario), []
    for name, sines in signals.items():
        cause = "target" if name == "ft" else "disturbance"
        control = closed_loop(scenario, sines.omega).u[cause]
        parts.append((*inputs_of(scenario, sines.omega, cause), control))
    omega, e, x, u = map(np.concatenate, zip(*parts, strict=True))
    view, gains, free = View(experiment, None), {}, {}
    weights = view.weights * view.circulation.density
    noise = closed_loop(scenario, view.omega).u["remnant"]
    for name, lines, noisy in (("e", e, view.circulation.error), ("u", u, noise)):
        by_lines, alone = np.abs(lines) ** 2, float(weights @ np.abs(noisy) ** 2)
        whole = alone + float(by_lines @ usual)
        gains[name], free[name] = by_lines / whole, alone / whole
    return line_information(experiment, (omega, e, x)), gains, free


def _ends(signals: dict[str, Multisine]) -> list[int]:
    """Where the lines of the second signal and later ones begin, among those of all."""
    return [int(end) for end in np.cumsum([len(sines.lines) for sines in signals.values()])[:-1]]


def _spectra(
    signals: dict[str, Multisine], usual: FloatArray
) -> tuple[FloatArray, list[FloatArray]]:
    """The power of each signal over the reference's, and rows that are not to be above zero."""
    wholes, shapes = [], []
    for part in np.split(np.eye(usual.size), _ends(signals)):
        weights = part / float((part @ usual).sum())
        whole, shares = weights.sum(axis=0), weights @ usual
        wholes.append(whole)
        for number, (line, share) in enumerate(zip(weights, shares, strict=True)):
            shapes += [line - max(LARGEST_SHARE, share) * whole, LEAST_SHARE * share * whole - line]
            # A hair of room: the reference itself is on all of these limits at once.
            shapes.append(weights[number:].sum(axis=0) - (shares[number:].sum() + 1e-6) * whole)
    return np.array(wholes), shapes


# ---------------------------------------------------------------------------------- phases


def _with_phases(scenario: Scenario, signals: dict[str, Multisine], powers: FloatArray) -> Scenario:
    """The scenario with the powers of a design, phases of low crest, and its remnant's power."""
    rng, made = draw_rng(DEFAULT_SEED, "phases"), {}
    parts = np.split(np.sqrt(2.0 * powers), _ends(signals))
    for (name, sines), amplitudes in zip(signals.items(), parts, strict=True):
        made[name] = low_crest(replace(sines, amplitudes=tuple(amplitudes.tolist())), rng)
    digest = crc32(repr(made).encode() + repr(scenario).encode())
    gain = white_level(scenario) / UNIT_LEVEL
    return replace(
        scenario,
        name=f"design-{scenario.name}-{digest:08x}",
        description=f"forcing functions designed for {scenario.name}",
        target=made.get("ft"),
        disturbance=made.get("fd"),
        remnant=replace(scenario.remnant, level=gain, level_is="gain"),
    )


def crest_of(sines: Multisine) -> float:
    """Crest factor, the peak over the root mean square, of a sum of sines."""
    amplitudes, phases = np.array(sines.amplitudes), np.array(sines.phases)
    phasors = amplitudes * np.exp(1j * phases)
    signal = np.imag(phasors @ _turns(np.array(sines.lines), 4 * SAMPLES))
    return float(np.max(np.abs(signal)) / np.sqrt(0.5 * np.sum(amplitudes**2)))


def low_crest(sines: Multisine, rng: np.random.Generator) -> Multisine:
    """The same lines and amplitudes with the phases of lowest crest among many draws."""
    turns, amplitudes = _turns(np.array(sines.lines), SAMPLES), np.array(sines.amplitudes)
    draws = rng.uniform(-np.pi, np.pi, (DRAWS, amplitudes.size))
    peaks = [np.max(np.abs(np.imag((amplitudes * np.exp(1j * p)) @ turns))) for p in draws]
    return replace(sines, phases=tuple(draws[int(np.argmin(peaks))].tolist()))


def _turns(lines: FloatArray, density: int) -> ComplexArray:
    """exp(j k w0 t) over a period, shape (lines, times)."""
    count = int(density * np.max(lines))
    return np.asarray(np.exp(2j * np.pi * np.outer(lines, np.arange(count)) / count))


def scenario_of_fit(path: Path, scenario: Scenario | None = None) -> Scenario:
    """The scenario in the JSON of ``pilotid fit --json``: pilot, loop, window, forcing functions.

    Parameters
    ----------
    path
        The file.
    scenario
        Where forcing functions and window are from; None for the recording's.

    Raises
    ------
    InputError
        If the file does not hold one recording with an estimate that can be simulated.
    """
    fitted = designed_scenario(path)
    if scenario is None:
        return replace(fitted, **_repeated(fitted))
    settings = {name: getattr(fitted, name) for name in ("model", "truth", "element", "remnant")}
    return replace(scenario, **settings, name=f"{scenario.name}-{fitted.name}"[:60])


def _repeated(scenario: Scenario) -> dict[str, Any]:
    """Forcing functions that repeat in the window alone, by their fields of the scenario.

    How a recording began before its window makes no difference to a design.
    """
    from pydantic import TypeAdapter

    fields = {"ft": "target", "fd": "disturbance"}
    sines = forcing_sines(simulate(scenario, draw_rng(DEFAULT_SEED, scenario.name)))
    return {
        fields[name]: TypeAdapter(Multisine).validate_python(about)
        for name, about in sines.items()
        if getattr(scenario, fields[name]).period > scenario.duration
    }


# ----------------------------------------------------------------------------------- files


def write_files(folder: Path, made: Design, about: dict[str, Any]) -> None:
    """Write design.json and forcing.csv.

    The measurement window begins at t = 0.  Before it the signals run on from the run-in's
    beginning, where they are faded in; after it they are faded out.
    """
    scenario = made.scenario
    signals = {
        name: {**asdict(sines), "omega": sines.omega.tolist(), "crest_factor": made.crest[name][0]}
        for name, sines in sines_of(scenario).items()
    }
    content = {
        **about,
        "objective": {"minimise": made.minimise, "limits": made.limits},
        "reference": made.reference.name,
        "binding": made.binding,
        **made.errors,
        "costs": made.costs,
        "signals": signals,
        "scenario": scenario_json(scenario),
    }
    write_file(folder / "design.json", strict_json(content).encode())
    time: FloatArray = scenario.dt * np.arange(
        -round(max(scenario.run_in, FADE) / scenario.dt),
        round((scenario.duration + FADE) / scenario.dt) + 1,
        dtype=float,
    )
    near = np.clip(np.minimum(time - time[0], time[-1] - time) / FADE, 0.0, 1.0)
    fade = 0.5 - 0.5 * np.cos(np.pi * near)
    both = [fade * samples_of(f, time) for f in (scenario.target, scenario.disturbance)]
    rows = [[f"{value + 0.0:.9g}" for value in row] for row in np.column_stack([time, *both])]
    write_file(folder / "forcing.csv", table_bytes(("t", "ft", "fd"), rows))
