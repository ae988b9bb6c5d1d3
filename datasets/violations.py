"""Violations: what no linear, constant pilot with a faultless recorder does.

What acts inside the loop (a stick with a threshold, with levels or with stops; a pilot who
changes) is simulated there, see `pilotid.datasets.stepping`; what the recorder does to the
control is put on the recorded control.  Bounds, and all else that follows from a scenario's
truth, are those of the linear, constant pilot without the violation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from pilotid.types import FloatArray

Kind = Literal["threshold", "change", "quantised", "saturated", "drift", "lost"]
BURST = 10  # samples that are lost together


@dataclass(frozen=True)
class Violation:
    """One assumption of the methods that does not hold.

    Attributes
    ----------
    kind
        In the loop: ``threshold`` (the control is zero while the command is smaller than
        `size`), ``quantised`` (the control has steps of `size`), ``saturated`` (it is clipped
        at plus and minus `size`), ``change`` (the pilot's parameters change half-way).  In the
        recorder: ``drift`` (the control gains `size` from the start of the window to its end),
        ``lost`` (a share `size` of the control's samples, in bursts, is the last one before).
    size
        In root mean squares of the linear loop's control, but for ``lost``.
    change
        Parameters that change, and by which share: each is below its true value by that in
        the first half of the window and above it in the second (a negative one the other way
        round), so that the truth is the mean.
    """

    kind: Kind
    size: float = 0.0
    change: tuple[tuple[str, float], ...] = ()

    def __post_init__(self) -> None:
        if self.kind not in get_args(Kind):
            raise ValueError(f"the kind must be one of {', '.join(get_args(Kind))}")
        if (self.kind == "change") != bool(self.change):
            raise ValueError("a pilot who changes needs parameters that do, and no other has any")
        if not (self.kind == "change" or self.size > 0.0):
            raise ValueError(f"the size of kind {self.kind} must be above 0, not {self.size:g}")
        if self.kind == "lost" and self.size >= 1.0:
            raise ValueError("the share of lost samples must be below 1")

    @property
    def in_loop(self) -> bool:
        """Whether the loop answers to it, or only the recorder knows of it."""
        return self.kind not in ("drift", "lost")

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
            case "saturated":
                return np.clip(command, -size, size)
        return command

    def recorded(
        self, u: FloatArray, share: FloatArray, rms: float, rng: np.random.Generator
    ) -> FloatArray:
        """What a recorder writes for the control.

        Parameters
        ----------
        u
            Control, shape (runs, samples).
        share
            Time since the start of the window over its length, shape (samples,).
        rms
            See `stick`.
        rng
            Draws which samples are lost.
        """
        if self.kind == "drift":
            return u + self.size * rms * share
        if self.kind == "lost":
            begins = rng.random(u.shape) < self.size / BURST
            reach = np.cumsum(begins, axis=1)
            lost = reach > np.pad(reach, ((0, 0), (BURST, 0)))[:, : u.shape[1]]
            lost[:, 0] = False
            kept = np.maximum.accumulate(np.where(lost, 0, np.arange(u.shape[1])), axis=1)
            return np.take_along_axis(u, kept, axis=1)
        return u
