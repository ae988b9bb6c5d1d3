"""The command `analyse`."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pilotid.cli.arguments import (
    ElementOption,
    MethodOption,
    SeedOption,
    default_method,
    methods_of,
    names_of,
)
from pilotid.cli.reading import DetrendOption, IntervalOption, LeadInOption, MapOption
from pilotid.cli.stopping import StoppedError
from pilotid.recordings.files import Reading
from pilotid.recordings.recording import LEAD_IN
from pilotid.seeds import DEFAULT_SEED
from pilotid.terminal import make_console, make_table, print_table, with_bar
from pilotid.types import InputError

if TYPE_CHECKING:
    from rich.table import Table

    from pilotid.analysis.results import Results
    from pilotid.analysis.trials import Tried


def analyse(
    files: Annotated[
        list[Path], typer.Argument(metavar="F.csv|F.mat ...", help="Recordings to analyse.")
    ],
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder of the results; goes on where it stopped.")
    ],
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
    method: MethodOption = None,
    contrast: Annotated[
        list[str] | None,
        typer.Option(
            metavar="A:B",
            help="Conditions to compare, B less A, all if none; or parameters of one fit, such as "
            "tlead1:tlead2; repeat.",
        ),
    ] = None,
    per_run: Annotated[
        bool, typer.Option("--per-run", help="Fit every run on its own as well.")
    ] = False,
    left_out: Annotated[
        bool,
        typer.Option("--left-out", help="Predict every run by the fit of the others, too."),
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
    mapping: MapOption = None,
    dt: IntervalOption = None,
    detrend: DetrendOption = False,
    lead_in: LeadInOption = LEAD_IN,
    element: ElementOption = None,
    seed: SeedOption = DEFAULT_SEED,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes; default: one for each processor.")
    ] = None,
) -> None:
    """Analyse a laboratory's recordings: subjects, conditions, runs; tables and a report."""
    from pilotid.analysis.analyse import Settings
    from pilotid.analysis.analyse import analyse as analysed
    from pilotid.analysis.board import BOARD
    from pilotid.analysis.pattern import Pattern, parts_of
    from pilotid.analysis.report import write_report
    from pilotid.analysis.results import results_of
    from pilotid.analysis.source import Source
    from pilotid.analysis.tables import write_tables
    from pilotid.analysis.trials import tried_conditions
    from pilotid.cli.progress import with_progress
    from pilotid.datasets.named import model_place
    from pilotid.disk import make_folder, strict_json, write_file
    from pilotid.pilot.catalogue import AUTO, model_named
    from pilotid.pilot.element import element_named
    from pilotid.study.facts import about_this

    names = names_of(model, [AUTO], [AUTO])
    models = {m.name: m for m in (model_named(name) for name in names if name != AUTO)}
    plant = element_named(element) if element else None
    settings = Settings(
        models,
        AUTO in names,
        methods_of(method, [default_method()]),
        per_run,
        left_out,
        plant,
        seed,
    )
    pairs = _pairs(contrast)
    reading = Reading(tuple(mapping or ()), dt, detrend, lead_in)
    parts, refused = parts_of(files, Pattern(pattern) if pattern else None)
    if not parts:
        raise InputError("; ".join(refused))
    make_folder(out)
    sources = {part.name: Source(part, reading) for part in parts}
    try:
        analysis = analysed(
            list(sources.values()),
            settings,
            out,
            with_bar,
            workers,
            refused=refused,
        )
        tried: list[Tried] = []
        untried: list[str] = []
        if trust:
            places = {model_named(n).name: model_place(n) for n in names if n != AUTO}
            tried, untried = tried_conditions(
                analysis, sources, out, replications, places, with_progress, workers
            )
    except KeyboardInterrupt:
        raise StoppedError(
            f"stopped; {out} keeps what is done, and the same command goes on from there"
        ) from None
    if not analysis.parts:
        raise InputError("; ".join(analysis.refused))
    results = results_of(analysis, pairs, tried, untried)
    options = {
        "--pattern": [pattern] if pattern else [],
        "--model": model or [],
        "--method": method or [],
        "--contrast": contrast or [],
        "--map": mapping or [],
        "--element": [element] if element else [],
        "--seed": [str(seed)] if seed != DEFAULT_SEED else [],
    }
    said = [word for name, values in options.items() for value in values for word in (name, value)]
    said += [] if dt is None else ["--dt", f"{dt:g}"]
    said += [] if lead_in == LEAD_IN else ["--lead-in", f"{lead_in:g}"]
    said += ["--replications", str(replications)] if trust and replications != 40 else []
    flags = (
        ("--detrend", detrend),
        ("--per-run", per_run),
        ("--left-out", left_out),
        ("--trust", trust),
    )
    said += [flag for flag, on in flags if on]
    command = shlex.join(["pilotid", "analyse", *map(str, files), *said, "--out", str(out)])
    write_tables(out, results, command)
    about = {k: v for k, v in about_this(seed).items() if k not in ("seed", "code")}
    if analysis.left_out:
        # Where the recordings are is nobody's business.
        named = ["pilotid", "analyse", *(file.name for file in files), *said, "--out", out.name]
        board = results.board(shlex.join(named), about)
        write_file(out / BOARD, strict_json(board.to_dict()).encode())
    path = write_report(out, results, command, about)
    console = make_console()
    for group, choice in analysis.choices.items():
        words = " ".join(value for _, value in group)
        if choice.reason:
            console.print(f"{words}: {choice.reason}", soft_wrap=True)
    if results.contrasts:
        print_table(console, _contrast_table(results))
    for own in results.tried:
        for sentence in own.trust.sentences:
            console.print(f"{own.words}: {sentence}", soft_wrap=True)
    for note in results.notes:
        console.print(note, soft_wrap=True)
    console.print(f"report: {path}", soft_wrap=True)
    if analysis.refused:
        raise InputError("; ".join(analysis.refused))


def _contrast_table(results: Results) -> Table:
    """Differences between conditions for the terminal."""
    from pilotid.analysis.report_estimates import chance, contrast_overview, to_error
    from pilotid.numbers import MINUS, NONE, number

    table = make_table()
    shown, table.title = contrast_overview(results)
    table.title_justify, table.title_style = "left", ""
    for title in ("", "conditions", "method", "quantity", "unit"):
        table.add_column(title, no_wrap=True)
    for title in ("n", "difference", "t", "p", "p Holm", "d_z"):
        table.add_column(title, justify="right", no_wrap=True)
    for c in shown:
        numbers = (
            f"{to_error(c.difference, c.std_error)} +- {to_error(c.std_error, c.std_error)}",
            number(c.t),
            chance(c.p),
            chance(c.p_holm),
            number(c.effect_size, 2),
        )
        # A terminal may lack these two signs.
        plain = (text.replace(MINUS, "-").replace(NONE, "-") for text in numbers)
        stratum = " ".join(value for _, value in c.stratum)
        pair = c.condition_a if c.within else f"{c.condition_a}:{c.condition_b}"
        table.add_row(stratum, pair, c.method, c.parameter, c.unit, str(c.subjects), *plain)
    return table


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
