"""Quantities with errors and intervals: parameters, and products of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pilotid.chance import Z95
from pilotid.document import Column, Table
from pilotid.estimates.draws import Draws, Spread, spread_of
from pilotid.numbers import decimals
from pilotid.types import FloatArray


@dataclass(frozen=True)
class Quantity:
    """One number with its standard error and 95 % interval; NaN where the fit failed.

    Attributes
    ----------
    key, unit
        As printed; no unit for a number without dimension.
    value, std_error
        Value and standard error in that unit.
    lower, upper
        Ends of the 95 % interval.
    """

    key: str
    unit: str
    value: float
    std_error: float
    lower: float
    upper: float

    @property
    def interval(self) -> tuple[float, float]:
        """Lower and upper end of the 95 % interval."""
        return self.lower, self.upper

    def shown(self, plus_minus: str = "±") -> tuple[str, str]:
        """Value with standard error, and interval, to the digits that the error allows."""
        if not math.isfinite(self.value):
            return "-", ""
        error = self.std_error
        if not (math.isfinite(error) and error > 0.0):
            return f"{self.value:.4g}", ""
        digits = decimals(error)
        value = f"{self.value:.{digits}f} {plus_minus} {error:.{digits}f}"
        return value, f"{self.lower:.{digits}f} .. {self.upper:.{digits}f}"

    def to_dict(self) -> dict[str, object]:
        """Plain objects, as JSON has them."""
        return {
            "value": self.value,
            "std_error": self.std_error,
            "interval_95": [self.lower, self.upper],
            "unit": self.unit,
        }

    def __str__(self) -> str:
        value, interval = self.shown()
        unit = f" {self.unit}" if self.unit else ""
        return f"{self.key} = {value}{unit}" + (f", 95 % {interval}" if interval else "")


#: What stands side by side: a name, and quantities with the same keys for all.
SideBySide = Sequence[tuple[str, Sequence[Quantity]]]


def quantity_tables(
    columns: SideBySide, abreast: int, what: str = "parameter"
) -> list[Table[tuple[Quantity, ...]]]:
    """A row for each quantity, two columns for each estimate, so many estimates in a table."""

    def of(place: int, name: str) -> list[Column[tuple[Quantity, ...]]]:
        return [
            Column(name, lambda row: row[place].shown()[0], str),
            Column("95 % interval", lambda row: row[place].shown()[1], str),
        ]

    front: list[Column[tuple[Quantity, ...]]] = [
        Column(what, lambda row: row[0].key),
        Column("unit", lambda row: row[0].unit),
    ]
    tables = []
    for begin in range(0, len(columns), abreast):
        some = columns[begin : begin + abreast]
        own = [column for place, (name, _) in enumerate(some) for column in of(place, name)]
        rows = list(zip(*(quantities for _, quantities in some), strict=True))
        tables.append(Table("", [*front, *own], rows))
    return tables


def abreast(width: int) -> int:
    """How many estimates stand side by side in a terminal of this width."""
    return max(1, (width - 20) // 40)  # an estimate takes some 40 characters


def quantity_of(spread: Spread) -> Quantity:
    """A posterior as a quantity: mean, standard deviation and equal-tailed interval."""
    low, high = spread.equal_tailed.tolist()
    return Quantity(spread.key, spread.unit, spread.mean, spread.deviation, low, high)


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
PRODUCTS = (
    Product(("Kvis", "tlead"), "s"),
    Product(("Kvis1", "tlead1"), "s"),
    Product(("Kvis2", "tlead2"), "s"),
)


def products_of(keys: tuple[str, ...]) -> list[Product]:
    """The products whose factors are among the parameters."""
    return [product for product in PRODUCTS if set(product.factors) <= set(keys)]


def product_spreads(draws: Draws) -> list[Spread]:
    """Posteriors of the products."""
    return [
        spread_of(p.key, p.unit, p.of(draws.values, draws.keys), draws.weights)
        for p in products_of(draws.keys)
    ]


def products_by_delta(
    keys: tuple[str, ...], values: FloatArray, covariance: FloatArray
) -> list[Quantity]:
    """Products of parameters, with errors to first order.

    Parameters
    ----------
    keys
        The parameters' keys.
    values, covariance
        The estimate, shapes (parameters,) and (parameters, parameters).
    """
    result = []
    for product in products_of(keys):
        value = float(product.of(values, keys))
        slope = product.gradient(values, keys)
        error = float(np.sqrt(slope @ covariance @ slope))
        reach = Z95 * error
        result.append(
            Quantity(product.key, product.unit, value, error, value - reach, value + reach)
        )
    return result
