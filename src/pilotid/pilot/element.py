"""Controlled elements: the dynamics that the pilot controls, x = Hc (u + fd)."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pilotid.pilot.element_text import NotTransferFunctionError, Ratio, transfer_function
from pilotid.types import ComplexArray, FloatArray, InputError

if TYPE_CHECKING:
    import control


@dataclass(frozen=True)
class ControlledElement:
    """A rational transfer function with an optional pure delay.

    Attributes
    ----------
    numerator, denominator
        Polynomial coefficients, highest power of s first.
    delay
        Pure time delay [s].
    name
        As printed in reports.
    """

    numerator: tuple[float, ...]
    denominator: tuple[float, ...]
    delay: float = 0.0
    name: str = ""

    def __post_init__(self) -> None:
        if len(self.numerator) > len(self.denominator) or self.denominator[0] == 0.0:
            raise ValueError(f"controlled element {self.name}: must be a proper transfer function")
        if self.delay < 0.0:
            raise ValueError(f"controlled element {self.name}: a delay cannot be negative")

    def response(self, omega: FloatArray) -> ComplexArray:
        """Frequency response at `omega` [rad/s], shape (n,)."""
        s = 1j * np.asarray(omega, dtype=float)
        ratio = np.polyval(self.numerator, s) / np.polyval(self.denominator, s)
        return np.asarray(ratio * np.exp(-self.delay * s))

    def rational(self, pade_order: int = 5) -> control.TransferFunction:
        """As a python-control transfer function; a delay becomes a Pade approximant."""
        import control

        from pilotid.pilot.factors import pade

        top, bottom = pade(self.delay, pade_order)
        return control.TransferFunction(
            np.polymul(self.numerator, top), np.polymul(self.denominator, bottom)
        )


def position_control(gain: float) -> ControlledElement:
    """K: the output follows the control."""
    return ControlledElement((gain,), (1.0,), name=f"{gain:g}")


def single_integrator(gain: float) -> ControlledElement:
    """K/s: rate control."""
    return ControlledElement((gain,), (1.0, 0.0), name=f"{gain:g}/s")


def double_integrator(gain: float) -> ControlledElement:
    """K/s^2: acceleration control."""
    return ControlledElement((gain,), (1.0, 0.0, 0.0), name=f"{gain:g}/s^2")


def integrator_with_lag(gain: float, break_frequency: float) -> ControlledElement:
    """K/(s (s + a)), with a in rad/s: between rate and acceleration control.

    Parameters
    ----------
    gain
        K, in units of x over those of u, times rad^2/s^2.
    break_frequency
        a [rad/s].
    """
    return ControlledElement(
        (gain,), (1.0, break_frequency, 0.0), name=f"{gain:g}/(s(s{break_frequency:+g}))"
    )


def second_order(gain: float, frequency: float, damping: float) -> ControlledElement:
    """K/(s^2 + 2 z w s + w^2), with its natural frequency w in rad/s and its damping z.

    Parameters
    ----------
    gain
        K, in units of x over those of u, times rad^2/s^2.
    frequency
        w [rad/s].
    damping
        z [-].
    """
    bottom = (1.0, 2.0 * damping * frequency, frequency**2)
    name = f"{gain:g}/(s^2{bottom[1]:+g}s{bottom[2]:+g})"
    return ControlledElement((gain,), bottom, name=name)


def from_control(system: control.TransferFunction, delay: float = 0.0) -> ControlledElement:
    """Any continuous single-input single-output transfer function of python-control.

    Parameters
    ----------
    system
        A transfer function, or a state space.
    delay
        Pure time delay in series with it [s].
    """
    if not system.issiso() or (system.dt not in (0, None)):
        raise ValueError("the controlled element must be continuous, with one input and one output")
    import control

    system = control.tf(system)  # from a state space too
    return ControlledElement(
        tuple(float(c) for c in system.num[0][0]),
        tuple(float(c) for c in system.den[0][0]),
        delay,
        "user-defined",
    )


def _well_known(found: Ratio) -> ControlledElement | None:
    """One of the forms that have a function of their own here, so that its name is theirs."""
    top, bottom = found.top.tolist(), found.bottom.tolist()
    if len(top) > 1 or bottom[0] != 1.0 or found.delay:
        return None
    match bottom[1:]:
        case []:
            return position_control(top[0])
        case [0.0]:
            return single_integrator(top[0])
        case [0.0, 0.0]:
            return double_integrator(top[0])
        case [a, 0.0]:
            return integrator_with_lag(top[0], a)
    return None


def parsed_element(text: str) -> ControlledElement | None:
    """The controlled element that a text describes; None for any other text.

    See `pilotid.pilot.element_text` for what can be written.
    """
    try:
        return element_named(text)
    except InputError:
        return None


def element_named(text: str) -> ControlledElement:
    """As `parsed_element`; `InputError` for a text that is none, which says where."""
    try:
        found = transfer_function(text)
    except NotTransferFunctionError as error:
        raise InputError(
            f"the controlled element '{text}' cannot be read: {error}; write for example 4/s^2 or "
            "4 exp(-0.05s)/(s(1+s/30)^2)"
        ) from None
    known = _well_known(found)
    if known is not None:
        return known
    name = re.sub(r"\s", "", text.rpartition("=")[2])
    top, bottom = found.top.tolist(), found.bottom.tolist()
    return ControlledElement(tuple(top), tuple(bottom), found.delay, name)
