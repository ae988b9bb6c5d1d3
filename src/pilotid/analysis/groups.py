"""Groups of subjects compared: a factor between subjects, beside the conditions within them.

In each condition two groups are compared by Welch's t-test, which takes no equal variances.  Over
all conditions, subjects with a usable estimate in each count: the main effect of the group, and
its interaction with the condition, by the analysis of variance of a split plot.  That is the mixed
model with an intercept for each subject, exact however few there are where nothing is missing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from pilotid.analysis.combine import NAN, ROUNDING, holm, mean_of
from pilotid.analysis.factors import Effect, Variance, contrasts_of, notes_on
from pilotid.analysis.rows import (
    CONDITION,
    GROUP,
    Chosen,
    Layout,
    Row,
    Stratum,
    group_in,
    in_order,
    layouts,
)
from pilotid.pilot.catalogue import MODELS
from pilotid.pilot.model import PilotModel
from pilotid.types import FloatArray


@dataclass(frozen=True)
class GroupDifference:
    """A quantity's difference between two groups in one condition: a line of groups.csv.

    What cannot be worked out is NaN.

    Attributes
    ----------
    stratum, condition, method, parameter, unit
        What was estimated, and how.
    group_a, group_b, subjects_a, subjects_b
        What is compared, and the subjects with a usable estimate.
    mean_a, mean_b
        Means over these subjects.
    difference, std_error, freedom, t, p, lower, upper
        Mean of b less that of a, with Welch's test and the 95 % interval.
    p_holm
        p after Holm's correction for the number of pairs of groups and conditions.
    effect_size
        Hedges' g, by the standard deviation within the groups.
    """

    stratum: Stratum
    condition: str
    method: str
    parameter: str
    unit: str
    group_a: str
    group_b: str
    subjects_a: int
    subjects_b: int
    mean_a: float = NAN
    mean_b: float = NAN
    difference: float = NAN
    std_error: float = NAN
    freedom: float = NAN
    t: float = NAN
    p: float = NAN
    p_holm: float = NAN
    lower: float = NAN
    upper: float = NAN
    effect_size: float = NAN


def group_differences(rows: Sequence[Row], chosen: Chosen | None = None) -> list[GroupDifference]:
    """Differences between groups in each condition, for each stratum, method, model and quantity.

    Parameters
    ----------
    rows
        Rows of estimates.csv and loops.csv; only fits of all runs together are used.
    chosen
        As for `pilotid.analysis.contrasts.contrasts`.
    """
    found: list[GroupDifference] = []
    for layout in _grouped(rows, chosen):
        made = []
        for condition in layout.conditions:
            cells = layout.cells[condition]
            values = {s: cell.value for s, cell in cells.items() if not cell.fault}
            for a, b in combinations(in_order([group_in(s) for s in cells]), 2):
                own = [np.array([v for s, v in values.items() if group_in(s) == g]) for g in (a, b)]
                made.append(_difference(layout, condition, (a, b), own))
        corrected = holm([one.p for one in made])
        found += [replace(one, p_holm=p) for one, p in zip(made, corrected, strict=True)]
    return found


def _grouped(rows: Sequence[Row], chosen: Chosen | None) -> list[Layout]:
    some = [row for row in rows if row.field(GROUP)]
    return [layout for layout in layouts(some, chosen) if "," not in layout.unit]


def _difference(
    layout: Layout, condition: str, names: tuple[str, str], values: Sequence[FloatArray]
) -> GroupDifference:
    counts = [len(own) for own in values]
    stratum, method, parameter, unit = layout.stratum, layout.method, layout.parameter, layout.unit
    found = GroupDifference(stratum, condition, method, parameter, unit, *names, *counts)
    if not min(counts):
        return found
    means = [float(own.mean()) for own in values]
    found = replace(found, mean_a=means[0], mean_b=means[1], difference=means[1] - means[0])
    if min(counts) < 2:
        return found
    squares = [float(own.var(ddof=1)) / len(own) for own in values]
    error = math.sqrt(sum(squares))
    if error <= ROUNDING * max(map(abs, means)):
        return found
    freedom = error**4 / sum(q**2 / (n - 1) for q, n in zip(squares, counts, strict=True))
    test = mean_of(found.difference, error, freedom)
    within = sum(float(np.sum((own - own.mean()) ** 2)) for own in values) / (sum(counts) - 2)
    correction = 1.0 - 3.0 / (4.0 * (sum(counts) - 2) - 1.0)
    return replace(
        found,
        std_error=error,
        freedom=freedom,
        t=test.t,
        p=test.p,
        lower=test.lower,
        upper=test.upper,
        effect_size=correction * found.difference / math.sqrt(within),
    )


def group_effects(
    rows: Sequence[Row],
    chosen: Chosen | None = None,
    models: Mapping[str, PilotModel] = MODELS,
) -> list[Effect]:
    """Main effect of the group and its interaction with the condition.

    Parameters
    ----------
    rows, chosen, models
        As for `pilotid.analysis.factors.effects`.
    """
    return [e for layout in _grouped(rows, chosen) for e in _effects(layout, models)]


def _effects(layout: Layout, models: Mapping[str, PilotModel]) -> Iterator[Effect]:
    conditions = layout.conditions
    subjects, out = layout.split(conditions)
    names = [group_in(s) for s in subjects]
    groups = np.unique(names, return_inverse=True)[1] if names else np.zeros(0, dtype=int)
    table = np.array([[layout.cells[c][s].value for c in conditions] for s in subjects])
    notes = notes_on(layout, conditions, out, models)
    count = len(conditions)
    plans = {GROUP: np.full((1, count), count**-0.5)}
    if count > 1:
        plans[f"{GROUP}:{CONDITION}"] = contrasts_of(count)
    for effect, contrasts in plans.items():
        tested = variance_between(table, contrasts, groups) if names else Variance()
        yield Effect(
            layout.stratum,
            layout.method,
            layout.parameter,
            layout.unit,
            effect,
            tuple(subjects),
            tested,
            tuple(notes if math.isfinite(tested.f) else [*notes, "no test: too few subjects"]),
        )


def variance_between(
    table: FloatArray, contrasts: FloatArray, groups: NDArray[np.intp]
) -> Variance:
    """The test that groups do not differ in contrasts of the conditions.

    Parameters
    ----------
    table
        Shape (subjects, conditions).
    contrasts
        Orthonormal contrasts of the conditions, shape (size, conditions): their mean for the main
        effect, all others for the interaction.
    groups
        The group of each subject, numbered from 0, shape (subjects,).
    """
    from scipy.special import fdtrc

    own, count = table @ contrasts.T, int(groups.max(initial=-1)) + 1
    size, left = len(contrasts), len(table) - count
    if count < 2 or left < 1:
        return Variance()
    means = np.array([own[groups == g].mean(axis=0) for g in range(count)])
    rest = own - means[groups]
    if np.abs(rest).max() <= ROUNDING * np.abs(table).max():
        return Variance()
    between = float(np.sum((means[groups] - own.mean(axis=0)) ** 2))
    within = float(np.sum(rest**2))
    df1, df2 = float(size * (count - 1)), float(size * left)
    f = between / df1 / (within / df2)
    covariance = rest.T @ rest
    epsilon = float(np.trace(covariance) ** 2 / (size * np.sum(covariance**2)))
    p, corrected = (float(fdtrc(e * df1, e * df2, f)) for e in (1.0, epsilon))
    return Variance(f, df1, df2, p, epsilon, corrected, between / (between + within))
