"""Loop shapes of the closed loop of pilot and controlled element, and its stability.

With u = Hpe e - Hpx x, e = ft - x and x = Hc (u + fd) the target and
disturbance open loops are

    L_t = Hpe Hc / (1 + Hpx Hc),        L_d = Hc (Hpe + Hpx).

A channel Hpt on the target is one on both, since ft = e + x: Hpe is then the error's own channel
and Hpt together, and Hpx the output's less Hpt.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import get_args

import numpy as np

from pilotid.pilot.element import ControlledElement
from pilotid.pilot.model import Input, PilotModel
from pilotid.types import ComplexArray, FloatArray


@dataclass(frozen=True)
class Margin:
    """Crossover frequency [rad/s] and phase margin [deg] of one open loop."""

    crossover: float
    phase_margin: float


def pilot_on(
    model: PilotModel, omega: FloatArray, values: FloatArray
) -> tuple[ComplexArray, ComplexArray]:
    """Hpe and Hpx in u = Hpe e - Hpx x, each of shape (n,)."""
    on = pilot_on_each(model, omega, values)
    return on["error"] + on["target"], -on["output"] - on["target"]


def pilot_on_each(
    model: PilotModel, omega: FloatArray, values: FloatArray
) -> dict[Input, ComplexArray]:
    """What the pilot makes of each signal by itself, with its sign, each of shape (n,)."""
    on: dict[Input, ComplexArray] = {
        name: np.zeros(omega.shape, dtype=complex) for name in get_args(Input)
    }
    for channel, response in zip(model.channels, model.response(omega, values), strict=True):
        on[channel.input] += channel.sign * response
    return on


def open_loops(
    model: PilotModel, values: FloatArray, element: ControlledElement, omega: FloatArray
) -> tuple[ComplexArray, ComplexArray]:
    """Target and disturbance open loops at `omega` [rad/s], each of shape (n,)."""
    on_error, on_output = pilot_on(model, omega, values)
    plant = element.response(omega)
    return on_error * plant / (1.0 + on_output * plant), plant * (on_error + on_output)


def margin(omega: FloatArray, loop: ComplexArray) -> Margin:
    """The last crossing of |L| = 1 on a fine ascending grid; NaN where there is none."""
    magnitude = np.log(np.abs(loop))
    falls = np.flatnonzero((magnitude[:-1] > 0.0) & (magnitude[1:] <= 0.0))
    if falls.size == 0:
        return Margin(float("nan"), float("nan"))
    i = int(falls[-1])
    share = magnitude[i] / (magnitude[i] - magnitude[i + 1])
    crossover = omega[i] * (omega[i + 1] / omega[i]) ** share
    phase = np.angle(loop[i] * (loop[i + 1] / loop[i]) ** share, deg=True)
    return Margin(float(crossover), float((phase + 360.0) % 360.0 - 180.0))


def margins(
    model: PilotModel, values: FloatArray, element: ControlledElement
) -> tuple[Margin, Margin]:
    """Crossover frequency and phase margin of the target and the disturbance loop."""
    omega = np.geomspace(0.05, 60.0, 4000)
    target, disturbance = open_loops(model, values, element, omega)
    return margin(omega, target), margin(omega, disturbance)


def unstable_poles(model: PilotModel, values: FloatArray, element: ControlledElement) -> int:
    """Closed-loop poles in the right half plane, delays exact (Mikhailov's criterion).

    F(s) = D(s) + N(s) (Hpe + Hpx), with Hc = N/D and a stable pilot, has no poles
    in the right half plane; its argument then turns by (n - 2 z) pi/2 on the way
    from w = 0 to infinity, with n the degree of D and z the zeros sought.
    """
    omega = np.concatenate(([0.0], np.geomspace(1e-5, 1e4, 40_000)))
    s = 1j * omega
    on_error, on_output = pilot_on(model, omega, values)
    numerator = np.polyval(element.numerator, s) * np.exp(-element.delay * s)
    characteristic = np.polyval(element.denominator, s) + numerator * (on_error + on_output)
    turn = np.unwrap(np.angle(characteristic))
    degree = len(element.denominator) - 1
    return round(float(degree - (turn[-1] - turn[0]) / (np.pi / 2.0)) / 2.0)
