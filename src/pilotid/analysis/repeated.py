"""All conditions at once: repeated-measures analysis of variance, and a linear mixed model.

The analysis of variance takes the subjects with a usable estimate in every condition, see
`pilotid.analysis.factors`.  The mixed model takes all usable estimates.  Its likelihood-ratio
test trusts large numbers: with few subjects its p is too small, and the corrected p is the one to
report.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from pilotid.analysis.combine import NAN, ROUNDING
from pilotid.analysis.factors import contrasts_of, variance_of
from pilotid.analysis.rows import Chosen, Layout, Row, Stratum, layouts
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
    eta_squared
        Partial eta squared, the effect's size.
    estimates
        Number of estimates in the mixed model.
    likelihood_ratio, mixed_p
        Twice the gain in log-likelihood by letting conditions differ, and its p.
    between_subjects, residual
        Standard deviations of the mixed model: of subjects, and within them (REML).
    notes
        Who is left out and why.
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
    eta_squared: float = NAN
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
    numbers: dict[str, float] = {}
    count = 0
    if len(conditions) < 2 or "," in layout.unit:
        why = "the units differ" if "," in layout.unit else "fewer than two conditions are left"
        notes.append(f"no analysis: {why}")
    else:
        table = np.array([[usable[c][s] for c in conditions] for s in subjects])
        entries = [(c, s, value) for c in conditions for s, value in usable[c].items()]
        count = len(entries)
        numbers = {**_variance(table, notes), **_mixed(entries, conditions, notes)}
    return Repeated(
        layout.stratum,
        layout.method,
        layout.parameter,
        layout.unit,
        conditions,
        tuple(layout.models[c] for c in conditions),
        tuple(subjects),
        estimates=count,
        notes=tuple(notes),
        **numbers,
    )


def _variance(table: FloatArray, notes: list[str]) -> dict[str, float]:
    """The analysis of variance of a table, shape (subjects, conditions)."""
    if len(table) < 2:
        notes.append("no analysis of variance: fewer than two subjects are complete")
        return {}
    found = asdict(variance_of(table, contrasts_of(table.shape[1])))
    if math.isnan(found["f"]):
        notes.append("no analysis of variance: all subjects differ alike between the conditions")
        return {}
    return found


def _mixed(
    entries: Sequence[tuple[str, str, float]], conditions: Sequence[str], notes: list[str]
) -> dict[str, float]:
    """A mixed model of all usable estimates: conditions, and an intercept for each subject."""
    named = np.array([condition for condition, _, _ in entries])
    subjects = np.array([subject for _, subject, _ in entries])
    values = np.array([value for _, _, value in entries])
    scale = float(np.std(values))
    count = len(set(subjects.tolist()))
    if count < 2 or len(entries) - len(conditions) - count + 1 < 1:
        notes.append("no mixed model: too few estimates")
        return {}
    level = np.ones((len(entries), 1))
    effects = np.column_stack([level, *(named == c for c in conditions[1:])]).astype(float)
    groups = np.unique(subjects, return_inverse=True)[1]
    additive = np.column_stack([effects, groups[:, None] == np.arange(1, count)])
    rest = values - additive @ np.linalg.lstsq(additive, values)[0]
    if np.abs(rest).max() <= ROUNDING * np.abs(values).max():
        notes.append("no mixed model: all subjects differ alike between the conditions")
        return {}
    from scipy.special import chdtrc

    # In units of their own scatter, rounding is the same for every parameter.
    scaled = (values - values.mean()) / scale
    full, none = (
        random_intercept(scaled, design, groups, restricted=False) for design in (effects, level)
    )
    spread = random_intercept(scaled, effects, groups, restricted=True)
    gain = max(0.0, 2.0 * (full.log_likelihood - none.log_likelihood))
    return {
        "likelihood_ratio": gain,
        "mixed_p": float(chdtrc(len(conditions) - 1, gain)),
        "between_subjects": scale * spread.between,
        "residual": scale * spread.within,
    }


#: Correlations within a subject at which the likelihood is looked at before it is searched.
GRID = np.concatenate([np.linspace(0.0, 0.98, 50), 1.0 - np.geomspace(1e-2, 1e-9, 22)])


@dataclass(frozen=True)
class MixedFit:
    """Log-likelihood, and the standard deviations between subjects and within them."""

    log_likelihood: float
    between: float
    within: float


def random_intercept(
    values: FloatArray, design: FloatArray, groups: NDArray[np.intp], *, restricted: bool
) -> MixedFit:
    """The mixed model of values = design @ effects + intercept of the group + residual.

    Parameters
    ----------
    values
        Shape (n,).
    design
        Fixed effects, of full rank, shape (n, effects).
    groups
        The group of each value, numbered from 0, shape (n,).
    restricted
        Whether the likelihood is the restricted one (REML), for standard deviations, or the
        whole, for tests of fixed effects.
    """
    from scipy.optimize import minimize_scalar

    def loss(correlation: float) -> float:
        return -_profile(correlation, values, design, groups, restricted)[0]

    looked = [loss(r) for r in GRID]
    best = int(np.argmin(looked))
    correlation = float(GRID[best])
    if 0 < best < len(GRID) - 1:
        found = minimize_scalar(
            loss, bounds=(GRID[best - 1], GRID[best + 1]), method="bounded", options={"xatol": 1e-9}
        )
        correlation = float(found.x)
    likelihood, within = _profile(correlation, values, design, groups, restricted)
    between = within * correlation / (1.0 - correlation)
    return MixedFit(likelihood, math.sqrt(between), math.sqrt(within))


def _profile(
    correlation: float,
    values: FloatArray,
    design: FloatArray,
    groups: NDArray[np.intp],
    restricted: bool,
) -> tuple[float, float]:
    """Log-likelihood at its best for a correlation within subjects, and the residual variance."""
    sizes = np.bincount(groups)
    spread = 1.0 + sizes * correlation / (1.0 - correlation)
    # The root of the inverse covariance of a group takes a share of its mean away.
    share = (1.0 - 1.0 / np.sqrt(spread))[groups]
    table = np.column_stack([values, design])
    means = np.stack([np.bincount(groups, column) / sizes for column in table.T], axis=1)
    table = table - share[:, None] * means[groups]
    orthogonal, triangle = np.linalg.qr(table[:, 1:])
    residual = table[:, 0] - orthogonal @ (orthogonal.T @ table[:, 0])
    count = len(values) - (design.shape[1] if restricted else 0)
    variance = float(residual @ residual) / count
    if variance <= 0.0:
        return -math.inf, 0.0
    likelihood = -0.5 * (count * (math.log(2.0 * math.pi * variance) + 1.0))
    likelihood -= 0.5 * float(np.sum(np.log(spread)))
    if restricted:
        likelihood -= float(np.sum(np.log(np.abs(np.diag(triangle)))))
    return likelihood, variance
