"""The command line.

Heavy libraries are imported by the commands that need them: `pilotid list` is instant.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer

from pilotid import datasets
from pilotid.cli import options, studies
from pilotid.datasets.named import truth
from pilotid.estimate.method import Fitted, Method, fit_all
from pilotid.estimate.warnings import unrecorded
from pilotid.methods import METHODS
from pilotid.methods.bayes import Bayes
from pilotid.model.catalogue import AUTO, MODELS
from pilotid.model.model import PilotModel
from pilotid.recording.files import Reading, read_with, save_recording
from pilotid.recording.recording import Recording
from pilotid.recording.windows import sidecar_path, stem_of
from pilotid.support.disk import require_folder, require_free, strict_json, write_file
from pilotid.support.format import Line, make_console, show, show_warning, with_bar
from pilotid.support.naming import labelled
from pilotid.support.numbers import DEFAULT_SEED, draw_rng, recording_rng
from pilotid.support.types import InputError

STOPPED = 130  # the status that shells give to a program that Ctrl-C ended
#: Help is not asked for where nobody asks: to make that of None, typer takes 50 ms.
SETTINGS = {"default_map": {"help": False}}
app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, context_settings=SETTINGS)


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line; bad input is one sentence on standard error and status 2."""
    for stream in (sys.stdout, sys.stderr):
        # A terminal that lacks a sign is no reason to stop.
        getattr(stream, "reconfigure", lambda **_: None)(errors="replace")
    given = list(sys.argv[1:] if arguments is None else arguments)
    options.TYPED[:] = "pilotid", *given
    with warnings.catch_warnings():
        warnings.showwarning = show_warning
        try:
            status = app(given or ["--help"], prog_name="pilotid", standalone_mode=False)
            sys.stdout.flush()
        except InputError as error:
            _end(str(error))
        except OSError as error:  # of files it is a sentence already
            sys.stdout = None  # what is left cannot be written either
            _end(f"the output cannot be written ({error.strerror or error}); make room for it")
        except MemoryError as error:
            _end(f"out of memory {error}".rstrip() + "; cut the recording, or do less at once")
        except typer.TyperException as error:  # a wrong option or value
            command = getattr(getattr(error, "ctx", None), "command_path", "pilotid")
            _end(f"{error.format_message().rstrip('.')}; see {command} --help")
    if status == STOPPED:
        _end(
            "stopped; what a study or an analysis has done is kept: run the same command again",
            STOPPED,
        )
    raise SystemExit(status or 0)


def _end(sentence: str, status: int = 2) -> NoReturn:
    with suppress(OSError):
        sys.stderr.write(f"pilotid: {' '.join(sentence.split())}\n")
        sys.stderr.flush()
    raise SystemExit(status) from None


@app.callback(invoke_without_command=True)
def program(
    version: Annotated[bool, typer.Option("--version", help="Show the version.")] = False,
) -> None:
    """Identify pilot models from tracking recordings with every standard method."""
    if version:
        from importlib import metadata

        typer.echo(f"pilotid {metadata.version('pilotid')}")


@app.command("list", context_settings=SETTINGS)
def list_names() -> None:
    """List models, methods and scenarios."""
    summaries = {
        "models": {m.name: f"{m.description}: {', '.join(m.keys)}" for m in MODELS.values()},
        "methods": {
            name: f"{str(method.__doc__).splitlines()[0]} {labelled('', method)}".rstrip()
            for name, method in METHODS.items()
        },
        "scenarios": {s.name: s.description for s in datasets.CATALOGUE.values()},
    }
    for title, entries in summaries.items():
        lines = (f"  {name:<20} {text}" for name, text in entries.items())
        show(make_console(), Line(title, "heading"), *lines)


def simulate(
    scenario: str,
    *,
    out: Path,
    seed: int = DEFAULT_SEED,
    runs: int | None = None,
) -> None:
    """Simulate a scenario, or a pilot drawn from a population; truth goes to F.truth.json."""
    truth_file = out.with_suffix(".truth.json")
    written = [out, truth_file, sidecar_path(out)]
    require_free(written, [Path(scenario)], force=truth_file.exists())  # it was simulated
    named = datasets.scenario_named(scenario)
    drawn = named.drawn(draw_rng(seed, named.name))
    drawn = replace(drawn, runs=runs or drawn.runs)
    save_recording(datasets.simulate(drawn, recording_rng(seed, drawn.name)), out)
    write_file(truth_file, strict_json({"seed": seed, **truth(drawn)}).encode())
    what = f"a recording of scenario {drawn.name} (model {drawn.model.name})"
    show(make_console(), f"{out}: {what}", f"{truth_file}: its truth, which no method reads")


