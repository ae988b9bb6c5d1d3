"""The command `pilotid check`: what was understood of recordings, and what is wrong with them."""

from __future__ import annotations

from pathlib import Path

from pilotid.cli import options
from pilotid.naming.settings import split_list
from pilotid.pilot.catalogue import model_named
from pilotid.pilot.element import element_named
from pilotid.recordings.files import Reading
from pilotid.report.check import check_all, summary_of
from pilotid.support.document import Text, print_blocks
from pilotid.support.remarks import codes_in
from pilotid.support.terminal import make_console


def check(
    files: list[Path],
    *,
    model: str = "single,multi",
    reading: Reading,
    joint: bool = False,
    element: str | None = None,
    brief: bool = False,
    ignore: list[str] | None = None,
    json: str | None = None,
    force: bool = False,
) -> None:
    """Summarise recordings and report problems."""
    plant = element_named(element) if element else None
    ignored = codes_in(ignore or ())
    models = [model_named(name) for name in split_list(model, names=True)]
    options.require_free(files, json, force=force)
    recordings, refused = reading.all(files, joint=joint)
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
