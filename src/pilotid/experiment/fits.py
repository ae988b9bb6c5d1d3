"""The work on recordings: a look at each, models chosen, everything fitted, all of it kept."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from pilotid.checks.checks import remarks
from pilotid.checks.detectors import copies_among, fingerprints
from pilotid.choice import (
    Candidate,
    Choice,
    choose_jointly,
    choose_model,
    compare_models,
    default_candidates,
)
from pilotid.element_fit import chosen_element
from pilotid.estimate.estimate import Estimate, Outcome, failed, is_at_bound
from pilotid.estimate.fitted import Fitted, fit_all
from pilotid.estimate.loops import Loops
from pilotid.estimate.method import Method
from pilotid.estimate.quantities import Quantity, spans_decade
from pilotid.experiment.cross_validation import failed_rows, predict_left_out
from pilotid.experiment.files import CONDITION, SUBJECT, Part, in_order
from pilotid.experiment.performance import lines_shared, performance
from pilotid.jobs import Loss, run_tasks
from pilotid.likelihood.remnant_models import LowPass
from pilotid.methods.fourier import first_step_of
from pilotid.model.catalogue import MODELS, with_held
from pilotid.model.element import ControlledElement
from pilotid.model.model import PilotModel
from pilotid.naming.code import code_digest, own_digest, packed, reason, unpacked
from pilotid.naming.settings import plain
from pilotid.recording.files import Reading
from pilotid.recording.recording import Recording
from pilotid.recording.windows import span_of
from pilotid.support.remarks import Remark, remark_of
from pilotid.support.store import Rows
from pilotid.support.terminal import with_bar
from pilotid.support.types import InputError, one_line

if TYPE_CHECKING:
    from pandas import DataFrame

#: What a task gives back: plain objects, as JSON has them.
Content = dict[str, Any]
What = Literal["look", "fit", "left-out"]
#: Recordings for which one model is chosen: their stratum and condition, or one file.
Group = tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Settings:
    """What is done to every recording.

    Attributes
    ----------
    models, methods
        Models that the user named, by name, and methods by their labels.
    auto
        Whether the catalogue's sensible models compete with them, and the best is fitted.
    per_run, left_out
        Whether every run is fitted on its own as well, and predicted by the fit of the others.
    element
        The controlled element, where the user names it.
    seed
        Seed of all random numbers.
    pairs
        What the user contrasts; conditions that differ in one factor if nothing.
    factors
        Level of each factor (columns) by condition; None for no factors.
    keep_all
        Whether estimates that are not determined, or wrong, count as well.
    sensitivity
        Whether each recording is fitted in other ways as well, see `variants`.
    excluded
        Recordings that the user leaves out.
    ignored
        Codes of remarks that the user does not want to see.
    fix
        Parameters that are held or bounded, see `pilotid.model.catalogue.with_held`.
    reading
        How files are read.
    """

    models: Mapping[str, PilotModel]
    auto: bool
    methods: Mapping[str, Method]
    per_run: bool = False
    left_out: bool = False
    element: ControlledElement | None = None
    seed: int = 0
    pairs: Sequence[tuple[str, str]] = ()
    factors: DataFrame | None = None
    keep_all: bool = False
    sensitivity: bool = False
    excluded: Sequence[Part] = ()
    ignored: frozenset[str] = frozenset()
    fix: str | None = None
    reading: Reading = field(default_factory=Reading)

    @property
    def known(self) -> dict[str, PilotModel]:
        """All models that may be fitted, by name."""
        every = {**MODELS, **self.models}
        return {m.name: m for m in with_held(every.values(), self.fix)} if self.fix else every

    def condition_pairs(self, conditions: Sequence[str]) -> list[tuple[str, str]]:
        """The pairs of conditions that are contrasted."""
        if self.pairs:
            return [pair for pair in self.pairs if set(pair) <= set(conditions)]
        every = list(combinations(in_order(conditions), 2))
        if self.factors is None:
            return every
        levels = self.factors
        own = [(a, b) for a, b in every if {a, b} <= {*levels.index}]
        return [(a, b) for a, b in own if (levels.loc[a] != levels.loc[b]).sum() == 1]


@dataclass(frozen=True)
class Fit:
    """What was fitted to a recording, to one run of it, or to all runs but one."""

    part: Part
    run: int | None
    content: Content


@dataclass(frozen=True, eq=False)
class Fits:
    """All that was done.

    Attributes
    ----------
    settings
        What was asked for.
    looks
        The recordings that could be read, and what a look at each gave.
    choices
        The model chosen for each group of recordings; None where all models were named.
    compared
        By stratum and conditions, the models in which these are compared, by condition, and whether
        they suit all; empty where all models were named.
    fits, left_out, varied
        All fits, runs predicted by the fits of the others, and fits in other ways by their names.
    refused
        A sentence for each file that was left out.
    """

    settings: Settings
    looks: Mapping[Part, Content]
    choices: Mapping[Group, Choice]
    compared: Mapping[tuple[Group, Group], tuple[Mapping[str, str], bool]]
    fits: Sequence[Fit]
    left_out: Sequence[Fit]
    varied: Sequence[tuple[str, Fit]]
    refused: Sequence[str]

    @property
    def fields(self) -> list[str]:
        """The fields of the pattern."""
        return [*dict(next(iter(self.looks)).fields)]

    def models_of(self, part: Part) -> list[str]:
        """The models that a recording's own table has."""
        own = self.settings.models
        return [self.choices[group_of(part)].model] if self.settings.auto else [*own]


