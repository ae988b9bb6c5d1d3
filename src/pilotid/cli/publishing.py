"""The commands on several studies: `publish` and `compare-studies`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pilotid.terminal import make_console
from pilotid.types import InputError

if TYPE_CHECKING:
    from pilotid.publishing.changes import Changes


def publish(
    folders: Annotated[
        list[Path],
        typer.Argument(metavar="DIR...", help="What `compare` wrote, or its rows alone."),
    ],
    out: Annotated[Path, typer.Option(metavar="SITE", help="Folder of the pages.")],
) -> None:
    """Make static pages over several studies, from their stores alone."""
    from pilotid.publishing.pages import publish as published

    make_console().print(f"pages: {published(folders, out)}", soft_wrap=True)


def compare_studies(
    first: Annotated[Path, typer.Argument(metavar="A", help="A study that `compare` wrote.")],
    second: Annotated[Path, typer.Argument(metavar="B", help="Another of the same scenarios.")],
    csv: Annotated[
        str | None, typer.Option(metavar="F.csv|-", help="Write all comparisons; - prints.")
    ] = None,
    json: Annotated[
        str | None, typer.Option(metavar="F.json|-", help="Write them as JSON; - prints.")
    ] = None,
) -> None:
    """Say what changed from one study to another of the same scenarios, and how surely."""
    from pilotid.cli.options import require_writable
    from pilotid.disk import strict_json, table_bytes, write_file
    from pilotid.publishing.changes import COLUMNS, find_changes
    from pilotid.publishing.studies import read_study

    files = [Path(text) for text in (csv, json) if text not in (None, "-") and text is not None]
    for file in files:
        require_writable(file, ())
    if csv == "-" and json == "-":
        raise InputError("--csv - and --json - would print both; write one of them to a file")
    studies = [read_study(folder) for folder in (first, second)]
    found = find_changes(*studies)
    texts = {
        csv: table_bytes(COLUMNS, found.rows()),
        json: strict_json(as_json(found)).encode(),
    }
    for target, content in texts.items():
        if target == "-":
            make_console().file.write(content.decode())
        elif target is not None:
            write_file(Path(target), content)
    if "-" not in texts:
        _print(found)


def as_json(found: Changes) -> dict[str, object]:
    """All comparisons as plain objects."""
    from pilotid.publishing.changes import COLUMNS
    from pilotid.study.judge import LEVEL

    return {
        "first": {"folder": str(found.first.folder), **found.first.about},
        "second": {"folder": str(found.second.folder), **found.second.about},
        "level": LEVEL,
        "fits_paired": found.fits,
        "fits_same": found.same,
        "notes": list(found.notes),
        "words": found.words,
        "comparisons": [dict(zip(COLUMNS, row, strict=True)) for row in found.rows()],
    }


def _print(found: Changes) -> None:
    from pilotid.numbers import number, plus_minus
    from pilotid.report.content import Column, Table, entries, terminal_table
    from pilotid.terminal import print_table

    console = make_console()
    for letter, data in (("A", found.first), ("B", found.second)):
        facts = (f"{name} {data.about.get(name, '?')}" for name in ("pilotid", "code", "seed"))
        console.print(f"{letter}: {data.folder} ({', '.join(facts)})", soft_wrap=True)
    words = ("scenario", "method", "parameter", "score")
    columns = [Column(title, text=True) for title in words]
    columns += [*map(Column, ("A", "B", "change", "p")), Column("", text=True)]
    rows = []
    for c in found.changed:
        size = plus_minus(c.change, c.error)
        size = f"x {size.lstrip('+')}" if c.score == "time" else size
        p = f"{c.p:.1e}" if c.p >= 1e-99 else "0"
        score = "bias / bound" if c.score == "bias" else c.score
        better = "better" if c.is_better else "worse"
        numbers = (number(c.first), number(c.second), size, p, better)
        rows.append([c.scenario, c.method, c.parameter, score, *numbers])
    if rows:
        print_table(console, terminal_table(Table("What changed", columns, entries(rows))))
    changed = {
        f"{c.scenario}, {c.method}: {c.verdicts[0]} -> {c.verdicts[1]}"
        for c in found.all
        if c.verdicts[0] != c.verdicts[1]
    }
    for sentence in (found.words, *sorted(changed), *found.notes):
        console.print(sentence, soft_wrap=True)
