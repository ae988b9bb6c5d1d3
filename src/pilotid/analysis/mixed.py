"""A linear mixed model with one intercept for each subject, on its exact likelihood.

Laird and Ware (1982).  With one variance ratio left, the likelihood is searched over an interval,
its end included: few subjects often have no spread between them beyond that within, and there
statsmodels' MixedLM, with which this agrees elsewhere, does not converge.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pilotid.types import FloatArray

#: Correlations within a subject at which the likelihood is looked at before it is searched.
GRID = np.concatenate([np.linspace(0.0, 0.98, 50), 1.0 - np.geomspace(1e-2, 1e-9, 22)])


@dataclass(frozen=True)
class MixedFit:
    """Log-likelihood, and the standard deviations between subjects and within them."""

    log_likelihood: float
    between: float
    within: float


def random_intercept(
    values: FloatArray, design: FloatArray, groups: NDArray[np.intp], *, restricted: bool
) -> MixedFit:
    """The mixed model of values = design @ effects + intercept of the group + residual.

    Parameters
    ----------
    values
        Shape (n,).
    design
        Fixed effects, of full rank, shape (n, effects).
    groups
        The group of each value, numbered from 0, shape (n,).
    restricted
        Whether the likelihood is the restricted one (REML), for standard deviations, or the
        whole, for tests of fixed effects.
    """
    from scipy.optimize import minimize_scalar

    def loss(correlation: float) -> float:
        return -_profile(correlation, values, design, groups, restricted)[0]

    looked = [loss(r) for r in GRID]
    best = int(np.argmin(looked))
    correlation = float(GRID[best])
    if 0 < best < len(GRID) - 1:
        found = minimize_scalar(
            loss, bounds=(GRID[best - 1], GRID[best + 1]), method="bounded", options={"xatol": 1e-9}
        )
        correlation = float(found.x)
    likelihood, within = _profile(correlation, values, design, groups, restricted)
    between = within * correlation / (1.0 - correlation)
    return MixedFit(likelihood, math.sqrt(between), math.sqrt(within))


def _profile(
    correlation: float,
    values: FloatArray,
    design: FloatArray,
    groups: NDArray[np.intp],
    restricted: bool,
) -> tuple[float, float]:
    """Log-likelihood at its best for a correlation within subjects, and the residual variance."""
    sizes = np.bincount(groups)
    spread = 1.0 + sizes * correlation / (1.0 - correlation)
    # The root of the inverse covariance of a group takes a share of its mean away.
    share = (1.0 - 1.0 / np.sqrt(spread))[groups]
    table = np.column_stack([values, design])
    means = np.stack([np.bincount(groups, column) / sizes for column in table.T], axis=1)
    table = table - share[:, None] * means[groups]
    orthogonal, triangle = np.linalg.qr(table[:, 1:])
    residual = table[:, 0] - orthogonal @ (orthogonal.T @ table[:, 0])
    count = len(values) - (design.shape[1] if restricted else 0)
    variance = float(residual @ residual) / count
    if variance <= 0.0:
        return -math.inf, 0.0
    likelihood = -0.5 * (count * (math.log(2.0 * math.pi * variance) + 1.0))
    likelihood -= 0.5 * float(np.sum(np.log(spread)))
    if restricted:
        likelihood -= float(np.sum(np.log(np.abs(np.diag(triangle)))))
    return likelihood, variance
