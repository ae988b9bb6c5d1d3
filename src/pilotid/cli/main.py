"""The command line.

Heavy libraries are imported by the commands that need them: `pilotid list` is instant.
"""

from __future__ import annotations

import inspect
import sys
import warnings
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer

from pilotid import datasets
from pilotid.checks.element_fit import chosen_element
from pilotid.cli import options, studies
from pilotid.datasets.named import fitted_scenario, truth
from pilotid.estimate.method import Fitted, Method, fit_all
from pilotid.estimate.warnings import unrecorded
from pilotid.methods import METHODS
from pilotid.methods.bayes import Bayes
from pilotid.model.catalogue import AUTO, MODELS, model_named
from pilotid.model.model import PilotModel
from pilotid.recording.files import Reading, read_with, save_recording
from pilotid.recording.recording import Recording
from pilotid.recording.windows import sidecar_path, stem_of
from pilotid.support.disk import path_shown, require_folder, require_free, strict_json, write_file
from pilotid.support.format import Line, make_console, show, show_warning, with_bar
from pilotid.support.naming import labelled
from pilotid.support.numbers import DEFAULT_SEED, draw_rng, recording_rng
from pilotid.support.remarks import codes_in
from pilotid.support.types import InputError

#: What `list` shows first; all else is under "more".
CORE = {
    "models": ("single", "multi", "gain", "lead-lag"),
    "methods": ("mle", "fourier", "arx", "sindy", "bayes"),
    "scenarios": ("nominal", "single", "population-usual"),
}
STOPPED = 130  # the status that shells give to a program that Ctrl-C ended
app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


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
        typer.echo(f"pilotid {metadata.version('pilotid')}")


@app.command("list")
def list_names() -> None:
    """List models, methods and scenarios, the usual ones first."""
    summaries = {
        "models": {m.name: f"{m.description}: {', '.join(m.keys)}" for m in MODELS.values()},
        "methods": {name: _first_line(m) for name, m in METHODS.items()},
        "scenarios": {s.name: s.description for s in datasets.CATALOGUE.values()},
    }
    for more in ("", "more "):
        for title, entries in summaries.items():
            names = [n for n in entries if n not in CORE[title]] if more else CORE[title]
            lines = (f"  {name:<20} {entries[name]}" for name in names)
            show(make_console(), Line(more + title, "heading"), *lines)


def _first_line(method: Method) -> str:
    """What a method is, and its settings where they are not the usual ones."""
    line = (inspect.getdoc(type(method)) or "").partition("\n")[0]
    return f"{line} {labelled('', method)}".rstrip()


def simulate(
    scenario: str,
    *,
    out: Path,
    seed: int = DEFAULT_SEED,
    runs: int | None = None,
    force: bool = False,
) -> None:
    """Simulate a scenario, or a pilot drawn from a population; truth goes to F.truth.json."""
    truth_file = out.with_suffix(".truth.json")
    written = [out, truth_file, sidecar_path(out)]
    again = truth_file.exists()  # it was simulated
    require_free(written, [Path(scenario)], force=force or again)
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
    ignore: list[str] | None = None,
    json: str | None = None,
    report: Path | None = None,
    force: bool = False,
) -> None:
    """Identify a pilot model from recordings."""
    ignored = codes_in(ignore or ())
    models, methods = options.models_of(model, fix), options.methods_of(method, ["mle"])
    options.require_free(files, json, report, force=force)
    recordings, refused = reading.all(files, joint=joint)
    fits: list[Fitted] = []
    for recording in with_bar(recordings, "fitting", len(recordings)):
        why = {m.name: text for m in models if (text := unrecorded(recording, m))}
        refused += [f"{recording.source}: {text}" for text in why.values()]
        able = [m for m in models if m.name not in why]
        if able or not models:
            found = _fitted(recording, able, fix, methods, seed, element)
            fits += [fitted.without(ignored) for fitted in found]
    if not fits:
        options.raise_refused(refused)
    from pilotid.report.fit import html_report, print_fit

    printed = options.write_json(json, map(_entry, fits))
    if report is not None:
        page = html_report(fits)
        write_file(report, page.encode("utf-8", "replace"))
    console = make_console()
    for number, fitted in enumerate([] if printed else fits):
        show(console, *[""] * (number > 0))
        print_fit(fitted, console)
    options.raise_refused(refused)


