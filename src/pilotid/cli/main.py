"""The command line.

Heavy libraries are imported by the commands that need them: `pilotid list` is instant.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Sequence
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from pilotid.cli.arguments import (
    default_method,
    methods_of,
    names_of,
    read_truth,
    require_writable,
    started,
)
from pilotid.disk import strict_json, write_file
from pilotid.estimates.fitted import Fitted, fit_all
from pilotid.estimates.method import Method
from pilotid.pilot.catalogue import MODELS, model_named
from pilotid.recordings.files import load_recording, parse_mapping, save_recording
from pilotid.recordings.recording import Recording, joined
from pilotid.seeds import DEFAULT_SEED, recording_rng
from pilotid.terminal import make_console, print_table, with_bar
from pilotid.types import InputError

if TYPE_CHECKING:
    from pilotid.study.store import Store, Unit

app = typer.Typer(
    help="Identify pilot models from tracking recordings with every standard method.",
    add_completion=False,
    pretty_exceptions_enable=False,
)

SeedOption = Annotated[int, typer.Option("--seed", min=0, help="Seed of all random numbers.")]
MethodOption = Annotated[
    list[str] | None,
    typer.Option(
        "--method", metavar="NAME", help="Method; repeat, separate by commas, or say all."
    ),
]
ScenarioOption = Annotated[
    list[str] | None,
    typer.Option(
        "--scenario", metavar="NAME", help="Scenario; repeat, separate by commas, or say all."
    ),
]
ModelOption = Annotated[
    str, typer.Option(metavar="NAME", help="Pilot model; multi needs motion of the pilot.")
]
MapOption = Annotated[
    list[str] | None,
    typer.Option(
        "--map",
        metavar="u=stick,e=err",
        help="The file's names for t, e, u, x, ft, fd; a minus before one flips its sign.",
    ),
]
JointOption = Annotated[
    bool, typer.Option("--joint", help="Take all files as runs of one recording.")
]


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line; bad input is one sentence on standard error and status 2."""
    for stream in (sys.stdout, sys.stderr):
        # A terminal that lacks a sign is no reason to stop.
        getattr(stream, "reconfigure", lambda **_: None)(errors="replace")
    given = list(sys.argv[1:] if arguments is None else arguments)
    try:
        status = app(given or ["--help"], prog_name="pilotid", standalone_mode=False)
    except InputError as error:
        _refuse(str(error))
    except typer.TyperException as error:  # a wrong option or value
        context = getattr(error, "ctx", None)
        command = context.command_path if context else "pilotid"
        _refuse(f"{error.format_message().rstrip('.')}; see {command} --help")
    raise SystemExit(status or 0)


def _refuse(sentence: str) -> NoReturn:
    sys.stderr.write(f"pilotid: {' '.join(sentence.split())}\n")
    raise SystemExit(2) from None


@app.command("list")
def list_names() -> None:
    """List models, methods and scenarios."""
    from pilotid.datasets import SCENARIOS
    from pilotid.methods import methods

    console = make_console()
    summaries = {
        "models": {m.name: f"{m.description}: {', '.join(m.keys)}" for m in MODELS.values()},
        "methods": {m.name: _first_line(m) for m in methods().values()},
        "scenarios": {s.name: s.description for s in SCENARIOS.values()},
    }
    for title, entries in summaries.items():
        console.print(title, style="bold")
        for name, text in entries.items():
            console.print(f"  {name:<17} {text}", soft_wrap=True)


def _first_line(method: Method) -> str:
    """What a method is, and its settings where they are not the usual ones."""
    line = (inspect.getdoc(type(method)) or "").partition("\n")[0]
    given: Any = method  # methods of other packages need not be dataclasses
    settings = fields(given) if is_dataclass(given) else ()
    values = {f.name: getattr(given, f.name) for f in settings}
    changed = [f"{f.name}={values[f.name]!r}" for f in settings if values[f.name] != f.default]
    return f"{line} ({', '.join(changed)})" if changed else line


