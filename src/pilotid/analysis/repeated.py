"""All conditions at once: repeated-measures analysis of variance, and a linear mixed model.

The analysis of variance, by statsmodels, takes the subjects with a usable
estimate in every condition; p is corrected for unequal variances of the differences by Greenhouse
and Geisser (1959).  The mixed model takes all usable estimates.  Its likelihood-ratio test trusts
large numbers: with few subjects its p is too small, and the corrected p is the one to report.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pilotid.analysis.cells import Chosen, Layout, Stratum, layouts
from pilotid.analysis.combine import NAN, ROUNDING
from pilotid.analysis.mixed import random_intercept
from pilotid.analysis.rows import Row
from pilotid.types import FloatArray


@dataclass(frozen=True)
class Repeated:
    """One parameter over all conditions; what cannot be worked out is NaN, and `notes` say why.

    Attributes
    ----------
    stratum, method, parameter, unit
        What was estimated, and how.
    conditions, models
        The conditions, and the model of each.
    subjects
        Those with a usable estimate in every condition.
    f, df1, df2, p
        F of the analysis of variance, its degrees of freedom, and its p.
    epsilon, p_corrected
        Greenhouse and Geisser's epsilon, and p with both degrees of freedom times that.
    estimates
        Number of estimates in the mixed model.
    likelihood_ratio, mixed_p
        Twice the gain in log-likelihood by letting conditions differ, and its p.
    between_subjects, residual
        Standard deviations of the mixed model: of subjects, and within them (REML).
    notes
        Who is left out and why, and what statsmodels had to say.
    """

    stratum: Stratum
    method: str
    parameter: str
    unit: str
    conditions: tuple[str, ...]
    models: tuple[str, ...]
    subjects: tuple[str, ...]
    f: float = NAN
    df1: float = NAN
    df2: float = NAN
    p: float = NAN
    epsilon: float = NAN
    p_corrected: float = NAN
    estimates: int = 0
    likelihood_ratio: float = NAN
    mixed_p: float = NAN
    between_subjects: float = NAN
    residual: float = NAN
    notes: tuple[str, ...] = ()


def repeated(rows: Sequence[Row], chosen: Chosen | None = None) -> list[Repeated]:
    """Whether conditions differ, for each stratum, method, model and parameter.

    Parameters
    ----------
    rows
        Rows of estimates.csv and loops.csv; only fits of all runs together are used.
    chosen
        The model of each stratum and condition, as for `contrasts`.

    Returns
    -------
    One for each quantity with two conditions or more.
    """
    return [_repeated(layout) for layout in layouts(rows, chosen) if len(layout.conditions) > 1]


def _repeated(layout: Layout) -> Repeated:
    usable = {
        condition: {s: cell.value for s, cell in cells.items() if not cell.fault}
        for condition, cells in layout.cells.items()
    }
    empty = [condition for condition, values in usable.items() if not values]
    conditions = tuple(c for c in layout.conditions if c not in empty)
    notes = [f"left out: {c} (no usable estimate)" for c in empty]
    subjects, out = layout.split(conditions)
    if out:
        notes.append(f"not in the analysis of variance: {'; '.join(out)}")
    result = Repeated(
        layout.stratum,
        layout.method,
        layout.parameter,
        layout.unit,
        conditions,
        tuple(layout.models[c] for c in conditions),
        tuple(subjects),
        notes=tuple(notes),
    )
    if len(conditions) < 2 or "," in layout.unit:
        why = "the units differ" if "," in layout.unit else "fewer than two conditions are left"
        return replace(result, notes=(*result.notes, f"no analysis: {why}"))
    table = np.array([[usable[c][s] for c in conditions] for s in subjects])
    return _mixed(_variance(result, table), usable)


def _variance(result: Repeated, table: FloatArray) -> Repeated:
    """With the analysis of variance of a table, shape (subjects, conditions)."""
    if len(table) < 2:
        return replace(
            result,
            notes=(*result.notes, "no analysis of variance: fewer than two subjects are complete"),
        )
    residual = table - table.mean(axis=1, keepdims=True) - table.mean(axis=0) + table.mean()
    if np.abs(residual).max() <= ROUNDING * np.abs(table).max():
        told = "no analysis of variance: all subjects differ alike between the conditions"
        return replace(result, notes=(*result.notes, told))
    from pandas import DataFrame
    from scipy.special import fdtrc
    from statsmodels.stats.anova import AnovaRM

    count, conditions = table.shape
    frame = DataFrame(
        {
            # statsmodels takes numbers: names of conditions may hold anything
            "value": table.ravel(),
            "subject": np.repeat(np.arange(count), conditions),
            "condition": np.tile(np.arange(conditions), count),
        }
    )
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        found = AnovaRM(frame, "value", "subject", within=["condition"]).fit().anova_table
    f, df1, df2, p = (
        float(found.loc["condition", name]) for name in ("F Value", "Num DF", "Den DF", "Pr > F")
    )
    epsilon = sphericity(table)
    return replace(
        result,
        f=f,
        df1=df1,
        df2=df2,
        p=p,
        epsilon=epsilon,
        p_corrected=float(fdtrc(epsilon * df1, epsilon * df2, f)),
        notes=(*result.notes, *_words(heard)),
    )


def sphericity(table: FloatArray) -> float:
    """Greenhouse and Geisser's epsilon of a table, shape (subjects, conditions).

    1 if all differences between conditions scatter alike, 1/(conditions - 1) at the worst.
    """
    within = table - table.mean(axis=1, keepdims=True)  # the contrasts of the conditions
    covariance = np.cov(within, rowvar=False)
    worst = 1.0 / (table.shape[1] - 1)
    return float(worst * np.trace(covariance) ** 2 / np.sum(covariance**2))


def _mixed(result: Repeated, usable: dict[str, dict[str, float]]) -> Repeated:
    """With a mixed model of all usable estimates: conditions, and an intercept for each subject."""
    entries = [(c, s, usable[c][s]) for c in result.conditions for s in usable[c]]
    values = np.array([value for _, _, value in entries])
    subjects = np.array([subject for _, subject, _ in entries])
    result = replace(result, estimates=len(entries))
    scale = float(np.std(values))
    count = len(set(subjects.tolist()))
    free = len(entries) - len(result.conditions) - count + 1
    if count < 2 or free < 1:
        return replace(result, notes=(*result.notes, "no mixed model: too few estimates"))
    named = np.array([condition for condition, _, _ in entries])
    level = np.ones((len(entries), 1))
    effects = np.column_stack([level, *(named == c for c in result.conditions[1:])]).astype(float)
    groups = np.unique(subjects, return_inverse=True)[1]
    additive = np.column_stack([effects, groups[:, None] == np.arange(1, count)])
    rest = values - additive @ np.linalg.lstsq(additive, values)[0]
    if np.abs(rest).max() <= ROUNDING * np.abs(values).max():
        told = "no mixed model: all subjects differ alike between the conditions"
        return replace(result, notes=(*result.notes, told))
    from scipy.special import chdtrc

    # In units of their own scatter, rounding is the same for every parameter.
    scaled = (values - values.mean()) / scale
    full, none = (
        random_intercept(scaled, design, groups, restricted=False) for design in (effects, level)
    )
    spread = random_intercept(scaled, effects, groups, restricted=True)
    gain = max(0.0, 2.0 * (full.log_likelihood - none.log_likelihood))
    return replace(
        result,
        likelihood_ratio=gain,
        mixed_p=float(chdtrc(len(result.conditions) - 1, gain)),
        between_subjects=scale * spread.between,
        residual=scale * spread.within,
    )


def _words(heard: Sequence[warnings.WarningMessage]) -> list[str]:
    """What statsmodels warned of, each once, on one line."""
    texts = dict.fromkeys(" ".join(str(warning.message).split()) for warning in heard)
    return [f"statsmodels: {text}" for text in texts]
