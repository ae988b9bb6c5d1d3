"""One table in its written forms, and what names from files cannot do to them."""

from __future__ import annotations

import io
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest
from rich.console import Console

from pilotid.support.document import (
    Bullets,
    Column,
    Command,
    Figure,
    LogAxis,
    Section,
    Table,
    Text,
    pdf,
    print_blocks,
    save_figures,
    to_html,
    to_markdown,
)
from pilotid.support.numbers import plus_minus, share

Item = tuple[str, float, float]


def table(*items: Item) -> Table[Item]:
    columns: list[Column[Item]] = [
        Column("name", lambda i: i[0]),
        Column("bias", lambda i: (i[1], i[2]), plus_minus, "a hint", lambda i: "good"),
        Column("nothing", lambda i: None),
        Column("", lambda i: (1.0 + i[2], 1.0, 2.0), axis=LogAxis(-0.5, 0.5)),
        Column("coverage %", lambda i: (0.95, (0.9, 0.98)), share),
    ]
    return Table("A **caption**", columns, items, heads=1)


def test_a_table_is_a_frame_of_values() -> None:
    frame = table(("x", -1.2, 0.1)).to_dataframe()
    assert frame["bias"][0] == (-1.2, 0.1)
    assert list(frame.columns)[:3] == ["name", "bias", "nothing"]


def test_columns_that_say_nothing_are_left_out() -> None:
    assert [c.title for c in table(("x", 1.0, 0.1)).titles] == ["name", "bias", "", "coverage %"]


EVIL = (
    "<script>document.title='PWNED'</script>",
    "[x](javascript:alert(1))",
    "![x](http://example.org/x.png)",
    "</title><img src=x onerror=alert(1)>",
    r"$\frac{$ \x1b]0;a\x07 \x00\x01 \udcff \u202e",
    '" onmouseover="alert(1)',
    "a|b\n# c",
)


def parsed(page: str) -> tuple[list[str], list[tuple[str, str]]]:
    """The tags and the attributes of a page."""
    tags: list[str] = []
    attributes: list[tuple[str, str]] = []

    class Reader(HTMLParser):
        def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
            tags.append(tag)
            attributes.extend((name, value or "") for name, value in attrs)

    Reader().feed(page)
    return tags, attributes


@pytest.mark.parametrize("evil", EVIL)
def test_what_strangers_write_does_nothing_anywhere(evil: str) -> None:
    from matplotlib.figure import Figure as Drawing

    drawing = Drawing()
    drawing.subplots().set(title=evil, xlabel=evil)
    blocks = (Figure(evil, drawing, evil), table((evil, 1.0, 0.1)), Command(evil, evil))
    sections = [Section("a", evil, (*blocks, Text(evil), Bullets([evil])))]
    page, markdown = to_html(evil, sections), to_markdown(evil, sections)
    tags, attributes = parsed(page)
    assert tags.count("script") == 1
    assert "img" not in tags
    assert not [name for name, _ in attributes if name.startswith("on")]
    assert all(place.startswith("#") for name, place in attributes if name.endswith("href"))
    assert not re.search(r"[\x00\x1b\udcff\u202e]", page)
    markdown = re.sub("^    .*", "", markdown, flags=re.M)  # what is to type is code
    assert not re.search(r"<script|<img|(?<!\\)\[?x\]|[\x00\x1b\udcff\u202e]|^# c", markdown, re.M)
    assert pdf(drawing)
    stream = io.StringIO()
    print_blocks(Console(file=stream), Text(evil), Bullets([evil]), table((evil, 1.0, 0.1)))
    assert not re.search(r"[\x00\x1b\x07]", stream.getvalue())


def test_a_figure_that_is_there_is_not_written_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[bytes] = []
    monkeypatch.setattr("pilotid.support.document.pdf", lambda _: drawn.append(b"") or b"%PDF")

    def saved(title: str) -> int:
        from matplotlib.figure import Figure as Drawing

        drawing = Drawing()
        drawing.suptitle(title)
        save_figures(tmp_path, [Figure("one", drawing, "A figure.")])
        return len(drawn)

    assert [saved("a"), saved("a"), saved("b")] == [1, 1, 2]
    (tmp_path / "one.pdf").unlink()
    assert saved("b") == 3


def test_a_narrow_terminal_has_a_table_in_parts_and_cuts_no_number() -> None:
    numbers = [1.234567, 2.345678, 3.456789, 4.567891]
    columns: list[Column[int]] = [Column("key", lambda i: f"k{i}")]
    columns += [
        Column(f"n{n}", lambda _, value=value: value, "{:.6f}".format)  # type: ignore[misc]
        for n, value in enumerate(numbers)
    ]
    stream = io.StringIO()
    print_blocks(Console(file=stream, width=30), Table("", columns, [1, 2]))
    printed = stream.getvalue()
    assert all(printed.count(f"{value:.6f}") == 2 for value in numbers)
    assert printed.count("key") == 2  # parts, each with what the rows are about
    assert max(map(len, printed.splitlines())) <= 30
