"""Loop shapes of the closed loop of pilot and controlled element, and its stability.

With u = Hpe e - Hpx x, e = ft - x and x = Hc (u + fd) the target and
disturbance open loops are

    L_t = Hpe Hc / (1 + Hpx Hc),        L_d = Hc (Hpe + Hpx).

A channel Hpt on the target is one on both, since ft = e + x: Hpe is then the error's own channel
and Hpt together, and Hpx the output's less Hpt.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pilotid.model.channel import INPUTS
from pilotid.model.element import ControlledElement
from pilotid.model.model import PilotModel
from pilotid.support.types import BoolArray, ComplexArray, FloatArray

#: Where crossings are looked for [rad/s]: a pilot's loops have none beyond.
GRID = np.geomspace(0.05, 60.0, 4000)


@dataclass(frozen=True)
class Margin:
    """Crossover frequency [rad/s] and phase margin [deg] of one open loop.

    Attributes
    ----------
    crossover
        Where the magnitude falls through one first; NaN where it never does.
    phase_margin
        What the phase there is above -180 deg, from -180 to 180; NaN likewise.
    others
        Where it falls through one once more [rad/s], ascending: above a resonance.
    """

    crossover: float
    phase_margin: float
    others: tuple[float, ...] = ()


def pilot_on(
    model: PilotModel, omega: FloatArray, values: FloatArray
) -> tuple[ComplexArray, ComplexArray]:
    """Hpe and Hpx in u = Hpe e - Hpx x, each of shape (n,), or (sets, n) of sets of values."""
    on = pilot_on_each(model, model.response(omega, values))
    return on["e"] + on["ft"], -on["x"] - on["ft"]


def pilot_on_each(model: PilotModel, responses: ComplexArray) -> dict[str, ComplexArray]:
    """Responses of channels, or their derivatives, summed with their signs by their inputs."""
    on = {name: np.zeros_like(responses[0]) for name in INPUTS.values()}
    for channel, response in zip(model.channels, responses, strict=True):
        on[channel.on] += channel.sign * response
    return on


def loop_slopes(
    model: PilotModel, values: FloatArray, element: ControlledElement, omega: FloatArray
) -> tuple[ComplexArray, ComplexArray]:
    """Derivatives of the logarithms of both open loops by each parameter, (parameters, n)."""
    on_error, on_output = pilot_on(model, omega, values)
    on = pilot_on_each(model, model.response_and_jacobian(omega, values)[1])
    of_error, of_output = on["e"] + on["ft"], -on["x"] - on["ft"]
    plant = element.response(omega)
    with np.errstate(invalid="ignore"):  # of the target alone: the disturbance loop is nil
        disturbance = (of_error + of_output) / (on_error + on_output)
    return of_error / on_error - of_output * plant / (1.0 + on_output * plant), disturbance


def open_loops(
    model: PilotModel, values: FloatArray, element: ControlledElement, omega: FloatArray
) -> tuple[ComplexArray, ComplexArray]:
    """Target and disturbance open loops at `omega` [rad/s], each of shape (n,).

    Parameters
    ----------
    model
        The pilot.
    values
        Its parameters in model order, shape (parameters,).
    element
        The controlled element.
    omega
        Frequencies [rad/s], shape (n,).
    """
    on_error, on_output = pilot_on(model, omega, values)
    plant = element.response(omega)
    return on_error * plant / (1.0 + on_output * plant), plant * (on_error + on_output)


def crossings(omega: FloatArray, loop: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """Where the magnitude of a loop falls through one on a fine ascending grid.

    Parameters
    ----------
    omega
        The grid [rad/s], shape (n,).
    loop
        The open loop, shape (n,).

    Returns
    -------
    frequencies, phase_margins
        Ascending [rad/s], and what the phase there is above -180 deg [deg], from -180 to 180,
        shape (crossings,) each.
    """
    with np.errstate(divide="ignore"):  # a loop without a channel is zero
        magnitude = np.log(np.abs(loop))
    i = np.flatnonzero((magnitude[:-1] > 0.0) & (magnitude[1:] <= 0.0))
    share = magnitude[i] / (magnitude[i] - magnitude[i + 1])
    frequency = omega[i] * (omega[i + 1] / omega[i]) ** share
    phase = np.angle(loop[i] * (loop[i + 1] / loop[i]) ** share, deg=True)
    return frequency, (phase + 360.0) % 360.0 - 180.0


def margin(omega: FloatArray, loop: ComplexArray) -> Margin:
    """The first crossing where |L| falls through one on a fine ascending grid."""
    frequency, phase_margin = crossings(omega, loop)
    if frequency.size == 0:
        return Margin(float("nan"), float("nan"))
    others = tuple(frequency[1:].tolist())
    return Margin(float(frequency[0]), float(phase_margin[0]), others)


def margins(
    model: PilotModel, values: FloatArray, element: ControlledElement
) -> tuple[Margin, Margin]:
    """Crossover frequency and phase margin of the target and the disturbance loop.

    Parameters
    ----------
    model
        The pilot.
    values
        Its parameters in model order, shape (parameters,).
    element
        The controlled element.
    """
    target, disturbance = open_loops(model, values, element, GRID)
    return margin(GRID, target), margin(GRID, disturbance)


#: Where `are_stable` follows the loop [rad/s]: a recorded loop moves within this range.
STABILITY_GRID = np.geomspace(0.01, 400.0, 600)


def turn(responses: ComplexArray) -> FloatArray:
    """By how much phases turn from the first to the last frequency [rad], along the last axis."""
    ratios = responses[..., 1:] * responses[..., :-1].conj()
    return np.asarray(np.angle(ratios).sum(axis=-1))


def are_stable(model: PilotModel, sets: FloatArray, element: ControlledElement) -> BoolArray:
    """Whether the closed loop of each pilot is stable, shape (sets,); delays are exact.

    With Hc = N/D and a stable pilot, F(s) = D(s) + N(s) (Hpe + Hpx) has no zeros in the right half
    plane if its argument turns by n pi/2 on the way from w = 0 to infinity, with n the degree of
    D (Mikhailov's criterion).  A loop whose gain is above one at the end of the grid is taken for
    unstable.

    Parameters
    ----------
    model
        The pilot, constant in time.
    sets
        Parameters in model order, shape (sets, parameters).
    element
        The controlled element.
    """
    omega = np.concatenate(([0.0], STABILITY_GRID))
    s = 1j * omega
    pilot = np.add(*pilot_on(model, omega, sets))
    denominator = np.polyval(element.denominator, s)
    around = np.polyval(element.numerator, s) * np.exp(-element.delay * s) * pilot
    loop = around[:, -1] / denominator[-1]
    # From the end of the grid on the element's denominator turns alone.
    roots = np.angle(s[-1] - np.roots(element.denominator)) % (2.0 * np.pi)
    roots -= 2.0 * np.pi * (roots > 1.5 * np.pi)
    rest = 0.5 * np.pi * len(roots) - float(np.sum(roots)) - np.angle(1.0 + loop)
    whole = turn(denominator + around) + rest
    degree = len(element.denominator) - 1
    poles = np.round((degree - whole / (np.pi / 2.0)) / 2.0)
    return np.asarray((poles == 0.0) & (np.abs(loop) < 1.0))


def is_stable(model: PilotModel, values: FloatArray, element: ControlledElement) -> bool:
    """Whether the closed loop of one pilot, shape (parameters,), is stable, see `are_stable`."""
    return bool(are_stable(model, values[None], element)[0])
