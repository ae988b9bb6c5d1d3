"""The work of an analysis, in tasks that cross to other processes: look at a recording, fit it.

What a task gives back is plain data, which the store keeps as JSON.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pilotid.analysis.candidates import Candidate, compared, sensible
from pilotid.analysis.left_out import failed_rows, predicted
from pilotid.analysis.source import Source
from pilotid.disk import make_folder, write_file
from pilotid.element.fit import chosen_element
from pilotid.estimates.estimate import Outcome, failed
from pilotid.estimates.fitted import Fitted, fit_all
from pilotid.estimates.method import Method
from pilotid.estimates.quantities import Quantity
from pilotid.jobs import Loss
from pilotid.methods.fourier import first_step_of
from pilotid.naming.code import code_digest, packed, reason, unpacked
from pilotid.naming.settings import plain
from pilotid.pilot.element import ControlledElement
from pilotid.pilot.model import PilotModel
from pilotid.recordings.checks import remarks
from pilotid.study.entries import number
from pilotid.types import InputError, one_line

Content = dict[str, Any]

#: The folder of the recordings' pages.
PAGES = "recordings"


@dataclass(frozen=True)
class Task:
    """One task.

    Attributes
    ----------
    key
        Tells all that its content follows from.
    what
        ``look``, ``fit``, or ``left-out``: fit all runs but one, and predict that one.
    source
        The recording: where it is and how it is read.
    run
        Number of the run to take alone, or to leave out, from 1; None for all.
    code
        Models and methods, see `pilotid.naming.code.packed`.
    seed
        Seed of all random numbers.
    folder
        Where the recording's page goes; None for none.
    """

    key: str
    what: str
    source: Source
    run: int | None
    code: bytes
    seed: int
    folder: Path | None


@dataclass(frozen=True)
class Answer:
    """What a task gave: content, or a sentence that says why there is none.

    Attributes
    ----------
    task
        The task.
    content
        Plain data; None where there is none.
    refused
        Why, if the recording is at fault.
    lost
        How the process was lost, if it was.
    """

    task: Task
    content: Content | None = None
    refused: str = ""
    lost: str = ""

    @property
    def why(self) -> str:
        """Why there is no content, with the recording's name."""
        return self.refused or f"{self.task.source.part.name}: {self.lost}"


def look_task(
    source: Source,
    digest: str,
    models: tuple[PilotModel, ...],
    auto: bool,
    element: ControlledElement | None,
    seed: int,
) -> Task:
    """The task to look at a recording and to compare models on it.

    Parameters
    ----------
    source
        The recording.
    digest
        Of the file's bytes and the code.
    models
        Models that the user named.
    auto
        Whether the sensible ones of the catalogue are compared too.
    element
        The controlled element that the user names, if any.
    seed
        Seed of the searches.
    """
    own = [code_digest(model) for model in models]
    key = _key(digest, "look", models, own, auto, element, seed)
    return Task(key, "look", source, None, packed((models, auto, element)), seed, None)


def fit_task(
    source: Source,
    digest: str,
    model: PilotModel,
    methods: Mapping[str, Method],
    run: int | None,
    element: ControlledElement | None,
    seed: int,
    folder: Path | None,
) -> Task:
    """The task to fit one model to a recording, or to one run of it, by all methods."""
    told = {label: (plain(method), code_digest(method)) for label, method in methods.items()}
    drawn = folder is not None
    key = _key(digest, "fit", run, model, code_digest(model), told, element, seed, drawn)
    return Task(key, "fit", source, run, packed((model, dict(methods), element)), seed, folder)


def left_out_task(
    source: Source,
    digest: str,
    model: PilotModel,
    methods: Mapping[str, Method],
    run: int,
    seed: int,
) -> Task:
    """The task to fit one model to all runs of a recording but one, which is then predicted."""
    told = {label: (plain(method), code_digest(method)) for label, method in methods.items()}
    key = _key(digest, "left-out", run, model, code_digest(model), told, seed)
    return Task(key, "left-out", source, run, packed((model, dict(methods), None)), seed, None)


def _key(*parts: object) -> str:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(repr(part).encode("utf-8", "replace") + b"\0")
    return digest.hexdigest()


def perform(task: Task) -> Answer:
    """Do a task; whatever goes wrong is an answer."""
    try:
        content = {"look": _look, "fit": _fit, "left-out": _left_out}[task.what](task)
        return Answer(task, json.loads(json.dumps(content)))
    except InputError as error:
        return Answer(task, refused=str(error))
    except MemoryError as error:
        return Answer(task, lost=f"{Outcome.OUT_OF_MEMORY.value} {one_line(str(error))}".strip())
    except Exception as error:
        return Answer(task, lost=one_line(reason(error)))


def given_up(task: Task, loss: Loss, why: str) -> Answer:
    """The answer to a task whose process was lost."""
    return Answer(task, lost=f"{loss.value} ({why})")


def _look(task: Task) -> Content:
    named, auto, element = unpacked(task.code)
    recording = task.source.recording()
    choice = chosen_element(recording, element)
    models = {model.name: model for model in (*(sensible(recording) if auto else ()), *named)}
    candidates = compared(choice.named_in(recording), list(models.values()), task.seed)
    return {
        "recording": recording.to_dict(),
        "remarks": [*remarks(recording), *choice.remarks],
        "candidates": [asdict(candidate) for candidate in candidates],
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
    recording = task.source.recording(task.run)
    choice = chosen_element(recording, element)
    fitted = fit_all(recording, model, methods, task.seed, choice)
    content = content_of(fitted)
    if task.folder is not None:
        content["page"] = _page(task, fitted)
    return content


def _left_out(task: Task) -> Content:
    model, methods, _ = unpacked(task.code)
    assert task.run is not None
    fits = predicted(task.source.recording(), model, methods, task.run, task.seed)
    return {"model": model.name, "left_out": fits}


def _page(task: Task, fitted: Fitted) -> str:
    """Write a recording's page, with its figures, and give its place beside the report."""
    from pilotid.report.fit import html_report

    assert task.folder is not None
    text = html_report([fitted], points=[first_step_of(fitted.recording, fitted.model)])
    words = re.sub(r"[^\w.+-]+", "_", f"{task.source.part.words}_{fitted.model.name}")
    name = f"{PAGES}/{words}_{task.key[:6]}.html"
    make_folder(task.folder / PAGES)
    write_file(task.folder / name, text.encode("utf-8", "replace"))
    return name


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
                "verdict": e.verdict(timed=False),
                "vaf": number(e.vaf),
                "remarks": list(e.remarks),
                "parameters": [[q.key, q.unit, *_numbers(q)] for q in e.quantities],
                "loops": [[q.key, q.unit, *_numbers(q)] for q in own.quantities] if own else [],
                "loop_remarks": [*own.remarks, *own.notes] if own else [],
            }
            for e, own in zip(fitted.estimates, loops, strict=True)
        ],
    }


def failed_content(task: Task, why: str) -> Content:
    """The same of fits that a process was lost with: rows without numbers."""
    model, methods, _ = unpacked(task.code)
    if task.what == "left-out":
        return {"model": model.name, "left_out": failed_rows(methods, Outcome.DIED.slug)}
    estimates = tuple(failed(label, model, Outcome.DIED, why) for label in methods)
    return content_of(Fitted(None, model, estimates))  # type: ignore[arg-type]


def _numbers(q: Quantity) -> list[float | None]:
    return [number(n) for n in (q.value, q.std_error, q.lower, q.upper)]
