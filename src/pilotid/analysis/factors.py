"""Factors that conditions are combinations of: repeated-measures analysis of variance.

F and p of each main effect and interaction are those of statsmodels; p is corrected for effects
that scatter differently after Greenhouse and Geisser (1959); the effect size is partial eta
squared.  Subjects with a usable estimate in every condition count.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from pathlib import Path

import numpy as np

from pilotid.analysis.combine import NAN, ROUNDING
from pilotid.analysis.contrasts import is_across
from pilotid.analysis.rows import Chosen, Layout, Row, Stratum, in_order, layouts
from pilotid.pilot.catalogue import MODELS
from pilotid.pilot.model import PilotModel
from pilotid.support.disk import require_file
from pilotid.support.types import FloatArray, InputError

#: Level of each condition, by factor.
Factors = Mapping[str, Mapping[str, str]]
LARGEST = 2**20  # bytes of a file of factors
FEWEST = 2  # levels of a factor, and subjects of a test


@dataclass(frozen=True)
class Effect:
    """A main effect, or an interaction, on one quantity: a line of factors.csv.

    Attributes
    ----------
    stratum, method, parameter, unit
        What was estimated, and how.
    effect
        The factors, joined by colons.
    subjects
        Those with a usable estimate in every condition.
    notes
        Who is left out and why, and what could not be worked out.
    f, df1, df2, p
        F, its degrees of freedom and its p; NaN where there is no test, as all that follows.
    epsilon, p_corrected
        Greenhouse and Geisser's epsilon, and p with both degrees of freedom times that.
    eta_squared
        Partial eta squared.
    """

    stratum: Stratum
    method: str
    parameter: str
    unit: str
    effect: str
    subjects: tuple[str, ...]
    notes: tuple[str, ...] = ()
    f: float = NAN
    df1: float = NAN
    df2: float = NAN
    p: float = NAN
    epsilon: float = NAN
    p_corrected: float = NAN
    eta_squared: float = NAN


def factors_of(text: str, conditions: Sequence[str]) -> dict[str, dict[str, str]]:
    """The factors in a text such as ``motion=C1,C2:off;C3,C4:on``, or in a CSV file.

    The file has a column ``condition``, and one for each factor.

    Raises
    ------
    InputError
        If it is neither, a level has no condition, or the conditions are no full crossing.
    """
    is_file = text.lower().endswith(".csv")
    found = _in_file(Path(text)) if is_file else _in_text(text)
    for factor, levels in found.items():
        for condition, level in levels.items():
            if condition not in conditions:
                there = ", ".join(name for name in conditions if name) or "none"
                raise InputError(
                    f"--factors: the level {level} of {factor} names the condition {condition}, "
                    f"which no file has; the conditions are {there}"
                )
        if len(set(levels.values())) < FEWEST:
            raise InputError(f"--factors: {factor} has one level only; give it two or more")
    named = in_order([condition for levels in found.values() for condition in levels])
    cells: dict[tuple[str, ...], str] = {}
    for condition in named:
        for factor, levels in found.items():
            if condition not in levels:
                raise InputError(f"--factors: the condition {condition} has no level of {factor}")
        cell = tuple(levels[condition] for levels in found.values())
        if cell in cells:
            raise InputError(
                f"--factors: {cells[cell]} and {condition} have the same levels "
                f"({', '.join(cell)}); name a factor that tells them apart"
            )
        cells[cell] = condition
    for cell in product(*(dict.fromkeys(levels.values()) for levels in found.values())):
        if cell not in cells:
            raise InputError(f"--factors: no condition has the levels {', '.join(cell)}")
    return found


def _in_text(text: str) -> dict[str, dict[str, str]]:
    found: dict[str, dict[str, str]] = {}
    factor = ""
    for part in (part.strip() for part in text.split(";") if part.strip()):
        name, equals, rest = part.partition("=")
        factor = name.strip() if equals else factor
        members, colon, level = (rest if equals else part).rpartition(":")
        names = [name.strip() for name in members.split(",") if name.strip()]
        if not (factor and colon and level.strip() and names):
            raise InputError(
                f"--factors: '{part}' must be FACTOR=CONDITIONS:LEVEL, as in motion=C1,C2:off;"
                "C3,C4:on"
            )
        for condition in names:
            if condition in found.setdefault(factor, {}):
                raise InputError(f"--factors: {condition} has two levels of {factor}; give one")
            found[factor][condition] = level.strip()
    if not found:
        raise InputError("--factors: names no factor; write for example motion=C1,C2:off;C3,C4:on")
    return found


def _in_file(path: Path) -> dict[str, dict[str, str]]:
    require_file(path, LARGEST)
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = list(csv.DictReader(file, strict=True))
    except (OSError, ValueError, csv.Error) as error:
        raise InputError(f"{path}: cannot be read as a table of factors ({error})") from None
    names = [name for name in (rows[0] if rows else ()) if name and name != "condition"]
    if not names or any(not row.get(name) for row in rows for name in ("condition", *names)):
        raise InputError(
            f"{path}: must have a column condition, one for each factor, and a level in every cell"
        )
    return {name: {row["condition"]: row[name] for row in rows} for name in names}


def effects(
    rows: Sequence[Row],
    factors: Factors,
    chosen: Chosen | None = None,
    models: Mapping[str, PilotModel] = MODELS,
) -> list[Effect]:
    """Every main effect and interaction, for each stratum, method, model and quantity.

    Parameters
    ----------
    rows
        Rows of estimates.csv and loops.csv; only fits of all runs together are used.
    factors
        What `factors_of` gave.
    chosen, models
        As for `pilotid.analysis.contrasts.contrasts`.
    """
    if not factors:
        return []
    own = [layout for layout in layouts(rows, chosen) if "," not in layout.unit]
    return [effect for layout in own for effect in _effects(layout, factors, models)]


def _effects(
    layout: Layout, factors: Factors, models: Mapping[str, PilotModel]
) -> Iterator[Effect]:
    levels = [list(dict.fromkeys(own.values())) for own in factors.values()]
    by_cell = {tuple(own[c] for own in factors.values()): c for c in next(iter(factors.values()))}
    conditions = [by_cell[cell] for cell in product(*levels)]
    if not set(conditions) <= set(layout.conditions):
        return  # a parameter that some models do not have
    subjects, out = layout.split(conditions)
    table = np.array([[layout.cells[c][s].value for c in conditions] for s in subjects])
    notes = [f"left out: {'; '.join(out)}"] if out else []
    known = dict.fromkeys(layout.models[c] for c in conditions)
    if is_across(layout.parameter, [models[name] for name in known if name in models]):
        notes.append("across models")
    tested = variances_of(table, [len(own) for own in levels])
    for size in range(1, len(factors) + 1):
        for some in combinations(range(len(factors)), size):
            yield Effect(
                layout.stratum,
                layout.method,
                layout.parameter,
                layout.unit,
                ":".join(list(factors)[place] for place in some),
                tuple(subjects),
                tuple(notes if some in tested else [*notes, "no test: nothing scatters"]),
                *tested.get(some, ()),
            )


def variances_of(
    table: FloatArray, levels: Sequence[int]
) -> dict[tuple[int, ...], tuple[float, ...]]:
    """F and all behind it in `Effect` by the places of an effect's factors, if it scatters.

    Parameters
    ----------
    table
        Shape (subjects, conditions), conditions in the order of `product` over the factors.
    levels
        Number of levels of each factor.
    """
    from pandas import DataFrame
    from scipy.special import fdtrc
    from statsmodels.stats.anova import AnovaRM

    if len(table) < FEWEST:
        return {}
    names = [f"f{place}" for place in range(len(levels))]
    cells = list(product(range(len(table)), *map(range, levels)))
    frame = DataFrame(cells, columns=["subject", *names]).assign(value=table.ravel())
    found: dict[tuple[int, ...], tuple[float, ...]] = {}
    with np.errstate(divide="ignore", invalid="ignore"):
        tested = AnovaRM(frame, "value", "subject", names).fit().anova_table
    for effect, row in tested.iterrows():
        some = tuple(names.index(name) for name in effect.split(":"))
        f, df1, df2, p = map(float, row[["F Value", "Num DF", "Den DF", "Pr > F"]])
        own = np.ones((1, 1))
        for place, count in enumerate(levels):
            mean = np.full((count, count), 1.0 / count)
            own = np.kron(own, np.eye(count) - mean if place in some else mean)
        spread = np.cov(table @ own, rowvar=False)
        if np.sqrt(np.trace(spread)) <= ROUNDING * np.abs(table).max():
            continue
        epsilon = float(np.trace(spread) ** 2 / (df1 * np.sum(spread**2)))
        corrected = float(fdtrc(epsilon * df1, epsilon * df2, f))
        found[some] = f, df1, df2, p, epsilon, corrected, f * df1 / (f * df1 + df2)
    return found
