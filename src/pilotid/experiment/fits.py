"""The work on recordings: a look at each, models chosen, everything fitted, all of it kept."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from itertools import zip_longest
from pathlib import Path
from typing import Any, Literal

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
from pilotid.estimate.loops import Loops
from pilotid.estimate.method import Method, fit_all
from pilotid.estimate.quantities import frame_of, spans_decade
from pilotid.experiment.cross_validation import predict_left_out
from pilotid.experiment.files import CONDITION, SUBJECT, Part, alone
from pilotid.experiment.performance import lines_shared, measured
from pilotid.experiment.results import (
    LEFT_OUT,
    LEFT_OUT_COLUMNS,
    LOOP,
    MEASURED,
    MODEL_COLUMNS,
    PARAMETER,
    Compared,
    Group,
    Results,
    Settings,
    group_of,
)
from pilotid.jobs import Loss, processors, run_tasks
from pilotid.likelihood.remnant_models import LowPass
from pilotid.methods.fourier import first_step_of
from pilotid.model.catalogue import with_held
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

#: What a task gives back: plain objects, as JSON has them.
Content = dict[str, Any]
#: Seconds that all fits of a model to a recording may take.
TIME_LIMIT = 3600.0


# ----------------------------------------------------------------------------------- tasks


@dataclass(frozen=True)
class Task:
    """One task, which may be done by another process.

    Attributes
    ----------
    key
        A digest of all that its content follows from: recording, settings and code.
    what
        To `look` at a recording or to `fit` a model.
    part
        The recording.
    code
        The other arguments, see `pilotid.naming.code.packed`.
    """

    key: str
    what: Literal["look", "fit"]
    part: Part
    code: bytes


#: A task, and what it gave or why there is nothing.
Answer = tuple[Task, Content | None, str]


def perform(task: Task) -> Answer:
    """Do a task; whatever goes wrong is an answer."""
    try:
        code = unpacked(task.code)
        content = look(task.part, *code) if task.what == "look" else fit(task.part, *code)
        return task, json.loads(json.dumps(content)), ""
    except InputError as error:
        return task, None, str(error)
    except Exception as error:
        return task, None, f"{task.part.name}: {one_line(reason(error))}"


def given_up(task: Task, loss: Loss, why: str) -> Answer:
    """The answer to a task whose process was lost."""
    return task, None, f"{task.part.name}: {loss.value} ({why})"


def look(part: Part, settings: Settings) -> Content:
    """What a recording shows, what is wrong with it, and what it says for each model."""
    recording = part.recording(settings.reading)
    chosen = chosen_element(recording, settings.element)
    candidates = default_candidates(recording) if settings.auto else ()
    every = with_held((*candidates, *settings.models.values()), settings.fix)
    models = list({model.name: model for model in every}.values())
    shared = filter(None, [lines_shared(recording)])
    signals = {
        **dict.fromkeys(("otherwise", "model", "element"), ""),
        **dict.fromkeys(("remarks", "loop_remarks"), ()),
        **{"method": MEASURED, "outcome": MEASURED, "usable": True, "run": None},
        "quantities": measured(recording),
    }
    return {
        "runs": recording.runs,
        "remarks": _graded([*remarks(recording), *shared, *chosen.remarks]),
        "fingerprints": list(fingerprints(recording)),
        "candidates": [
            asdict(own) for own in compare_models(chosen.named_in(recording), models, settings.seed)
        ],
        "estimates": [signals],
        **dict.fromkeys(("left_out", "responses"), ()),
    }


def fit(part: Part, model: PilotModel, settings: Settings) -> Content:
    """Fits of a model to a recording, and if so asked to its runs, and in other ways."""
    recording, methods = part.recording(settings.reading), dict(settings.methods)
    runs = range(1, recording.runs + 1) if recording.runs > 1 else ()
    single = [("", run, alone(recording, run), methods) for run in runs if settings.per_run]
    ways: list[tuple[str, int | None, Recording, dict[str, Method]]]
    ways = [("", None, recording, methods), *single]
    for name, reading, some in variants(settings, recording.duration):
        with suppress(InputError):  # half of the recording may be too short
            ways.append((name, None, part.recording(reading), some))
    estimates = []
    for name, run, own, some in ways:
        fitted = fit_all(own, model, some, settings.seed, chosen_element(own, settings.element))
        for estimate, loops in zip_longest(fitted.estimates, fitted.loops):
            estimates.append({"otherwise": name, "run": run, **_estimate(estimate, loops)})
    predicted = [
        {"run": run, **row}
        for run in (runs if settings.left_out else ())
        for row in predict_left_out(recording, model, methods, run, settings.seed)
    ]
    responses = _responses(recording, model)
    return {"estimates": estimates, "left_out": predicted, "responses": responses}


def variants(
    settings: Settings, seconds: float
) -> Iterator[tuple[str, Reading, dict[str, Method]]]:
    """Other ways to fit a recording of so many seconds: name, how it is read, and methods."""
    if not settings.sensitivity:
        return
    reading, methods = settings.reading, dict(settings.methods)
    start, end = span_of(reading.span) if reading.span else (0.0, seconds)
    middle = 0.5 * (start + end)
    changes: dict[str, dict[str, Any]]
    changes = {"band 26 rad/s": {"band": 26.0}, "remnant low-pass": {"noise": LowPass(2)}}
    for name, change in changes.items():
        able = {k: m for k, m in methods.items() if change.keys() <= vars(m).keys()}
        yield name, reading, {k: replace(m, **change) for k, m in able.items()}  # type: ignore[type-var]
    yield "lead-in 3 s longer", replace(reading, lead_in=reading.lead_in + 3.0), methods
    yield "first half", replace(reading, span=f"{start:.6g}:{middle:.6g}"), methods
    yield "second half", replace(reading, span=f"{middle:.6g}:{end:.6g}"), methods


def _estimate(estimate: Estimate, loops: Loops | None) -> Content:
    """What tables need of a fit."""
    model, quantities = estimate.model, list[Content]()
    ends = dict(zip(model.keys, is_at_bound(model, estimate.values), strict=True))
    for row in frame_of(estimate.quantities).to_dict("records"):
        why = "" if row["determined"] else "not determined"
        why = "at its bound" if ends.get(row["parameter"], False) else why
        quantities.append({"kind": PARAMETER, **row, LEFT_OUT: why})
    for loop in loops.shown if loops else ():
        low, high = loop.crossover.interval
        known = low > 0.0 and not spans_decade(low, high)
        own = frame_of((loop.crossover, loop.phase_margin, loop.effective_delay))
        own = own.assign(kind=LOOP, determined=bool(known))
        own[LEFT_OUT] = "" if known else "not determined"
        quantities += own.to_dict("records")
    return {
        "model": model.name,
        "method": estimate.method,
        "outcome": estimate.outcome.slug,
        "usable": estimate.outcome.usable,
        "vaf": estimate.vaf,
        "element": loops.element.name if loops else "",
        "remarks": _graded(estimate.remarks),
        "loop_remarks": _graded([*loops.remarks, *loops.notes]) if loops else [],
        "quantities": quantities,
    }


def _responses(recording: Recording, model: PilotModel) -> list[Content]:
    """Coefficients at the forcing lines, with their errors."""
    found = None if model.changes else first_step_of(recording, model)
    if found is None:
        return []
    names = ("omega", "real", "imag", "std")
    return [
        {"channel": channel.name, **dict(zip(names, row, strict=True))}
        for channel, values, errors in zip(model.channels, found.value, found.std, strict=True)
        for row in np.column_stack([found.omega, values.real, values.imag, errors]).tolist()
    ]


def _graded(told: Iterable[str]) -> list[tuple[str, str, str]]:
    """Codes, sentences and grades of remarks, as JSON has them."""
    return [(r.code, str(r), r.grade) for r in map(remark_of, told)]


# ------------------------------------------------------------------------------ all of them


def fit_recordings(
    parts: Sequence[Part],
    settings: Settings,
    folder: Path,
    workers: int | None = None,
    refused: Sequence[str] = (),
) -> Results:
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

    Raises
    ------
    InputError
        If no recording can be used.
    """
    refused, looks = [*refused], dict[Part, Content]()
    # What follows from fits alone makes none of them another one.
    whole = replace(
        settings, pairs=(), factors=None, keep_all=False, excluded=(), ignored=frozenset()
    )
    pooled = replace(whole, per_run=False, left_out=False, sensitivity=False)
    with Rows(folder, create=True) as store:
        tasks = [_task("look", part, replace(pooled, methods={})) for part in parts]
        for part, content, why in _contents(store, tasks, "looking at recordings", workers):
            if content is None:
                refused.append(why)
            else:
                looks[part] = content
        if not looks:
            raise InputError("; ".join(refused))
        _name_copies(looks)
        choices, compared = _choices(looks, settings)
        tasks = []
        for part in looks:
            chosen = [choices[group_of(part)].model] if settings.auto else [*settings.models]
            pairs = [
                models[part.field(CONDITION)]
                for (stratum, _), (models, _) in compared.items()
                if stratum == part.stratum and part.field(CONDITION) in models
            ]
            for name in dict.fromkeys([*chosen, *pairs]):
                how = replace(whole if name in chosen else pooled, models={}, auto=False, fix=None)
                tasks.append(_task("fit", part, settings.known[name], how))
        fits = [(part, content) for part, content, _ in _contents(store, tasks, "fitting", workers)]
    return _results(settings, looks, choices, compared, fits, refused)


