"""A pilot's loop, as a design sees it: what each line tells, and what it costs."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pilotid.datasets.experiments import experiment_of, inputs_of
from pilotid.datasets.remnant import UNIT_LEVEL
from pilotid.datasets.scenarios import Scenario
from pilotid.datasets.simulation import closed_loop, remnant_ratio, white_level
from pilotid.designing.lines import Lines, multisine
from pilotid.pilot.loops import margins
from pilotid.theory.bounds import GRID, LineInformation, line_information
from pilotid.time_domain.maximum_likelihood import SHORT
from pilotid.types import FloatArray

#: Error and control, and their rates.
SIGNALS = ("e", "u", "de", "du")


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
        """Variance of e, u or their rates, the remnant's part included."""
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
    error, output = np.zeros((2, omega.size), dtype=complex)
    at_lines = closed_loop(scenario, omega)
    control = np.concatenate(
        [at_lines.u["target"][lines.of_target], at_lines.u["disturbance"][lines.of_disturbance]]
    )
    for cause, at in (("target", lines.of_target), ("disturbance", lines.of_disturbance)):
        error[at], output[at] = inputs_of(scenario, omega[at], cause)
    grid = np.linspace(0.0, np.pi / scenario.dt, GRID + 1)
    weights = np.full(GRID + 1, 1.0 / GRID)
    weights[[0, -1]] *= 0.5
    remnant = experiment.circulation(grid)
    weights = weights * remnant.density
    of_error = np.abs(remnant.error) ** 2
    of_control = np.abs(closed_loop(scenario, grid).u["remnant"]) ** 2
    free = {
        "e": weights @ of_error,
        "u": weights @ of_control,
        "de": weights @ (grid**2 * of_error),
        "du": weights @ (grid**2 * of_control),
    }
    gains = {"e": np.abs(error) ** 2, "u": np.abs(control) ** 2}
    gains |= {f"d{name}": omega**2 * gain for name, gain in gains.items()}
    return Loop(
        scenario,
        lines,
        line_information(experiment, omega, error, output, band),
        {name: np.asarray(gain) for name, gain in gains.items()},
        {name: float(variance) for name, variance in free.items()},
        margins(scenario.model, scenario.values, scenario.element)[0].crossover,
    )


def widening(runs: int, seconds: float) -> float:
    """Factor on variances for the recording's finite length, as in the errors of `mle`.

    Bounds hold for long recordings.
    """
    return 1.0 + SHORT / (runs * seconds)


def powers_of(scenario: Scenario) -> FloatArray:
    """Powers of a scenario's own lines, the target's first, shape (lines,)."""
    own = [multisine(scenario, f) for f in (scenario.target, scenario.disturbance)]
    return np.concatenate([0.5 * np.array(f.amplitudes) ** 2 for f in own if f is not None])


def with_held_remnant(scenario: Scenario) -> Scenario:
    """The scenario with the power of its remnant held, whatever the forcing functions become."""
    gain = white_level(scenario) / UNIT_LEVEL
    return replace(scenario, remnant=replace(scenario.remnant, level=gain, level_is="gain"))


def with_shared_remnant(scenario: Scenario) -> Scenario:
    """The scenario with a remnant that keeps its share of the control's power."""
    ratio = remnant_ratio(scenario)
    return replace(scenario, remnant=replace(scenario.remnant, level=ratio, level_is="ratio"))
