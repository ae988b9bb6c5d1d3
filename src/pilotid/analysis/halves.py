"""Agreement between halves: estimates from the first half of a recording against the second.

Both halves are of one pilot in one condition, so that estimates differ by as much as their errors
claim, where these are right and the pilot does not change.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pilotid.analysis.agreement import MEDIAN
from pilotid.analysis.combine import plain_mean
from pilotid.analysis.recordings import Part
from pilotid.analysis.rows import PERSON, grouped
from pilotid.document import Block, Text, table_of
from pilotid.estimates.method import Method, identify
from pilotid.numbers import unsigned
from pilotid.pilot.model import PilotModel
from pilotid.recordings.recording import Recording
from pilotid.recordings.selection import of_runs
from pilotid.seeds import fit_rng
from pilotid.study.entries import number
from pilotid.types import InputError

COLUMNS = (
    "model", "method", "parameter", "first", "first_std_error", "second", "second_std_error",
    "difference_over_claims",
)  # fmt: skip

TEXT = (
    "Parameters from the first half of the runs (or of the window of one run) less those from the "
    "second: the median magnitude over what is claimed, mean over recordings. Above 1, errors are "
    "too small, or pilots change."
)


@dataclass(frozen=True)
class HalvesApart:
    """A parameter in both halves of a recording: a line of halves.csv.

    Attributes
    ----------
    part
        The recording.
    model, method, parameter
        What was fitted.
    numbers
        Value and standard error in the first half, then in the second.
    """

    part: Part
    model: str
    method: str
    parameter: str
    numbers: tuple[float, float, float, float]

    @property
    def apart(self) -> float:
        """Difference over its claimed error."""
        first, error, second, other = self.numbers
        return (first - second) / math.hypot(error, other)

    @property
    def cells(self) -> list[object]:
        """`COLUMNS`."""
        return [self.model, self.method, self.parameter, *self.numbers, self.apart]


def halves_of(recording: Recording) -> tuple[Recording, ...]:
    """The first and the second half of the runs, or of the window of one; none if too short.

    Of an odd number of runs the one in the middle is left out.
    """
    half, count = recording.runs // 2, recording.runs
    if half:
        first, second = range(1, half + 1), range(count - half + 1, count + 1)
        return of_runs(recording, first, "first half"), of_runs(recording, second, "second half")
    middle = recording.samples // 2 * recording.dt
    try:
        return recording.cut(0.0, middle), recording.cut(middle, 2.0 * middle)
    except InputError:
        return ()


def fit_halves(
    recording: Recording, model: PilotModel, methods: Mapping[str, Method], seed: int
) -> list[list[object]]:
    """Method, parameter, and value and error in either half, where both fits can be used.

    Parameters
    ----------
    recording
        What is halved.
    model, methods, seed
        What is fitted, methods by their labels.
    """
    found: list[list[object]] = []
    halves = halves_of(recording)
    for label, method in methods.items() if halves else ():
        both = [identify(method, half, model, fit_rng(seed, label)) for half in halves]
        if not all(estimate.outcome.usable for estimate in both):
            continue
        for key in model.keys:
            held = [x for e in both for x in (e[key].value, e[key].std_error)]
            if np.isfinite(held).all() and min(held[1::2]) > 0.0:
                found.append([label, key, *map(number, held)])
    return found


def halves_rows(part: Part, content: Mapping[str, Any]) -> Iterator[HalvesApart]:
    """Lines of a model's name and what `fit_halves` gave."""
    for method, parameter, *numbers in content["halves"]:
        first, error, second, other = map(float, numbers)
        yield HalvesApart(part, content["model"], method, parameter, (first, error, second, other))


def halves_blocks(rows: Sequence[HalvesApart]) -> list[Block]:
    """How far halves are apart by each method, within each kind of recording."""

    def kind(row: HalvesApart) -> tuple[str, str, str]:
        words = " ".join(value for field, value in row.part.fields if field not in PERSON)
        return words, row.model, row.method

    cells = []
    for names, own in grouped(rows, kind).items():
        by_part = grouped(own, lambda row: row.part)
        medians = [np.median([abs(row.apart) for row in each]) for each in by_part.values()]
        mean = plain_mean(np.array(medians) / MEDIAN)
        cells.append((*names, len(medians), (mean.value, mean.std_error)))
    heads = [
        *(("recordings",), ("model",), ("method",)),
        ("halved", str, "recordings whose halves could both be fitted"),
        ("halves / claims", unsigned, "1: halves differ as much as claimed"),
    ]
    if not cells:
        return [Text("No recording could be fitted in both halves.")]
    return [Text(TEXT), table_of("Halves of recordings", heads, cells, 3)]
