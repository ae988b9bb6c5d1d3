"""The choice among black-box structures: orders and delays by information criteria."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from pilotid.types import FloatArray, IntArray


@dataclass(frozen=True)
class Structure:
    """Orders and delays of A(q) u(t) = sum_i B_i(q) q^-delay_i input_i(t) + w(t).

    Attributes
    ----------
    poles
        Degree of A: how many past values of the output.
    zeros
        Per input, the number of coefficients of B_i.
    delays
        Per input, the lag of the first of them [samples].
    """

    poles: int
    zeros: tuple[int, ...]
    delays: tuple[int, ...]

    @property
    def parameters(self) -> int:
        """Number of coefficients."""
        return self.poles + sum(self.zeros)

    def lags(self, i: int) -> IntArray:
        """Lags of input `i` [samples], shape (coefficients,)."""
        return self.delays[i] + np.arange(self.zeros[i])


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
        """The structure of the lowest criterion.

        Parameters
        ----------
        name, weight
            As for `criterion`.
        """
        return self.structures[int(np.argmin(self.criterion(name, weight)))]
