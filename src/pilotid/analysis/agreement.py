"""Estimates of people held against those of consistent methods.

No truth is known of people.  But where a method is consistent whatever the remnant is, as one that
uses the forcing functions' lines or their instruments alone, what another method estimates must
lie within its errors.  An efficient and right one differs from it by the root of the difference of
their variances, which is less than the reference's standard error (Hausman 1978); a biased one
differs by more, the longer the recording.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pilotid.analysis.rows import Row
from pilotid.document import Block, Text, table_of
from pilotid.numbers import number

#: Methods that are consistent without a model of the remnant.
CONSISTENT = ("fourier", "mle-reference")
#: Median of the magnitude of a standard normal number.
MEDIAN = 0.6745

TEXT = (
    "Differences from a consistent method, over its standard errors: the median magnitude over "
    "parameters and recordings, scaled to 1 where differences are as large as these errors. Right "
    "and more precise methods lie below 1, biased ones above."
)


@dataclass(frozen=True)
class Agreement:
    """How far a method lies from a consistent one.

    Attributes
    ----------
    model, method, reference
        What was fitted, and what it is held against.
    estimates
        Parameters of recordings that both know.
    distance
        See `TEXT`.
    """

    model: str
    method: str
    reference: str
    estimates: int
    distance: float


def agreements(rows: Sequence[Row]) -> list[Agreement]:
    """Every method against every consistent one, the nearest first.

    Parameters
    ----------
    rows
        Parameters of fits of all runs of recordings together; those of single runs do not count.
    """
    known = {
        (row.model, row.method, row.file, row.parameter): row
        for row in rows
        if row.run is None and row.usable and math.isfinite(row.std_error) and row.std_error > 0.0
    }
    apart: dict[tuple[str, str, str], list[float]] = {}
    for (model, method, file, parameter), row in known.items():
        for reference in CONSISTENT:
            other = known.get((model, reference, file, parameter))
            if other is not None and method != reference:
                held = apart.setdefault((model, method, reference), [])
                held.append(abs(row.value - other.value) / other.std_error)
    found = [
        Agreement(*key, len(held), float(np.median(held)) / MEDIAN) for key, held in apart.items()
    ]
    return sorted(found, key=lambda own: (own.model, own.reference, own.distance))


def agreement_blocks(rows: Sequence[Row]) -> list[Block]:
    """The table of `agreements`, and what it means."""
    heads = [
        *(("model",), ("against",), ("method",)),
        ("estimates", str, "parameters of recordings that both know"),
        ("distance", number, "1: as large as the errors of what it is held against"),
    ]
    cells = [
        (own.model, own.reference, own.method, own.estimates, (own.distance, 2))
        for own in agreements(rows)
    ]
    if not cells:
        return [Text("No method without a model of the remnant could fit these recordings.")]
    return [Text(TEXT), table_of("Differences from consistent estimates", heads, cells, 3)]
