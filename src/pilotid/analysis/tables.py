"""The tables of an analysis: tidy CSV files, and LaTeX for papers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from operator import attrgetter
from pathlib import Path

from pilotid.analysis.analyse import Analysis, group_of
from pilotid.analysis.contrasts import Contrast
from pilotid.analysis.cross_validation import COLUMNS as LEFT_OUT_COLUMNS
from pilotid.analysis.factors import Effect
from pilotid.analysis.recordings import Part
from pilotid.analysis.repeated import Repeated
from pilotid.analysis.report_tables import tables_tex
from pilotid.analysis.responses import COLUMNS as RESPONSE_COLUMNS
from pilotid.analysis.responses import response_cells
from pilotid.analysis.results import Results
from pilotid.analysis.rows import Row
from pilotid.analysis.spread import RunSpread
from pilotid.disk import table_bytes, write_file

ESTIMATES, MODELS, LOOPS, CONTRASTS = "estimates.csv", "models.csv", "loops.csv", "contrasts.csv"
CONDITIONS, RUNS, TEX = "conditions.csv", "runs.csv", "tables.tex"
LEFT_OUT, FACTORS, FRF = "left_out.csv", "factors.csv", "frf.csv"
TABLES = ESTIMATES, MODELS, LOOPS, CONTRASTS, CONDITIONS, RUNS, TEX, LEFT_OUT, FACTORS, FRF

QUANTITY_COLUMNS = ("unit", "value", "std_error", "lower_95", "upper_95", "outcome", "remarks")

MODEL_COLUMNS = (
    "model", "chosen", "pilot_parameters", "parameters", "remnant", "samples", "log_likelihood",
    "aicc", "bic", "vaf", "left_out_vaf", "left_out_log_likelihood", "chi_squared", "freedom",
    "chi_squared_per_freedom", "left_out_chi_squared", "change_p", "change_size",
    "change_time", "remarks",
)  # fmt: skip


#: Columns of contrasts.csv behind those of the stratum's fields.
CONTRAST_COLUMNS = (
    *("condition_a", "condition_b", "model_a", "model_b", "method", "parameter", "unit"),
    *("subjects", "mean_a", "mean_b", "difference", "std_error", "t", "freedom", "p", "p_holm"),
    *("lower_95", "upper_95", "effect_size", "weighted_difference", "weighted_std_error"),
    *("weighted_p", "weighted_p_holm", "weighted_lower_95", "weighted_upper_95"),
    *("between_subjects", "between_lower_95", "between_upper_95", "claimed_error", "notes"),
    *("misspecified", "robust_difference", "wilcoxon_p", "lower_holm_95", "upper_holm_95"),
)
#: Columns of the table of analyses of all conditions.
REPEATED_COLUMNS = (
    *("conditions", "models", "method", "parameter", "unit", "subjects", "F", "df1", "df2", "p"),
    *("epsilon", "p_corrected", "estimates", "likelihood_ratio", "mixed_p", "between_subjects"),
    *("residual", "notes", "eta_squared"),
)
#: Columns of the table of factors.
FACTOR_COLUMNS = (
    *("method", "parameter", "unit", "effect", "subjects", "F", "df1", "df2", "p", "epsilon"),
    *("p_corrected", "eta_squared", "notes"),
)
#: Columns of the table of spreads from run to run.
SPREAD_COLUMNS = (
    *("file", "condition", "model", "method", "parameter", "unit", "runs", "ratio"),
    *("ratio_lower_95", "ratio_upper_95", "ratio_p", "between_runs", "value", "claimed_error"),
    *("std_error", "lower_95", "upper_95", "notes"),
)
#: Where columns are found that are not called like what they hold.
PLACES = {
    "F": "f",
    "ratio": "ratio.value",
    "ratio_lower_95": "ratio.lower",
    "ratio_upper_95": "ratio.upper",
    "ratio_p": "ratio.p",
}


def table_of(
    lines: Sequence[Contrast | Repeated | RunSpread | Effect], columns: Sequence[str]
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
    if isinstance(line, Effect) and hasattr(line.variance, PLACES.get(column, column)):
        line = line.variance
    value = attrgetter(PLACES.get(column, column.removesuffix("_95")))(line)
    if column == "notes":
        return " | ".join(value)
    if column in ("conditions", "models"):
        return " ".join(dict.fromkeys(value))
    return len(value) if isinstance(value, tuple) else value


#: Heads and rows of a CSV file.
Cells = tuple[list[str], list[list[object]]]


def table_cells(results: Results) -> dict[str, Cells]:
    """All tables of an analysis that have rows, and those that always are, by their files."""
    analysis = results.analysis
    # The fields of the pattern are columns of every table.
    names = list(dict(analysis.parts[0].fields)) if analysis.parts else []
    head = ["file", *names, "run", "model", "method"]
    elements = analysis.elements
    found: dict[str, Cells] = {
        ESTIMATES: (
            [*head, "parameter", *QUANTITY_COLUMNS],
            [_row_cells(row, names) for row in results.rows],
        ),
        LOOPS: (
            [*head, "element", "quantity", *QUANTITY_COLUMNS],
            [
                _row_cells(row, names, elements[row.file, row.run, row.model])
                for row in results.loops
            ],
        ),
        MODELS: (
            ["file", *names, *MODEL_COLUMNS],
            [cells for part in analysis.parts for cells in _model_cells(analysis, part, names)],
        ),
        CONTRASTS: table_of(results.contrasts, CONTRAST_COLUMNS),
    }
    more: dict[str, Cells] = {
        CONDITIONS: table_of(results.repeated, REPEATED_COLUMNS),
        FRF: (
            ["file", *names, *RESPONSE_COLUMNS],
            [
                [fit.part.name, *dict(fit.part.fields).values(), *cells]
                for fit in analysis.fits
                for cells in response_cells(fit.content)
            ],
        ),
        FACTORS: table_of(results.effects, FACTOR_COLUMNS),
        RUNS: table_of(results.spreads, SPREAD_COLUMNS),
        LEFT_OUT: (
            ["file", *names, *LEFT_OUT_COLUMNS],
            [[e.part.name, *dict(e.part.fields).values(), *e.cells] for e in analysis.left_out],
        ),
    }
    return found | {name: cells for name, cells in more.items() if cells[1]}


def write_tables(folder: Path, results: Results, command: str) -> None:
    """Write the tables, numbers with as many digits as restore them.

    Parameters
    ----------
    folder
        Where to write.
    results
        What was found.
    command
        The command that found it, for the head of tables.tex.
    """
    for name, cells in table_cells(results).items():
        write_file(folder / name, table_bytes(*cells))
    share = results.analysis.settings.share
    text = tables_tex(results.shown, results.contrasts, results.chosen, command, share)
    write_file(folder / TEX, text.encode("utf-8", "replace"))


def _row_cells(row: Row, names: Sequence[str], *element: str) -> list[object]:
    numbers = (row.value, row.std_error, row.lower, row.upper)
    return [
        *(row.file, *map(row.field, names), "" if row.run is None else row.run),
        *(row.model, row.method, *element, row.parameter, row.unit),
        *(*numbers, row.outcome, " | ".join(row.remarks)),
    ]


def _model_cells(analysis: Analysis, part: Part, names: Sequence[str]) -> list[list[object]]:
    fields = dict(part.fields)
    chosen = analysis.choices[group_of(part)].model
    rows = []
    for c in analysis.candidates(part):
        known = {
            **asdict(c),
            "chosen": "yes" if c.model == chosen else "no",
            "freedom": c.freedom or "",
            "chi_squared_per_freedom": c.excess,
            "left_out_log_likelihood": sum(c.left_out_log_likelihood) or "",
            "left_out_chi_squared": sum(c.left_out_chi_squared) or "",
            "remarks": c.bounds,
        }
        places = (fields[name] for name in names)
        rows.append([part.name, *places, *(known[column] for column in MODEL_COLUMNS)])
    return rows