def _entry(fitted: Fitted) -> dict[str, Any]:
    """A fit as JSON has it, with what would be recorded if it were the truth."""
    scenario = fitted_scenario(fitted)
    return fitted.to_dict() | ({"scenario": scenario} if scenario else {})


def _fitted(
    recording: Recording,
    named: Sequence[PilotModel],
    fix: str | None,
    methods: Mapping[str, Method],
    seed: int,
    element: str | None,
) -> list[Fitted]:
    """The fits of each model, and their loops with the controlled element, if it is known.

    The first has what was said of models, where there are several or none is named.
    """
    choice = chosen_element(recording, element)
    if len(named) == 1:
        return [fit_all(recording, named[0], methods, seed, choice)]
    from pilotid.likelihood.choice import select

    fitted = select(choice.named_in(recording), named, seed, fix)
    models = named or [fitted.model]
    first, *rest = [fit_all(recording, model, methods, seed, choice) for model in models]
    compared = tuple(map(asdict, fitted.candidates))
    return [replace(first, choice=fitted.reason, compared=compared), *rest]


def check(
    files: list[Path],
    *,
    reading: Reading,
    joint: bool = False,
    element: str | None = None,
    brief: bool = False,
    ignore: list[str] | None = None,
    json: str | None = None,
    force: bool = False,
) -> None:
    """Summarise recordings and report problems."""
    from pilotid.report.check import check_all, summary_of

    ignored = codes_in(ignore or ())
    options.require_free(files, json, force=force)
    recordings, refused = reading.all(files, joint=joint)
    every = check_all(recordings, element, ignored)
    if not options.write_json(json, (checked.to_dict() for checked in every)):
        gap = [""] * (not brief)
        for number, checked in enumerate(every):
            shown = [checked.brief] if brief else checked.blocks()
            show(make_console(), *gap * (number > 0), *shown)
        if len(every) > 1:
            show(make_console(), *gap, summary_of(every))
    options.raise_refused(refused)


#: What is written into a folder, beside figures.
FILES = ("report.html", "draws.npy", "summary.csv", "estimate.json")


def posterior(
    files: list[Path],
    *,
    model: str = AUTO,
    reading: Reading,
    joint: bool = False,
    element: str | None = None,
    seed: int = DEFAULT_SEED,
    out: Path | None = None,
    force: bool = False,
) -> None:
    """Sample the posterior of a pilot model's parameters with emcee."""
    from pilotid.report.fit import print_posterior, quantities_of, write_posterior

    models = [] if model == AUTO else [model_named(model)]
    folders: dict[str, Path] = {}
    if out is not None and len(files) > 1 and not joint:
        folders = {path_shown(file): out / stem_of(file) for file in files}
        if len({*folders.values()}) < len(files):
            raise InputError("two files have one name; choose another --out for one of them")
    for folder in folders.values() or ([out] if out else []):
        require_folder(folder, FILES, read_with(files), force=force)
    recordings, refused = reading.all(files, joint=joint)
    sampler = {"bayes": Bayes(effective=2000.0)}
    for number, recording in enumerate(recordings):
        with make_console(errors=True).status("sampling"):
            (fitted,) = _fitted(recording, models, None, sampler, seed, element)
        quantities = quantities_of(fitted)
        source = f"{recording.source}, "  # behind a file's name may be the span and the runs
        place = next((f for name, f in folders.items() if source.startswith(f"{name}, ")), out)
        written = write_posterior(place, fitted, quantities) if place and quantities else []
        show(make_console(), *[""] * (number > 0))
        print_posterior(fitted, quantities, written)
    options.raise_refused(refused)


for command in (
    *(simulate, fit, check, posterior, studies.analyse, studies.design, studies.compare),
    *(studies.trust, studies.export, studies.report, studies.compare_studies, studies.fetch_data),
):
    app.command()(options.as_command(command))
