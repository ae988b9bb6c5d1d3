"""Differences between two parameters of the same fits, such as a lead before and after a change.

A pilot who changes has both in one fit, so that the difference is paired in the subject and in
the recording.  Errors of parameters of one fit are correlated, and the claimed ones say nothing
of a difference: only its scatter over subjects counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from pilotid.analysis.cells import Chosen, Layout, layouts, who
from pilotid.analysis.combine import NAN, holm
from pilotid.analysis.contrasts import Contrast, Pair, plain
from pilotid.analysis.rows import CONDITION, Row
from pilotid.types import InputError


def parted(
    rows: Sequence[Row], pairs: Sequence[tuple[str, str]]
) -> tuple[list[tuple[str, str]], list[tuple[str, str]]]:
    """Pairs of conditions, and pairs of parameters.

    Parameters
    ----------
    rows
        Rows of estimates.csv and loops.csv.
    pairs
        What the user compares; a name that is both is a condition.

    Raises
    ------
    InputError
        If a pair has one parameter twice.
    """
    conditions = {row.field(CONDITION) for row in rows}
    parameters = {row.parameter for row in rows} - conditions
    own = [pair for pair in pairs if set(pair) <= parameters]
    for pair in own:
        if pair[0] == pair[1]:
            raise InputError(f"the contrast {':'.join(pair)} names one parameter twice; name two")
    return [pair for pair in pairs if pair not in own], own


def within_fits(
    rows: Sequence[Row], pairs: Sequence[tuple[str, str]], chosen: Chosen | None = None
) -> list[Contrast]:
    """Second parameter less the first over subjects, for each condition, method and model.

    Parameters
    ----------
    rows
        Rows of estimates.csv and loops.csv; only fits of all runs together count.
    pairs
        Parameters, ``("tlead1", "tlead2")`` for tlead2 less tlead1.
    chosen
        See `pilotid.analysis.contrasts.contrasts`.

    Returns
    -------
    list of Contrast
        Both conditions are that of the fits.  p is corrected after Holm for the number of
        conditions.
    """
    groups: dict[tuple[object, ...], dict[str, Layout]] = {}
    for layout in layouts(rows, chosen):
        place = layout.stratum, layout.method, tuple(layout.models.items())
        groups.setdefault(place, {})[layout.parameter] = layout
    result = []
    for own in groups.values():
        for a, b in pairs:
            if a not in own or b not in own:
                continue
            made = [_within(own[a], own[b], condition) for condition in own[a].conditions]
            corrected = holm([c.p for c in made])
            result += [replace(c, p_holm=p) for c, p in zip(made, corrected, strict=True)]
    return result


def _within(first: Layout, second: Layout, condition: str) -> Contrast:
    subjects, out = first.split((condition,))
    also, others = second.split((condition,))
    subjects = [subject for subject in subjects if subject in also]
    out = list(dict.fromkeys([*out, *others]))
    notes = [f"left out: {'; '.join(out)}"] if out else []
    pairs = []
    for subject in subjects:
        one, two = (layout.cells[condition][subject] for layout in (first, second))
        pairs.append(Pair(subject, one.value, two.value, NAN, NAN))
        notes += [f"{who(subject)}: a parameter is at its bound"] * one.at_bound
    contrast = Contrast(
        first.stratum,
        condition,
        condition,
        first.models[condition],
        first.models[condition],
        first.method,
        f"{second.parameter} - {first.parameter}",
        ", ".join(dict.fromkeys((first.unit, second.unit))),
        tuple(pairs),
    )
    if first.unit != second.unit:
        return replace(contrast, notes=(*notes, f"the units differ ({contrast.unit}): no test"))
    if len(pairs) < 2:
        notes.append(f"{len(pairs) or 'no'} subject in the condition: a test takes two")
    return plain(replace(contrast, notes=tuple(notes)))
