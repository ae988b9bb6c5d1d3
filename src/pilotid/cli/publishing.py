"""The commands on several studies: `publish` and `compare-studies`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pilotid.terminal import make_console
from pilotid.types import InputError

if TYPE_CHECKING:
    from pilotid.publishing.changes import Change, Changes


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
    from pilotid.cli.arguments import require_writable
    from pilotid.disk import strict_json, table_bytes, write_file
    from pilotid.publishing.changes import COLUMNS, find_changes, read_study

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
    from pilotid.document import Bullets, Column, Table, print_blocks
    from pilotid.numbers import number, plus_minus, unsigned

    def size(c: Change) -> str:
        if c.score == "time":
            return f"x {unsigned(c.change, c.error)}"
        return plus_minus(c.change, c.error)

    columns: list[Column[Change]] = [
        Column("scenario", lambda c: c.scenario),
        Column("method", lambda c: c.method),
        Column("parameter", lambda c: c.parameter),
        Column("score", lambda c: "bias / bound" if c.score == "bias" else c.score),
        Column("A", lambda c: c.first, number),
        Column("B", lambda c: c.second, number),
        Column("change", size, str),
        Column("p", lambda c: c.p, lambda p: f"{p:.1e}" if p >= 1e-99 else "0"),
        Column("", lambda c: "better" if c.is_better else "worse"),
    ]
    studies = []
    for letter, data in (("A", found.first), ("B", found.second)):
        facts = (f"{name} {data.about.get(name, '?')}" for name in ("pilotid", "code", "seed"))
        studies.append(f"{letter}: {data.folder} ({', '.join(facts)})")
    verdicts = {
        f"{c.scenario}, {c.method}: {c.verdicts[0]} -> {c.verdicts[1]}"
        for c in found.all
        if c.verdicts[0] != c.verdicts[1]
    }
    table = [Table("What changed", columns, found.changed)] if found.changed else []
    told = Bullets([found.words, *sorted(verdicts), *found.notes])
    print_blocks(make_console(), Bullets(studies), *table, told)