def _task(what: Literal["look", "fit"], part: Part, *code: object) -> Task:
    """A task with its key; models, methods and the element may be of the user's own code."""
    told = (own_digest(), part.digest(), part, what, plain(code), code_digest(code))
    key = hashlib.sha256(repr(told).encode("utf-8", "replace")).hexdigest()
    return Task(key, what, part, packed(code))


def _contents(
    store: Rows, tasks: Sequence[Task], what: str, workers: int | None
) -> Iterator[tuple[Part, Any, str]]:
    """The recording and content of each task, in their order, or why there is none."""
    found = {task.key: (store.get(dict, (task.key, task.what, 0)), "") for task in tasks}
    todo = [task for task in tasks if found[task.key][0] is None]
    if todo:
        count = min(workers or processors(), len(todo))
        answers = run_tasks(perform, todo, given_up, count, seconds=TIME_LIMIT)
        for task, content, why in with_bar(answers, what, len(todo)):
            found[task.key] = content, why
            if content is not None:
                store.put((task.key, task.what, 0), content, again=True)
    for task in tasks:
        content, why = found[task.key]
        if content is None and task.what == "fit":  # rows without numbers
            model, how = unpacked(task.code)
            lost = [failed(name, model, Outcome.DIED, why) for name in how.methods]
            rows = [{"otherwise": "", "run": None, **_estimate(own, None)} for own in lost]
            content = {"estimates": rows, "left_out": [], "responses": []}
        yield task.part, content, why