def group_of(part: Part) -> Group:
    """The recordings that a recording is judged with: those of other subjects, else none."""
    alone = () if part.field(SUBJECT) else (part.name,)
    return (*part.stratum, part.field(CONDITION), *alone)


def variants(
    settings: Settings, look: Content
) -> list[tuple[str, tuple[Reading, dict[str, Method]]]]:
    """Other ways to fit a recording: how files are read, and by which methods, by name."""
    if not settings.sensitivity:
        return []
    reading, methods = settings.reading, dict(settings.methods)
    span = span_of(reading.span) if reading.span else (0.0, look["recording"]["duration"])
    ends = [f"{time:.6g}" for time in (span[0], 0.5 * (span[0] + span[1]), span[1])]

    def other(**changes: object) -> dict[str, Method]:
        """The methods that have these settings, with other values."""
        able = {k: m for k, m in methods.items() if changes.keys() <= vars(m).keys()}
        return {k: replace(m, **changes) for k, m in able.items()}  # type: ignore[type-var]

    return [
        ("band 26 rad/s", (reading, other(band=26.0))),
        ("remnant low-pass", (reading, other(noise=LowPass(2)))),
        ("lead-in 3 s longer", (replace(reading, lead_in=reading.lead_in + 3.0), methods)),
        ("first half", (replace(reading, span=":".join(ends[:2])), methods)),
        ("second half", (replace(reading, span=":".join(ends[1:])), methods)),
    ]


# ----------------------------------------------------------------------------------- tasks


@dataclass(frozen=True)
class Task:
    """One task, which may be done by another process.

    Attributes
    ----------
    key
        A digest of all that its content follows from: recording, settings and code.
    what
        Look at a recording and compare models, fit a model, or fit one to all runs but one and
        predict that one.
    part, reading
        The recording, and how files are read.
    code
        Models, methods (or whether models of the catalogue compete) and controlled element, see
        `pilotid.naming.code.packed`.
    seed
        Seed of all random numbers.
    run
        Number of the run to take alone, or to leave out, from 1; None for all.
    """

    key: str
    what: What
    part: Part
    reading: Reading
    code: bytes
    seed: int
    run: int | None = None


#: A task, and what it gave or why there is nothing.
Answer = tuple[Task, Content | None, str]


