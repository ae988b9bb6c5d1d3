"""The commands `check`, `analyse`, `design` and `posterior`."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from pilotid.cli import options
from pilotid.naming.settings import split_list
from pilotid.pilot.catalogue import AUTO, model_named
from pilotid.pilot.element import ControlledElement, element_named
from pilotid.pilot.model import PilotModel
from pilotid.recordings.files import Reading, read_with
from pilotid.recordings.recording import Recording
from pilotid.recordings.windows import stem_of
from pilotid.report.check import check_all, summary_of
from pilotid.support.disk import path_shown, require_folder
from pilotid.support.format import show
from pilotid.support.numbers import DEFAULT_SEED, fit_rng
from pilotid.support.remarks import codes_in
from pilotid.support.terminal import make_console
from pilotid.support.types import InputError


def check(
    files: list[Path],
    *,
    model: str = "single,multi",
    reading: Reading,
    joint: bool = False,
    element: str | None = None,
    brief: bool = False,
    ignore: list[str] | None = None,
    json: str | None = None,
    force: bool = False,
) -> None:
    """Summarise recordings and report problems."""
    plant = element_named(element) if element else None
    ignored = codes_in(ignore or ())
    models = [model_named(name) for name in split_list(model, names=True)]
    options.require_free(files, json, force=force)
    recordings, refused = reading.all(files, joint=joint)
    found = check_all(recordings, models, plant, ignored)
    console, summary = make_console(), [summary_of(found)] if len(found) > 1 else []
    if brief and json is None:
        show(console, *(own.brief for own in found), *summary)
    else:
        entries = [own.to_dict() for own in found]
        if not options.write_json(json, entries[0] if len(entries) == 1 else entries):
            for number, own in enumerate(found):
                if number:
                    console.print()
                show(console, *own.blocks())
            if summary:
                console.print()
                show(console, *summary)
    options.raise_refused(refused)


def analyse(
    files: list[Path],
    *,
    out: Path,
    pattern: str | None = None,
    model: list[str] | None = None,
    method: list[str] | None = None,
    contrast: list[str] | None = None,
    keep_all: bool = False,
    sensitivity: bool = False,
    per_run: bool = False,
    left_out: bool = False,
    reading: Reading,
    exclude: list[str] | None = None,
    factors: str | None = None,
    element: str | None = None,
    fix: str | None = None,
    ignore: list[str] | None = None,
    seed: int = DEFAULT_SEED,
    workers: int | None = None,
    force: bool = False,
) -> None:
    """Analyse a laboratory's recordings: subjects, conditions, runs; tables and a report."""
    given = dict(locals())
    from pilotid.experiment.experiment import analyse as analysed
    from pilotid.pilot.catalogue import AUTO

    with options.resumable(out):
        found = analysed(
            files,
            pattern,
            options.names_of(model, [AUTO], [AUTO]),
            list(options.methods_of(method, ["mle"]).values()),
            out=out,
            contrasts=contrast or (),
            keep_all=keep_all,
            sensitivity=sensitivity,
            per_run=per_run,
            left_out=left_out,
            exclude=exclude or (),
            factors=factors,
            element=element,
            fix=fix,
            reading=reading,
            ignore=ignore or (),
            seed=seed,
            workers=workers,
            force=force,
        )
    path = found.write(options.typed_command(analyse, given))
    show(make_console(), *found.blocks(path))
    options.raise_refused(found.refused)


