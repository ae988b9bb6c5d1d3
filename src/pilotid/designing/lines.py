"""Which lines the forcing functions may have."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from pilotid.datasets.experiments import experiment_of, inputs_of
from pilotid.datasets.forcing import Multisine
from pilotid.datasets.remnant import UNIT_LEVEL
from pilotid.datasets.scenarios import Scenario
from pilotid.datasets.simulation import closed_loop, remnant_ratio, white_level
from pilotid.pilot.loops import margins
from pilotid.theory.bounds import GRID, LineInformation, line_information
from pilotid.time_domain.settings import PROFILE
from pilotid.types import ComplexArray, FloatArray, InputError

Pick = Literal["any", "odd", "prime"]


@dataclass(frozen=True)
class Lines:
    """Lines of the target and of the disturbance, as multiples of 2 pi / period.

    Attributes
    ----------
    target, disturbance
        Ascending; empty for a signal that is not there.
    period
        Period of line 1 [s].
    """

    target: tuple[int, ...]
    disturbance: tuple[int, ...]
    period: float

    @property
    def omega(self) -> FloatArray:
        """Frequencies [rad/s], those of the target first, shape (lines,)."""
        both = np.array([*self.target, *self.disturbance], dtype=float)
        return np.asarray(2.0 * np.pi * both / self.period)

    @property
    def shared(self) -> bool:
        """Whether both signals have a line in common."""
        return bool(set(self.target) & set(self.disturbance))

    @property
    def signals(self) -> tuple[tuple[str, slice], ...]:
        """Name and place of each signal that is there."""
        first, count = len(self.target), len(self.target) + len(self.disturbance)
        both = ("ft", slice(0, first)), ("fd", slice(first, count))
        return tuple((name, at) for name, at in both if at.stop > at.start)


def sines_of(scenario: Scenario, name: str) -> Multisine | None:
    """The forcing function ``ft`` or ``fd`` of a scenario, if it is a multisine or none.

    Raises
    ------
    InputError
        If it is of another kind, or has no whole number of periods in the window.
    """
    forcing = scenario.target if name == "ft" else scenario.disturbance
    if forcing is None:
        return None
    if not isinstance(forcing, Multisine):
        raise InputError(
            f"scenario {scenario.name}: a design starts from sums of sines, and this one has "
            "another kind of forcing function; name nominal, for example"
        )
    periods = scenario.duration / forcing.period
    if round(periods) < 1 or abs(periods - round(periods)) > 1e-9:
        raise InputError(
            f"scenario {scenario.name}: its window of {scenario.duration:g} s is no whole number "
            f"of periods of {forcing.period:g} s; a design needs that"
        )
    return forcing


def reference_lines(scenario: Scenario) -> Lines:
    """The lines that a scenario has."""
    target, disturbance = sines_of(scenario, "ft"), sines_of(scenario, "fd")
    periods = {f.period for f in (target, disturbance) if f is not None}
    if len(periods) != 1:
        raise InputError(
            f"scenario {scenario.name}: a design needs forcing functions of one period to start "
            "from; name nominal, for example"
        )
    return Lines(
        target.lines if target else (), disturbance.lines if disturbance else (), periods.pop()
    )


def chosen_lines(
    reference: Lines,
    count: int | None = None,
    pick: Pick = "any",
    period: float | None = None,
    *,
    shared: bool = False,
) -> Lines:
    """Lines over the frequencies of the reference, evenly on a logarithmic scale.

    Parameters
    ----------
    reference
        Lines that are kept where nothing else is asked for.
    count
        Lines of each signal; None for as many as the reference has.
    pick
        ``any``, ``odd`` (a pilot's even nonlinearity then answers between the lines) or
        ``prime`` lines (no line is a harmonic of another).
    period
        Period of line 1 [s], 2 pi over the base frequency; None for the reference's.
    shared
        Whether both signals have the same lines: by themselves the target's of the reference.

    Raises
    ------
    InputError
        If there are too few such lines.
    """
    if pick not in get_args(Pick):
        raise InputError(f"lines can be {', '.join(get_args(Pick))}, not {pick}")
    shared = shared and len(reference.signals) == 2
    if count is None and pick == "any" and period is None:
        return replace(reference, disturbance=reference.target) if shared else reference
    base = period or reference.period
    signals = 1 if shared else len(reference.signals)
    each = count or max(len(reference.target), len(reference.disturbance))
    low, high = (float(f(reference.omega)) * base / (2.0 * np.pi) for f in (np.min, np.max))
    allowed = [k for k in range(1, int(np.ceil(high)) + 1) if _is(k, pick)]
    if len(allowed) < each * signals:
        raise InputError(
            f"there are {len(allowed)} {pick} lines up to {np.max(reference.omega):.3g} rad/s with "
            f"a period of {base:g} s, fewer than {each * signals}; take fewer lines or a longer "
            "period"
        )
    lines: list[int] = []
    free = list(allowed)
    for wish in np.geomspace(low, high, each * signals):
        best = min(free, key=lambda k: abs(np.log(k / wish)))
        lines.append(best)
        free.remove(best)
    lines.sort()
    if signals == 1:
        both = tuple(lines)
        return Lines(both if reference.target else (), both if reference.disturbance else (), base)
    return Lines(tuple(lines[1::2]), tuple(lines[::2]), base)


def _is(line: int, pick: Pick) -> bool:
    if pick == "odd":
        return line % 2 == 1
    if pick == "prime":
        return line > 1 and all(line % k for k in range(2, int(line**0.5) + 1))
    return True


def shares_like(reference: Lines, powers: FloatArray, lines: Lines, at: str) -> FloatArray:
    """Shares of a signal's power on other lines that follow a reference's spectrum.

    The cumulative power over the logarithm of frequency is that of the reference.

    Parameters
    ----------
    reference, powers
        The reference's lines and their powers, shape (reference's lines,).
    lines
        The lines sought.
    at
        The signal, ``ft`` or ``fd``.

    Returns
    -------
    Shares that add up to 1, shape (the signal's lines,).
    """
    there, here = dict(reference.signals)[at], dict(lines.signals)[at]
    known, wanted = reference.omega[there], lines.omega[here]
    own = powers[there] / powers[there].sum()
    if known.size == wanted.size and np.allclose(known, wanted):
        return np.asarray(own)
    cumulative = np.concatenate([[0.0], np.cumsum(own)])
    shares = np.diff(np.interp(_edges(wanted), _edges(known), cumulative))
    shares = np.maximum(shares, 1e-6)
    return np.asarray(shares / shares.sum())


def _edges(omega: FloatArray) -> FloatArray:
    """Boundaries between the bands of lines on a logarithmic scale."""
    log = np.log(omega)
    if log.size == 1:
        return np.array([log[0] - 0.5, log[0] + 0.5])
    middle = 0.5 * (log[1:] + log[:-1])
    first, last = 2.0 * log[0] - middle[0], 2.0 * log[-1] - middle[-1]
    return np.concatenate([[first], middle, [last]])


#: Error, control and their rates; output, its rate and its acceleration.
SIGNALS = ("e", "u", "de", "du", "x", "dx", "ddx")


@dataclass(frozen=True, eq=False)
class Loop:
    """One pilot in the loop, with the lines that a forcing function may have.

    Attributes
    ----------
    scenario
        The pilot, the element, the remnant, the window; its forcing functions set the
        remnant's power and are left aside otherwise.
    lines
        The lines.
    information
        What each line tells of relative parameters, with unit power.
    gains
        By signal, the variance that each line with unit power causes, shape (lines,).
    free
        By signal, the variance that the remnant causes.
    crossover
        Of the target loop [rad/s].
    control
        Variance of the control at which the remnant has the power that `information` holds for,
        where it is a share of the control's; None where the remnant is held.
    """

    scenario: Scenario
    lines: Lines
    information: LineInformation
    gains: dict[str, FloatArray]
    free: dict[str, float]
    crossover: float
    control: float | None = None

    def sharing(self, control: float) -> Loop:
        """The same with a remnant that grows with the control, to its power at this variance.

        What the remnant causes then grows with the powers too, in proportion to the control
        that they force.
        """
        forced = control - self.free["u"]
        gains = {
            name: gain + self.free[name] / forced * self.gains["u"]
            for name, gain in self.gains.items()
        }
        return replace(self, gains=gains, free=dict.fromkeys(self.free, 0.0), control=control)

    def told(self, powers: FloatArray) -> FloatArray:
        """Powers that tell as much while the remnant is held, shape (lines,).

        Where the remnant grows with the control, only ratios of powers count.
        """
        if self.control is None:
            return powers
        return np.asarray(self.control / float(self.gains["u"] @ powers) * powers)

    def variance(self, signal: str, powers: FloatArray) -> float:
        """Variance of one of `SIGNALS`, the remnant's part included."""
        return self.free[signal] + float(self.gains[signal] @ powers)

    def errors(self, powers: FloatArray) -> FloatArray:
        """Standard errors as shares of the true values, shape (parameters,)."""
        return np.asarray(np.sqrt(np.diag(self.information.covariance(self.told(powers)))))


def loop_of(scenario: Scenario, lines: Lines, band: float | None = None) -> Loop:
    """The loop of a scenario with other lines; its remnant is the one that it has.

    Raises
    ------
    InputError
        If the loop is unstable or has no remnant.
    """
    experiment = experiment_of(scenario)
    omega = lines.omega
    error, control, output = np.zeros((3, omega.size), dtype=complex)
    at_lines = closed_loop(scenario, omega)
    for name, at in lines.signals:
        cause: Literal["target", "disturbance"] = "target" if name == "ft" else "disturbance"
        error[at], output[at] = inputs_of(scenario, omega[at], cause)
        control[at] = at_lines.u[cause][at]
    grid = np.linspace(0.0, np.pi / scenario.dt, GRID + 1)
    weights = np.full(GRID + 1, 1.0 / GRID)
    weights[[0, -1]] *= 0.5
    remnant = experiment.circulation(grid)
    weights = weights * remnant.density
    answers = _powers(grid, remnant.error, closed_loop(scenario, grid).u["remnant"], remnant.output)
    return Loop(
        scenario,
        lines,
        line_information(experiment, omega, error, output, band),
        _powers(omega, error, control, output),
        {name: float(weights @ answer) for name, answer in answers.items()},
        margins(scenario.model, scenario.values, scenario.element)[0].crossover,
    )


def _powers(
    omega: FloatArray, error: ComplexArray, control: ComplexArray, output: ComplexArray
) -> dict[str, FloatArray]:
    """Squared magnitudes of all `SIGNALS` from those of e, u and x, each of shape (n,)."""
    own = {"e": np.abs(error) ** 2, "u": np.abs(control) ** 2, "x": np.abs(output) ** 2}
    return {
        name: np.asarray(omega ** (2 * name.count("d")) * own[name.lstrip("d")]) for name in SIGNALS
    }


def widening(runs: int, seconds: float) -> float:
    """Factor on variances for the recording's finite length, as in the errors of `mle`.

    Bounds hold for long recordings.
    """
    return 1.0 + PROFILE.bartlett_seconds / (runs * seconds)


def powers_of(scenario: Scenario) -> FloatArray:
    """Powers of a scenario's own lines, the target's first, shape (lines,)."""
    own = [sines_of(scenario, name) for name in ("ft", "fd")]
    return np.concatenate([0.5 * np.array(f.amplitudes) ** 2 for f in own if f is not None])


def with_held_remnant(scenario: Scenario) -> Scenario:
    """The scenario with the power of its remnant held, whatever the forcing functions become."""
    gain = white_level(scenario) / UNIT_LEVEL
    return replace(scenario, remnant=replace(scenario.remnant, level=gain, level_is="gain"))


def with_shared_remnant(scenario: Scenario) -> Scenario:
    """The scenario with a remnant that keeps its share of the control's power."""
    ratio = remnant_ratio(scenario)
    return replace(scenario, remnant=replace(scenario.remnant, level=ratio, level_is="ratio"))
