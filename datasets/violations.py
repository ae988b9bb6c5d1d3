"""What no linear, constant loop does: sticks with a violation, elements that change.

Both are simulated in the loop, see `pilotid.datasets.stepping`.  Bounds, and all else that follows
from a scenario's truth, are those of the linear pilot without the violation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from pilotid.model.element import ControlledElement
from pilotid.support.types import FloatArray

Kind = Literal["threshold", "quantised", "saturated"]
TERMS = 16  # of the series of an exponential: steps are short beside what the element takes


@dataclass(frozen=True)
class Violation:
    """A stick that is not linear, as methods assume.

    Attributes
    ----------
    kind
        ``threshold`` (the control is zero while the command is smaller than `size`),
        ``quantised`` (the control has steps of `size`), ``saturated`` (it is clipped at plus and
        minus `size`).
    size
        In root mean squares of the linear loop's control.
    """

    kind: Kind
    size: float

    def __post_init__(self) -> None:
        if self.kind not in get_args(Kind) or not self.size > 0.0:
            raise ValueError(f"a violation is {', '.join(get_args(Kind))}, of a size above 0")

    def stick(self, command: FloatArray, rms: float) -> FloatArray:
        """The control that a stick makes of a command.

        Parameters
        ----------
        command
            Command, any shape.
        rms
            Root mean square of the linear loop's control, in the command's unit.
        """
        size = self.size * rms
        match self.kind:
            case "threshold":
                return np.where(np.abs(command) < size, 0.0, command)
            case "quantised":
                return np.asarray(size * np.round(command / size))
        return np.clip(command, -size, size)


@dataclass(frozen=True)
class ElementChange:
    """How the coefficients of a controlled element pass to those of another.

    Of N/D and N2/D2, both with a constant numerator, a leading coefficient 1 and the same order,
    it is the differential equation whose coefficients go along the sigmoid of
    `pilotid.model.timevarying.Changing`.

    Attributes
    ----------
    after
        What the element becomes.
    middle
        Middle of the change, from the start of the measurement window [s].
    rate
        Its rate [1/s].
    """

    after: ControlledElement
    middle: float
    rate: float

    def share(self, time: FloatArray) -> FloatArray:
        """How much of the change has passed at some times [s], 0 to 1, shape (n,)."""
        return np.asarray(0.5 + 0.5 * np.tanh(0.5 * self.rate * (time - self.middle)))


class SteppedElement:
    """The answer of an element that changes, in blocks of steps.

    Within a step the coefficients are those at its middle, and the input is straight.

    Parameters
    ----------
    before, change
        The element and what becomes of it.
    time
        Times of all steps [s], shape (steps,).
    """

    def __init__(self, before: ControlledElement, change: ElementChange, time: FloatArray) -> None:
        h = float(time[1] - time[0])
        order = len(before.denominator) - 1
        for element in (before, change.after):
            if (
                len(element.numerator) != 1
                or len(element.denominator) != order + 1
                or element.denominator[0] != 1.0
                or element.delay
            ):
                raise ValueError(
                    "elements that change must be a gain over polynomials of one order that begin "
                    "with 1, without delay"
                )
        share = change.share(time + 0.5 * h)
        # The coefficients keep their value for most of the time.
        shares, self._which = np.unique(share, return_inverse=True)
        ends = (before, change.after)
        gains = np.array([element.numerator[0] for element in ends])
        lower = np.array([element.denominator[:0:-1] for element in ends])
        part = np.stack([1.0 - shares, shares], axis=1)
        # States, input, and its slope: one matrix exponential holds all that a step does.
        matrix = np.zeros((len(shares), order + 2, order + 2))
        matrix[:, np.arange(order - 1), np.arange(1, order)] = 1.0
        matrix[:, order - 1, :order] = -(part @ lower)
        matrix[:, order - 1, order] = part @ gains
        matrix[:, order, order + 1] = 1.0 / h
        steps = _exponential(h * matrix)[:, :order]
        self._own = np.ascontiguousarray(steps[..., :order].transpose(0, 2, 1))
        self._by_last = steps[..., order] - steps[..., order + 1]
        self._by_new = steps[..., order + 1]
        self._order = order
        self._now = 0
        self._state = self._last = np.zeros((0, 0))

    def through(self, signal: FloatArray) -> FloatArray:
        """The answer to the next block of a signal, shape (runs, steps)."""
        first = self._now == 0
        if first:  # all is at rest, and the input begins here
            self._state, self._last = np.zeros((len(signal), self._order)), signal[:, :1]
        which = self._which[self._now + first - 1 : self._now + signal.shape[1] - 1]
        inputs = np.concatenate([self._last, signal], axis=1)[:, first:, None]
        given = inputs[:, :-1] * self._by_last[which] + inputs[:, 1:] * self._by_new[which]
        answer = np.empty(signal.shape)
        state = self._state
        answer[:, 0] = state[:, 0]
        for i, (own, part) in enumerate(
            zip(self._own[which], given.transpose(1, 0, 2), strict=True)
        ):
            state = state @ own + part
            answer[:, i + first] = state[:, 0]
        self._now += signal.shape[1]
        self._state, self._last = state, signal[:, -1:]
        return answer


def _exponential(matrices: FloatArray) -> FloatArray:
    """Exponentials of many small matrices of small steps, shape (n, m, m), by their series."""
    term = np.broadcast_to(np.eye(matrices.shape[-1]), matrices.shape)
    total = term.copy()
    for power in range(1, TERMS + 1):
        term = term @ matrices / power
        total += term
    return total
