"""The command `pilotid check`: what was understood of recordings, and what is wrong with them."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypedDict

import numpy as np
import typer

from pilotid.analysis.candidates import sensible
from pilotid.analysis.choice import select
from pilotid.cli.arguments import methods_of, require_writable
from pilotid.cli.reading import (
    DetrendOption,
    IntervalOption,
    JointOption,
    LeadInOption,
    MapOption,
)
from pilotid.disk import strict_json, write_file
from pilotid.element.fit import ElementChoice, chosen_element
from pilotid.estimates.applicability import lines_objection, motionless_input
from pilotid.estimates.method import Method
from pilotid.methods import methods
from pilotid.naming.settings import split_list
from pilotid.pilot.catalogue import model_named
from pilotid.pilot.element import ControlledElement, element_named
from pilotid.pilot.model import PilotModel
from pilotid.recordings.checks import remarks
from pilotid.recordings.files import Reading
from pilotid.recordings.recording import LEAD_IN, Recording
from pilotid.recordings.understood import Forcing, Understood, understood
from pilotid.remarks import codes_of, remarks_json
from pilotid.seeds import DEFAULT_SEED, fit_rng
from pilotid.terminal import make_console, make_table, print_table
from pilotid.time_domain.constancy import LEVEL, constancy_of
from pilotid.types import InputError

if TYPE_CHECKING:
    from rich.console import Console


class Entry(TypedDict):
    """What JSON has of one recording."""

    recording: dict[str, object]
    understood: dict[str, Any]
    remarks: list[str]
    codes: list[str]
    methods: dict[str, dict[str, str]]


YES = "yes"
MUCH_REST = 0.2  # share of the time from which a control that rests is worth a line


def check(
    files: Annotated[
        list[Path], typer.Argument(metavar="F.csv|F.mat ...", help="Recordings to look at.")
    ],
    model: Annotated[
        str,
        typer.Option(metavar="NAME,...", help="Models of which is told what methods can do."),
    ] = "single,multi",
    mapping: MapOption = None,
    dt: IntervalOption = None,
    joint: JointOption = False,
    detrend: DetrendOption = False,
    lead_in: LeadInOption = LEAD_IN,
    element: Annotated[
        str | None,
        typer.Option(metavar="4/s^2", help="Controlled element, to compare with what is seen."),
    ] = None,
    json: Annotated[
        str | None, typer.Option(metavar="F.json|-", help="Write it as JSON; - prints.")
    ] = None,
) -> None:
    """Tell what was understood of recordings, and what is wrong with them."""
    plant = element_named(element) if element else None
    models = [model_named(name) for name in split_list(model, names=True)]
    json_file = None if json in (None, "-") else Path(str(json))
    if json_file is not None:
        require_writable(json_file, files)
    recordings, refused = Reading(tuple(mapping or ()), dt, detrend, lead_in).all(
        files, joint=joint
    )
    known = methods_of(None, list(methods()))
    found = [_checked(recording, models, known, plant) for recording in recordings]
    text = strict_json(found[0][1] if len(found) == 1 else [entry for _, entry in found])
    if json_file is not None:
        write_file(json_file, text.encode())
    if json == "-":
        sys.stdout.write(text)
    else:
        console = make_console()
        for number, (facts, entry) in enumerate(found):
            if number:
                console.print()
            _print(console, recordings[number], facts, entry)
    if refused:
        raise InputError("; ".join(refused))


def _checked(
    recording: Recording,
    models: Sequence[PilotModel],
    known: dict[str, Method],
    element: ControlledElement | None,
) -> tuple[Understood, Entry]:
    facts = understood(recording)
    told: list[str] = list(remarks(recording))
    choice = chosen_element(recording, element)
    told += choice.remarks
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
    able = [m for m in sensible(recording) if motionless_input(recording, m) is None]
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
    if found.p < LEVEL:
        words = (
            f"{what} vary during the recording as people do, by less than a third ({found}; {p})"
        )
    if found.changes:
        words = (
            f"{what} change during the recording, most about t = {found.time:.0f} s ({found}; "
            f"{p} of a constant pilot): fit the parts apart, or the model adapting"
        )
    return {**found.to_dict(), "model": model.name, "words": words}


def _element(choice: ElementChoice) -> str:
    """The controlled element and how it is known; why not, if it is not."""
    if choice.element is None:
        return choice.why
    how = {"given": "given", "recording": "the file says", "identified": "from u, fd and x"}
    return f"{choice.element.name} ({how.get(choice.origin, choice.origin)})"


def _print(
    console: Console,
    recording: Recording,
    facts: Understood,
    entry: Entry,
) -> None:
    console.print(recording.description, style="bold", soft_wrap=True)
    console.print()
    table = make_table()
    for title in ("signal", "what it is", "from", "unit"):
        table.add_column(title)
    for title in ("rms", "smallest", "largest"):
        table.add_column(title, justify="right")
    for s in facts.signals:
        numbers = (f"{n:.4g}" for n in (s.rms, s.smallest, s.largest))
        table.add_row(s.name, s.meaning, s.origin, s.unit, *numbers)
    print_table(console, table)
    console.print()
    for line in _lines(facts):
        console.print(line, soft_wrap=True)
    console.print(f"controlled element: {entry['understood']['element']}", soft_wrap=True)
    if constancy := entry["understood"]["constancy"]:
        console.print(f"pilot: {constancy['words']}", soft_wrap=True)
    for remark in entry["remarks"]:
        console.print(f"recording: {remark}", style="yellow", soft_wrap=True)
    if not entry["remarks"]:
        console.print("nothing is wrong with the signals")
    for name, answers in entry["methods"].items():
        console.print(_methods(name, answers), soft_wrap=True)


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
            f"u rests at one value for {100.0 * facts.rest:.0f} % of the time, as on a breakout: a "
            "non-linearity, which linear models take for remnant"
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
