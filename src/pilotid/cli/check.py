"""The command `pilotid check`: what was understood of recordings, and what is wrong with them."""

from __future__ import annotations

from typing import Annotated

import typer

from pilotid.cli import options
from pilotid.document import Text, print_blocks
from pilotid.naming.settings import split_list
from pilotid.pilot.catalogue import model_named
from pilotid.pilot.element import element_named
from pilotid.recordings.recording import LEAD_IN
from pilotid.remarks import codes_in
from pilotid.report.check import check_all, summary_of
from pilotid.terminal import make_console


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
    ignore: options.IgnoreOption = None,
    json: options.JsonOption = None,
    force: options.ForceOption = False,
) -> None:
    """Summarise recordings and report problems."""
    plant = element_named(element) if element else None
    ignored = codes_in(ignore or ())
    models = [model_named(name) for name in split_list(model, names=True)]
    options.require_free(files, json, force=force)
    recordings, refused = options.recordings_of(
        files, mapping, dt, detrend, lead_in, runs, span, joint=joint
    )
    found = check_all(recordings, models, plant, ignored)
    console, summary = make_console(), [Text(summary_of(found))] if len(found) > 1 else []
    if brief and json is None:
        print_blocks(console, *(own.brief for own in found), *summary)
    else:
        entries = [own.to_dict() for own in found]
        if not options.write_json(json, entries[0] if len(entries) == 1 else entries):
            for number, own in enumerate(found):
                if number:
                    console.print()
                print_blocks(console, *own.blocks)
            if summary:
                console.print()
                print_blocks(console, *summary)
    options.raise_refused(refused)