def perform(task: Task) -> Answer:
    """Do a task; whatever goes wrong is an answer."""
    try:
        content = {"look": _look, "fit": _fit, "left-out": _leave_out}[task.what](task)
        return task, json.loads(json.dumps(content)), ""
    except InputError as error:
        return task, None, str(error)
    except MemoryError as error:
        return _lost(task, f"{Outcome.OUT_OF_MEMORY.value} {one_line(str(error))}".strip())
    except Exception as error:
        return _lost(task, one_line(reason(error)))


def given_up(task: Task, loss: Loss, why: str) -> Answer:
    """The answer to a task whose process was lost."""
    return _lost(task, f"{loss.value} ({why})")


def _lost(task: Task, why: str) -> Answer:
    return task, None, f"{task.part.name}: {why}" if task.what == "look" else why


def _look(task: Task) -> Content:
    named, auto, element, fix = unpacked(task.code)
    recording = task.part.recording(task.reading)
    choice = chosen_element(recording, element)
    candidates = default_candidates(recording) if auto else ()
    models = {m.name: m for m in with_held((*candidates, *named), fix)}
    shared = filter(None, [lines_shared(recording)])
    compared = compare_models(choice.named_in(recording), list(models.values()), task.seed)
    return {
        "recording": recording.to_dict(),
        "remarks": _graded([*remarks(recording), *shared, *choice.remarks]),
        "fingerprints": list(fingerprints(recording)),
        "candidates": [asdict(candidate) for candidate in compared],
        "performance": [
            [key, unit, values.tolist()] for key, (unit, values) in performance(recording).items()
        ],
    }


def candidates_of(look: Content) -> list[Candidate]:
    """The models compared, from what a look at a recording gave."""
    found = []
    for held in look["candidates"]:
        fields: Content = {k: tuple(v) if isinstance(v, list) else v for k, v in held.items()}
        found.append(Candidate(**fields))
    return found


def _fit(task: Task) -> Content:
    model, methods, element = unpacked(task.code)
    recording = task.part.recording(task.reading, task.run)
    fitted = fit_all(recording, model, methods, task.seed, chosen_element(recording, element))
    return content_of(fitted) | {"responses": _responses(recording, model, task.run)}


def _leave_out(task: Task) -> Content:
    model, methods, _ = unpacked(task.code)
    assert task.run is not None
    fits = predict_left_out(task.part.recording(task.reading), model, methods, task.run, task.seed)
    return {"model": model.name, "left_out": fits}


def content_of(fitted: Fitted) -> Content:
    """What tables and figures need of fits."""
    element = fitted.loop_element
    loops: Sequence[Loops | None] = fitted.loops or [None] * len(fitted.estimates)
    return {
        "model": fitted.model.name,
        "element": element.element.name if element and element.element else "",
        "estimates": [
            {
                "method": e.method,
                "outcome": e.outcome.slug,
                "usable": e.outcome.usable,
                "vaf": e.vaf,
                "remarks": _graded(e.remarks),
                "parameters": _parameters(e),
                "loops": _loops(own) if own else [],
                "loop_remarks": _graded([*own.remarks, *own.notes]) if own else [],
            }
            for e, own in zip(fitted.estimates, loops, strict=True)
        ],
        "responses": [],
    }


def _parameters(estimate: Estimate) -> list[list[object]]:
    """Key, unit, numbers, whether it is determined, and why not, of each quantity."""
    ends = dict(zip(estimate.model.keys, is_at_bound(estimate.model, estimate.values), strict=True))
    return [_row(q, "at its bound" if ends.get(q.key, False) else "") for q in estimate.quantities]


def _loops(loops: Loops) -> list[list[object]]:
    """The same of crossover, phase margin and effective delay, determined together."""
    found: list[list[object]] = []
    for loop in loops.shown:
        low, high = loop.crossover.interval
        known = low > 0.0 and not spans_decade(low, high)
        quantities = (loop.crossover, loop.phase_margin, loop.effective_delay)
        found += [_row(replace(q, determined=known)) for q in quantities]
    return found


