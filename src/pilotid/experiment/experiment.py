"""Recordings of a laboratory analysed: from files to tables, tidy CSV and LaTeX, and a page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pandas import DataFrame

from pilotid.estimate.method import Method
from pilotid.experiment.files import QUANTITY_COLUMNS, pairs_of, parts_of, with_factors, without
from pilotid.experiment.fits import fit_recordings
from pilotid.experiment.report import blocks, tables_tex, write_report
from pilotid.experiment.results import Fitting, Results, Settings
from pilotid.methods import label_of, method_named
from pilotid.model.catalogue import AUTO, MODELS, model_named, with_held
from pilotid.model.element import ControlledElement, as_element
from pilotid.model.model import PilotModel
from pilotid.recording.files import Reading, read_with
from pilotid.support.disk import frame_bytes, require_folder, write_file
from pilotid.support.format import as_text
from pilotid.support.numbers import DEFAULT_SEED
from pilotid.support.types import InputError, several

TABLES = ("estimates", "models", "loops", "contrasts", "factors", "left_out")


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Experiment(Results):
    """An analysis of recordings of subjects under conditions: all frames that follow from it.

    Attributes
    ----------
    contrasts, factors, models, left_out
        The tables of these names, see `to_dataframe`.
    quantities
        A row for each quantity of each fit.
    responses
        Coefficients at the forcing lines of the recordings that count.
    settings, looks, fitted, choices, compared
        What was asked for; what the tasks gave; the model of each group of recordings, and those in
        which conditions are compared.
    refused
        A sentence for each file or fit that there is not.
    folder
        Where its store is.
    """

    folder: Path

    def to_dataframe(self, table: str = "estimates") -> DataFrame:
        """A table, such as ``contrasts``, with the columns of its CSV file."""
        if table not in ("estimates", "loops"):
            return getattr(self, table)
        rows = self.quantities
        rows = rows[(rows["otherwise"] == "") & ((rows["kind"] == "loop") == (table == "loops"))]
        columns = ["file", *next(iter(self.looks)).fields, *QUANTITY_COLUMNS]
        if table == "loops":
            columns.insert(columns.index("parameter"), "element")
        renamed = {"parameter": "quantity"} if table == "loops" else {}
        return rows[columns].rename(columns=renamed).reset_index(drop=True)

    def write(self, command: str = "") -> Path:
        """Write all tables, figures and the page to the folder, and return the page's path.

        Parameters
        ----------
        command
            The command that makes them, which the page names.
        """
        for name in TABLES:
            frame = self.to_dataframe(name)
            if len(frame) or name in TABLES[:4]:
                write_file(self.folder / f"{name}.csv", frame_bytes(frame))
        write_file(self.folder / "tables.tex", tables_tex(self).encode("utf-8", "replace"))
        page = self.folder / "report.html"
        write_report(page, self, command)
        return page

    def __repr__(self) -> str:
        return as_text(*blocks(self))


def analyse(
    files: Sequence[str | Path],
    pattern: str | None = None,
    models: Sequence[PilotModel | str] = (AUTO,),
    methods: Sequence[Method | str] = ("mle",),
    *,
    out: str | Path,
    contrasts: Sequence[str] = (),
    factors: str | None = None,
    keep_all: bool = False,
    sensitivity: bool = False,
    per_run: bool = False,
    left_out: bool = False,
    exclude: Sequence[str] = (),
    element: ControlledElement | str | None = None,
    fix: str | None = None,
    reading: Reading | None = None,
    seed: int = DEFAULT_SEED,
    workers: int | None = None,
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
        Objects, or what the command line takes for them; ``auto`` alone is the catalogue's best
        model.
    out
        Folder of what is done: the same call resumes there.
    contrasts
        Conditions to compare, such as ``C3:C6``; else all that differ in one factor.
    factors
        Factors that conditions are combinations of, as text or fields of the pattern.
    keep_all
        Whether estimates that are not determined, or wrong, count in means and tests as well.
    sensitivity
        Whether each recording is fitted in other ways as well: another band, remnant and lead-in,
        and each half alone.
    per_run, left_out
        Whether each run is fitted alone as well, and whether it is predicted by the others' fit.
    exclude
        Recordings to leave out, such as ``subject=6,condition=C4``.
    element
        The controlled element; else the file's, or what the signals show.
    fix
        Parameters that are held or bounded, such as ``fnm=12,dnm=.1..0.5``.
    reading
        How files are read, a `pilotid.recording.files.Reading`.
    seed
        Seed of all random numbers.
    workers
        Processes; None for one for each processor.

    Returns
    -------
    Experiment
        It prints what the command prints; ``write()`` writes the tables and the page.

    Raises
    ------
    InputError
        If no file can be used, or an option does not fit them.
    """
    models, methods = several(models), several(methods)
    named = [model_named(m) if isinstance(m, str) else m for m in models if m != AUTO]
    if named and AUTO in models:
        raise InputError("--model: is auto, or models by name, not both")
    reading, folder = reading or Reading(), Path(out)
    known = [method_named(m) if isinstance(m, str) else m for m in methods]
    parts, refused = parts_of([Path(file) for file in several(files)], pattern or None)
    if not parts:
        raise InputError("; ".join(refused))
    parts = without(parts, several(exclude))
    parts, levels = with_factors(parts, factors)
    settings = Settings(
        fitting=Fitting(
            methods={label_of(method): method for method in known},
            element=as_element(element) if element else None,
            seed=seed,
            reading=reading,
            per_run=per_run,
            left_out=left_out,
            sensitivity=sensitivity,
        ),
        models={m.name: m for m in with_held(named or MODELS.values(), fix)},
        named=[model.name for model in named],
        pairs=pairs_of(several(contrasts), {part.condition for part in parts}),
        factors=levels,
        keep_all=keep_all,
    )
    read = [file for part in parts for file in part.files]
    names = (*(f"{name}.csv" for name in TABLES), "tables.tex", "report.html")
    require_folder(folder, names, read_with(read))
    results = fit_recordings(parts, settings, folder, workers, refused)
    return Experiment(**vars(results), folder=folder)
