"""Estimates of several conditions with parameters in common.

Each estimate stands for its likelihood by value and covariance, and the sum of these is made as
large as it can be under equal values of the shared parameters (minimum distance; Malinvaud,
*Statistical Methods of Econometrics*, 3rd ed., sec. 9.5).  For long recordings that is the joint
fit.  The other parameters move as they are correlated with the shared ones.  Positive parameters
count by their logarithms: their errors grow with their values, and weights by the errors themselves
would favour what came out small.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pilotid.chance import Z95
from pilotid.estimates.estimate import Estimate, at_bounds
from pilotid.limits import ESTIMATE
from pilotid.remarks import Remark
from pilotid.types import BoolArray, FloatArray


@dataclass(frozen=True)
class Equality:
    """The test that parameters are equal in all conditions.

    Attributes
    ----------
    statistic, freedom, p
        Chi-squared, its degrees of freedom and its p-value.
    """

    statistic: float
    freedom: int
    p: float


def share(
    estimates: Mapping[str, Estimate], keys: Sequence[str]
) -> tuple[dict[str, Estimate], Equality | None]:
    """Estimates with parameters in common, each with a remark on them, and the test of equality.

    Parameters
    ----------
    estimates
        Estimates of one pilot by condition; those that are not usable, or end with a shared
        parameter at its bound, share nothing.
    keys
        The shared parameters, which every model has.
    """
    able = {}
    for name, own in estimates.items():
        places = [own.model.keys.index(key) for key in keys]
        ends = np.logical_or(*at_bounds(own.model, own.values, own.values))
        if own.outcome.usable and not ends[places].any():
            able[name] = own
    result = {
        name: replace(own, remarks=(*own.remarks, Remark("not-shared", _without(keys))))
        if own.outcome.usable
        else own
        for name, own in estimates.items()
    }
    if len(able) < 2:
        return result, None
    from scipy.special import chdtrc

    pieces = [_Piece.of(own, keys) for own in able.values()]
    weights = [np.linalg.inv(piece.shared_covariance) for piece in pieces]
    spread = np.linalg.inv(np.sum(weights, axis=0))
    common = spread @ np.sum([w @ p.shared for w, p in zip(weights, pieces, strict=True)], axis=0)
    away = [piece.shared - common for piece in pieces]
    statistic = float(sum(a @ w @ a for a, w in zip(away, weights, strict=True)))
    freedom = len(keys) * (len(able) - 1)
    test = Equality(statistic, freedom, float(chdtrc(freedom, statistic)))
    told = _remarks(able, keys, test)
    result |= {
        name: piece.moved(own, common, spread, told)
        for (name, own), piece in zip(able.items(), pieces, strict=True)
    }
    return result, test


def _without(keys: Sequence[str]) -> str:
    return (
        f"{', '.join(keys)} stand for this condition alone: a shared parameter ends at its bound "
        "here, or no other condition has an estimate to share it with"
    )


def _remarks(able: Mapping[str, Estimate], keys: Sequence[str], test: Equality) -> list[Remark]:
    whole = sum(len(own.model.keys) for own in able.values())
    verb = "is" if len(keys) == 1 else "are"
    words = f"chi-squared {test.statistic:.1f}, {test.freedom} degrees of freedom, p = {test.p:.2g}"
    told = [
        Remark(
            "shared",
            f"{', '.join(keys)} {verb} shared by {', '.join(able)}: {whole - test.freedom} free "
            f"parameters in place of {whole} ({words} of equal values)",
        )
    ]
    if test.p < ESTIMATE.unequal:
        told.append(
            Remark(
                "unequal",
                f"{', '.join(keys)} {verb} not the same in {', '.join(able)} ({words}), and "
                "sharing moves the other parameters; estimate them for each condition",
            )
        )
    return told


@dataclass(frozen=True)
class _Piece:
    """An estimate in coordinates in which its errors are more alike: logarithms where positive."""

    places: list[int]
    logarithmic: BoolArray
    point: FloatArray
    covariance: FloatArray

    @classmethod
    def of(cls, own: Estimate, keys: Sequence[str]) -> _Piece:
        logs = own.model.positive & (own.values > 0.0)
        values = np.where(logs, own.values, 1.0)
        scale = own.std_error / np.sqrt(np.diag(own.covariance)) / values
        return cls(
            [own.model.keys.index(key) for key in keys],
            logs,
            np.where(logs, np.log(values), own.values),
            own.covariance * np.outer(scale, scale),
        )

    @property
    def shared(self) -> FloatArray:
        """The shared parameters, shape (shared,)."""
        return self.point[self.places]

    @property
    def shared_covariance(self) -> FloatArray:
        """Their covariance, shape (shared, shared)."""
        return self.covariance[np.ix_(self.places, self.places)]

    def moved(
        self, own: Estimate, common: FloatArray, spread: FloatArray, told: Sequence[Remark]
    ) -> Estimate:
        """The estimate at common values of the shared parameters with this covariance."""
        gain = np.linalg.solve(self.shared_covariance, self.covariance[self.places]).T
        point = self.point + gain @ (common - self.shared)
        covariance = self.covariance + gain @ (spread - self.shared_covariance) @ gain.T
        point[self.places], covariance[np.ix_(self.places, self.places)] = common, spread
        values = np.where(self.logarithmic, np.exp(np.where(self.logarithmic, point, 0.0)), point)
        values = np.clip(values, own.model.lower, own.model.upper)
        scale = np.where(self.logarithmic, values, 1.0)
        covariance = 0.5 * (covariance + covariance.T) * np.outer(scale, scale)
        error = np.sqrt(np.diag(covariance))
        reach = (own.intervals - own.values[:, None]) * (error / own.std_error)[:, None]
        reach[self.places] = np.outer(error[self.places], [-Z95, Z95])
        return replace(
            own,
            values=values,
            covariance=covariance,
            intervals=values[:, None] + reach,
            errors=None,
            draws=None,
            remarks=(*own.remarks, *told),
        )
