"""The commands on studies, on experiments and on designs of forcing functions."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from pilotid import datasets
from pilotid.cli import options
from pilotid.datasets.named import PEOPLE, fetch, recordings_in
from pilotid.methods import METHODS
from pilotid.model.catalogue import AUTO, model_named
from pilotid.recording.files import Reading, load_recording, read_with
from pilotid.support import disk
from pilotid.support.format import Line, Table, make_console, show, table, with_bar
from pilotid.support.naming import split_list
from pilotid.support.numbers import DEFAULT_SEED
from pilotid.support.types import InputError

if TYPE_CHECKING:
    from pilotid.study.table import Comparison

Format = Literal["csv", "mat", "npz"]
Profile = Literal["quick", "full", "paper"]
#: What reports of studies are written as.
TABLES = (
    *("report.html", "report.md", "paper.html"),
    *("estimates.csv", "summary.csv", "population.csv", "scores.csv"),
)


def compare(
    *,
    profile: Profile = "quick",
    scenario: list[str] | None = None,
    like: Path | None = None,
    method: list[str] | None = None,
    replications: int | None = None,
    seed: int = DEFAULT_SEED,
    workers: int | None = None,
    scheduler: str | None = None,
    time_limit: float = 600.0,
    retry_failed: bool = False,
    people: str | None = None,
    imported: Path | None = None,
    out: Path = Path("results/compare"),
) -> None:
    """Compare methods on simulated recordings whose truth is known."""
    from pilotid.study.exchange import enter_estimates, read_estimates, read_manifest
    from pilotid.study.study import PROFILES, Study
    from pilotid.study.table import Store

    if people is not None:
        if scenario or like or replications or scheduler:
            raise InputError("--people: leave out --scenario, --like, --replications, --scheduler")
        folder, known = fetch(people), PEOPLE[people]
        mapping = (known["map"],) if known["map"] else ()
        analyse(
            recordings_in(folder, people),
            out=out,
            model=[known["model"]],
            method=method or ["mle", "mle-white", "mle-reference", "fourier", "arx", "mmle3"],
            how=Analysis(known["pattern"], left_out=True, seed=seed, workers=workers),
            reading=Reading(mapping, float(known["dt"]) if known["dt"] else None),
        )
        return
    default, count, usual = PROFILES[profile]
    if imported is not None:
        _, default, count, _ = read_manifest(imported)
    like_it = [] if like is None else [scenario_like(like, seed)]
    names = options.names_of(scenario, () if like_it else default, list(datasets.CATALOGUE))
    tried = options.names_of(method, usual, list(METHODS))
    study = Study([*like_it, *names], tried, replications or count, seed)
    read = read_with([path for path in (imported, like) if path])
    disk.require_folder(out, TABLES, read)
    theirs = [] if imported is None else read_estimates(imported, study)
    with Store(out, create=True) as store:
        pending, size = study.enter(store, retry=retry_failed), len(study.keys)
        enter_estimates(store, theirs)
        if done := size - len(pending):
            show(make_console(), f"{store.path}: holds {done} of {size} fits already")
        results = study.run(store, pending, workers, scheduler, time_limit or None)
        for _ in with_bar(results, "fits", len(pending)):
            pass
        _finish(out, store.comparison())
        if profile == "paper" and not (scenario or method):
            from pilotid.report.paper import write_paper
            from pilotid.study.paper import fit_trials

            page = write_paper(out, store.comparison(), fit_trials(seed, workers))
            show(make_console(), f"the paper's tables and figures: {page}")


def export(
    scenario: str,
    *,
    replications: int,
    kind: Format = "csv",
    seed: int = DEFAULT_SEED,
    out: Path,
) -> None:
    """Write a study's recordings as files for other languages, and their truth apart."""
    from pilotid.study import exchange

    count = exchange.export(split_list(scenario), replications, seed, out, kind)
    words = f"{out / exchange.MANIFEST}: {count} recordings; the truth is in {out / 'truth'}"
    fits = f"fits of yours: pilotid compare --estimates {out / 'mine.csv'} --seed {seed}"
    show(make_console(), words, fits)


def report(folder: Path) -> None:
    """Make the tables and the report of a comparison again, from its store alone."""
    from pilotid.study.table import Store

    with Store(folder) as store:
        _finish(folder, store.comparison())


def _finish(folder: Path, study: Comparison, *more: str | Table) -> None:
    """Write the tables and the report of a comparison, and show what it and more say."""
    from pilotid.report.study import overview, write_report

    study.write(folder)
    path = write_report(folder, study)
    words, losses, rankings = overview(study)
    show(make_console(), *losses, *rankings, *words, *more, f"report: {path}")


