"""Estimates as quantities with errors and intervals, for tables, JSON and reports."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pilotid.chance import Z95
from pilotid.estimates.draws import Draws, Spread, spread_of
from pilotid.estimates.estimate import Estimate
from pilotid.estimates.method import Method, identify
from pilotid.pilot.model import PilotModel
from pilotid.recordings.recording import Recording
from pilotid.seeds import fit_rng
from pilotid.types import FloatArray


@dataclass(frozen=True, eq=False)
class Fitted:
    """All estimates of one model from one recording."""

    recording: Recording
    model: PilotModel
    estimates: tuple[Estimate, ...]


@dataclass(frozen=True)
class Quantity:
    """One number with its standard error and 95 % interval; NaN where the fit failed."""

    key: str
    unit: str
    value: float
    std_error: float
    lower: float
    upper: float


def fit_all(
    recording: Recording, model: PilotModel, methods: Sequence[Method], seed: int
) -> Fitted:
    """Run methods on a recording, each with its own random generator."""
    return Fitted(
        recording,
        model,
        tuple(identify(m, recording, model, fit_rng(seed, m.name)) for m in methods),
    )


def parameters(estimate: Estimate) -> list[Quantity]:
    """The model's parameters, in model order."""
    return [
        Quantity(p.key, p.unit, float(value), float(error), float(low), float(high))
        for p, value, error, (low, high) in zip(
            estimate.model.parameters,
            estimate.values,
            estimate.std_error,
            estimate.intervals,
            strict=True,
        )
    ]


@dataclass(frozen=True)
class Product:
    """A product of parameters that is better known than the parameters themselves."""

    factors: tuple[str, ...]
    unit: str

    @property
    def key(self) -> str:
        """Its name in tables and files."""
        return "*".join(self.factors)

    def of(self, values: FloatArray, keys: tuple[str, ...]) -> FloatArray:
        """The product for parameter sets in the order of the keys, shape (...,)."""
        return np.asarray(np.prod([values[..., keys.index(f)] for f in self.factors], axis=0))

    def gradient(self, values: FloatArray, keys: tuple[str, ...]) -> FloatArray:
        """Its derivative by each parameter of one set, shape (parameters,)."""
        slope = np.zeros(len(keys))
        for factor in self.factors:
            others = Product(tuple(f for f in self.factors if f != factor), "")
            slope[keys.index(factor)] = others.of(values, keys)
        return slope


#: Gain and lead time of the visual channel are correlated at about -0.99; their product, the
#: gain on the error's rate, is known several times more accurately than either.
PRODUCTS = (Product(("Kvis", "tlead"), "s"),)


def products_of(keys: tuple[str, ...]) -> list[Product]:
    """The products whose factors are among the parameters."""
    return [product for product in PRODUCTS if set(product.factors) <= set(keys)]


def product_spreads(draws: Draws) -> list[Spread]:
    """Posteriors of the products."""
    return [
        spread_of(p.key, p.unit, p.of(draws.values, draws.keys), draws.weights)
        for p in products_of(draws.keys)
    ]


def derived(estimate: Estimate) -> list[Quantity]:
    """Products of parameters, by the posterior where there is one, else by the delta method."""
    if estimate.draws is not None:
        return [
            Quantity(s.key, s.unit, s.mean, s.deviation, *s.equal_tailed.tolist())
            for s in product_spreads(estimate.draws)
        ]
    keys, result = estimate.model.keys, []
    for product in products_of(keys):
        value = float(product.of(estimate.values, keys))
        slope = product.gradient(estimate.values, keys)
        error = float(np.sqrt(slope @ estimate.covariance @ slope))
        reach = Z95 * error
        result.append(
            Quantity(product.key, product.unit, value, error, value - reach, value + reach)
        )
    return result
