"""The tidy rows that an analysis is made of: one number with its error, and whose it is."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

#: The field of a pattern that names who was recorded, and the one that names under what.
SUBJECT, CONDITION = "subject", "condition"


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

    def field(self, name: str) -> str:
        """The value of a field; empty where the pattern has no such field."""
        return dict(self.fields).get(name, "")

    @property
    def stratum(self) -> tuple[tuple[str, str], ...]:
        """All fields but subject and condition: contrasts are made within each value of them."""
        return tuple(pair for pair in self.fields if pair[0] not in (SUBJECT, CONDITION))


def rows_of(
    file: str,
    fields: tuple[tuple[str, str], ...],
    run: int | None,
    content: Mapping[str, Any],
    what: str,
    told: str,
) -> list[Row]:
    """Every quantity of a fit, or of its loops.

    Parameters
    ----------
    file, fields, run
        What was fitted.
    content
        What `pilotid.analysis.tasks.content_of` gave.
    what, told
        Where it has the quantities, and the remarks on them.
    """
    return [
        Row(
            file=file,
            fields=fields,
            run=run,
            model=content["model"],
            method=estimate["method"],
            parameter=key,
            unit=unit,
            value=_number(value),
            std_error=_number(error),
            lower=_number(lower),
            upper=_number(upper),
            outcome=estimate["outcome"],
            usable=estimate["usable"],
            remarks=tuple(estimate[told]),
        )
        for estimate in content["estimates"]
        for key, unit, value, error, lower, upper in estimate[what]
    ]


def _number(held: float | None) -> float:
    return math.nan if held is None else held


def in_order(values: Sequence[str]) -> list[str]:
    """Distinct values in a natural order: C2 before C10."""
    import re

    def key(text: str) -> list[tuple[bool, int, str]]:
        return [
            (not part.isdigit(), int(part) if part.isdigit() else 0, part)
            for part in re.split(r"(\d+)", text)
        ]

    return sorted(set(values), key=key)
