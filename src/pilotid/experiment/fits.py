"""The work on recordings: a look at each, models chosen, everything fitted, all of it kept.

Performance and control activity are variances of signals, and what they are made of.  At the lines
of the target and the disturbance a signal holds the answer to them, and remnant.  The answer is
what a run has in common with the others, in phase with the forcing function; of fewer than three
runs it is what stands above the bins beside the line.  All the rest is remnant.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from itertools import zip_longest
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pandas import DataFrame
from scipy.special import stdtrit

from pilotid.checks.checks import remarks
from pilotid.checks.detectors import copies_among, fingerprints
from pilotid.checks.element_fit import chosen_element
from pilotid.estimate.estimate import Estimate, is_at_bound
from pilotid.estimate.loops import Loops
from pilotid.estimate.method import Method, fit_all, identify
from pilotid.estimate.quantities import frame_of
from pilotid.experiment.files import Part, in_order
from pilotid.experiment.results import Content, Fitting, Results, Settings, choices_of
from pilotid.likelihood.choice import compare_models, default_candidates
from pilotid.likelihood.remnant_models import LowPass
from pilotid.likelihood.second_step import first_step_of
from pilotid.model.model import PilotModel
from pilotid.recording.files import Reading
from pilotid.recording.recording import Recording
from pilotid.recording.spectra import known_lines
from pilotid.recording.windows import of_runs, span_of
from pilotid.support.format import with_bar
from pilotid.support.jobs import Loss, own_digest, run_tasks
from pilotid.support.naming import code_digest, digest_of, packed, to_jsonable, unpacked
from pilotid.support.numbers import LEVEL, fit_rng
from pilotid.support.remarks import Remark, remark_of
from pilotid.support.store import Rows
from pilotid.support.types import FloatArray, InputError, IntArray, one_line, reason

# ------------------------------------------------------------------------------------- performance

#: What variances are made of, by the signal that has it.
SOURCES = {"ft": "target", "fd": "disturbance"}


def performance(recording: Recording) -> dict[str, tuple[str, FloatArray]]:
    """Quantities of e, u and x: unit, and value in each run.

    ``var_e`` and ``rms_e``, and where forcing functions are multisines ``var_e_target``,
    ``var_e_disturbance`` (of those that there are) and ``var_e_remnant``, and ``remnant_share_u``.
    """
    lines = {} if lines_shared(recording) else known_lines(recording)
    every = np.concatenate([*lines.values()]) if lines else np.zeros(0, dtype=int)
    quantities: dict[str, tuple[str, FloatArray]] = {}
    for name in (name for name in ("e", "u", "x") if name in recording.signals):
        unit, signal = recording.units.get(name, ""), getattr(recording, name)
        window = recording.window(signal)
        total = rest = window.var(axis=1)
        square = f"({unit})^2" if "/" in unit else f"{unit}^2" * bool(unit)
        quantities[f"var_{name}"] = square, total
        quantities[f"rms_{name}"] = unit, np.sqrt(np.mean(window**2, axis=1))
        for forcing, own in lines.items():
            answer = _answer(recording, signal, forcing, own, every)
            quantities[f"var_{name}_{SOURCES[forcing]}"] = square, answer
            rest = rest - answer
        if lines:
            quantities[f"var_{name}_remnant"] = square, rest
        if lines and name == "u":
            quantities["remnant_share_u"] = "", rest / total
    return quantities


def measured(recording: Recording) -> list[Content]:
    """What estimates have, of signals: the means over runs, and each of several runs alone."""
    known = performance(recording)
    units, values = zip(*known.values(), strict=True)
    runs, mean = recording.runs, np.mean(values, axis=1)
    error = np.std(values, axis=1, ddof=1) / math.sqrt(runs) if runs > 1 else np.nan * mean
    reach = stdtrit(max(runs - 1, 1), 1.0 - 0.5 * LEVEL) * error
    rows = DataFrame({"parameter": [*known], "unit": units, "determined": True, "left_out": ""})
    whole = rows.assign(value=mean, std_error=error, lower_95=mean - reach, upper_95=mean + reach)
    single = [rows.assign(value=value) for value in zip(*values, strict=True)] if runs > 1 else []
    facts: Content = {"kind": "measured", "model": "", "method": "measured", "outcome": "measured"}
    facts |= {"usable": True, "vaf": math.nan, "element": "", "of_fit": (), "of_loops": ()}
    return [
        {"otherwise": "", "failure": "", "run": run or None, **facts, **row}
        for run, quantities in enumerate([whole, *single])
        for row in quantities.to_dict("records")
    ]


def lines_shared(recording: Recording) -> Remark | None:
    """What to say where nothing tells the answers to target and disturbance apart."""
    lines = known_lines(recording)
    if len(lines) < 2 or not np.intersect1d(lines["ft"], lines["fd"]).size:
        return None
    return Remark("inseparable", "ft and fd have lines in common: variances are not split by them")


def _answer(
    recording: Recording, signal: FloatArray, forcing: str, lines: IntArray, every: IntArray
) -> FloatArray:
    """Variance of the answer to a forcing function at its lines in each run, shape (runs,)."""
    spectrum = np.fft.rfft(recording.window(signal)) / recording.samples
    values, runs = spectrum[:, lines], recording.runs
    if runs < 3:  # too few to set each against the mean of the others
        free = np.setdiff1d(np.arange(1, spectrum.shape[1]), every)
        after = np.clip(np.searchsorted(free, lines), 1, free.size - 1)
        beside = np.mean(np.abs(spectrum[:, [free[after - 1], free[after]]]) ** 2, axis=1)
        return np.asarray(2.0 * np.sum(np.abs(values) ** 2 - beside, axis=1))
    source = recording.input("ft") if forcing == "ft" else recording.fd
    if source is not None:
        values = values * np.exp(-1j * np.angle(np.fft.rfft(recording.window(source))[:, lines]))
    others = (values.sum(axis=0) - values) / (runs - 1)
    common = 2.0 * np.sum((values * others.conj()).real, axis=1)
    # A run counts in its own product and in those of the others: the scatter is twice as large.
    return np.asarray(2.0 * common - common.mean())


def beside_others(looks: Mapping[Part, Content]) -> Iterator[tuple[Part, Remark]]:
    """Recordings that copy another one, or are far from as large as most of their condition."""
    prints = [content["fingerprints"] for content in looks.values()]
    copies = copies_among([part.name for part in looks], prints)
    for place, part in enumerate(looks):
        yield from ((part, remark) for remark in copies.get(place, ()))
    frame = DataFrame(
        {"part": part, "group": part.group, **row}
        for part, content in looks.items()
        for row in content["rows"]
        if row["parameter"].startswith("rms_") and row["run"] is None
    )
    alike = frame.groupby(["group", "parameter"])["value"]
    frame["factor"] = frame["value"] / alike.transform("median")
    # A ratio of signals of two subjects that is one of units; degrees are 57 of radians.
    far = np.abs(np.log(frame["factor"])) > math.log(20.0)
    for row in frame[far & (alike.transform("size") > 2)].itertuples():
        words = (
            f"{row.parameter.removeprefix('rms_')} is {row.factor:.3g} times as large as in the "
            "other recordings of its condition: it is in another unit; convert it in the file, or "
            "leave the file out"
        )
        yield row.part, Remark("wrong-unit", words)


# ----------------------------------------------------------------------------------- tasks


class Task(NamedTuple):
    """One task, which may be done by another process.

    Attributes
    ----------
    key
        A digest of all that its content follows from: recording, settings and code.
    function
        `look` at a recording, or `fit` a model.
    part
        The recording.
    code
        The other arguments, see `pilotid.support.naming.packed`.
    """

    key: str
    function: Callable[..., Content]
    part: Part
    code: bytes


#: A task, and what it gave or why there is nothing.
Answer = tuple[Task, Content | None, str]


def perform(task: Task) -> Answer:
    """Do a task; whatever goes wrong is an answer."""
    try:
        return task, task.function(task.part, *unpacked(task.code)), ""
    except InputError as error:
        return task, None, str(error)
    except Exception as error:
        return task, None, f"{task.part.name}: {one_line(reason(error))}"


def given_up(task: Task, loss: Loss, why: str) -> Answer:
    """The answer to a task whose process was lost."""
    return task, None, f"{task.part.name}: {loss.value} ({why})"


def look(
    part: Part, models: Mapping[str, PilotModel], named: Sequence[str], how: Fitting
) -> Content:
    """What a recording shows, what is wrong with it, and what it says for each model."""
    recording = part.recording(how.reading)
    chosen = chosen_element(recording, how.element)
    names = named or [model.name for model in default_candidates(recording)]
    tried = [models[name] for name in names]
    shared = filter(None, [lines_shared(recording)])
    return {
        "runs": recording.runs,
        "remarks": _graded([*remarks(recording), *shared, *chosen.remarks]),
        "fingerprints": [*fingerprints(recording)],
        "candidates": [
            asdict(model) for model in compare_models(chosen.named_in(recording), tried, how.seed)
        ],
        "rows": measured(recording),
    }


def fit(part: Part, model: PilotModel, how: Fitting) -> Content:
    """Fits of a model to a recording, and if so asked to its runs, and in other ways."""
    recording, methods = part.recording(how.reading), dict(how.methods)
    ways: list[tuple[str, int | None, Recording, dict[str, Method]]]
    ways = [("", None, recording, methods)]
    if how.per_run and recording.runs > 1:
        runs = range(1, recording.runs + 1)
        ways += [("", run, of_runs(recording, [run], f"run {run}"), methods) for run in runs]
    for name, reading, able in variants(how, recording.duration) if how.sensitivity else ():
        with suppress(InputError):  # half of the recording may be too short
            ways.append((name, None, part.recording(reading), able))
    rows = list[Content]()
    for name, run, some, able in ways:
        fitted = fit_all(some, model, able, how.seed, how.element)
        for estimate, loops in zip_longest(fitted.estimates, fitted.loops):
            rows += [{"otherwise": name, "run": run, **row} for row in _rows(estimate, loops)]
    predicted = predict_left_out(recording, model, methods, how.seed) if how.left_out else ()
    return {"rows": rows, "left_out": [*predicted], "responses": [*_responses(recording, model)]}


def variants(how: Fitting, seconds: float) -> Iterator[tuple[str, Reading, dict[str, Method]]]:
    """Other ways to fit a recording of so many seconds: name, how it is read, and methods."""
    reading, methods = how.reading, dict(how.methods)
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


def _rows(estimate: Estimate, loops: Loops | None) -> list[Content]:
    """A row for each quantity of a fit."""
    model, parameters = estimate.model, estimate.quantities
    # Of a pilot who changes there is no loop, and nothing to show.
    shown = loops.shown if loops and not model.no_loop else ()
    of_loop = [q for lp in shown for q in (lp.crossover, lp.phase_margin, lp.effective_delay)]
    rows = frame_of([*parameters, *of_loop])
    rows["kind"] = ["parameter"] * len(parameters) + ["loop"] * len(of_loop)
    rows["left_out"] = rows["determined"].map({True: "", False: "not determined"})
    ends = np.array(model.keys)[is_at_bound(model, estimate.values)]
    rows.loc[rows["parameter"].isin(ends), "left_out"] = "at its bound"
    rows = rows.assign(
        model=model.name,
        method=estimate.method,
        outcome=estimate.outcome.slug,
        usable=estimate.outcome.usable,
        failure="" if estimate.outcome.usable else estimate.sentence,
        vaf=estimate.vaf,
        element=loops.element.name if loops else "",
    )
    of_fit = _graded(estimate.remarks)
    of_loops = _graded([*loops.remarks, *loops.notes]) if loops else []
    return [{**row, "of_fit": of_fit, "of_loops": of_loops} for row in rows.to_dict("records")]


def predict_left_out(
    recording: Recording, model: PilotModel, methods: Mapping[str, Method], seed: int
) -> Iterator[Content]:
    """How well fits of all other runs predict each, by each method: rows of left_out.csv.

    No truth is known of people; what can be held against an estimate is a run that it has not
    seen.  The likelihood is that of the whole control, which in a closed loop the inverse of the
    controlled element predicts well without being a pilot; the VAF shows that.

    Parameters
    ----------
    recording
        The recording; of one run there is nothing to predict.
    model, methods, seed
        What is fitted, methods by their labels.
    """
    for run in range(1, recording.runs + 1) if recording.runs > 1 else ():
        # What is known of a recording is remembered with it: one for all methods.
        rest = [other for other in range(1, recording.runs + 1) if other != run]
        others = of_runs(recording, rest, f"without run {run}")
        left = of_runs(recording, [run], f"run {run}")
        for label, method in methods.items():
            estimate = identify(method, others, model, fit_rng(seed, label))
            outcome = estimate.outcome
            score = estimate.score(left, others) if outcome.usable else None
            vaf, likelihood = (score.vaf, score.log_score) if score else (math.nan, math.nan)
            row = {"run": run, "model": model.name, "method": label, "outcome": outcome.slug}
            row |= {"vaf": vaf, "log_likelihood": likelihood, "seconds": estimate.seconds}
            yield row


def _responses(recording: Recording, model: PilotModel) -> Iterator[Content]:
    """Coefficients at the forcing lines, with their errors."""
    step = None if model.changes else first_step_of(recording, model)
    if step is not None:
        for channel, values, errors in zip(model.channels, step.value, step.std, strict=True):
            for omega, own, std in zip(step.omega, values, errors, strict=True):
                place = {"channel": channel.name, "omega": omega}
                yield {**place, "real": own.real, "imag": own.imag, "std": std}


def _graded(sentences: Iterable[str]) -> list[tuple[str, str, str]]:
    """Codes, sentences and grades of remarks, as JSON has them."""
    return [(r.code, str(r), r.grade) for r in map(remark_of, sentences)]


# ------------------------------------------------------------------------------ all of them


def fit_recordings(
    parts: Sequence[Part],
    settings: Settings,
    folder: Path,
    workers: int | None = None,
    refused: Sequence[str] = (),
) -> Results:
    """Look at recordings, choose models, and fit everything; what is stored is not done again.

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
    refused, whole = [*refused], settings.fitting
    pooled = replace(whole, per_run=False, left_out=False, sensitivity=False)
    asked = (settings.models, settings.named, replace(pooled, methods={}))
    with Rows(folder, create=True) as store:
        tasks = [_task(look, part, *asked) for part in parts]
        looks = dict(_contents(store, tasks, "looking at recordings", workers, refused))
        if not looks:
            raise InputError("; ".join(dict.fromkeys(refused)))
        for part, remark in beside_others(looks):
            looks[part]["remarks"].insert(0, *_graded([remark]))
        choices, compared = choices_of(looks, settings)
        tasks = []
        for part in looks:
            chosen = settings.named or [choices[part.group].model]
            asked = compared[(compared["kind"] == "parameter") & (compared["model"] != "")]
            for name in dict.fromkeys([*chosen, *asked.loc[asked["group"] == part.group, "model"]]):
                how = whole if name in chosen else pooled
                tasks.append(_task(fit, part, settings.models[name], how))
        fitted = [*_contents(store, tasks, "fitting", workers, refused)]
    return Results(settings, looks, choices, compared, fitted, refused)


def _task(function: Callable[..., Content], part: Part, *code: object) -> Task:
    """A task with its key; models, methods and the element may be of the user's own code."""
    name = function.__name__
    content = (own_digest(), part.digest(), part, name, to_jsonable(code), code_digest(code))
    key = digest_of([repr(content).encode("utf-8", "replace")])
    return Task(key, function, part, packed(code))


def _contents(
    store: Rows, tasks: Sequence[Task], what: str, workers: int | None, refused: list[str]
) -> Iterator[tuple[Part, Content]]:
    """The recording and content of each task, in their order; `refused` gets why there is none."""
    todo = [task for task in tasks if store.get(dict, (task.key, "", 0)) is None]
    lost = list[str]()
    answers = run_tasks(perform, todo, given_up, workers, seconds=3600.0)
    for task, content, why in with_bar(answers, what, len(todo)):
        if content is None:
            lost.append(why)
        else:
            store.put((task.key, "", 0), content, again=True)
    refused += in_order(lost)
    for task in tasks:
        if content := store.get(dict, (task.key, "", 0)):
            yield task.part, content
