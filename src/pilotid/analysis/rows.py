"""The tidy rows that an analysis is made of: one number with its error, and whose it is."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from pilotid.analysis.combine import plain_mean
from pilotid.estimates.estimate import Outcome
from pilotid.support.numbers import Z95

T = TypeVar("T")
K = TypeVar("K", bound=Hashable)

#: The field of a pattern that names who was recorded, and the one that names under what.
SUBJECT, CONDITION = "subject", "condition"
#: The method of what signals show without any model.
MEASURED = "measured"


@dataclass(frozen=True)
class Row:
    """One quantity of one fit: a line of estimates.csv, or of loops.csv.

    Attributes
    ----------
    file
        The recording, as it was named.
    fields
        What the pattern found in the file's name, as pairs of field and value.
    run
        Number of the run, from 1; None where all runs were fitted together.
    model, method
        What was fitted, and by which method (its label).
    parameter, unit
        Key and unit of the quantity: a parameter's key, or that of a loop's, such as
        ``disturbance_crossover``.
    value, std_error, lower, upper
        The estimate, its claimed standard error and its 95 % interval; NaN where there is none.
    outcome
        How the fit ended, as `Outcome.slug`.
    usable
        Whether the value may be used: the fit ended as one that can be believed.
    remarks
        What a user must know of the fit, a sentence each.
    agrees
        Whether the lines of the forcing functions agree, see `pilotid.estimates.parts`.
    determined
        Whether the recording tells it, see `pilotid.estimates.quantities.Quantity`.
    """

    file: str
    fields: tuple[tuple[str, str], ...]
    run: int | None
    model: str
    method: str
    parameter: str
    unit: str
    value: float
    std_error: float
    lower: float
    upper: float
    outcome: str
    usable: bool
    remarks: tuple[str, ...] = ()
    agrees: bool = True
    determined: bool = True

    def field(self, name: str) -> str:
        """The value of a field; empty where the pattern has no such field."""
        return dict(self.fields).get(name, "")

    @property
    def subject(self) -> str:
        """The subject; empty where the pattern has none."""
        return self.field(SUBJECT)

    @property
    def condition(self) -> str:
        """The condition; empty where the pattern has none."""
        return self.field(CONDITION)

    @property
    def stratum(self) -> tuple[tuple[str, str], ...]:
        """All fields but who and under what: contrasts are made within each value of them."""
        return tuple(pair for pair in self.fields if pair[0] not in (SUBJECT, CONDITION))


def grouped(items: Iterable[T], key: Callable[[T], K]) -> dict[K, list[T]]:
    """Items that share a key, in the order of the first of each."""
    groups: dict[K, list[T]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return groups


def in_order(values: Sequence[str]) -> list[str]:
    """Distinct values in a natural order: C2 before C10."""
    import re

    def key(text: str) -> list[tuple[bool, int, str]]:
        return [
            (not part.isdigit(), int(part) if part.isdigit() else 0, part)
            for part in re.split(r"(\d+)", text)
        ]

    return sorted(set(values), key=key)


#: All fields of a row but subject and condition.
Stratum = tuple[tuple[str, str], ...]
#: The model that is believed of a condition within a stratum.
Chosen = Mapping[tuple[Stratum, str], str]


@dataclass(frozen=True)
class Cell:
    """What is known of one subject in one condition.

    Attributes
    ----------
    value, std_error
        The estimate and its claimed standard error; NaN where there is none.
    fault
        Why the value may not be used; empty if it may.
    recordings
        Recordings of the subject in the condition; of several it is the mean.
    at_bound
        Whether the fit ended with a parameter, this or another, at its bound.
    agrees
        Whether the lines of the forcing functions agree with all fits.
    interval
        The claimed 95 % interval; that of several recordings is symmetric.
    determined
        Whether all recordings tell it.
    """

    value: float
    std_error: float
    fault: str = ""
    recordings: int = 1
    at_bound: bool = False
    agrees: bool = True
    interval: tuple[float, float] = (math.nan, math.nan)
    determined: bool = True


@dataclass(frozen=True)
class Layout:
    """One quantity within a stratum, by one method.

    Attributes
    ----------
    stratum, method, parameter, unit
        What it is an estimate of; the units where conditions differ in it.
    models
        Model by condition, in the natural order of the conditions.
    cells
        Cells by condition, then by subject, subjects in natural order.
    """

    stratum: Stratum
    method: str
    parameter: str
    unit: str
    models: dict[str, str]
    cells: dict[str, dict[str, Cell]]

    @property
    def conditions(self) -> list[str]:
        """The conditions that there are."""
        return list(self.models)

    def missing(self, subject: str, condition: str) -> str:
        """Why a subject has no value in a condition, in words; empty if there is one."""
        cell = self.cells.get(condition, {}).get(subject)
        if cell is None:
            return f"{who(subject)} (no recording in {condition})"
        return f"{who(subject)} ({condition}: {cell.fault})" if cell.fault else ""

    def split(self, conditions: Sequence[str]) -> tuple[list[str], list[str]]:
        """Subjects with a value in all these conditions, and the others with the reason."""
        everyone = in_order([s for c in conditions for s in self.cells.get(c, {})])
        whole, out = [], []
        for subject in everyone:
            faults = [fault for c in conditions if (fault := self.missing(subject, c))]
            if faults:
                out.append(faults[0])
            else:
                whole.append(subject)
        return whole, out


def who(subject: str) -> str:
    """A subject in words."""
    return f"subject {subject}" if subject else "a subject without a name"


def layouts(rows: Sequence[Row], chosen: Chosen | None = None) -> list[Layout]:
    """Every quantity by stratum, method and model, from the fits of all runs together.

    Parameters
    ----------
    rows
        Rows of any fits; those of single runs are passed over.
    chosen
        The model of each condition; None to keep every model to itself.  With it a quantity
        that the models of several conditions share is one quantity.
    """

    def counts(row: Row) -> bool:
        own = not chosen or chosen.get((row.stratum, row.condition)) == row.model
        return row.run is None and (own or not row.model)

    order = grouped(
        filter(counts, rows),
        lambda r: (r.stratum, r.method, r.model if chosen is None else "", r.parameter),
    )
    found = [
        _layout(stratum, method, parameter, mine)
        for (stratum, method, _, parameter), mine in order.items()
    ]
    rank = {stratum: place for place, stratum in enumerate(dict.fromkeys(r.stratum for r in rows))}
    return sorted(found, key=lambda layout: rank[layout.stratum])


def _layout(stratum: Stratum, method: str, parameter: str, rows: Sequence[Row]) -> Layout:
    models, cells = {}, {}
    by_condition = grouped(rows, lambda row: row.condition)
    for condition in in_order(list(by_condition)):
        here = by_condition[condition]
        models[condition] = here[0].model
        own = grouped(here, lambda row: row.subject)
        cells[condition] = {subject: _cell(own[subject]) for subject in in_order(list(own))}
    units = ", ".join(dict.fromkeys(row.unit for row in rows))
    return Layout(stratum, method, parameter, units, models, cells)


def _cell(rows: Sequence[Row]) -> Cell:
    """The estimate of one subject in one condition: the mean over recordings if there are more."""
    sound = [row for row in rows if row.usable and math.isfinite(row.value)]
    if not sound:
        fault = next((row.outcome for row in rows if not row.usable), "no value")
        return Cell(math.nan, math.nan, fault, len(rows))
    count = len(sound)
    value = math.fsum(row.value for row in sound) / count
    error = math.sqrt(math.fsum(row.std_error**2 for row in sound)) / count
    at_bound = any(row.outcome == Outcome.AT_BOUND.slug for row in sound)
    error = error if error > 0.0 else math.nan
    interval = (value - Z95 * error, value + Z95 * error)
    if count == 1 and math.isfinite(sound[0].lower) and math.isfinite(sound[0].upper):
        interval = (sound[0].lower, sound[0].upper)
    agrees = all(row.agrees for row in sound)
    determined = all(row.determined for row in sound)
    return Cell(value, error, "", count, at_bound, agrees, interval, determined)


def by_table(
    found: Sequence[Layout], *, one_model: bool
) -> dict[tuple[Stratum, str, str], list[Layout]]:
    """Quantities that share a table: those of one stratum and method, and of one model if so asked.

    The model is empty where a table holds several.
    """
    return grouped(
        found,
        lambda own: (own.stratum, own.method, next(iter(own.models.values())) if one_model else ""),
    )


def mean_and_spread(cells: Sequence[Cell]) -> tuple[float, float]:
    """Mean over usable cells, and their standard deviation; NaN where there are too few."""
    mean = plain_mean(np.array([cell.value for cell in cells]))
    return mean.value, mean.std_error * math.sqrt(len(cells))