@app.command()
def simulate(
    scenario: Annotated[str, typer.Argument(metavar="SCENARIO", help="See `pilotid list`.")],
    out: Annotated[Path, typer.Option(metavar="F.csv", help="Recording to write, .csv or .mat.")],
    seed: SeedOption = DEFAULT_SEED,
    runs: Annotated[
        int | None, typer.Option(min=1, help="Runs, each with its own remnant.")
    ] = None,
) -> None:
    """Simulate a scenario; its truth goes to F.truth.json."""
    from pilotid.datasets import scenario_named
    from pilotid.datasets import simulate as simulated
    from pilotid.datasets.truth import truth

    chosen = scenario_named(scenario)
    chosen = replace(chosen, runs=runs or chosen.runs)
    recording = simulated(chosen, recording_rng(seed, chosen.name))
    save_recording(recording, out)
    truth_file = out.with_suffix(".truth.json")
    text = strict_json({"seed": seed, **truth(chosen)})
    write_file(truth_file, text.encode())
    console = make_console()
    console.print(f"{out}: a recording of scenario {chosen.name}", soft_wrap=True)
    console.print(f"{truth_file}: its truth, which no method reads", soft_wrap=True)


@app.command()
def fit(
    files: Annotated[
        list[Path], typer.Argument(metavar="F.csv|F.mat ...", help="Recordings to identify.")
    ],
    model: ModelOption = "single",
    method: MethodOption = None,
    mapping: MapOption = None,
    joint: JointOption = False,
    start: Annotated[
        str | None, typer.Option(metavar="Kvis=0.2,tlead=1.5", help="Initial guesses.")
    ] = None,
    seed: SeedOption = DEFAULT_SEED,
    json: Annotated[
        str | None, typer.Option(metavar="F.json|-", help="Write the estimates as JSON; - prints.")
    ] = None,
    report: Annotated[
        Path | None, typer.Option(metavar="F.html", help="Write a report with figures.")
    ] = None,
    truth: Annotated[
        Path | None,
        typer.Option(metavar="F.truth.json", help="Draw a simulation's truth in the report."),
    ] = None,
) -> None:
    """Identify a pilot model from recordings."""
    chosen = started(model_named(model), start)
    true = read_truth(truth, chosen) if truth is not None else None
    methods = methods_of(method, [default_method()])
    json_file = None if json in (None, "-") else Path(str(json))
    for target in (json_file, report):
        if target is not None:
            require_writable(target, files)
    recordings = _loaded(files, mapping, joint)
    todo = with_bar(recordings, "fitting", len(recordings))
    fits = [fit_all(recording, chosen, methods, seed) for recording in todo]

    entries = [f.to_dict() for f in fits]
    text = strict_json(entries[0] if len(entries) == 1 else entries)
    if json_file is not None:
        write_file(json_file, text.encode())
    if report is not None:
        from pilotid.show.page import html_report

        write_file(report, html_report(fits, true).encode("utf-8", "replace"))
    if json == "-":
        sys.stdout.write(text)
    else:
        _print(fits)


def _print(fits: Sequence[Fitted]) -> None:
    """Print the tables of several fits, an empty line between them."""
    console = make_console()
    for number, fit in enumerate(fits):
        if number:
            console.print()
        fit.print(console)


def _loaded(files: list[Path], mapping: list[str] | None, joint: bool) -> list[Recording]:
    """The recordings in files, as one if they are runs of one."""
    names = parse_mapping(",".join(mapping)) if mapping else None
    recordings = [load_recording(file, names) for file in files]
    return [joined(recordings)] if joint and len(recordings) > 1 else recordings


