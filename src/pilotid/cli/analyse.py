"""The command `analyse`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from pilotid.cli import options
from pilotid.outputs import require_folder
from pilotid.recordings.files import Reading
from pilotid.recordings.recording import LEAD_IN
from pilotid.seeds import DEFAULT_SEED
from pilotid.terminal import make_console, with_bar
from pilotid.types import InputError

if TYPE_CHECKING:
    from pilotid.analysis.trials import Tried


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
    seed: options.SeedOption = DEFAULT_SEED,
    workers: options.WorkersOption = None,
    force: options.ForceOption = False,
) -> None:
    """Analyse a laboratory's recordings: subjects, conditions, runs; tables and a report."""
    given = dict(locals())
    from pilotid.analysis.analyse import Settings
    from pilotid.analysis.analyse import analyse as analysed
    from pilotid.analysis.board import BOARD
    from pilotid.analysis.factors import factors_of
    from pilotid.analysis.recordings import Pattern, Source, excluded_of, parts_of
    from pilotid.analysis.report import write_report
    from pilotid.analysis.report_tables import alarms, contrast_overview
    from pilotid.analysis.results import results_of
    from pilotid.analysis.rows import CONDITION, in_order
    from pilotid.analysis.tables import TABLES, write_tables
    from pilotid.analysis.trials import tried_conditions
    from pilotid.cli.running import with_progress
    from pilotid.datasets.named import model_place
    from pilotid.disk import strict_json, write_file
    from pilotid.document import Bullets, print_blocks
    from pilotid.pilot.catalogue import AUTO, MODELS, model_named, with_held
    from pilotid.pilot.element import element_named
    from pilotid.recordings.selection import span_of
    from pilotid.study.study import about_this

    names = options.names_of(model, [AUTO], [AUTO])
    models = {m.name: m for m in (model_named(name) for name in names if name != AUTO)}
    auto = AUTO in names
    with_held([*models.values(), *(MODELS.values() if auto else ())], fix)  # refused at once
    plant = element_named(element) if element else None
    chosen = options.methods_of(method, [options.default_method()])
    pairs = _pairs(contrast)
    reading = Reading(tuple(mapping or ()), dt, detrend, lead_in, runs or "", span or "")
    if span:
        span_of(span)
    parts, refused = parts_of(files, Pattern(pattern) if pattern else None)
    parts, excluded = excluded_of(parts, exclude or (), because) if parts else (parts, [])
    if because and not exclude:
        raise InputError("--because: says why something is excluded; name it with --exclude")
    conditions = in_order([dict(part.fields).get(CONDITION, "") for part in parts])
    crossed = factors_of(factors, conditions) if factors else {}
    settings = Settings(
        models,
        auto,
        chosen,
        per_run,
        left_out,
        plant,
        seed,
        pairs,
        model_per_condition,
        crossed,
        excluded,
        fix,
    )
    if not parts:
        options.raise_refused(refused)
    require_folder(out, (*TABLES, BOARD, "report.html"), options.read_with(files), force=force)
    sources = {part.name: Source(part, reading) for part in parts}
    tried: list[Tried] = []
    untried: list[str] = []
    with options.resumable(out):
        analysis = analysed(list(sources.values()), settings, out, with_bar, workers, refused)
        if trust:
            places = {model_named(n).name: model_place(n) for n in names if n != AUTO}
            tried, untried = tried_conditions(
                analysis, sources, out, replications, places, with_progress, workers
            )
    if not analysis.parts:
        options.raise_refused(analysis.refused)
    results = results_of(analysis, tried, untried)
    command = options.typed_command(analyse, given)
    write_tables(out, results, command)
    about = {k: v for k, v in about_this(seed).items() if k not in ("seed", "code")}
    if analysis.left_out:
        # Where the recordings are is nobody's business.
        named = {**given, "files": [file.name for file in files], "out": out.name}
        board = results.board(options.typed_command(analyse, named), about)
        write_file(out / BOARD, strict_json(board.to_dict()).encode())
    path = write_report(out, results, command, about)
    choices = [
        f"{' '.join(value for _, value in group)}: {choice.reason}"
        for group, choice in analysis.choices.items()
        if choice.reason
    ]
    tables = [contrast_overview(results)] if results.contrasts else []
    told = [f"{own.words}: {words}" for own in results.tried for words in own.trust.sentences]
    sentences = Bullets([*told, *alarms(analysis), *results.notes, f"report: {path}"])
    print_blocks(make_console(), Bullets(choices), *tables, sentences)
    options.raise_refused(analysis.refused)


def _pairs(texts: Sequence[str] | None) -> list[tuple[str, str]]:
    """The conditions in texts such as ``C3:C6``."""
    pairs = []
    for text in (part for given in texts or () for part in given.split(",")):
        first, colon, second = (part.strip() for part in text.partition(":"))
        if not (colon and first and second):
            raise InputError(
                f"--contrast {text}: must be two conditions, as in C3:C6, or two parameters of "
                "one model, as in tlead1:tlead2"
            )
        pairs.append((first, second))
    return pairs
