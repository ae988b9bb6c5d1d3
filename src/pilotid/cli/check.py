"""The command `pilotid check`: what was understood of recordings, and what is wrong with them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Annotated, Any

import numpy as np
import typer

from pilotid.cli import options
from pilotid.document import Bullets, Column, Table, Text, print_blocks
from pilotid.element.fit import ElementChoice, chosen_element
from pilotid.estimates.applicability import lines_objection, motionless_input
from pilotid.estimates.method import Method
from pilotid.limits import ESTIMATE
from pilotid.methods import methods
from pilotid.model_choice import default_candidates, select
from pilotid.naming.settings import split_list
from pilotid.pilot.catalogue import model_named
from pilotid.pilot.element import element_named
from pilotid.pilot.model import PilotModel
from pilotid.recordings.checks import remarks
from pilotid.recordings.detectors import copies_among, findings, fingerprints
from pilotid.recordings.recording import LEAD_IN, Recording
from pilotid.recordings.understood import REST, Forcing, Signal, Understood, understood
from pilotid.remarks import GRADES, codes_of, gravest_first, remark_of, remarks_json
from pilotid.seeds import DEFAULT_SEED, fit_rng
from pilotid.terminal import make_console
from pilotid.time_domain.constancy import constancy_of
from pilotid.types import InputError

#: What JSON has of one recording.
Entry = dict[str, Any]
YES = "yes"
MUCH_REST = 0.2  # share of the time from which a control that rests is worth a line


def check(
    files: options.FilesArgument,
    model: Annotated[
        str,
        typer.Option(metavar="NAME,...", help="Models of which is told what methods can do."),
    ] = "single,multi",
    mapping: options.MapOption = None,
    dt: options.IntervalOption = None,
    joint: options.JointOption = False,
    detrend: options.DetrendOption = False,
    lead_in: options.LeadInOption = LEAD_IN,
    runs: options.RunsOption = None,
    span: options.SpanOption = None,
    element: Annotated[
        str | None,
        typer.Option(metavar="4/s^2", help="Controlled element, to compare with what is seen."),
    ] = None,
    brief: Annotated[
        bool, typer.Option("--brief", help="One line a file, and a summary of many.")
    ] = False,
    json: options.JsonOption = None,
) -> None:
    """Summarise recordings and report problems."""
    plant = element_named(element) if element else None
    models = [model_named(name) for name in split_list(model, names=True)]
    options.require_writable(files, json)
    recordings, refused = options.recordings_of(
        files, mapping, dt, detrend, lead_in, runs, span, joint=joint
    )
    choices = [chosen_element(recording, plant) for recording in recordings]
    copies = copies_among([r.source for r in recordings], [fingerprints(r) for r in recordings])
    told = [
        [*copies.get(number, ()), *remarks(recording), *choice.remarks]
        for number, (recording, choice) in enumerate(zip(recordings, choices, strict=True))
    ]
    if brief and json is None:
        _print_brief(recordings, choices, told)
        options.raise_refused(refused)
        return
    known = options.methods_of(None, list(methods()))
    found = [
        _checked(recording, models, known, choice, own)
        for recording, choice, own in zip(recordings, choices, told, strict=True)
    ]
    entries = [entry for _, entry in found]
    if not options.write_json(json, entries[0] if len(entries) == 1 else entries):
        console = make_console()
        for number, (facts, entry) in enumerate(found):
            if number:
                console.print()
            print_blocks(console, *_blocks(recordings[number], facts, entry))
        if len(found) > 1:
            console.print()
            print_blocks(console, Text(_summary([entry["remarks"] for entry in entries])))
    options.raise_refused(refused)


def _print_brief(
    recordings: Sequence[Recording],
    choices: Sequence[ElementChoice],
    every: Sequence[Sequence[str]],
) -> None:
    """Print a line for each recording, with the codes of its remarks, and a summary."""
    console = make_console()
    for recording, choice, own in zip(recordings, choices, every, strict=True):
        told = gravest_first(map(remark_of, own))
        codes = {g: dict.fromkeys(r.code for r in told if r.grade == g) for g in GRADES}
        flags = [f"{grade}: {', '.join(kind)}" for grade, kind in codes.items() if kind] or ["ok"]
        size = f"{recording.runs} x {recording.duration:.4g} s, {' '.join(recording.signals)}"
        name = choice.element.name if choice.element else "element unknown"
        line = f"{recording.source}: {size}, {name}; {'; '.join(flags)}"
        print_blocks(console, Text(line, "warning" if codes["wrong"] or codes["doubt"] else ""))
    if len(every) > 1:
        print_blocks(console, Text(_summary(every)))


def _summary(every: Sequence[Sequence[str]]) -> str:
    """How many recordings are sound, and how many have which remark."""
    told = [{remark.code: remark.grade for remark in map(remark_of, own)} for own in every]
    bad = [own for own in told if set(own.values()) & {"wrong", "doubt"}]
    words = f"{len(every)} recordings, {len(every) - len(bad)} without anything wrong or in doubt"
    kinds = dict.fromkeys(
        pair for grade in GRADES for own in told for pair in own.items() if pair[1] == grade
    )
    counts = [f"{code} ({grade}) {sum(code in own for own in told)}" for code, grade in kinds]
    return f"{words}: {', '.join(counts)}" if counts else words


def _checked(
    recording: Recording,
    models: Sequence[PilotModel],
    known: dict[str, Method],
    choice: ElementChoice,
    told: Sequence[str],
) -> tuple[Understood, Entry]:
    facts = understood(recording)
    constancy = _constancy(recording)
    able = {
        m.name: {
            label: motionless_input(recording, m) or method.objection(recording, m) or YES
            for label, method in known.items()
        }
        for m in models
    }
    entry: Entry = {
        "recording": {**recording.to_dict(), **remarks_json(told)},
        "understood": {
            **facts.to_dict(),
            "recorder": [asdict(fault) for fault in findings(recording)],
            "element": _element(choice),
            "constancy": constancy,
        },
        "remarks": told,
        "codes": codes_of(told),
        "methods": able,
    }
    return facts, entry


def _constancy(recording: Recording) -> dict[str, object] | None:
    """Whether gains and leads are constant, under the model that the recording speaks for.

    None where no model has its inputs, or where the signals allow no fit.
    """
    able = [m for m in default_candidates(recording) if motionless_input(recording, m) is None]
    if not able:
        return None
    try:
        with np.errstate(all="ignore"):  # signals may be anything
            # Without lines a choice takes long; the model with the most parameters misses least.
            quick = all(lines_objection(recording, m) is None for m in able)
            model = select(recording, able).model if quick else able[-1]
            found = constancy_of(recording, model, fit_rng(DEFAULT_SEED, "constancy"))
    except (InputError, np.linalg.LinAlgError):
        return None
    if found is None:
        return None
    p = "p < 0.001" if found.p < 0.001 else f"p = {found.p:.2g}"
    what = f"{' and '.join(found.keys)} of the model {model.name}"
    words = f"no sign that {what} change during the recording ({p})"
    if found.p < ESTIMATE.changes:
        words = (
            f"{what} vary during the recording as people do, by less than a third ({found}; {p})"
        )
    if found.changes:
        words = (
            f"{what} change during the recording, most about t = {found.time:.0f} s ({found}; "
            f"{p} under constant parameters). Fit the segments separately, or use the model "
            "adapting"
        )
    return {**found.to_dict(), "model": model.name, "words": words}


def _element(choice: ElementChoice) -> str:
    """The controlled element and how it is known; why not, if it is not."""
    if choice.element is None:
        return choice.why
    how = {"given": "given", "recording": "the file says", "identified": "from the signals"}
    return f"{choice.element.name} ({how.get(choice.origin, choice.origin)})"


def _blocks(
    recording: Recording, facts: Understood, entry: Entry
) -> list[Text | Bullets | Table[Signal]]:
    columns: list[Column[Signal]] = [
        Column("signal", lambda s: s.name),
        Column("what it is", lambda s: s.meaning),
        Column("from", lambda s: s.origin),
        Column("unit", lambda s: s.unit),
        Column("rms", lambda s: s.rms, "{:.4g}".format),
        Column("smallest", lambda s: s.smallest, "{:.4g}".format),
        Column("largest", lambda s: s.largest, "{:.4g}".format),
    ]
    lines = [*_lines(facts), f"controlled element: {entry['understood']['element']}"]
    if constancy := entry["understood"]["constancy"]:
        lines.append(f"pilot: {constancy['words']}")
    faults = entry["understood"]["recorder"]
    lines += [f"recorder: {f['sentence']}" for f in faults if f["grade"] == "note"]
    sound = [] if entry["remarks"] else ["nothing is wrong with the signals"]
    return [
        Text(recording.description, "heading"),
        Table("", columns, facts.signals),
        Bullets(lines),
        *(Text(f"recording: {remark}", "warning") for remark in entry["remarks"]),
        Bullets([*sound, *(_methods(name, able) for name, able in entry["methods"].items())]),
    ]


def _lines(facts: Understood) -> list[str]:
    lines = [_forcing(forcing) for forcing in facts.forcing]
    lines += [f"no {name}: {why}" for name, why in facts.missing.items()]
    if facts.unscored:
        lines.append(
            f"methods in the time domain do not score the first {facts.unscored:.3g} s of the "
            "window, for want of a longer run-in (--lead-in)"
        )
    else:
        lines.append("all of the window is scored: the run-in is long enough")
    if facts.rest >= MUCH_REST:
        lines.append(
            f"u rests at one value for {REST:g} s and more in {100.0 * facts.rest:.0f} % of the "
            "time (stiction or breakout force?). Linear models will attribute this to remnant"
        )
    return lines


def _forcing(forcing: Forcing) -> str:
    if not forcing.lines or forcing.lowest is None or forcing.highest is None:
        return f"{forcing.name}: no lines: {forcing.why}"
    words = (
        f"{forcing.name}: {len(forcing.lines)} lines {'given' if forcing.given else 'found'}, "
        f"{forcing.lines[0]} to {forcing.lines[-1]} times {forcing.base:.4g} rad/s "
        f"({forcing.lowest:.3g} to {forcing.highest:.3g} rad/s)"
    )
    if forcing.answered is not None:
        words += (
            f"; u stands out of its noise at {forcing.answered} of them (coherence "
            f"{forcing.coherence:.2f} in the median)"
        )
    return words


def _methods(model: str, answers: dict[str, str]) -> str:
    """One line that says which methods can fit a model, and why others cannot."""
    able = [label for label, answer in answers.items() if answer == YES]
    text = f"model {model}: {', '.join(able) or 'no method'} can fit it"
    reasons: dict[str, list[str]] = {}
    for label, answer in answers.items():
        if answer != YES:
            reasons.setdefault(answer, []).append(label)
    for reason, labels in reasons.items():
        text += f"\n  not {', '.join(labels)}: {reason}"
    return text