def design(
    scenario: str | None = None,
    *,
    out: Path,
    minimise: str = "A",
    limit: str = "e=1,u=1",
    estimates: Path | None = None,
    force: bool = False,
) -> None:
    """Design forcing functions for small errors, within limits on error and control."""
    given = dict(locals())
    from importlib.metadata import version

    from pilotid.datasets import Scenario, scenario_named
    from pilotid.datasets.named import model_place
    from pilotid.designing.design import design as designed
    from pilotid.designing.design import scenario_of_fit, write_files
    from pilotid.designing.report import error_table, sentences, write_report

    read = [Path(path) for path in (scenario, estimates) if path is not None]
    require_folder(out, ("design.json", "forcing.csv", "report.html"), read, force=force)
    named: Scenario | None = None
    if scenario is not None or estimates is None:
        found = scenario_named(scenario or "nominal")
        if not isinstance(found, Scenario) or found.violation is not None:
            raise InputError(f"{found.name}: a design is for one sound loop; name a scenario")
        named = found
    chosen = named if estimates is None else scenario_of_fit(estimates, named)
    assert isinstance(chosen, Scenario)
    with make_console(errors=True).status("designing"):
        made = designed(chosen, minimise, options.numbers_in("--limit", limit))
    command = options.typed_command(design, given)
    about = {"pilotid": version("pilotid"), "command": command}
    write_files(out, made, about, model_place(scenario or ""))
    page = write_report(out, made, command)
    show(make_console(), error_table(made), *sentences(made), f"report: {page}")


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
    from pilotid.model_choice import select

    plant = element_named(element) if element else None
    named = None if model == AUTO else model_named(model)
    folders = folders_of(files, out) if len(files) > 1 and not joint else {}
    for folder in folders.values() or [out] * (out is not None):
        assert folder is not None
        require_folder(folder, FILES, read_with(files), force=force)
    recordings, refused = reading.all(files, joint=joint)
    for number, recording in enumerate(recordings):
        folder = folders.get(recording.source, out)
        if number:
            make_console().print()
        chosen = named
        if chosen is None:
            selection = select(recording, seed=seed)
            chosen = selection.model
            if selection.reason:
                make_console().print(selection.reason, soft_wrap=True)
        infer(recording, chosen, element=plant, seed=seed, folder=folder)
    options.raise_refused(refused)


def folders_of(files: Sequence[Path], out: Path | None) -> dict[str, Path]:
    """A folder inside `out` for each of several files, named after it."""
    if out is None:
        return {}
    taken: dict[Path, Path] = {}
    for file in files:
        folder = out / stem_of(file)
        if folder in taken:
            raise InputError(
                f"{file}: its results would go to {folder} as those of {taken[folder]}; rename one "
                "of the files, or choose another --out for it"
            )
        taken[folder] = file
    return {path_shown(file): folder for folder, file in taken.items()}


def infer(
    recording: Recording,
    model: PilotModel,
    *,
    element: ControlledElement | None,
    seed: int,
    folder: Path | None,
) -> None:
    """Sample a posterior with emcee, write draws, summary and figures, and print what it says."""
    from pilotid.element.fit import chosen_element
    from pilotid.estimates.applicability import made_for, motionless_input
    from pilotid.estimates.estimate import Outcome, failed
    from pilotid.estimates.fitted import Fitted
    from pilotid.estimates.method import import_libraries
    from pilotid.estimates.warnings import all_remarks
    from pilotid.methods.bayes import Bayes
    from pilotid.posterior.predictive import (
        derived,
        loop_notes,
        predictive_band,
        sampled_parameters,
    )
    from pilotid.recordings.checks import remarks
    from pilotid.report.posterior import print_posterior, write_posterior
    from pilotid.support.terminal import share_bar

    method = Bayes(effective=2000.0)
    rng = fit_rng(seed, method.name)
    told = remarks(recording)
    choice = chosen_element(recording, element)
    model = made_for(choice.named_in(recording), model)
    if objection := motionless_input(recording, model):
        nothing = failed(method.name, model, Outcome.NOT_APPLICABLE, objection)
        print_posterior(Fitted(recording, model, (nothing,), told))
        return
    import_libraries(method)
    begin = time.perf_counter()
    with share_bar("sampling") as watch:
        estimate, likelihood = method.infer(choice.named_in(recording), model, rng, watch)
    seconds = time.perf_counter() - begin
    estimate = replace(estimate, seconds=seconds, remarks=all_remarks(estimate, recording))
    fit = Fitted(recording, model, (estimate,), told)
    if estimate.draws is None:
        print_posterior(fit)
        return
    draws, plant = estimate.draws, choice.element
    quantities = sampled_parameters(draws, model) + derived(draws, model, recording, plant)
    predictive = predictive_band(draws, likelihood, rng)
    notes = [choice.words, *(loop_notes(draws, model, plant) if plant is not None else [])]
    fit = replace(fit, remarks=(*fit.remarks, *choice.remarks))
    if folder is not None:
        written = write_posterior(folder, fit, quantities, predictive, plant, notes)
        notes += [str(path) for path in written]
    print_posterior(fit, quantities, predictive, notes)
