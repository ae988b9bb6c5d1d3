"""The command `analyse`."""

from __future__ import annotations

from typing import Annotated

import typer

from pilotid.cli import options
from pilotid.document import print_blocks
from pilotid.recordings.files import Reading
from pilotid.recordings.recording import LEAD_IN
from pilotid.seeds import DEFAULT_SEED
from pilotid.terminal import make_console


def analyse(
    files: options.FilesArgument,
    out: options.OutOption,
    pattern: Annotated[
        str | None,
        typer.Option(
            metavar="'subj{subject}_{condition}'",
            help="What the files' names say; files that differ in {run} alone are runs of one "
            "recording.",
        ),
    ] = None,
    model: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME|auto",
            help="Pilot model; repeat or use commas; auto takes the catalogue's best.",
        ),
    ] = None,
    method: options.MethodOption = None,
    contrast: Annotated[
        list[str] | None,
        typer.Option(
            metavar="A:B",
            help="Conditions to compare, B less A, all if none; or parameters of one fit, such as "
            "tlead1:tlead2; repeat.",
        ),
    ] = None,
    model_per_condition: Annotated[
        bool,
        typer.Option(
            "--model-per-condition",
            help="Choose a model for each condition, also of those that are contrasted.",
        ),
    ] = False,
    per_run: Annotated[
        bool, typer.Option("--per-run", help="Also fit each run separately.")
    ] = False,
    left_out: Annotated[
        bool,
        typer.Option("--left-out", help="Leave-one-run-out cross-validation."),
    ] = False,
    trust: Annotated[
        bool,
        typer.Option(
            "--trust",
            help="Simulate a typical recording of each condition, and say what its fit is worth.",
        ),
    ] = False,
    replications: Annotated[
        int, typer.Option(min=1, help="Simulations of each condition, with --trust.")
    ] = 40,
    mapping: options.MapOption = None,
    dt: options.IntervalOption = None,
    detrend: options.DetrendOption = False,
    lead_in: options.LeadInOption = LEAD_IN,
    runs: options.RunsOption = None,
    span: options.SpanOption = None,
    exclude: Annotated[
        list[str] | None,
        typer.Option(metavar="subject=6,condition=C4", help="Recordings to leave out; repeat."),
    ] = None,
    because: Annotated[
        str, typer.Option(metavar="WHY", help="Why these are excluded, for the report.")
    ] = "",
    factors: Annotated[
        str | None,
        typer.Option(
            metavar="'motion=C1,C2:off;C3,C4:on;...'|F.csv",
            help="Factors that conditions are combinations of, for an analysis of variance.",
        ),
    ] = None,
    element: options.ElementOption = None,
    fix: options.FixOption = None,
    share: Annotated[
        list[str] | None,
        typer.Option(
            metavar="fnm,dnm", help="Parameters that a subject's conditions have in common."
        ),
    ] = None,
    ignore: options.IgnoreOption = None,
    seed: options.SeedOption = DEFAULT_SEED,
    workers: options.WorkersOption = None,
    force: options.ForceOption = False,
) -> None:
    """Analyse a laboratory's recordings: subjects, conditions, runs; tables and a report."""
    given = dict(locals())
    from pilotid.analysis.experiment import analyse as analysed
    from pilotid.cli.running import with_progress
    from pilotid.pilot.catalogue import AUTO

    reading = Reading(tuple(mapping or ()), dt, detrend, lead_in, runs or "", span or "")
    with options.resumable(out):
        found = analysed(
            files,
            pattern,
            options.names_of(model, [AUTO], [AUTO]),
            list(options.methods_of(method, [options.default_method()]).values()),
            out=out,
            contrasts=contrast or (),
            model_per_condition=model_per_condition,
            per_run=per_run,
            left_out=left_out,
            trust=replications if trust else 0,
            exclude=exclude or (),
            because=because,
            factors=factors,
            element=element,
            fix=fix,
            share=share or (),
            reading=reading,
            ignore=ignore or (),
            seed=seed,
            workers=workers,
            force=force,
            bar=with_progress,
        )
    # Where the recordings are is nobody's business.
    named = {**given, "files": [file.name for file in files], "out": out.name}
    path = found.write(options.typed_command(analyse, given), options.typed_command(analyse, named))
    print_blocks(make_console(), *found.blocks(path))
    options.raise_refused(found.refused)
