"""Contrasts, analyses of all conditions and spreads of runs as tables for CSV files.

Each function gives the names of the columns and the rows; numbers are floats, NaN where there is
none, and several notes are one text.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

from pilotid.analysis.contrasts import Contrast
from pilotid.analysis.repeated import Repeated
from pilotid.analysis.spread import RunSpread

Line = TypeVar("Line", Contrast, Repeated, RunSpread)
Table = tuple[list[str], list[list[object]]]

#: Columns of contrasts.csv behind those of the stratum's fields.
CONTRAST_COLUMNS: Mapping[str, Callable[[Contrast], object]] = {
    "condition_a": lambda c: c.condition_a,
    "condition_b": lambda c: c.condition_b,
    "model_a": lambda c: c.model_a,
    "model_b": lambda c: c.model_b,
    "method": lambda c: c.method,
    "parameter": lambda c: c.parameter,
    "unit": lambda c: c.unit,
    "subjects": lambda c: c.subjects,
    "mean_a": lambda c: c.mean_a,
    "mean_b": lambda c: c.mean_b,
    "difference": lambda c: c.difference,
    "std_error": lambda c: c.std_error,
    "t": lambda c: c.t,
    "freedom": lambda c: c.freedom,
    "p": lambda c: c.p,
    "p_holm": lambda c: c.p_holm,
    "lower_95": lambda c: c.lower,
    "upper_95": lambda c: c.upper,
    "effect_size": lambda c: c.effect_size,
    "weighted_difference": lambda c: c.weighted_difference,
    "weighted_std_error": lambda c: c.weighted_std_error,
    "weighted_p": lambda c: c.weighted_p,
    "weighted_p_holm": lambda c: c.weighted_p_holm,
    "weighted_lower_95": lambda c: c.weighted_lower,
    "weighted_upper_95": lambda c: c.weighted_upper,
    "between_subjects": lambda c: c.between_subjects,
    "between_lower_95": lambda c: c.between_lower,
    "between_upper_95": lambda c: c.between_upper,
    "claimed_error": lambda c: c.claimed_error,
    "notes": lambda c: " | ".join(c.notes),
}

#: Columns of the table of analyses of all conditions.
REPEATED_COLUMNS: Mapping[str, Callable[[Repeated], object]] = {
    "conditions": lambda r: " ".join(r.conditions),
    "models": lambda r: " ".join(dict.fromkeys(r.models)),
    "method": lambda r: r.method,
    "parameter": lambda r: r.parameter,
    "unit": lambda r: r.unit,
    "subjects": lambda r: len(r.subjects),
    "F": lambda r: r.f,
    "df1": lambda r: r.df1,
    "df2": lambda r: r.df2,
    "p": lambda r: r.p,
    "epsilon": lambda r: r.epsilon,
    "p_corrected": lambda r: r.p_corrected,
    "estimates": lambda r: r.estimates,
    "likelihood_ratio": lambda r: r.likelihood_ratio,
    "mixed_p": lambda r: r.mixed_p,
    "between_subjects": lambda r: r.between_subjects,
    "residual": lambda r: r.residual,
    "notes": lambda r: " | ".join(r.notes),
}

#: Columns of the table of spreads from run to run.
SPREAD_COLUMNS: Mapping[str, Callable[[RunSpread], object]] = {
    "file": lambda s: s.file,
    "condition": lambda s: s.condition,
    "model": lambda s: s.model,
    "method": lambda s: s.method,
    "parameter": lambda s: s.parameter,
    "unit": lambda s: s.unit,
    "runs": lambda s: len(s.runs),
    "ratio": lambda s: s.ratio.value,
    "ratio_lower_95": lambda s: s.ratio.lower,
    "ratio_upper_95": lambda s: s.ratio.upper,
    "ratio_p": lambda s: s.ratio.p,
    "between_runs": lambda s: s.between_runs,
    "value": lambda s: s.value,
    "claimed_error": lambda s: s.claimed_error,
    "std_error": lambda s: s.std_error,
    "lower_95": lambda s: s.lower,
    "upper_95": lambda s: s.upper,
    "notes": lambda s: " | ".join(s.notes),
}


def contrast_table(contrasts: Sequence[Contrast]) -> Table:
    """Columns and rows of contrasts.csv."""
    return _table(contrasts, CONTRAST_COLUMNS)


def repeated_table(analyses: Sequence[Repeated]) -> Table:
    """Columns and rows of analyses of all conditions."""
    return _table(analyses, REPEATED_COLUMNS)


def spread_table(spreads: Sequence[RunSpread]) -> Table:
    """Columns and rows of spreads from run to run."""
    return _table(spreads, SPREAD_COLUMNS)


def _table(lines: Sequence[Line], columns: Mapping[str, Callable[[Line], object]]) -> Table:
    fields: list[str] = []
    for line in lines:
        fields += [name for name, _ in line.stratum if name not in fields]
    rows: list[list[object]] = []
    for line in lines:
        found = dict(line.stratum)
        own: list[object] = [found.get(name, "") for name in fields]
        rows.append(own + [value(line) for value in columns.values()])
    return [*fields, *columns], rows
