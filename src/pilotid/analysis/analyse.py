"""An analysis: recordings looked at, models chosen, everything fitted, all of it kept."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

from pilotid.analysis.cross_validation import LeftOut, failed_rows, left_out_rows, predict_left_out
from pilotid.analysis.performance import lines_shared, performance_content, performance_rows
from pilotid.analysis.recordings import Part
from pilotid.analysis.rows import CONDITION, SUBJECT, Row, grouped, in_order
from pilotid.element.fit import chosen_element
from pilotid.estimates.estimate import Outcome, failed
from pilotid.estimates.fitted import Fitted, fit_all
from pilotid.estimates.method import Method
from pilotid.estimates.quantities import Quantity
from pilotid.jobs import Loss, run_tasks
from pilotid.model_choice import (
    Candidate,
    Choice,
    choose_jointly,
    choose_model,
    compare_models,
    default_candidates,
)
from pilotid.naming.code import code_digest, own_digest, packed, reason, unpacked
from pilotid.naming.settings import plain
from pilotid.pilot.catalogue import MODELS, with_held
from pilotid.pilot.element import ControlledElement
from pilotid.pilot.model import PilotModel
from pilotid.recordings.checks import remarks
from pilotid.recordings.detectors import copies_among, fingerprints
from pilotid.recordings.files import Reading
from pilotid.recordings.windows import stem_of
from pilotid.support.remarks import Remark, remark_of
from pilotid.support.store import Key, Rows, number
from pilotid.support.terminal import with_bar
from pilotid.support.types import InputError, one_line

#: What a task gives back: plain objects, as JSON has them.
Content = dict[str, Any]
#: Recordings for which one model is chosen: their fields but the subject.
Group = tuple[tuple[str, str], ...]


@dataclass(frozen=True, eq=False)
class Settings:
    """What is done to every recording.

    Attributes
    ----------
    models, methods
        Models that the user named, by name, and methods by their labels.
    auto
        Whether the catalogue's sensible models compete with them, and the best is fitted alone.
    per_run
        Whether every run is fitted on its own as well.
    left_out
        Whether every run is also predicted by the fit of the others.
    element
        The controlled element, where the user names it.
    seed
        Seed of all random numbers.
    pairs
        What the user contrasts; every condition with every other if nothing.
    alone
        Whether a model is chosen for each condition alone, also of those that are contrasted.
    factors
        Level of each factor by condition, by factor; see `pilotid.analysis.factors`.
    excluded
        Recordings that the user leaves out.
    fix
        Parameters that are held or bounded, see `pilotid.pilot.catalogue.with_held`.
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
    alone: bool = False
    factors: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    excluded: Sequence[Part] = ()
    fix: str | None = None
    reading: Reading = field(default_factory=Reading)

    @property
    def known(self) -> dict[str, PilotModel]:
        """All models that may be fitted, by name."""
        every = {**MODELS, **self.models}
        return {m.name: m for m in with_held(every.values(), self.fix)} if self.fix else every


@dataclass(frozen=True, eq=False)
class Fit:
    """What was fitted to a recording, or to one run of it; see `content_of`."""

    part: Part
    run: int | None
    content: Content

    def rows(self, what: str, told: str) -> list[Row]:
        """Every quantity of it, or of its loops: where it has them, and the remarks on them."""
        return [
            Row(
                file=self.part.name,
                fields=self.part.fields,
                run=self.run,
                model=self.content["model"],
                method=estimate["method"],
                parameter=key,
                unit=unit,
                value=_number(value),
                std_error=_number(error),
                lower=_number(lower),
                upper=_number(upper),
                outcome=estimate["outcome"],
                usable=estimate["usable"],
                remarks=tuple(Remark(*remark) for remark in estimate[told]),
                agrees=estimate["agrees"],
                determined=determined,
            )
            for estimate in self.content["estimates"]
            for key, unit, value, error, lower, upper, determined in estimate[what]
        ]


