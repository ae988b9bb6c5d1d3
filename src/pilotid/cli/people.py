"""Published recordings of people: `pilotid fetch-data`, and `compare --people`."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path

from pilotid.cli import options
from pilotid.datasets.people import PEOPLE, People, fetch, people_named, published, recordings_in
from pilotid.document import Bullets, Section, Table, Text, print_blocks, write_page
from pilotid.recordings.files import Reading
from pilotid.terminal import make_console

#: Methods that are compared on people where none is named; those of which one is consistent
#: without the others' assumptions are held against the others.
USUAL = ("mle", "mle-white", "mle-reference", "fourier", "arx", "mmle3")
PAGE = "people.html"


def fetch_data(name: str | None = None, *, source: Path | None = None) -> None:
    """Fetch published recordings of people into the user's cache, or list them."""
    console = make_console()
    if name is None:
        for people in PEOPLE.values():
            print_blocks(console, *_card(people))
        return
    folder = fetch(name, source)
    people = PEOPLE[name]
    print_blocks(console, *_card(people), Text(f"{len(published()[name])} files in {folder}"))
    files = f"{shlex.quote(str(folder))}/{people.files}"
    print_blocks(console, Text(f"pilotid analyse {files} {people.options} --out results/{name}"))


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


def compare_people(
    name: str,
    method: Sequence[str] | None,
    *,
    seed: int,
    workers: int | None,
    force: bool,
    out: Path,
) -> None:
    """Compare methods on published recordings: runs left out, runs and halves apart."""
    from pilotid.analysis.agreement import agreement_blocks
    from pilotid.analysis.board import left_out_blocks
    from pilotid.analysis.experiment import analyse
    from pilotid.analysis.halves import halves_blocks
    from pilotid.cli.running import with_progress

    methods = options.methods_of(method, USUAL)
    people, folder = people_named(name), fetch(name)
    with options.resumable(out):
        found = analyse(
            recordings_in(folder, name),
            people.pattern,
            [people.model],
            list(methods.values()),
            out=out,
            per_run=True,
            left_out=True,
            reading=Reading((people.mapping,) if people.mapping else (), people.dt),
            seed=seed,
            workers=workers,
            force=force,
            bar=with_progress,
        )
    report = found.write(f"pilotid compare --people {name}", f"pilotid compare --people {name}")
    agreement = agreement_blocks(found.results.rows)
    judged = left_out_blocks(found.results.board("", {}))
    halves = halves_blocks(found.results.analysis.halves)
    sections = [
        Section("people", "Who, and what to know", _card(people)[1:]),
        Section("left-out", "Runs left out", judged),
        Section("halves", "Agreement between halves", halves),
        Section("agreement", "Agreement with consistent estimates", agreement),
    ]
    write_page(out / PAGE, f"Methods on recordings of people: {name}", sections)
    told = [f"page: {out / PAGE}", f"all fits: {report}"]
    tables = [block for block in (*judged, *halves, *agreement) if isinstance(block, Table)]
    print_blocks(make_console(), *_card(people), *tables, Bullets(told))
    options.raise_refused(found.refused)
