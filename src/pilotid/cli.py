"""The command line.

Heavy libraries are imported by the commands that need them: `pilotid list` is instant.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from pilotid import output
from pilotid.arguments import default_method, methods_of, names_of, require_writable, started
from pilotid.estimate import Method
from pilotid.files import load_recording, parse_mapping, save_recording, write_file
from pilotid.fits import fit_all
from pilotid.model import MODELS, model_named
from pilotid.randomness import DEFAULT_SEED, recording_rng
from pilotid.recording import joined
from pilotid.types import InputError

if TYPE_CHECKING:
    from pilotid.study import Row

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

    console = output.make_console()
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
    return (inspect.getdoc(type(method)) or "").partition("\n")[0]


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
    text = output.strict_json({"seed": seed, **truth(chosen)})
    write_file(truth_file, text.encode())
    console = output.make_console()
    console.print(f"{out}: a recording of scenario {chosen.name}", soft_wrap=True)
    console.print(f"{truth_file}: its truth, which no method reads", soft_wrap=True)


@app.command()
def fit(
    files: Annotated[
        list[Path], typer.Argument(metavar="F.csv|F.mat ...", help="Recordings to identify.")
    ],
    model: Annotated[
        str, typer.Option(metavar="NAME", help="Pilot model; multi needs motion of the pilot.")
    ] = "single",
    method: MethodOption = None,
    mapping: Annotated[
        list[str] | None,
        typer.Option(
            "--map",
            metavar="u=stick,e=err",
            help="The file's names for t, e, u, x, ft, fd; a minus before one flips its sign.",
        ),
    ] = None,
    joint: Annotated[
        bool, typer.Option("--joint", help="Take all files as runs of one recording.")
    ] = False,
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
) -> None:
    """Identify a pilot model from recordings."""
    chosen = started(model_named(model), start)
    methods = methods_of(method, [default_method()])
    json_file = None if json in (None, "-") else Path(str(json))
    for target in (json_file, report):
        if target is not None:
            require_writable(target, files)
    names = parse_mapping(",".join(mapping)) if mapping else None
    recordings = [load_recording(file, names) for file in files]
    if joint and len(recordings) > 1:
        recordings = [joined(recordings)]
    todo = output.progress(recordings, "fitting", len(recordings))
    fits = [fit_all(recording, chosen, methods, seed) for recording in todo]

    entries = [output.fit_json(f) for f in fits]
    text = output.strict_json(entries[0] if len(entries) == 1 else entries)
    if json_file is not None:
        write_file(json_file, text.encode())
    if report is not None:
        from pilotid.report import html_report

        write_file(report, html_report(fits).encode("utf-8", "replace"))
    if json == "-":
        sys.stdout.write(text)
    else:
        output.print_fits(output.make_console(), fits)


@app.command()
def compare(
    profile: Annotated[
        str,
        typer.Option(
            metavar="quick|full",
            help="quick: 20 recordings of the nominal scenario; full: 100 of every scenario.",
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
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder of the results.")] = Path(
        "results/compare"
    ),
) -> None:
    """Compare methods on simulated recordings whose truth is known."""
    from pilotid.datasets import SCENARIOS, scenario_named
    from pilotid.methods import methods
    from pilotid.study import PROFILES, make_folder, run_units, units_of

    if profile not in PROFILES:
        raise InputError(f"unknown profile '{profile}': choose from {', '.join(PROFILES)}")
    default, count = PROFILES[profile]
    scenarios = [scenario_named(n).name for n in names_of(scenario, default, list(SCENARIOS))]
    chosen = [m.name for m in methods_of(method, list(methods()))]
    units = units_of(scenarios, chosen, replications or count, seed)
    make_folder(out)
    done = output.progress(run_units(units, workers), "comparing", len(units))
    _finish(out, [row for rows in done for row in rows])


@app.command()
def report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="What `compare` wrote.")],
) -> None:
    """Make the summary and report of a comparison again, from its estimates alone."""
    from pilotid.study import read_estimates

    _finish(folder, read_estimates(folder))


def _finish(folder: Path, rows: list[Row]) -> None:
    from pilotid.summary import summarise, summary_tables, write_results

    console = output.make_console()
    summaries = summarise(rows)
    for table in summary_tables(summaries):
        output.print_table(console, table)
        console.print()
    console.print(f"report: {write_results(folder, rows, summaries)}", soft_wrap=True)