def _number(held: float | None) -> float:
    return math.nan if held is None else held


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
    ignored
        Codes of remarks that the user does not want to see.
    """

    settings: Settings
    looks: Mapping[Part, Content]
    choices: Mapping[Group, Choice]
    fits: Sequence[Fit]
    refused: Sequence[str]
    left_out: Sequence[LeftOut] = ()
    ignored: frozenset[str] = frozenset()

    def without(self, codes: frozenset[str]) -> Analysis:
        """The same without remarks of these codes."""

        def kept(content: Content) -> Content:
            own: Content = {
                name: [told for told in content[name] if told[0] not in codes]
                for name in ("remarks", "loop_remarks")
                if name in content
            }
            return {**content, **own}

        looks = {part: kept(look) for part, look in self.looks.items()}
        fits = [
            replace(f, content={**f.content, "estimates": [*map(kept, f.content["estimates"])]})
            for f in self.fits
        ]
        return replace(self, looks=looks, fits=fits, ignored=codes)

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
    def performance(self) -> list[Row]:
        """Performance and control activity in every recording."""
        per_run = self.settings.per_run
        return [
            row
            for part, look in self.looks.items()
            for row in performance_rows(part, look, per_run=per_run)
        ]

    @property
    def elements(self) -> dict[tuple[str, int | None, str], str]:
        """The controlled element that loops are drawn with, by file, run and model."""
        return {
            (fit.part.name, fit.run, fit.content["model"]): fit.content["element"]
            for fit in self.fits
        }

    @property
    def remarks(self) -> list[tuple[str, Remark]]:
        """What is said of recordings and of fits of all runs together, and where."""
        found = [
            (part.words, Remark(*told))
            for part, look in self.looks.items()
            for told in look["remarks"]
        ]
        for fit in self.fits:
            if fit.run is None:
                for e in fit.content["estimates"]:
                    place = f"{fit.part.words}, {e['method']}"
                    found += [(place, Remark(*told)) for told in e["remarks"]]
        return found

    def candidates(self, part: Part) -> list[Candidate]:
        """The models compared on a recording."""
        return candidates_of(self.looks[part])


def group_words(group: Sequence[tuple[str, str]]) -> str:
    """A group of recordings, or the stratum of a contrast, in words."""
    fields = [value for field, value in group if field != "file"]
    return " ".join(fields) or " ".join(stem_of(value) for _, value in group)


def group_of(part: Part) -> Group:
    """The recordings that a recording is judged with: those of other subjects, else none."""
    if SUBJECT not in dict(part.fields):
        return (*part.fields, ("file", part.name))
    return tuple(pair for pair in part.fields if pair[0] != SUBJECT)


# ----------------------------------------------------------------------------------- tasks

What = Literal["look", "fit", "left-out"]


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


class Answer(NamedTuple):
    """What a task gave, or why there is nothing."""

    task: Task
    content: Content | None
    why: str = ""


def perform(task: Task) -> Answer:
    """Do a task; whatever goes wrong is an answer."""
    try:
        done = {"look": _look, "fit": _fit, "left-out": _leave_out}
        content = done[task.what](task)
        return Answer(task, json.loads(json.dumps(content)))
    except InputError as error:
        return Answer(task, None, str(error))
    except MemoryError as error:
        return _lost(task, f"{Outcome.OUT_OF_MEMORY.value} {one_line(str(error))}".strip())
    except Exception as error:
        return _lost(task, one_line(reason(error)))


def given_up(task: Task, loss: Loss, why: str) -> Answer:
    """The answer to a task whose process was lost."""
    return _lost(task, f"{loss.value} ({why})")


def _lost(task: Task, why: str) -> Answer:
    return Answer(task, None, f"{task.part.name}: {why}" if task.what == "look" else why)


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
        "performance": performance_content(recording),
    }


def candidates_of(look: Content) -> list[Candidate]:
    """The models compared, from what a look at a recording gave."""
    found = []
    for held in look["candidates"]:
        fields: Content = {k: tuple(v) if isinstance(v, list) else v for k, v in held.items()}
        found.append(Candidate(**fields))
    return found


def _fit(task: Task) -> Content:
    """What is kept of fits."""
    model, methods, element = unpacked(task.code)
    recording = task.part.recording(task.reading, task.run)
    fitted = fit_all(recording, model, methods, task.seed, chosen_element(recording, element))
    return content_of(fitted)


def _leave_out(task: Task) -> Content:
    model, methods, _ = unpacked(task.code)
    assert task.run is not None
    fits = predict_left_out(task.part.recording(task.reading), model, methods, task.run, task.seed)
    return {"model": model.name, "left_out": fits}


def content_of(fitted: Fitted) -> Content:
    """What the tables and the report need of fits."""
    element = fitted.loop_element
    loops = fitted.loops or [None] * len(fitted.estimates)
    return {
        "model": fitted.model.name,
        "element": element.element.name if element and element.element else "",
        "estimates": [
            {
                "method": e.method,
                "outcome": e.outcome.slug,
                "usable": e.outcome.usable,
                "vaf": number(e.vaf),
                "remarks": _graded(e.remarks),
                "agrees": e.specification is None or e.specification.agrees,
                "parameters": [[q.key, q.unit, *_numbers(q)] for q in e.quantities],
                "loops": [[q.key, q.unit, *_numbers(q)] for q in own.quantities] if own else [],
                "loop_remarks": _graded([*own.remarks, *own.notes]) if own else [],
            }
            for e, own in zip(fitted.estimates, loops, strict=True)
        ],
    }


def _graded(remarks: Iterable[str]) -> list[tuple[str, str, str]]:
    """Codes, sentences and grades of remarks, as JSON has them."""
    return [(r.code, str(r), r.grade) for r in map(remark_of, remarks)]


def _failed_content(task: Task, why: str) -> Content:
    """The same of fits that a process was lost with: rows without numbers."""
    model, methods, _ = unpacked(task.code)
    if task.what == "left-out":
        return {"model": model.name, "left_out": failed_rows(methods, Outcome.DIED.slug)}
    estimates = tuple(failed(label, model, Outcome.DIED, why) for label in methods)
    return content_of(Fitted(None, model, estimates))  # type: ignore[arg-type]


def _numbers(q: Quantity) -> list[float | None]:
    return [*(number(n) for n in (q.value, q.std_error, q.lower, q.upper)), q.determined]


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
    ) -> Task:
        """A task with its key."""
        seed = self.settings.seed
        told = (what, run, plain(content), code_digest(content), seed)
        text = repr((self.digests[part], *told)).encode("utf-8", "replace")
        key = hashlib.sha256(text).hexdigest()
        reading = self.settings.reading
        return Task(key, what, part, reading, packed(content), seed, run)

    def contents(self, tasks: Sequence[Task], what: str) -> dict[str, Content]:
        """The contents of tasks by their keys; looks at recordings that failed are missing."""
        found = ((task.key, self.store.get(dict, _key(task))) for task in tasks)
        held = {key: content for key, content in found if content is not None}
        todo = [task for task in tasks if task.key not in held]
        if not todo:
            return held
        workers = self.workers if self.workers is None else min(self.workers, len(todo))
        answers = run_tasks(perform, todo, given_up, workers)
        for task, content, why in with_bar(answers, what, len(todo)):
            if content is not None:
                held[task.key] = content
                self.store.put(_key(task), content, again=True)
            elif task.what == "look":
                self.refused[why] = None
            else:
                held[task.key] = _failed_content(task, why)
        return held


def analyse(
    parts: Sequence[Part],
    settings: Settings,
    folder: Path,
    workers: int | None = None,
    refused: Sequence[str] = (),
) -> Analysis:
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
        compared_with = (tuple(settings.models.values()), settings.auto, element, settings.fix)
        looks = {part: work.task("look", part, compared_with) for part in work.digests}
        seen = work.contents(list(looks.values()), "looking at recordings")
        looked = {part: seen[t.key] for part, t in looks.items() if t.key in seen}
        copies = copies_among(
            [part.name for part in looked],
            [look["fingerprints"] for look in looked.values()],
        )
        for place, look in enumerate(looked.values()):
            look["remarks"] = [*_graded(copies.get(place, ())), *look["remarks"]]
        groups = {
            group: [candidates_of(looked[part]) for part in own]
            for group, own in grouped(looked, group_of).items()
        }
        choices = _choices(groups, settings)
        models = {
            part: [settings.known[choices[group_of(part)].model]]
            if settings.auto
            else [settings.known[name] for name in settings.models]
            for part in looked
        }
        fits, left = [], []
        for part, look in looked.items():
            count = int(look["recording"]["runs"])
            runs = range(1, count + 1) if count > 1 else ()
            for model in models[part]:
                fitted = (model, methods, element)
                fits.append(work.task("fit", part, fitted))
                if settings.per_run:
                    fits += [work.task("fit", part, fitted, run) for run in runs]
                if settings.left_out:
                    predicts = (model, methods, None)
                    left += [work.task("left-out", part, predicts, run) for run in runs]
        held = work.contents(fits, "fitting")
        told = work.contents(left, "leaving runs out")
        every = [Fit(task.part, task.run, held[task.key]) for task in fits]
        runs_left = [(task.part, task.run or 0, told[task.key]) for task in left]
        lines = [line for own in runs_left for line in left_out_rows(*own)]
        return Analysis(settings, looked, choices, every, list(work.refused), lines)


def _choices(
    groups: Mapping[Group, list[list[Candidate]]], settings: Settings
) -> dict[Group, Choice]:
    """A model for each group of recordings, one for those that are contrasted."""
    found: dict[Group, Choice] = {}
    strata: dict[Group, dict[str, Group]] = {}
    for group in groups:
        name = dict(group).get(CONDITION)
        if settings.alone or not settings.auto or name is None or "file" in dict(group):
            found[group] = choose_model(groups[group])
        else:
            rest = tuple(pair for pair in group if pair[0] != CONDITION)
            strata.setdefault(rest, {})[name] = group
    for own in strata.values():
        for together in compared(in_order(list(own)), settings.pairs):
            held = {name: groups[own[name]] for name in together}
            jointly = choose_jointly(held, settings.known)
            found |= {own[name]: choice for name, choice in jointly.items()}
    return {group: found[group] for group in groups}


def compared(conditions: Sequence[str], pairs: Sequence[tuple[str, str]]) -> list[tuple[str, ...]]:
    """Conditions that are contrasted, directly or by way of others; all if no pair is given."""
    if not pairs:
        return [tuple(conditions)]
    sets = [{name} for name in conditions]
    for pair in pairs:
        joined = [own for own in sets if own & set(pair)]
        sets = [own for own in sets if own not in joined]
        if joined:
            sets.append(set().union(*joined))
    return [tuple(name for name in conditions if name in own) for own in sets]


def _key(task: Task) -> Key:
    """The key of a task's row in the store."""
    return task.key, task.what, task.run or 0
