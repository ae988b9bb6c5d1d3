"""Recordings of a laboratory analysed: from files to tables, tidy CSV and LaTeX, and a report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from pilotid.analysis.analyse import Analysis, Settings, group_of
from pilotid.analysis.analyse import analyse as analysed
from pilotid.analysis.cross_validation import COLUMNS as LEFT_OUT_COLUMNS
from pilotid.analysis.factors import factors_of
from pilotid.analysis.recordings import Part, Pattern, excluded_of, parts_of
from pilotid.analysis.report_tables import tables_tex
from pilotid.analysis.results import (
    CONTRAST_COLUMNS,
    FACTOR_COLUMNS,
    Results,
    results_of,
    table_of,
)
from pilotid.analysis.rows import CONDITION, Row, in_order
from pilotid.estimates.method import Method
from pilotid.methods import label_of, method_named
from pilotid.pilot.catalogue import AUTO, MODELS, model_named, with_held
from pilotid.pilot.element import ControlledElement, as_element
from pilotid.pilot.model import PilotModel
from pilotid.recordings.files import Reading, read_with
from pilotid.recordings.windows import span_of
from pilotid.study.study import about_this
from pilotid.support.disk import require_folder, table_bytes, write_file
from pilotid.support.format import Table, as_text
from pilotid.support.numbers import DEFAULT_SEED
from pilotid.support.remarks import codes_in
from pilotid.support.types import InputError

if TYPE_CHECKING:
    from pandas import DataFrame

ESTIMATES, COMPARED, LOOPS, CONTRASTS = "estimates.csv", "models.csv", "loops.csv", "contrasts.csv"
LEFT_OUT, FACTORS, TEX = "left_out.csv", "factors.csv", "tables.tex"
TABLES = (ESTIMATES, COMPARED, LOOPS, CONTRASTS, TEX, LEFT_OUT, FACTORS)

QUANTITY_COLUMNS = (
    *("unit", "value", "std_error", "lower_95", "upper_95", "outcome", "remarks", "determined"),
)

MODEL_COLUMNS = (
    "model", "chosen", "pilot_parameters", "parameters", "remnant", "samples", "log_likelihood",
    "aicc", "bic", "vaf", "left_out_vaf", "left_out_log_likelihood", "chi_squared", "freedom",
    "chi_squared_per_freedom", "left_out_chi_squared", "change_p", "change_size",
    "change_time", "remarks",
)  # fmt: skip


#: Heads and rows of a CSV file.
Cells = tuple[list[str], list[list[object]]]

T = TypeVar("T")


@dataclass(frozen=True, eq=False, repr=False)
class Experiment:
    """An analysis of recordings of subjects under conditions.

    Attributes
    ----------
    results
        Estimates, contrasts and all that follows from the fits.
    folder
        Where its store is.
    """

    results: Results
    folder: Path

    @property
    def refused(self) -> Sequence[str]:
        """A sentence for each file that was left out."""
        return self.results.analysis.refused

    def to_dataframe(self, table: str = ESTIMATES) -> DataFrame:
        """A table, such as ``contrasts``, with the columns of its CSV file."""
        from pandas import DataFrame

        tables = table_cells(self.results)
        name = f"{table.removesuffix('.csv')}.csv"
        if name not in tables:
            known = ", ".join(each.removesuffix(".csv") for each in tables)
            raise InputError(f"{table}: is no table of this analysis; there are {known}")
        head, rows = tables[name]
        return DataFrame(rows, columns=head)

    def write(self, command: str = "") -> Path:
        """Write all tables, figures and the report to the folder.

        Parameters
        ----------
        command
            The command that makes them, which they name.

        Returns
        -------
        Path
            The report.
        """
        from pilotid.analysis.report import write_report

        write_tables(self.folder, self.results, command)
        seed = self.results.analysis.settings.seed
        about = {k: v for k, v in about_this(seed).items() if k not in ("seed", "code")}
        return write_report(self.folder, self.results, command, about)

    def blocks(self, report: Path | None = None) -> list[str | Table]:
        """What the terminal shows, with the place of the report where there is one."""
        from pilotid.analysis.report_tables import alarms, contrast_overview

        results = self.results
        choices = [
            f"{' '.join(value for _, value in group)}: {choice.reason}"
            for group, choice in results.analysis.choices.items()
            if choice.reason
        ]
        tables = [contrast_overview(results)] if results.contrasts else []
        told = [*alarms(results.analysis), *results.notes]
        told += [f"report: {report}"] if report else []
        return [*choices, *tables, *told]

    def __repr__(self) -> str:
        return as_text(*self.blocks())


def analyse(
    files: Sequence[str | Path],
    pattern: str | None = None,
    models: Sequence[PilotModel | str] = (AUTO,),
    methods: Sequence[Method | str] = ("mle",),
    *,
    out: str | Path,
    contrasts: Sequence[str] = (),
    model_per_condition: bool = False,
    per_run: bool = False,
    left_out: bool = False,
    exclude: Sequence[str] = (),
    factors: str | None = None,
    element: ControlledElement | str | None = None,
    fix: str | None = None,
    reading: Reading | None = None,
    ignore: Sequence[str] = (),
    seed: int = DEFAULT_SEED,
    workers: int | None = None,
    force: bool = False,
) -> Experiment:
    """Analyse recordings of subjects under conditions, as ``pilotid analyse`` does.

    ``analyse(files, "subj{subject}_{condition}", out="results").to_dataframe("contrasts")``

    Parameters
    ----------
    files
        The recordings.
    pattern
        What their names say, such as ``subj{subject}_{condition}``.
    models, methods
        Objects, or what the command line takes for them; ``auto`` is the catalogue's best model.
    out
        Folder of what is done: the same call resumes there.
    contrasts
        Conditions or parameters to compare, such as ``C3:C6``; all conditions if none.
    model_per_condition
        Whether each condition has a model of its own, also where conditions are contrasted.
    per_run, left_out
        Whether each run is fitted alone as well, and whether it is predicted by the others' fit.
    exclude
        Recordings to leave out, such as ``subject=6,condition=C4``.
    factors
        Factors that conditions are combinations of, as text or CSV file.
    element
        The controlled element; else the file's, or what the signals show.
    fix
        Parameters that are held or bounded, such as ``fnm=12,dnm=.1..0.5``.
    reading
        How files are read, a `pilotid.recordings.files.Reading`.
    ignore
        Codes of warnings that tables and report leave out.
    seed
        Seed of all random numbers.
    workers
        Processes; None for one for each processor.
    force
        Whether files of the folder may be written over that this program did not write.

    Returns
    -------
    Experiment
        It prints what the command prints; ``write()`` writes the tables and the report.

    Raises
    ------
    InputError
        If no file can be used, or an option does not fit them.
    """
    models, methods = _several(models), _several(methods)
    every = [model_named(m) if isinstance(m, str) else m for m in models if m != AUTO]
    auto = len(every) < len(models)
    with_held([*every, *(MODELS.values() if auto else ())], fix)  # refused at once
    known = [method_named(m) if isinstance(m, str) else m for m in methods]
    ignored = codes_in(_several(ignore))
    reading, folder = reading or Reading(), Path(out)
    if reading.span:
        span_of(reading.span)
    parts, refused = parts_of(
        [Path(file) for file in _several(files)],
        Pattern(pattern) if pattern else None,
    )
    parts, excluded = excluded_of(parts, _several(exclude)) if parts else (parts, [])
    conditions = in_order([dict(part.fields).get(CONDITION, "") for part in parts])
    settings = Settings(
        {m.name: m for m in every},
        auto,
        {label_of(method): method for method in known},
        per_run,
        left_out,
        as_element(element) if element else None,
        seed,
        pairs_of(_several(contrasts)),
        model_per_condition,
        factors_of(factors, conditions) if factors else {},
        excluded,
        fix,
        reading,
    )
    if not parts:
        raise InputError("; ".join(refused))
    read = [file for part in parts for file in part.files]
    require_folder(folder, (*TABLES, "report.html"), read_with(read), force=force)
    analysis = analysed(parts, settings, folder, workers, refused)
    if not analysis.parts:
        raise InputError("; ".join(analysis.refused))
    analysis = analysis.without(ignored) if ignored else analysis
    return Experiment(results_of(analysis), folder)


def _several(given: Sequence[T]) -> Sequence[T]:
    """A list, also of one text alone."""
    return [given] if isinstance(given, str) else given  # type: ignore[list-item]


def pairs_of(texts: Sequence[str]) -> list[tuple[str, str]]:
    """The conditions in texts such as ``C3:C6``."""
    pairs = []
    for text in (part for given in texts for part in given.split(",")):
        first, colon, second = (part.strip() for part in text.partition(":"))
        if not (colon and first and second):
            raise InputError(
                f"--contrast {text}: must be two conditions, as in C3:C6, or two parameters of "
                "one model, as in tlead1:tlead2"
            )
        pairs.append((first, second))
    return pairs


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
        COMPARED: (
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
        *(*numbers, row.outcome, " | ".join(row.remarks), row.determined),
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