def fit(
    files: list[Path],
    *,
    model: str = AUTO,
    method: list[str] | None = None,
    reading: Reading,
    joint: bool = False,
    element: str | None = None,
    fix: str | None = None,
    seed: int = DEFAULT_SEED,
    json: str | None = None,
    report: Path | None = None,
) -> None:
    """Identify a pilot model from recordings."""
    named, methods = options.model_of(model, fix), options.methods_of(method, ["mle"])
    options.require_free(files, json, report)
    read, refused = reading.all(files, joint=joint)
    fits: list[Fitted] = []
    for recording in with_bar(read.values(), "fitting", len(read)):
        if named is not None and (why := unrecorded(recording, named)):
            refused.append(f"{recording.source}: {why}")
        else:
            fits.append(_fitted(recording, named, fix, methods, seed, element))
    if not fits:
        options.raise_refused(refused)
    from pilotid.report.fit import html_report, print_fit

    printed = options.write_json(json, map(_entry, fits))
    if report is not None:
        write_file(report, html_report(fits).encode("utf-8", "replace"))
    for fitted in [] if printed else fits:
        print_fit(fitted, make_console())
    options.raise_refused(refused)


def _entry(fitted: Fitted) -> dict[str, Any]:
    """A fit as JSON has it, with what would be recorded if it were the truth."""
    from pilotid.study.trust import fitted_scenario

    scenario = fitted_scenario(fitted)
    return fitted.to_dict() | ({"scenario": scenario} if scenario else {})


def _fitted(
    recording: Recording,
    named: PilotModel | None,
    fix: str | None,
    methods: Mapping[str, Method],
    seed: int,
    element: str | None,
) -> Fitted:
    """The fits of a model, or of the one that the recording supports best, and their loops."""
    if named is not None:
        return fit_all(recording, named, methods, seed, element)
    from pilotid.likelihood.choice import select

    selected = select(recording, seed=seed, fixed=fix, element=element)
    fitted = fit_all(recording, selected.model, methods, seed, element)
    compared = tuple(map(asdict, selected.candidates))
    return replace(fitted, choice=selected.reason, compared=compared)


def check(
    files: list[Path],
    *,
    reading: Reading,
    joint: bool = False,
    element: str | None = None,
    brief: bool = False,
    json: str | None = None,
) -> None:
    """Summarise recordings and report problems."""
    from pilotid.report.check import check_all, summary_of

    options.require_free(files, json)
    read, refused = reading.all(files, joint=joint)
    every = check_all([*read.values()], element)
    if not options.write_json(json, (checked.to_dict() for checked in every)):
        for checked in every:
            show(make_console(), *([checked.brief] if brief else checked.blocks()))
        if len(every) > 1:
            show(make_console(), summary_of(every))
    options.raise_refused(refused)


def posterior(
    files: list[Path],
    *,
    model: str = AUTO,
    reading: Reading,
    joint: bool = False,
    element: str | None = None,
    seed: int = DEFAULT_SEED,
    out: Path | None = None,
) -> None:
    """Sample the posterior of a pilot model's parameters with emcee."""
    from pilotid.report.fit import print_posterior, quantities_of, write_posterior

    named = options.model_of(model, None)
    several = len(files) > 1 and not joint
    folders = {file: out / stem_of(file) if several else out for file in files if out is not None}
    if several and len({*folders.values()}) < len(folders):
        raise InputError("two files have one name; choose another --out for one of them")
    names = ("report.html", "draws.npy", "summary.csv", "estimate.json")
    for folder in dict.fromkeys(folders.values()):
        require_folder(folder, names, read_with(files))
    read, refused = reading.all(files, joint=joint)
    sampler = {"bayes": Bayes(effective=2000.0)}
    for file, recording in read.items():
        fitted = _fitted(recording, named, None, sampler, seed, element)
        quantities = quantities_of(fitted)
        is_written = out is not None and quantities
        written = write_posterior(folders[file], fitted, quantities) if is_written else []
        print_posterior(fitted, quantities, written)
    options.raise_refused(refused)


for command in (
    *(simulate, fit, check, posterior, studies.analyse, studies.design, studies.compare),
    *(studies.trust, studies.export, studies.report, studies.compare_studies, studies.fetch_data),
):
    app.command(context_settings=SETTINGS)(options.as_command(command))
