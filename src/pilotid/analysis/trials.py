"""What the fits of each condition are worth: one recording of it simulated and fitted again."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pilotid.analysis.analyse import Analysis, Fit, Group, group_of
from pilotid.analysis.rows import grouped
from pilotid.report.study import write_report
from pilotid.study.study import Bar
from pilotid.study.trust import Trust, trial_of
from pilotid.types import InputError

FOLDER = "trust"


@dataclass(frozen=True, eq=False)
class Tried:
    """The trial of one condition.

    Attributes
    ----------
    words
        The condition, and the model that was fitted there.
    folder
        Where the trial's own report is.
    trust
        What simulations say.
    """

    words: str
    folder: Path
    trust: Trust


def typical(fits: list[Fit]) -> Fit | None:
    """The fit nearest the median of all, each parameter in its median absolute deviation."""
    usable = [fit for fit in fits if fit.content["estimates"][0]["usable"]]
    if not usable:
        return None
    values = np.array([[q[2] for q in f.content["estimates"][0]["parameters"]] for f in usable])
    away = np.abs(values - np.median(values, axis=0))
    spread = np.median(away, axis=0)
    distance = np.sum(np.divide(away, spread, out=np.zeros_like(away), where=spread > 0.0), axis=1)
    return usable[int(np.argmin(distance))]


def tried_conditions(
    analysis: Analysis,
    folder: Path,
    replications: int,
    places: Mapping[str, str],
    bar: Bar,
    workers: int | None,
) -> tuple[list[Tried], list[str]]:
    """Simulate a typical recording of each condition, and fit it by the methods of the analysis.

    Parameters
    ----------
    analysis
        What was fitted.
    folder
        The analysis's own.
    replications
        Simulations of each.
    places
        Where models that are not the catalogue's are found, by name.
    bar, workers
        As in `Trial.run`.

    Returns
    -------
    list of Tried, list of str
        Those that could be simulated, and a sentence for each condition that could not.
    """
    settings = analysis.settings

    def kind(fit: Fit) -> tuple[Group, str]:
        of = tuple(pair for pair in group_of(fit.part) if pair[0] != "file")
        return of, fit.content["model"]

    groups = grouped((fit for fit in analysis.fits if fit.run is None), kind)
    done, refused = [], []
    for (group, model), fits in groups.items():
        words = " ".join([value for _, value in group] or ["all"])
        example = typical(fits)
        if example is None:
            refused.append(f"{words}, {model}: no fit is usable, and nothing was simulated.")
            continue
        recording = example.part.recording(settings.reading)
        if settings.element is not None:
            recording = replace(recording, controlled_element=settings.element.name)
        own = re.sub(r"[^\w.]+", "-", f"{words}-{model}", flags=re.ASCII)
        place, named = folder / FOLDER / own, settings.known[model]
        try:
            trial = trial_of(recording, named, list(settings.methods.values()), settings.seed)
            trust = trial.run(
                place, replications, settings.seed, workers, places.get(model, ""), bar
            )
        except InputError as error:
            refused.append(f"{words}: {error}.")
            continue
        write_report(place, trust.comparison)
        done.append(Tried(f"{words}, {model}", place, trust))
    return done, refused
