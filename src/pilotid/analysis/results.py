"""What follows from all fits of an analysis: contrasts, and the effects of factors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pilotid.analysis.analyse import Analysis
from pilotid.analysis.contrasts import Contrast, contrasts, split_pairs, within_fits
from pilotid.analysis.factors import Effect, effects
from pilotid.analysis.rows import CONDITION, SUBJECT, Chosen, Row
from pilotid.support.types import InputError

#: Columns of contrasts.csv behind those of the stratum's fields.
CONTRAST_COLUMNS = (
    *("condition_a", "condition_b", "model_a", "model_b", "method", "parameter", "unit"),
    *("subjects", "mean_a", "mean_b", "difference", "std_error", "t", "freedom", "p", "p_holm"),
    *("lower_95", "upper_95", "effect_size", "notes"),
    *("misspecified", "robust_difference", "wilcoxon_p", "lower_holm_95", "upper_holm_95"),
)
#: Columns of the table of factors.
FACTOR_COLUMNS = (
    *("method", "parameter", "unit", "effect", "subjects", "F", "df1", "df2", "p", "epsilon"),
    *("p_corrected", "eta_squared", "notes"),
)


def table_of(
    lines: Sequence[Contrast | Effect], columns: Sequence[str]
) -> tuple[list[str], list[list[object]]]:
    """A table for a CSV file, behind the fields of the strata; several notes are one text."""
    fields = list(dict.fromkeys(name for line in lines for name, _ in line.stratum))
    rows = [
        [
            *(dict(line.stratum).get(name, "") for name in fields),
            *(_cell(line, column) for column in columns),
        ]
        for line in lines
    ]
    return [*fields, *columns], rows


def _cell(line: object, column: str) -> object:
    value = getattr(line, "f" if column == "F" else column.removesuffix("_95"))
    if column == "notes":
        return " | ".join(value)
    return len(value) if isinstance(value, tuple) else value


@dataclass(frozen=True, eq=False)
class Results:
    """All that tables and report show.

    Attributes
    ----------
    analysis
        What was fitted.
    chosen
        The model of each stratum and condition, where each has its own; None where all
        recordings were fitted with the same models.
    rows, loops
        Every quantity of every recording and fit, and of the fit's loops.
    contrasts
        Conditions compared in pairs.
    effects
        Effects of the factors that conditions are combinations of.
    notes
        What could not be worked out, a sentence each.
    """

    analysis: Analysis
    chosen: Chosen | None
    rows: Sequence[Row]
    loops: Sequence[Row]
    contrasts: Sequence[Contrast]
    effects: Sequence[Effect]
    notes: Sequence[str]

    @property
    def shown(self) -> Sequence[Row]:
        """Fits of all runs together."""
        return [row for row in (*self.rows, *self.loops) if row.run is None]


def results_of(analysis: Analysis) -> Results:
    """Work out what follows from an analysis.

    Raises
    ------
    InputError
        If a pair names a condition that no recording has.
    """
    seen, rows, loops = analysis.performance, analysis.rows, analysis.loop_rows
    pairs = analysis.settings.pairs
    both = [*seen, *rows, *loops]
    notes: list[str] = []
    differences: list[Contrast] = []
    crossed: list[Effect] = []
    chosen = _chosen(analysis) if analysis.settings.auto else None
    fields = dict(analysis.parts[0].fields) if analysis.parts else {}
    missing = [name for name in (SUBJECT, CONDITION) if name not in fields]
    if missing and pairs:
        raise InputError(
            f"--contrast: the pattern has no {{{missing[0]}}}; contrasts are made between "
            "conditions over subjects"
        )
    if missing:
        notes.append(
            "Conditions are not compared: that needs a pattern with {subject} and {condition}."
        )
    else:
        between, within = split_pairs(both, pairs)
        if between or not within:
            differences = contrasts(both, between, chosen, analysis.settings.known)
        differences += within_fits(both, within, chosen)
        crossed = effects(both, analysis.settings.factors, chosen, analysis.settings.known)
    return Results(
        analysis=analysis,
        chosen=chosen,
        rows=[*seen, *rows],
        loops=loops,
        contrasts=differences,
        effects=crossed,
        notes=notes,
    )


def _chosen(analysis: Analysis) -> Chosen:
    return {
        (
            tuple(pair for pair in group if pair[0] != CONDITION),
            dict(group).get(CONDITION, ""),
        ): choice.model
        for group, choice in analysis.choices.items()
    }