def _row(q: Quantity, why: str = "") -> list[object]:
    why = why or ("" if q.determined else "not determined")
    numbers = (q.value, q.std_error, q.lower, q.upper)
    return [q.key, q.unit, *numbers, q.determined, why]


def _responses(recording: Recording, model: PilotModel, run: int | None) -> list[list[object]]:
    """Channel, frequency, real and imaginary part and error of each coefficient at the lines."""
    found = first_step_of(recording, model) if run is None and not model.changes else None
    if found is None:
        return []
    parts = zip(model.channels, found.value, found.std, strict=True)
    return [
        [channel.name, *numbers]
        for channel, value, error in parts
        for numbers in np.transpose([found.omega, value.real, value.imag, error]).tolist()
    ]


def _graded(told: Iterable[str]) -> list[tuple[str, str, str]]:
    """Codes, sentences and grades of remarks, as JSON has them."""
    return [(r.code, str(r), r.grade) for r in map(remark_of, told)]


def remarks_of(told: Iterable[Sequence[str]], ignored: frozenset[str]) -> list[Remark]:
    """Remarks from what `Content` has of them, but those that the user ignores."""
    return [Remark(*own) for own in told if own[0] not in ignored]  # type: ignore[arg-type]


def _failed_content(task: Task, why: str) -> Content:
    """The same of fits that a process was lost with: rows without numbers."""
    model, methods, _ = unpacked(task.code)
    if task.what == "left-out":
        return {"model": model.name, "left_out": failed_rows(methods, Outcome.DIED.slug)}
    estimates = tuple(failed(label, model, Outcome.DIED, why) for label in methods)
    return content_of(Fitted(None, model, estimates))  # type: ignore[arg-type]


# ------------------------------------------------------------------------------ all of them


@dataclass(eq=False)
class _Work:
    """Where tasks are done: what is held, and what is refused meanwhile."""

    store: Rows
    workers: int | None
    settings: Settings
    refused: dict[str, None]
    digests: dict[Part, str] = field(default_factory=dict)

    def task(
        self,
        what: What,
        part: Part,
        content: tuple[object, ...],
        run: int | None = None,
        reading: Reading | None = None,
    ) -> Task:
        """A task with its key; files are read as the user says, or otherwise."""
        seed = self.settings.seed
        told = (what, run, plain(content), code_digest(content), seed, reading)
        text = repr((self.digests[part], *told)).encode("utf-8", "replace")
        key = hashlib.sha256(text).hexdigest()
        how = reading or self.settings.reading
        return Task(key, what, part, how, packed(content), seed, run)

    def contents(self, tasks: Iterable[Task], what: str) -> dict[str, Content]:
        """The contents of tasks by their keys; looks at recordings that failed are missing."""
        every = {task.key: task for task in tasks}
        held = {
            key: content
            for key, task in every.items()
            if (content := self.store.get(dict, (key, task.what, task.run or 0))) is not None
        }
        todo = [task for key, task in every.items() if key not in held]
        if not todo:
            return held
        workers = self.workers if self.workers is None else min(self.workers, len(todo))
        answers = run_tasks(perform, todo, given_up, workers)
        for task, content, why in with_bar(answers, what, len(todo)):
            if content is not None:
                held[task.key] = content
                self.store.put((task.key, task.what, task.run or 0), content, again=True)
            elif task.what == "look":
                self.refused[why] = None
            else:
                held[task.key] = _failed_content(task, why)
        return held

    def looks(self) -> dict[Part, Content]:
        """A look at each recording that can be read."""
        settings = self.settings
        named = (tuple(settings.models.values()), settings.auto, settings.element, settings.fix)
        tasks = {part: self.task("look", part, named) for part in self.digests}
        seen = self.contents(tasks.values(), "looking at recordings")
        looks = {part: seen[task.key] for part, task in tasks.items() if task.key in seen}
        copies = copies_among(
            [part.name for part in looks], [look["fingerprints"] for look in looks.values()]
        )
        for place, look in enumerate(looks.values()):
            look["remarks"] = [*_graded(copies.get(place, ())), *look["remarks"]]
        return looks


