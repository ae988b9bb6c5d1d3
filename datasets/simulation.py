"""Exact simulation of the closed loop of pilot and controlled element.

Everything passes through closed-loop frequency responses with true delays: the
forcing functions line by line, the remnant on a grid so long that it is not
periodic in the recording.  There is no integration step and no Pade approximant.
Only what is not linear, or not constant, is stepped through time, see
`pilotid.datasets.stepping`.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from pilotid.datasets.recorder import FASTER
from pilotid.datasets.scenarios import Scenario
from pilotid.datasets.signals import UNIT_LEVEL, Forcing, Multisine, TabulatedRemnant, samples_of
from pilotid.datasets.stepping import stepped
from pilotid.model.factors import Neuromuscular
from pilotid.model.loops import is_stable, pilot_on
from pilotid.recording.recording import Recording
from pilotid.support.types import ComplexArray, FloatArray, InputError


class ClosedLoop(NamedTuple):
    """Responses to each cause: ``target``, ``disturbance`` and ``remnant``.

    Attributes
    ----------
    u, x
        Control and output for each unit of a cause, shape (n,).
    """

    u: dict[str, ComplexArray]
    x: dict[str, ComplexArray]


def closed_loop(scenario: Scenario, omega: FloatArray) -> ClosedLoop:
    """Closed-loop frequency responses of a scenario at `omega` [rad/s].

    Written with the controlled element's polynomials Hc = N/D, which keeps it exact
    at w = 0 for an element with integrators.

    Parameters
    ----------
    scenario
        Pilot and controlled element.
    omega
        Frequencies [rad/s], shape (n,).
    """
    s = 1j * omega
    element = scenario.element
    on_error, on_output = pilot_on(scenario.model, omega, scenario.values)
    top = np.polyval(element.numerator, s) * np.exp(-element.delay * s)
    bottom = np.polyval(element.denominator, s)
    both = on_error + on_output
    characteristic = bottom + top * both
    by_output = {"target": top * on_error, "disturbance": top, "remnant": top}
    by_control = {"target": bottom * on_error, "disturbance": -top * both, "remnant": bottom}
    return ClosedLoop(
        {cause: response / characteristic for cause, response in by_control.items()},
        {cause: response / characteristic for cause, response in by_output.items()},
    )


def remnant_shaping(scenario: Scenario, omega: FloatArray) -> ComplexArray:
    """What makes the remnant at the control of white noise, shape (n,)."""
    shaping = scenario.remnant.filter(omega)
    if scenario.remnant.enters == "control":
        return shaping
    values = dict(zip(scenario.model.keys, scenario.values, strict=True))
    for factor in (f for channel in scenario.model.channels for f in channel.factors):
        if isinstance(factor, Neuromuscular):
            given = [np.array([values[p.key]]) for p in factor.parameters]
            return shaping * np.asarray(factor.response(np.asarray(1j * omega, complex), given))
    raise InputError(
        f"scenario {scenario.name}: the remnant cannot enter before the neuromuscular system, "
        f"since model {scenario.model.name} has none"
    )


class _Prepared(NamedTuple):
    """What all recordings of a scenario share."""

    time: FloatArray
    run_in: int
    grid: int  # samples of the remnant's period
    u_forced: FloatArray
    x_forced: FloatArray
    remnant_to_n: ComplexArray
    remnant_to_u: ComplexArray  # its power, averaged over what a scenario that changes is
    loop: ClosedLoop
    level: float


@lru_cache(maxsize=64)
def _prepared(scenario: Scenario) -> _Prepared:
    from scipy.fft import next_fast_len

    if not all(is_stable(end.model, end.values, end.element) for end, _ in scenario.constant_ends):
        raise InputError(
            f"scenario {scenario.name}: the closed loop is unstable; lower the gains or the delays"
        )
    run_in = round(scenario.run_in / scenario.dt)
    samples = run_in + round(scenario.duration / scenario.dt)
    time = (np.arange(samples, dtype=float) - run_in) * scenario.dt

    # Twice the recording: both ends of the recording are then far apart on the circle.
    # An even length keeps the Nyquist bin.
    grid = 2 * next_fast_len(samples, real=True)
    omega = np.asarray(2.0 * np.pi * np.fft.rfftfreq(grid, scenario.dt), dtype=float)
    ends = [(closed_loop(end, omega), share) for end, share in scenario.constant_ends]
    shaping = remnant_shaping(scenario.constant_ends[0][0], omega)
    power = sum(share * np.abs(loop.u["remnant"]) ** 2 for loop, share in ends)
    to_u = shaping * np.sqrt(power)
    if scenario.changes:
        nothing = np.zeros((1, grid))
        u_forced, x_forced = (signal[:1] for signal in stepped(scenario, nothing, 1.0))
    else:
        u_forced, x_forced = _forced(scenario, time)
    level = _level(scenario, shaping, to_u, float(np.var(u_forced[0, run_in:])))
    return _Prepared(
        time,
        run_in,
        grid,
        u_forced,
        x_forced,
        shaping,
        to_u,
        ends[0][0],
        level,
    )


def _forced(scenario: Scenario, time: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Control and output without remnant at times [s], shape (1, times)."""
    u, x = np.zeros((2, time.size))
    for forcing, cause in ((scenario.target, "target"), (scenario.disturbance, "disturbance")):
        if forcing is not None:

            def both(omega: FloatArray, cause: str = cause) -> ComplexArray:
                loop = closed_loop(scenario, omega)
                return np.array([loop.u[cause], loop.x[cause]])

            control, output = forcing.through(both, time)
            u += control
            x += output
    return u[None], x[None]


