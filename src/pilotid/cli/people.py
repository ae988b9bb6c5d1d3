"""The command `pilotid fetch-data`: published recordings of people."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer

from pilotid.datasets.people import PEOPLE, People, fetch, published
from pilotid.document import Bullets, Text, print_blocks
from pilotid.terminal import make_console


def fetch_data(
    name: Annotated[
        str | None, typer.Argument(metavar="NAME", help="Which; none lists what there is.")
    ] = None,
    source: Annotated[
        Path | None,
        typer.Option("--from", metavar="FOLDER", help="Take the files from here: no download."),
    ] = None,
) -> None:
    """Fetch published recordings of people into the user's cache, or list them."""
    console = make_console()
    if name is None:
        for people in PEOPLE.values():
            print_blocks(console, *_card(people))
        return
    folder = fetch(name, source)
    people = PEOPLE[name]
    print_blocks(console, *_card(people), Text(f"{len(published()[name])} files in {folder}"))
    # A pattern of files is for the shell to expand; what stands behind :: is not.
    files = f"{shlex.quote(str(folder))}/{people.files}"
    files = f"'{folder}/{people.files}'" if "::" in people.files else files
    command = "analyse" if "--pattern" in people.reading else "fit"
    print_blocks(console, Text(f"pilotid {command} {files} {people.reading}"))


def _card(people: People) -> list[Text | Bullets]:
    """What is known of an experiment."""
    files = published()[people.name]
    size = sum(file.size for file in files) / 1e6
    lines = [
        f"who: {people.who}",
        f"task: {people.task}",
        f"recorded: {people.rate}",
        f"to know: {people.faults}",
        f"files: {len(files)}, {size:.0f} MB; licence: {people.licence}",
        f"source: {people.source}",
    ]
    return [Text(people.name, "heading"), Bullets(lines)]
