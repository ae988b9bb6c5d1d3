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

    errors = make_console(errors=True)
    page = published(folders, out, lambda words: errors.print(f"pilotid: {words}", soft_wrap=True))
    make_console().print(f"pages: {page}", soft_wrap=True)


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
    from pilotid.publishing.changes import COLUMNS, changes
    from pilotid.publishing.held import held_in

    files = [Path(text) for text in (csv, json) if text not in (None, "-") and text is not None]
    for file in files:
        require_writable(file, ())
    if csv == "-" and json == "-":
        raise InputError("--csv - and --json - would print both; write one of them to a file")
    studies = [held_in(folder) for folder in (first, second)]
    errors = make_console(errors=True)
    for held in studies:
        if held.warning:
            errors.print(f"pilotid: {held.warning}", soft_wrap=True)
    found = changes(*studies)
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

    return {
        "first": {"folder": str(found.first.folder), **found.first.about},
        "second": {"folder": str(found.second.folder), **found.second.about},
        "level": found.level,
        "fits_paired": found.fits,
        "fits_same": found.same,
        "notes": list(found.notes),
        "words": found.words,
        "comparisons": [dict(zip(COLUMNS, row, strict=True)) for row in found.rows()],
    }


def _print(found: Changes) -> None:
    from pilotid.numbers import MINUS, NONE, number, plus_minus
    from pilotid.terminal import make_table, print_table

    console = make_console()
    for letter, held in (("A", found.first), ("B", found.second)):
        facts = (f"{name} {held.about.get(name, '?')}" for name in ("pilotid", "code", "seed"))
        console.print(f"{letter}: {held.folder} ({', '.join(facts)})", soft_wrap=True)
    table = make_table()
    for title in ("scenario", "method", "parameter", "score"):
        table.add_column(title, no_wrap=True)
    for title in ("A", "B", "change", "p"):
        table.add_column(title, justify="right", no_wrap=True)
    table.add_column("")
    for change in found.changed:
        n = change.numbers
        size = plus_minus(n.change, n.error)
        size = f"x {size.lstrip('+')}" if change.score == "time" else size
        p = f"{n.p:.1e}" if n.p >= 1e-99 else "0"
        shown = (number(n.first), number(n.second), size)
        plain = (text.replace(MINUS, "-").replace(NONE, "-") for text in shown)  # as terminals can
        score = {"bias": "bias / bound", "rmse": "rmse / bound"}.get(change.score, change.score)
        if change.unit == "% of truth":
            score = f"{change.score} %"
        better = "better" if change.better else "worse"
        table.add_row(change.scenario, change.method, change.parameter, score, *plain, p, better)
    if found.changed:
        print_table(console, table)
    for sentence in (found.words, *found.notes):
        console.print(sentence, soft_wrap=True)