def _level(
    scenario: Scenario, to_n: ComplexArray, to_u: ComplexArray, forced_power: float
) -> float:
    """Standard deviation of the sampled white noise that drives the remnant."""
    remnant = scenario.remnant
    if isinstance(remnant, TabulatedRemnant):
        return float(np.sqrt(np.pi / scenario.dt))  # of white noise with the density 1
    if remnant.level_is == "gain":
        return UNIT_LEVEL * remnant.level
    power_n, power_u = _power(to_n), _power(to_u)
    if remnant.level * power_u >= power_n:
        raise InputError(
            f"scenario {scenario.name}: a remnant power ratio of {remnant.level:g} cannot be "
            f"reached, since the loop itself limits it to {power_n / power_u:.3f}"
        )
    return float(np.sqrt(remnant.level * forced_power / (power_n - remnant.level * power_u)))


def _power(response: ComplexArray) -> float:
    """Variance of unit sampled white noise after a filter (one-sided grid, even length)."""
    return float(2.0 * np.sum(np.abs(response[1:-1]) ** 2) + abs(response[-1]) ** 2) / (
        2.0 * (response.size - 1)
    )


def remnant_ratio(scenario: Scenario) -> float:
    """Expected power ratio var(n)/var(u) of a scenario."""
    shared = _prepared(scenario)
    return shared.level**2 * _power(shared.remnant_to_n) / linear_rms(scenario) ** 2


def linear_rms(scenario: Scenario) -> float:
    """Expected root mean square of the control in the window, without any violation."""
    shared = _prepared(scenario)
    of_remnant = shared.level**2 * _power(shared.remnant_to_u)
    return float(np.sqrt(of_remnant + np.var(shared.u_forced[0, shared.run_in :])))


def white_level(scenario: Scenario) -> float:
    """Standard deviation of the sampled white noise that drives the scenario's remnant."""
    return _prepared(scenario).level


def lines_in(forcing: Forcing, duration: float) -> tuple[int, ...]:
    """Lines of a forcing function in a window, empty if it has no whole periods there."""
    if not isinstance(forcing, Multisine):
        return ()
    periods = duration / forcing.period
    whole = round(periods)
    if whole < 1 or abs(periods - whole) > 1e-9:
        return ()
    return tuple(whole * line for line in forcing.lines)


def simulate(scenario: Scenario, rng: np.random.Generator) -> Recording:
    """One recording of a scenario, with its remnant drawn from `rng`.

    Parameters
    ----------
    scenario
        Truth, loop, forcing functions and length.
    rng
        Draws the remnant.

    Raises
    ------
    InputError
        If the closed loop is unstable or the remnant level cannot be reached.
    """
    if scenario.recorder is not None:
        faster = replace(scenario, dt=scenario.dt / FASTER, recorder=None)
        return scenario.recorder.recorded(simulate(faster, rng), rng)
    shared = _prepared(scenario)
    samples, target = shared.time.size, samples_of(scenario.target, shared.time)
    noise = shared.level * scenario.remnant.white_noise(rng, (scenario.runs, shared.grid))
    spectrum = np.fft.rfft(noise) * shared.remnant_to_n
    if scenario.changes or scenario.violation is not None:
        u, x = stepped(scenario, np.fft.irfft(spectrum), linear_rms(scenario))
    else:
        u = shared.u_forced + np.fft.irfft(spectrum * shared.loop.u["remnant"])[:, :samples]
        x = shared.x_forced + np.fft.irfft(spectrum * shared.loop.x["remnant"])[:, :samples]
    forcing = {"ft": scenario.target, "fd": scenario.disturbance}
    return Recording(
        dt=scenario.dt,
        e=target - x,
        u=u,
        x=x,
        ft=target[None],
        fd=samples_of(scenario.disturbance, shared.time)[None],
        run_in=shared.run_in,
        lines={
            name: lines_in(f, scenario.duration) for name, f in forcing.items() if f is not None
        },
        units=dict(scenario.units),
        source=f"simulation {scenario.name}",
        controlled_element=scenario.element.name,
    )
