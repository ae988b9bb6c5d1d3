"""The remnant: the part of the control that no linear model of the pilot explains."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from pilotid.types import ComplexArray, FloatArray

#: Standard deviation of the sampled white noise at remnant gain 1, calibrated so that
#: the paper's scale holds with the inferred filter of `Remnant`: gain 0.1 gives
#: var(n)/var(u) = 3 %, gain 0.8 about 32 %.
UNIT_LEVEL = 1.75


@dataclass(frozen=True)
class Remnant:
    """White noise through a low-pass filter of order 0 (white) to 3.

    The white noise is white in the samples and band-limited to half the sampling
    rate.  The filter has unit gain at rest; order 1 is 1/(1 + s/w), order 2
    w^2/(s^2 + 2 z w s + w^2), order 3 their product.

    Attributes
    ----------
    order, frequency, damping
        Order, break frequency w [rad/s] and damping z of the filter.
    level
        The remnant gain, or the power ratio, as `level_is` says.
    level_is
        ``gain`` on the paper's scale, or ``ratio``: var(n)/var(u) at the control.
    enters
        ``control`` (added to u) or ``error`` (added to what the pilot sees, so that
        the visual channel shapes it).
    """

    order: int = 2
    frequency: float = 3.5
    damping: float = 0.7
    level: float = 0.4
    level_is: Literal["gain", "ratio"] = "gain"
    enters: Literal["control", "error"] = "control"

    def __post_init__(self) -> None:
        if self.order not in (0, 1, 2, 3):
            raise ValueError(f"the remnant filter must be of order 0 to 3, not {self.order}")
        if self.level < 0.0 or (self.level_is == "ratio" and self.level >= 1.0):
            raise ValueError(f"a remnant {self.level_is} of {self.level:g} makes no sense")

    def filter(self, omega: FloatArray) -> ComplexArray:
        """Frequency response of the shaping filter, shape (n,)."""
        s = 1j * np.asarray(omega, dtype=float)
        first = 1.0 / (1.0 + s / self.frequency)
        w = self.frequency
        second = w * w / (s * s + 2.0 * self.damping * w * s + w * w)
        return (np.ones_like(s), first, second, first * second)[self.order]


def white(ratio: float) -> Remnant:
    """White remnant at the control, set by its power ratio var(n)/var(u)."""
    return Remnant(order=0, level=ratio, level_is="ratio")
