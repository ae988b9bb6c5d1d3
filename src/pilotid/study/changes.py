"""What changed from one study to another of the same recordings: paired ratios of losses."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from pilotid.study.comparison import Comparison, MethodResults, comparison_of, loss_ratios
from pilotid.study.scores import Interval
from pilotid.study.store import Store
from pilotid.support.types import InputError


class Change(NamedTuple):
    """The loss of one parameter, or of all, in the second study over that in the first."""

    scenario: str
    method: str
    parameter: str
    ratio: Interval


def read_study(folder: Path) -> Comparison:
    """The study that `pilotid compare` wrote to a folder."""
    with Store(folder) as store:
        return comparison_of(store)


def find_changes(first: Comparison, second: Comparison) -> tuple[list[Change], list[str]]:
    """Ratios of losses on the recordings that both studies have, and what is left out.

    Parameters
    ----------
    first, second
        The studies, in this order.

    Raises
    ------
    InputError
        If the studies have no recordings in common.
    """
    seeds = [study.about.get("seed", "?") for study in (first, second)]
    if seeds[0] != seeds[1]:
        raise InputError(
            f"{second.folder}: has the seed {seeds[1]} and other recordings than {first.folder} "
            f"(seed {seeds[0]}); set the columns `loss` of both summary.csv side by side"
        )
    found, unlike = [], {}
    for ours in first.cells:
        theirs = second.at(ours.scenario.name, ours.method)
        if theirs is None:
            continue
        if why := _difference(ours, theirs):
            unlike[ours.scenario.name] = f"{ours.scenario.name} is left out: {why}"
            continue
        ratios = loss_ratios(theirs, ours).items()
        found += [Change(ours.scenario.name, ours.method, *own) for own in ratios]
    if not found:
        told = "; ".join(["", *unlike.values()])
        raise InputError(f"{second.folder}: has no fits of the recordings of {first.folder}{told}")
    return found, list(unlike.values())


def _difference(ours: MethodResults, theirs: MethodResults) -> str:
    """Why two fits of scenarios of one name are not of the same recordings; empty if they are."""
    if ours.scenario.settings != theirs.scenario.settings:
        return "its settings differ"
    draws = {r.unit.replication: r.draw for r in theirs.results}
    pairs = [(r.draw, draws.get(r.unit.replication)) for r in ours.results]
    same = all(a.same(b) for a, b in pairs if a is not None and b is not None)
    return "" if same else "other pilots were drawn"