def compare_studies(first: Path, second: Path) -> None:
    """Ratios of losses on the recordings of two studies, the second over the first."""
    from pilotid.study.scores import loss_text
    from pilotid.study.table import find_changes, read_study

    differences, left_out = find_changes(read_study(first), read_study(second))
    rows = differences.itertuples(index=False, name=None)
    changes = table(
        [(*row[:3], loss_text(*row[3:])) for row in rows],
        f"Losses in {second} (B) over those in {first} (A), with 95 % intervals",
        ("scenario", "method", "parameter", "loss B / A"),
        {"loss B / A": str},
    )
    show(make_console(), changes, *left_out)


def scenario_like(path: Path, seed: int) -> datasets.Scenario:
    """The scenario of a recording, or the one in a `trust.json`."""
    from pilotid.likelihood.choice import select
    from pilotid.study.trust import fits_of, scenario_of_estimate

    if path.suffix.lower() == ".json":
        return datasets.named.designed_scenario(path)
    recording = load_recording(path)
    model = select(recording, seed=seed).model
    return scenario_of_estimate(fits_of(recording, model, seed=seed)[0], recording)


def trust(
    files: list[Path],
    *,
    out: Path,
    model: str = AUTO,
    method: list[str] | None = None,
    replications: int = 40,
    reading: Reading,
    seed: int = DEFAULT_SEED,
    workers: int | None = None,
) -> None:
    """Compare methods on simulations of a recording, and correct the intervals of its fit.

    The first method that is named is the one whose fit is judged, else mle.
    """
    from pilotid.likelihood.choice import select
    from pilotid.report.study_tables import advice, trust_table
    from pilotid.study.trust import TRUST, UNKNOWN, try_fit

    disk.require_folder(out, TABLES, read_with(files))
    (recording,) = reading.all(files, joint=True)[0].values()
    chosen = select(recording, seed=seed).model if model == AUTO else model_named(model)
    tried = options.names_of(method, [], list(METHODS))
    trusted = try_fit(recording, chosen, tried, out, replications, seed, workers)
    content = trusted.to_dict()
    said = [*advice(content), UNKNOWN, f"scenario and numbers: {out / TRUST}"]
    _finish(out, trusted.comparison, trust_table(content), *said)


def fetch_data(name: str | None = None) -> None:
    """Fetch published recordings of people into the user's cache, or list them."""
    if name is not None:
        compare = f"pilotid compare --people {name} --out results/{name}"
        show(make_console(), f"The files are in {fetch(name)}:", compare)
        return
    for people in PEOPLE.values():
        facts = [f"{fact}: {text}" for fact, text in people.items() if text and fact != "name"]
        show(make_console(), Line(people["name"], "heading"), *facts)


@dataclass(frozen=True)
class Analysis:
    """What `analyse` of `pilotid.experiment.experiment` takes by these names."""

    pattern: str | None = None
    contrasts: Sequence[str] = ()
    keep_all: bool = False
    sensitivity: bool = False
    per_run: bool = False
    left_out: bool = False
    exclude: Sequence[str] = ()
    factors: str | None = None
    element: str | None = None
    fix: str | None = None
    seed: int = DEFAULT_SEED
    workers: int | None = None


def analyse(
    files: list[Path],
    *,
    out: Path,
    model: list[str] | None = None,
    method: list[str] | None = None,
    how: Analysis,
    reading: Reading,
) -> None:
    """Analyse a laboratory's recordings: subjects, conditions, runs; tables and a report."""
    from pilotid.experiment.experiment import analyse as analysed
    from pilotid.experiment.report import blocks

    models = options.names_of(model, [AUTO], [AUTO])
    methods = list(options.methods_of(method, ["mle"]).values())
    experiment = analysed(
        files, models=models, methods=methods, out=out, reading=reading, **vars(how)
    )
    path = experiment.write(shlex.join(options.TYPED))
    show(make_console(), *blocks(experiment), f"report: {path}")
    options.raise_refused(experiment.refused)


def design(
    scenario: str | None = None,
    *,
    out: Path,
    minimise: str = "A",
    limit: str = "e=1,u=1",
    estimates: Path | None = None,
) -> None:
    """Design forcing functions for small errors, within limits on error and control."""
    from importlib import metadata

    from pilotid.datasets import design as designs
    from pilotid.report.design import error_table, sentences, write_report

    read = [Path(path) for path in (scenario, estimates) if path is not None]
    disk.require_folder(out, ("design.json", "forcing.csv", "report.html"), read)
    chosen = datasets.scenario_named(scenario or "nominal")
    if not isinstance(chosen, datasets.Scenario) or chosen.violation is not None:
        raise InputError(f"{chosen.name}: a design is for one sound loop; name a scenario")
    if estimates is not None:
        chosen = designs.scenario_of_fit(estimates, chosen if scenario else None)
    made = designs.design(chosen, minimise, options.numbers_in("--limit", limit))
    command = shlex.join(options.TYPED)
    designs.write_files(out, made, {"pilotid": metadata.version("pilotid"), "command": command})
    page = write_report(out, made, command)
    show(make_console(), error_table(made), *sentences(made), f"report: {page}")
