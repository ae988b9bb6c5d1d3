"""How likely a recording is under a fitted model: what models are compared by."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Likelihood:
    """The largest likelihood of pilot and remnant, and what it took.

    Models of one recording can be compared if all were scored on the same samples in the same
    band (`comparable`), as `pilotid.time_domain.model_comparison` does.

    Attributes
    ----------
    logarithm
        Of the density of the control's samples, in the unit of the recording.
    parameters
        Everything that was estimated: pilot, remnant with its variance, offset and decays of
        every run.
    samples
        Scored samples of all runs.
    dt
        Interval between them [s], which tells the band.
    """

    logarithm: float
    parameters: int
    samples: int
    dt: float

    @property
    def aicc(self) -> float:
        """Akaike's information criterion, corrected for few samples (Hurvich & Tsai 1989)."""
        left = max(self.samples - self.parameters - 1.0, 1.0)
        return -2.0 * self.logarithm + 2.0 * self.parameters * self.samples / left

    @property
    def bic(self) -> float:
        """Schwarz's (Bayesian) information criterion."""
        return -2.0 * self.logarithm + self.parameters * math.log(self.samples)

    def comparable(self, other: Likelihood) -> bool:
        """Whether the other is of the same samples, if it is of the same recording."""
        return self.samples == other.samples and math.isclose(self.dt, other.dt)

    def to_dict(self) -> dict[str, object]:
        """Plain objects, as JSON has them."""
        return {
            "log_likelihood": self.logarithm,
            "parameters": self.parameters,
            "samples": self.samples,
            "dt": self.dt,
            "aicc": self.aicc,
            "bic": self.bic,
        }
