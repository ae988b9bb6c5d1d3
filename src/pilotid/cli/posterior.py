"""The command `pilotid posterior`: a full emcee run, its tables, files and figures."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from pilotid.cli import options
from pilotid.pilot.catalogue import AUTO, model_named
from pilotid.pilot.element import ControlledElement, element_named
from pilotid.pilot.model import PilotModel
from pilotid.recordings.files import Reading, read_with
from pilotid.recordings.recording import Recording
from pilotid.recordings.windows import stem_of
from pilotid.support.disk import path_shown, require_folder
from pilotid.support.numbers import DEFAULT_SEED, fit_rng
from pilotid.support.terminal import make_console
from pilotid.support.types import InputError

#: What is written into a folder, beside figures.
FILES = ("report.html", "draws.npy", "summary.csv", "estimate.json")


def posterior(
    files: list[Path],
    *,
    model: str = AUTO,
    white: bool = False,
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
        infer(recording, chosen, white=white, element=plant, seed=seed, folder=folder)
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
    white: bool,
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
        derived_spreads,
        loop_notes,
        parameter_spreads,
        predictive_band,
    )
    from pilotid.recordings.checks import remarks
    from pilotid.report.posterior import print_posterior, write_posterior
    from pilotid.support.terminal import share_bar

    method = Bayes(sampler="emcee")
    if white:
        method = replace(method, likelihood="white", band=None)
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
    spreads = parameter_spreads(draws, model) + derived_spreads(draws, model, recording, plant)
    predictive = predictive_band(draws, likelihood, rng)
    notes = [choice.words, *(loop_notes(draws, model, plant) if plant is not None else [])]
    fit = replace(fit, remarks=(*fit.remarks, *choice.remarks))
    if folder is not None:
        written = write_posterior(folder, fit, spreads, predictive, plant, notes)
        notes += [str(path) for path in written]
    print_posterior(fit, spreads, predictive, notes)
