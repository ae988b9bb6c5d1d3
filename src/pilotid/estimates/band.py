"""The band of frequencies that an estimate rests on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from pilotid.types import FloatArray

NOTHING = np.zeros(0)


@dataclass(frozen=True, eq=False)
class AnalysedBand:
    """What was analysed.

    Attributes
    ----------
    highest
        Frequency up to which the recording was used [rad/s].
    likelihood
        ``band`` if the likelihood has the loop's term, ``direct`` for direct prediction errors,
        empty for methods that maximise none.
    omega, weights
        Frequencies [rad/s] and the weight of a bin there, shape (n,); empty if all weigh the same.
    floors
        Power density of what the recorder adds, by signal [the unit of the signal squared s/rad].
    element
        The controlled element that closes the loop; empty for none.
    """

    highest: float
    likelihood: str = ""
    omega: FloatArray = field(default_factory=lambda: NOTHING)
    weights: FloatArray = field(default_factory=lambda: NOTHING)
    floors: Mapping[str, float] = field(default_factory=dict)
    element: str = ""

    @property
    def half(self) -> float:
        """Frequency from which on a bin weighs less than half [rad/s]; `highest` if none does."""
        light = np.flatnonzero(self.weights < 0.5)
        return min(self.highest, float(self.omega[light[0]])) if light.size else self.highest

    @property
    def words(self) -> str:
        """What was analysed, in a few words."""
        told = f"band to {self.highest:.3g} rad/s"
        if self.half < 0.95 * self.highest:
            told += f", half weight from {self.half:.3g}: the recorder's floor"
        return told

    def to_dict(self) -> dict[str, object]:
        """Plain objects, as JSON has them."""
        return {
            "highest": self.highest,
            "half_weight": self.half,
            "likelihood": self.likelihood,
            "omega": self.omega.tolist(),
            "weights": self.weights.tolist(),
            "floors": dict(self.floors),
            "element": self.element,
        }