def _name_copies(looks: Mapping[Part, Content]) -> None:
    """Say of recordings whose runs are copies of those of another."""
    prints = [content["fingerprints"] for content in looks.values()]
    copies = copies_among([part.name for part in looks], prints)
    for place, content in enumerate(looks.values()):
        content["remarks"] = [*_graded(copies.get(place, ())), *content["remarks"]]


def _choices(
    looks: Mapping[Part, Content], settings: Settings
) -> tuple[dict[Group, Choice], Compared]:
    """The model of each group of recordings, and those in which conditions are compared."""
    groups: dict[Group, list[list[Candidate]]] = {}
    strata: dict[Group, dict[str, Group]] = {}
    for part, content in looks.items():
        group, condition = group_of(part), part.field(CONDITION)
        groups.setdefault(group, []).append(_candidates(content))
        if part.field(SUBJECT) and condition:
            strata.setdefault(part.stratum, {})[condition] = group
    choices = {group: choose_model(own) for group, own in groups.items()}
    compared = dict[tuple[Group, Group], tuple[Mapping[str, str], bool]]()
    for stratum, conditions in strata.items() if settings.auto else ():
        sets: list[Group] = [*settings.condition_pairs(list(conditions))]
        if settings.factors is not None and set(settings.factors.index) <= set(conditions):
            sets.append(tuple(settings.factors.index))
        for own in sets:
            those = {name: groups[conditions[name]] for name in own}
            models, suits = choose_jointly(those, settings.known)
            # Of many conditions a model that does not suit them all serves no test.
            compared[stratum, own] = (models if suits or len(own) == 2 else {}, suits)
    return choices, compared


def _candidates(content: Content) -> list[Candidate]:
    """The models compared, from what a look at a recording gave."""
    found = []
    for held in content["candidates"]:
        fields: Content = {k: tuple(v) if isinstance(v, list) else v for k, v in held.items()}
        found.append(Candidate(**fields))
    return found


# ---------------------------------------------------------------------------------- frames