def fit_recordings(
    parts: Sequence[Part],
    settings: Settings,
    folder: Path,
    workers: int | None = None,
    refused: Sequence[str] = (),
) -> Fits:
    """Look at recordings, choose models, and fit everything; what is held is not done again.

    Parameters
    ----------
    parts
        The recordings.
    settings
        What is done to each.
    folder
        Where the store is, which exists.
    workers
        Number of processes; None for one for each processor.
    refused
        A sentence for each file that was left out already.
    """
    code, methods, element = own_digest(), dict(settings.methods), settings.element
    with Rows(folder, create=True) as store:
        work = _Work(store, workers, settings, dict.fromkeys(refused))
        for part in parts:
            try:
                work.digests[part] = part.digest(settings.reading) + code
            except InputError as error:
                work.refused[str(error)] = None
        looks = work.looks()
        groups: dict[Group, list[Part]] = {}
        for part in looks:
            groups.setdefault(group_of(part), []).append(part)
        held = {group: [candidates_of(looks[p]) for p in own] for group, own in groups.items()}
        choices = {group: choose_model(own) for group, own in held.items()}
        compared = _compared(groups, held, settings) if settings.auto else {}
        found = Fits(settings, looks, choices, compared, (), (), (), ())
        fits, left, varied = list[Task](), list[Task](), list[tuple[str, Task]]()
        for part, look in looks.items():
            count = int(look["recording"]["runs"])
            runs = range(1, count + 1) if count > 1 else ()
            own = found.models_of(part)
            pairs = [
                models[part.field(CONDITION)]
                for (stratum, _), (models, _) in compared.items()
                if stratum == part.stratum and part.field(CONDITION) in models
            ]
            for name in dict.fromkeys([*own, *pairs]):
                fitted = (settings.known[name], methods, element)
                fits.append(work.task("fit", part, fitted))
                if settings.per_run and name in own:
                    fits += [work.task("fit", part, fitted, run) for run in runs]
                if settings.left_out and name in own:
                    left += [work.task("left-out", part, (*fitted[:2], None), run) for run in runs]
                for word, (reading, other) in variants(settings, look) if name in own else ():
                    fitted = (settings.known[name], other, element)
                    varied.append((word, work.task("fit", part, fitted, None, reading)))
        told = work.contents([*fits, *(task for _, task in varied)], "fitting")
        predicted = work.contents(left, "leaving runs out")
        return replace(
            found,
            fits=[Fit(task.part, task.run, told[task.key]) for task in fits],
            left_out=[Fit(task.part, task.run, predicted[task.key]) for task in left],
            varied=[(word, Fit(task.part, None, told[task.key])) for word, task in varied],
            refused=list(work.refused),
        )


def _compared(
    groups: Mapping[Group, Sequence[Part]],
    held: Mapping[Group, list[list[Candidate]]],
    settings: Settings,
) -> dict[tuple[Group, Group], tuple[Mapping[str, str], bool]]:
    """Models in which the conditions of a pair, or all that factors name, are compared."""
    strata: dict[Group, dict[str, Group]] = {}
    for group, (part, *_) in groups.items():
        if part.field(SUBJECT) and part.field(CONDITION):
            strata.setdefault(part.stratum, {})[part.field(CONDITION)] = group
    found: dict[tuple[Group, Group], tuple[Mapping[str, str], bool]] = {}
    for stratum, conditions in strata.items():
        sets: list[Group] = [*settings.condition_pairs(list(conditions))]
        if settings.factors is not None and set(settings.factors.index) <= set(conditions):
            sets.append(tuple(settings.factors.index))
        for own in sets:
            candidates = {name: held[conditions[name]] for name in own}
            models, suits = choose_jointly(candidates, settings.known)
            # Of many conditions a model that does not suit them all serves no test.
            found[stratum, own] = (models if suits or len(own) == 2 else {}, suits)
    return found
