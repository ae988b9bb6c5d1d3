"""The tables of an analysis: tidy CSV files, and LaTeX for papers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from pilotid.analysis.analyse import Analysis, group_of
from pilotid.analysis.cross_validation import COLUMNS as LEFT_OUT_COLUMNS
from pilotid.analysis.recordings import Part
from pilotid.analysis.report_tables import tables_tex
from pilotid.analysis.results import (
    CONTRAST_COLUMNS,
    FACTOR_COLUMNS,
    Results,
    table_of,
)
from pilotid.analysis.rows import Row
from pilotid.support.disk import table_bytes, write_file

ESTIMATES, MODELS, LOOPS, CONTRASTS = "estimates.csv", "models.csv", "loops.csv", "contrasts.csv"
LEFT_OUT, FACTORS, TEX = "left_out.csv", "factors.csv", "tables.tex"
TABLES = (ESTIMATES, MODELS, LOOPS, CONTRASTS, TEX, LEFT_OUT, FACTORS)

QUANTITY_COLUMNS = ("unit", "value", "std_error", "lower_95", "upper_95", "outcome", "remarks")

MODEL_COLUMNS = (
    "model", "chosen", "pilot_parameters", "parameters", "remnant", "samples", "log_likelihood",
    "aicc", "bic", "vaf", "left_out_vaf", "left_out_log_likelihood", "chi_squared", "freedom",
    "chi_squared_per_freedom", "left_out_chi_squared", "change_p", "change_size",
    "change_time", "remarks",
)  # fmt: skip


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
        FACTORS: table_of(results.effects, FACTOR_COLUMNS),
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
    text = tables_tex(results.shown, results.contrasts, results.chosen, command)
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