def _kept(settings: Settings, told: Iterable[Sequence[str]]) -> list[Remark]:
    """Remarks from what `Content` has of them, but those that the user ignores."""
    return [Remark(*own) for own in told if own[0] not in settings.ignored]  # type: ignore[arg-type]


def _wrong(settings: Settings, told: Iterable[Sequence[str]]) -> str:
    """The first code of remarks that say not to use the numbers; empty if none does."""
    if settings.keep_all:
        return ""
    return next((r.code for r in _kept(settings, told) if r.grade == "wrong"), "")


def _quantities(settings: Settings, content: Content, estimate: Content) -> Iterator[Content]:
    """Rows of the quantities of a fit, with why a value does not count."""
    remarks = [*content["remarks"], *estimate["remarks"], *estimate["loop_remarks"]]
    wrong = _wrong(settings, remarks)
    names = ("otherwise", "run", "model", "method", "outcome", "element")
    head = {name: estimate[name] for name in names}
    for row in estimate["quantities"]:
        out = wrong or ("" if settings.keep_all else row[LEFT_OUT])
        if not estimate["usable"]:
            out = estimate["outcome"]
        elif not math.isfinite(row["value"]):
            out = out or "no value"
        own = _kept(settings, estimate["loop_remarks" if row["kind"] == LOOP else "remarks"])
        said = " | ".join([*([f"not counted: {out}"] if out else []), *own])
        yield {**head, **row, "remarks": said, LEFT_OUT: out}


def _results(
    settings: Settings,
    looks: Mapping[Part, Content],
    choices: Mapping[Group, Choice],
    compared: Compared,
    fits: Sequence[tuple[Part, Content]],
    refused: Sequence[str],
) -> Results:
    """All frames: of looks at recordings, of fits, and of runs left out of them."""
    from pandas import DataFrame

    quantities, verdicts, predicted = list[Content](), list[Content](), list[Content]()
    responses = dict[Part, list[Content]]()
    heads = {part: {"file": part.name, **dict(part.fields)} for part in looks}
    for part, found in [*looks.items(), *fits]:
        content, choice = looks[part], choices[group_of(part)].model
        for estimate in found["estimates"]:
            chosen = not settings.auto or estimate["model"] in ("", choice)
            quantities += [
                {**heads[part], **row, "chosen": chosen}
                for row in _quantities(settings, content, estimate)
                if row["run"] is None or settings.per_run
            ]
            if estimate["method"] != MEASURED:
                told = dict.fromkeys(_kept(settings, [*content["remarks"], *estimate["remarks"]]))
                own = {"recording": part.words, "runs": content["runs"], "told": [*told]}
                verdicts.append({**estimate, **own})
        predicted += [{**heads[part], **row} for row in found["left_out"]]
        if found["responses"] and not _wrong(settings, content["remarks"]):
            place = {"stratum": " ".join(part.stratum), CONDITION: part.field(CONDITION)}
            responses.setdefault(part, [{**place, **row} for row in found["responses"]])
    models = [
        {
            **{**heads[part], **asdict(c)},
            "chosen": "yes" if c.model == choices[group_of(part)].model else "no",
            "freedom": c.freedom or None,
            "chi_squared_per_freedom": c.excess,
            "left_out_log_likelihood": sum(c.left_out_log_likelihood) or None,
            "left_out_chi_squared": sum(c.left_out_chi_squared) or None,
            "remarks": c.bounds,
        }
        for part, content in looks.items()
        for c in _candidates(content)
    ]
    names = ["recording", "otherwise", "run", "runs", "model", "method", "vaf", "outcome", "told"]
    first = [*next(iter(heads.values()))]
    frame = DataFrame(quantities).astype({"run": "Int64"})
    # Of a pilot who changes there is no loop, and nothing to show.
    known = frame.groupby(["kind", "model", "parameter"])["value"].transform("count") > 0
    return Results(
        settings=settings,
        parts=[*looks],
        choices=choices,
        compared=compared,
        fits=DataFrame(verdicts)[names],
        quantities=frame[known | (frame["kind"] != LOOP)].reset_index(drop=True),
        models=DataFrame(models, columns=[*first, *MODEL_COLUMNS]),
        left_out=DataFrame(predicted, columns=[*first, *LEFT_OUT_COLUMNS]),
        responses=DataFrame([row for rows in responses.values() for row in rows]),
        contrasts=DataFrame(),
        factors=DataFrame(),
        refused=refused,
    )