@app.command()
def posterior(
    files: Annotated[
        list[Path], typer.Argument(metavar="F.csv|F.mat ...", help="Recording to identify.")
    ],
    model: ModelOption = "single",
    white: Annotated[
        bool, typer.Option("--white", help="Take the residual for white, as the seed did.")
    ] = False,
    mapping: MapOption = None,
    joint: JointOption = False,
    element: Annotated[
        str | None,
        typer.Option(metavar="4/s^2", help="Controlled element, for the loops' margins."),
    ] = None,
    seed: SeedOption = DEFAULT_SEED,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder for draws, summary and figures.")
    ] = None,
) -> None:
    """Sample the posterior of a pilot model's parameters with emcee."""
    from pilotid.cli.posterior import infer
    from pilotid.disk import make_folder
    from pilotid.pilot.element import element_named

    if len(files) > 1 and not joint:
        raise InputError("several files need --joint: they are then runs of one recording")
    plant = element_named(element) if element else None
    chosen = model_named(model)
    (recording,) = _loaded(files, mapping, joint)
    if out is not None:
        make_folder(out)
    infer(recording, chosen, white=white, element=plant, seed=seed, folder=out)


@app.command()
def compare(
    profile: Annotated[
        str,
        typer.Option(
            metavar="quick|full",
            help="quick: some recordings of the nominal scenario; full: 500 of every scenario.",
        ),
    ] = "quick",
    scenario: ScenarioOption = None,
    method: MethodOption = None,
    replications: Annotated[
        int | None, typer.Option(min=1, help="Recordings of each scenario.")
    ] = None,
    seed: SeedOption = DEFAULT_SEED,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes; default: one for each processor.")
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Use the workers of this Dask scheduler instead."),
    ] = None,
    mix: Annotated[
        bool, typer.Option("--mix", help="Add to results of other code or settings in DIR.")
    ] = False,
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder of the results; goes on where it stopped.")
    ] = Path("results/compare"),
) -> None:
    """Compare methods on simulated recordings whose truth is known."""
    from pilotid.cli.progress import with_progress
    from pilotid.datasets import SCENARIOS, scenario_named
    from pilotid.disk import make_folder
    from pilotid.methods import methods
    from pilotid.study.store import Store
    from pilotid.study.study import PROFILES, Study

    if profile not in PROFILES:
        raise InputError(f"unknown profile '{profile}': choose from {', '.join(PROFILES)}")
    if workers is not None and scheduler is not None:
        raise InputError("--workers and --scheduler exclude each other; leave one out")
    default, count = PROFILES[profile]
    scenarios = [scenario_named(n).name for n in names_of(scenario, default, list(SCENARIOS))]
    chosen = [m.name for m in methods_of(method, list(methods()))]
    study = Study(tuple(scenarios), tuple(chosen), replications or count, seed)
    make_folder(out)
    with Store(out, create=True) as store:
        pending = study.enter(store, mix=mix)
        console = make_console()
        total = len(study.units())
        if len(pending) < total:
            held = total - len(pending)
            console.print(f"{store.path}: holds {held} of {total} fits already", soft_wrap=True)
        results = with_progress(study.run(store, pending, workers, scheduler), pending)
        try:
            for number, _ in enumerate(results, start=1):
                if number == len(chosen):  # one fit by each method tells how long all will take
                    _foretell(store, pending, workers)
        except KeyboardInterrupt:
            raise InputError(
                f"stopped; {store.path} keeps what is done, and the same command goes on from there"
            ) from None
        _finish(out, store)


def _foretell(store: Store, pending: list[Unit], workers: int | None) -> None:
    """Say about how long a long study will take."""
    from pilotid.study.study import remaining_seconds
    from pilotid.study.workers import processors

    processes = workers or processors()
    minutes = remaining_seconds(store, pending, processes) / 60.0
    if minutes > 1.0:
        make_console(errors=True).print(
            f"{len(pending)} fits, about {minutes:.0f} min on {processes} processes", soft_wrap=True
        )


@app.command()
def report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="What `compare` wrote.")],
) -> None:
    """Make the tables and the report of a comparison again, from its store alone."""
    from pilotid.study.store import Store

    with Store(folder) as store:
        _finish(folder, store)


def _finish(folder: Path, store: Store) -> None:
    from pilotid.report.page import overview_table, write_report
    from pilotid.study.comparison import comparison_of
    from pilotid.study.summary import write_tables

    study = comparison_of(store)
    write_tables(folder, study)
    path = write_report(folder, store, study)
    console = make_console()
    print_table(console, overview_table(study))
    console.print(f"report: {path}", soft_wrap=True)
