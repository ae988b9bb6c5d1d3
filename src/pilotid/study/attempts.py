"""What the fits of one scenario by one method have in common, whatever their truth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pilotid.estimates.estimate import Outcome
from pilotid.study.entries import Result, ScenarioEntry
from pilotid.types import BoolArray


@dataclass(frozen=True, eq=False)
class Attempts:
    """All fits of one scenario, or of one population, by one method.

    Attributes
    ----------
    scenario
        The scenario.
    method
        The method's name.
    results
        The fits by replication.
    """

    scenario: ScenarioEntry
    method: str
    results: tuple[Result, ...]

    @cached_property
    def counted(self) -> BoolArray:
        """Which fits count as results, shape (fits,)."""
        return np.array([r.usable for r in self.results], dtype=bool)

    @property
    def usable(self) -> int:
        """Fits that count as results."""
        return int(np.sum(self.counted))

    @property
    def attempts(self) -> list[Result]:
        """Fits of recordings that the method can treat."""
        return [r for r in self.results if r.outcome != Outcome.NOT_APPLICABLE.slug]

    @property
    def tried(self) -> int:
        """How many these are."""
        return len(self.attempts)

    @property
    def milliseconds(self) -> float:
        """Median time of a fit."""
        known = [r.seconds for r in self.results if r.seconds is not None]
        return 1e3 * float(np.median(known)) if known else math.nan
