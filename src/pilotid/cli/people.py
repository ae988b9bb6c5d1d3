"""Published recordings of people: `pilotid fetch-data`, and `compare --people`."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path

from pilotid.cli import options
from pilotid.datasets.people import PEOPLE, fetch, recordings_in
from pilotid.recordings.files import Reading
from pilotid.support.document import Bullets, Text, print_blocks
from pilotid.support.terminal import make_console

#: Methods that are compared on people where none is named.
USUAL = ("mle", "mle-white", "mle-reference", "fourier", "arx", "mmle3")


def fetch_data(name: str | None = None, *, source: Path | None = None) -> None:
    """Fetch published recordings of people into the user's cache, or list them."""
    console = make_console()
    folder = None if name is None else fetch(name, source)
    for people in PEOPLE.values():
        if name in (None, people.name):
            facts = vars(people).items()
            told = [f"{fact}: {text}" for fact, text in facts if text and fact != "name"]
            print_blocks(console, Text(people.name, "heading"), Bullets(told))
    if name is None or folder is None:
        return
    people = PEOPLE[name]
    given = ["--pattern", people.pattern, "--model", people.model]
    given += ["--map", people.mapping] * bool(people.mapping)
    given += ["--dt", people.dt] * bool(people.dt)
    files = f"{shlex.quote(str(folder))}/{people.files}"  # which the shell expands
    command = f"pilotid analyse {files} {shlex.join(given)} --out results/{name}"
    print_blocks(console, Text(f"The files are in {folder}:"), Text(command))


def compare_people(
    name: str,
    method: Sequence[str] | None,
    *,
    seed: int,
    workers: int | None,
    force: bool,
    out: Path,
) -> None:
    """Compare methods on published recordings, by the runs that they predict."""
    from pilotid.analysis.experiment import analyse
    from pilotid.analysis.report_tables import left_out_table

    methods = options.methods_of(method, USUAL)
    folder = fetch(name)
    people = PEOPLE[name]
    with options.resumable(out):
        found = analyse(
            recordings_in(folder, name),
            people.pattern,
            [people.model],
            list(methods.values()),
            out=out,
            left_out=True,
            reading=Reading(
                (people.mapping,) if people.mapping else (),
                float(people.dt) if people.dt else None,
            ),
            seed=seed,
            workers=workers,
            force=force,
        )
    report = found.write(f"pilotid compare --people {name}")
    table = left_out_table(found.results.analysis.left_out)
    print_blocks(make_console(), table, Bullets([f"report: {report}"]))
    options.raise_refused(found.refused)
