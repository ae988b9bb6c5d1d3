"""The command `pilotid posterior`: a full emcee run, its tables, files and figures."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from pilotid.disk import path_shown
from pilotid.element.fit import chosen_element
from pilotid.estimates.applicability import motionless_input
from pilotid.estimates.estimate import Outcome, failed
from pilotid.estimates.fitted import Fitted
from pilotid.estimates.method import import_libraries
from pilotid.estimates.warnings import all_remarks
from pilotid.methods.bayes import Bayes
from pilotid.pilot.element import ControlledElement
from pilotid.pilot.model import PilotModel
from pilotid.posterior.predictive import (
    derived_spreads,
    loop_notes,
    parameter_spreads,
    predictive_band,
)
from pilotid.recordings.checks import remarks
from pilotid.recordings.recording import Recording
from pilotid.seeds import fit_rng
from pilotid.show.posterior import print_posterior, sampling_bar, write_posterior
from pilotid.types import InputError


def folders_of(files: Sequence[Path], out: Path | None) -> dict[str, Path]:
    """A folder inside `out` for each of several files, named after it.

    Raises
    ------
    InputError
        If two files would share one.
    """
    if out is None:
        return {}
    taken: dict[Path, Path] = {}
    for file in files:
        folder = out / file.stem
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
    """Sample a posterior with emcee and print what it says.

    Parameters
    ----------
    recording, model
        What is identified.
    white
        Whether the residual is taken for white.
    element
        Controlled element; None for that which the recording names or shows.
    seed
        Seed of all random numbers.
    folder
        Where draws, summary and figures go; None for nowhere.
    """
    method = Bayes(sampler="emcee")
    if white:
        method = replace(method, likelihood="white", band=None)
    rng = fit_rng(seed, method.name)
    told = remarks(recording)
    objection = motionless_input(recording, model)
    if objection:
        nothing = failed(method.name, model, Outcome.NOT_APPLICABLE, objection)
        print_posterior(Fitted(recording, model, (nothing,), told), [], [], None)
        return
    import_libraries(method)
    choice = chosen_element(recording, element)
    begin = time.perf_counter()
    with sampling_bar() as watch:
        estimate, likelihood = method.infer(choice.named_in(recording), model, rng, watch)
    seconds = time.perf_counter() - begin
    estimate = replace(estimate, seconds=seconds, remarks=all_remarks(estimate, recording))
    fit = Fitted(recording, model, (estimate,), told)
    draws = estimate.draws
    if draws is None:
        print_posterior(fit, [], [], None)
        return
    fit = replace(fit, remarks=(*fit.remarks, *choice.remarks))
    plant = choice.element
    spreads = parameter_spreads(draws, model)
    spreads += derived_spreads(draws, model, recording, plant)
    predictive = predictive_band(draws, likelihood, rng)
    notes = [choice.words]
    if plant is not None:
        notes += loop_notes(draws, model, plant)
    if folder is not None:
        written = write_posterior(folder, fit, spreads, predictive, plant, notes)
        notes += [str(path) for path in written]
    print_posterior(fit, spreads, notes, predictive)
