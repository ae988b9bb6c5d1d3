"""An analysis: recordings looked at, models chosen, everything fitted, all of it kept."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

from pilotid.analysis.candidates import Candidate
from pilotid.analysis.choice import Choice, chosen
from pilotid.analysis.left_out import LeftOut, left_out_rows
from pilotid.analysis.pattern import Part
from pilotid.analysis.rows import SUBJECT, Row, rows_of
from pilotid.analysis.source import Source
from pilotid.analysis.tasks import (
    Answer,
    Content,
    Task,
    candidates_of,
    failed_content,
    fit_task,
    given_up,
    left_out_task,
    look_task,
    perform,
)
from pilotid.database import DamagedError, checksum, in_words, open_to_write
from pilotid.estimates.method import Method
from pilotid.jobs import USUAL_LIMITS, Limits, run_tasks
from pilotid.naming.code import own_digest
from pilotid.pilot.catalogue import MODELS
from pilotid.pilot.element import ControlledElement
from pilotid.pilot.model import PilotModel
from pilotid.types import InputError

#: What is done already: its keys say all that a content follows from (recording, model, methods,
#: settings, code), so that whatever changes is done again.
STORE = "analysis.sqlite"
TABLE = "results (key TEXT PRIMARY KEY, content TEXT, checksum INTEGER)"

#: Recordings that are judged together when a model is chosen: their fields but the subject.
Group = tuple[tuple[str, str], ...]


@dataclass(frozen=True, eq=False)
class Settings:
    """What is done to every recording.

    Attributes
    ----------
    models
        Models that the user named, by name.
    auto
        Whether the catalogue's sensible models compete with them, and the best is fitted alone.
    methods
        Methods by their labels.
    per_run
        Whether every run is fitted on its own as well.
    left_out
        Whether every run is also predicted by the fit of the others.
    element
        The controlled element, where the user names it.
    seed
        Seed of all random numbers.
    """

    models: Mapping[str, PilotModel]
    auto: bool
    methods: Mapping[str, Method]
    per_run: bool = False
    left_out: bool = False
    element: ControlledElement | None = None
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Fit:
    """What was fitted to a recording, or to one run of it; see `content_of`."""

    part: Part
    run: int | None
    content: Content

    def rows(self, what: str, told: str) -> list[Row]:
        """Every quantity of it, see `rows_of`."""
        return rows_of(self.part.name, self.part.fields, self.run, self.content, what, told)


@dataclass(frozen=True, eq=False)
class Analysis:
    """All that the tables and the report are made of.

    Attributes
    ----------
    settings
        What was done to every recording.
    looks
        The recordings that could be read, and what a look at each gave.
    choices
        The model chosen for each group of recordings.
    fits
        All fits.
    refused
        A sentence for each file that was left out.
    left_out
        Runs predicted by the fits of the others.
    """

    settings: Settings
    looks: Mapping[Part, Content]
    choices: Mapping[Group, Choice]
    fits: Sequence[Fit]
    refused: Sequence[str]
    left_out: Sequence[LeftOut] = ()

    @property
    def parts(self) -> list[Part]:
        """The recordings that could be read."""
        return list(self.looks)

    @property
    def rows(self) -> list[Row]:
        """Every quantity of every fit."""
        return [row for fit in self.fits for row in fit.rows("parameters", "remarks")]

    @property
    def loop_rows(self) -> list[Row]:
        """Crossover frequencies and phase margins of every fit."""
        return [row for fit in self.fits for row in fit.rows("loops", "loop_remarks")]

    @property
    def elements(self) -> dict[tuple[str, int | None, str], str]:
        """The controlled element that loops are drawn with, by file, run and model."""
        return {
            (fit.part.name, fit.run, fit.content["model"]): fit.content["element"]
            for fit in self.fits
        }

    def candidates(self, part: Part) -> list[Candidate]:
        """The models compared on a recording."""
        return candidates_of(self.looks[part])


def group_of(part: Part) -> Group:
    """The recordings that a recording is judged with: those of other subjects, else none."""
    if SUBJECT not in dict(part.fields):
        return (*part.fields, ("file", part.name))
    return tuple(pair for pair in part.fields if pair[0] != SUBJECT)


#: Wraps answers in a bar: answers, what they are, how many.
Bar = Callable[[Iterable[Answer], str, int], Iterator[Answer]]


def _opened(path: Path) -> sqlite3.Connection:
    """The file of what is done; one that is damaged costs the time to do it again."""
    try:
        base = open_to_write(path)
    except DamagedError:
        path.unlink()
        base = open_to_write(path)
    base.execute(f"CREATE TABLE IF NOT EXISTS {TABLE}")
    return base


@dataclass(eq=False)
class _Work:
    """Where tasks are done: what is held, and what is refused meanwhile."""

    path: Path
    base: sqlite3.Connection
    bar: Bar
    workers: int | None
    limits: Limits
    refused: dict[str, None] = field(default_factory=dict)

    def held(self, task: Task) -> Content | None:
        """What is held of a task."""
        found = self.base.execute("SELECT * FROM results WHERE key = ?", (task.key,)).fetchone()
        if found is None or found[2] != checksum(*found[:2]):
            return None
        content: Content = json.loads(found[1])
        # A page that was moved away is made again.
        page = content.get("page")
        return None if page and not (self.path.parent / page).exists() else content

    def keep(self, key: str, content: Content) -> None:
        """Keep a content, complete or not at all."""
        text = json.dumps(content)
        row = (key, text, checksum(key, text))
        with in_words(self.path):
            self.base.execute("INSERT OR REPLACE INTO results VALUES (?, ?, ?)", row)

    def contents(self, tasks: Sequence[Task], what: str) -> dict[str, Content]:
        """The contents of tasks by their keys; those that a file is at fault for are missing."""
        found = ((task.key, self.held(task)) for task in tasks)
        held = {key: content for key, content in found if content is not None}
        todo = [task for task in tasks if task.key not in held]
        if not todo:
            return held
        workers = self.workers if self.workers is None else min(self.workers, len(todo))
        answers = run_tasks(perform, todo, given_up, workers, limits=self.limits)
        for answer in self.bar(answers, what, len(todo)):
            if answer.content is not None:
                held[answer.task.key] = answer.content
                self.keep(answer.task.key, answer.content)
            elif answer.task.what != "look":
                held[answer.task.key] = failed_content(answer.task, answer.refused or answer.lost)
            else:
                self.refused[answer.why] = None
        return held


def analyse(
    sources: Sequence[Source],
    settings: Settings,
    folder: Path,
    bar: Bar,
    workers: int | None = None,
    limits: Limits = USUAL_LIMITS,
    refused: Sequence[str] = (),
) -> Analysis:
    """Look at recordings, choose models, and fit everything; what is held is not done again.

    Parameters
    ----------
    sources
        The recordings.
    settings
        What is done to each.
    folder
        Where the store and the figures are, which exists.
    bar
        Shows the progress.
    workers
        Number of processes; None for one for each processor.
    limits
        What a task may take.
    refused
        A sentence for each file that was left out already.
    """
    code = own_digest()
    path = folder / STORE
    with closing(_opened(path)) as base:
        work = _Work(path, base, bar, workers, limits, dict.fromkeys(refused))
        digests = _digests(sources, code, work)
        looks = {
            source: look_task(
                source,
                digest,
                tuple(settings.models.values()),
                settings.auto,
                settings.element,
                settings.seed,
            )
            for source, digest in digests.items()
        }
        seen = work.contents(list(looks.values()), "looking at recordings")
        looked = {r: seen[task.key] for r, task in looks.items() if task.key in seen}
        choices = _choices(looked)
        tasks: list[tuple[Source, int | None, Task]] = []
        for source, look in looked.items():
            for model in _models(source, settings, choices):
                runs = range(1, look["recording"]["runs"] + 1) if settings.per_run else ()
                for run in (None, *(runs if len(runs) > 1 else ())):
                    task = fit_task(
                        source,
                        digests[source],
                        model,
                        settings.methods,
                        run,
                        settings.element,
                        settings.seed,
                        folder if run is None else None,
                    )
                    tasks.append((source, run, task))
        held = work.contents([task for *_, task in tasks], "fitting")
        left = _left_out(looked, digests, settings, choices) if settings.left_out else []
        told = work.contents([task for *_, task in left], "leaving runs out")
        return Analysis(
            settings,
            {source.part: look for source, look in looked.items()},
            choices,
            [Fit(source.part, run, held[task.key]) for source, run, task in tasks],
            list(work.refused),
            [
                line
                for source, run, task in left
                for line in left_out_rows(source.part, run, told[task.key])
            ],
        )


def _left_out(
    looked: Mapping[Source, Content],
    digests: Mapping[Source, str],
    settings: Settings,
    choices: Mapping[Group, Choice],
) -> list[tuple[Source, int, Task]]:
    """The tasks that leave each run out, of recordings of several."""
    return [
        (
            source,
            run,
            left_out_task(source, digests[source], model, settings.methods, run, settings.seed),
        )
        for source, look in looked.items()
        for model in _models(source, settings, choices)
        for run in range(1, look["recording"]["runs"] + 1)
        if look["recording"]["runs"] > 1
    ]


def _digests(sources: Sequence[Source], code: str, work: _Work) -> dict[Source, str]:
    found = {}
    for source in sources:
        try:
            found[source] = source.digest() + code
        except InputError as error:
            work.refused[str(error)] = None
    return found


def _choices(looked: Mapping[Source, Content]) -> dict[Group, Choice]:
    groups: dict[Group, list[list[Candidate]]] = {}
    for source, look in looked.items():
        groups.setdefault(group_of(source.part), []).append(candidates_of(look))
    return {group: chosen(held) for group, held in groups.items()}


def _models(
    source: Source, settings: Settings, choices: Mapping[Group, Choice]
) -> list[PilotModel]:
    """The models that a recording is fitted with."""
    if not settings.auto:
        return list(settings.models.values())
    name = choices[group_of(source.part)].model
    return [{**MODELS, **settings.models}[name]]
