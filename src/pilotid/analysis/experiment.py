"""Recordings of a laboratory analysed: from files to tables and a report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from pilotid.analysis.analyse import Settings
from pilotid.analysis.analyse import analyse as analysed
from pilotid.analysis.contrasts import Contrast
from pilotid.analysis.factors import factors_of
from pilotid.analysis.recordings import Pattern, excluded_of, parts_of
from pilotid.analysis.results import Results, results_of
from pilotid.analysis.rows import CONDITION, in_order
from pilotid.analysis.tables import ESTIMATES, TABLES, table_cells, write_tables
from pilotid.estimates.method import Method
from pilotid.methods import label_of, method_named
from pilotid.pilot.catalogue import AUTO, MODELS, model_named, with_held
from pilotid.pilot.element import ControlledElement, as_element
from pilotid.pilot.model import PilotModel
from pilotid.recordings.files import Reading, read_with
from pilotid.recordings.selection import span_of
from pilotid.study.study import about_this
from pilotid.support.disk import require_folder
from pilotid.support.document import Bullets, Table, blocks_text
from pilotid.support.numbers import DEFAULT_SEED
from pilotid.support.remarks import codes_in
from pilotid.support.types import InputError

if TYPE_CHECKING:
    from pandas import DataFrame

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

    def blocks(self, report: Path | None = None) -> list[Bullets | Table[Contrast]]:
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
        return [Bullets(choices), *tables, Bullets(told)]

    def __repr__(self) -> str:
        return blocks_text(*self.blocks())


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
