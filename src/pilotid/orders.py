"""The choice among black-box structures: orders and delays by information criteria."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pilotid.regression import Regression, Structure
from pilotid.types import FloatArray

Criterion = Literal["aicc", "bic", "heavy"]
HEAVY = 3.0  # weight of the heavy penalty


@dataclass(frozen=True, eq=False)
class StructureSearch:
    """The criterion surface of a search among structures.

    Attributes
    ----------
    structures
        What was tried.
    cost
        Residual sum of squares of each, shape (structures,).
    samples
        Number of rows, less the nuisance terms.
    """

    structures: tuple[Structure, ...]
    cost: FloatArray
    samples: int

    def criterion(self, name: Criterion, weight: float = HEAVY) -> FloatArray:
        """An information criterion of each structure, to be minimised; shape (structures,).

        Parameters
        ----------
        name
            ``aicc`` (Hurvich & Tsai 1989), ``bic``, or ``heavy``: BIC with its penalty
            multiplied by `weight` (Drop et al., IEEE Trans. Cybernetics 48(1), 2018, who tune
            the weight by simulation until no false channel is found).
        weight
            Of the heavy penalty.
        """
        count = np.array([s.parameters for s in self.structures], dtype=float)
        # A cost of rounding errors alone would make the smallest of them a minimum.
        least = 1e-24 * float(np.max(self.cost, initial=0.0)) + np.finfo(float).tiny
        deviance = self.samples * np.log(np.maximum(self.cost, least) / self.samples)
        if name == "aicc":
            left = np.maximum(self.samples - count - 1.0, 1e-3)
            return np.asarray(deviance + 2.0 * count * (1.0 + (count + 1.0) / left))
        return np.asarray(
            deviance + (weight if name == "heavy" else 1.0) * count * np.log(self.samples)
        )

    def best(self, name: Criterion, weight: float = HEAVY) -> Structure:
        """The structure of the lowest criterion."""
        return self.structures[int(np.argmin(self.criterion(name, weight)))]


def search_structures(regression: Regression, structures: Sequence[Structure]) -> StructureSearch:
    """Costs of many structures."""
    return StructureSearch(tuple(structures), regression.costs(structures), regression.samples)
