"""Tables and pages in their written forms, and what names from files cannot do to them."""

from __future__ import annotations

import io
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest
from rich.console import Console

from pilotid.plots.page import Figure, environment, pdf, save_figures
from pilotid.support.format import (
    Line,
    Table,
    as_text,
    latex,
    markdown,
    plus_minus,
    share,
    show,
    table,
    to_error,
)

PAGE = """{% from "macros.html" import bullets, command, figure, section, table %}
{% extends "base.html" %}
{% block main %}
{% call section("a", title) %}{{ table(frame) }}{{ bullets([title]) }}{% endcall %}
{{ figure(drawing) }}{{ command(title, title) }}
{% endblock %}"""


def example(name: str = "x") -> Table:
    row = (name, (-1.2, 0.1), None, (0.95, (0.9, 0.98)))
    titles = ("name", "bias", "nothing", "coverage %")
    forms = {"bias": plus_minus, "coverage %": share}
    return table([row], "A **caption**", titles, forms)


def test_columns_that_say_nothing_are_left_out() -> None:
    found = example()
    assert found.columns == ("name", "bias", "coverage %")
    assert found.numeric == (False, True, True)
    assert found.rows == [("x", "-1.20 ± 0.10", "95 (90-98)")]


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
    own = Figure(evil, drawing, evil)
    template = environment().from_string(PAGE)
    page = template.render(title=evil, contents=[], frame=example(evil), drawing=own)
    tags, attributes = parsed(page)
    assert tags.count("script") == 1
    assert "img" not in tags
    assert not [name for name, _ in attributes if name.startswith("on")]
    assert all(place.startswith("#") for name, place in attributes if name.endswith("href"))
    assert not re.search(r"[\x00\x1b\udcff\u202e]", page)
    written = markdown(example(evil))
    assert not re.search(r"<script|<img|(?<!\\)\[?x\]|[\x00\x1b\udcff\u202e]|^# c", written, re.M)
    assert pdf(drawing)
    stream = io.StringIO()
    show(Console(file=stream), Line(evil), evil, example(evil))
    assert not re.search(r"[\x00\x1b\x07]", stream.getvalue())


def test_a_figure_that_is_there_is_not_written_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[bytes] = []
    monkeypatch.setattr("pilotid.plots.page.pdf", lambda _: drawn.append(b"") or b"%PDF")

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
    titles = ["key", *(f"n{n}" for n in range(4))]
    rows = [(f"k{i}", *numbers) for i in (1, 2)]
    frame = table(rows, "", titles, dict.fromkeys(titles[1:], "{:.6f}".format))
    stream = io.StringIO()
    show(Console(file=stream, width=30), frame)
    printed = stream.getvalue()
    assert all(printed.count(f"{value:.6f}") == 2 for value in numbers)
    assert printed.count("key") == 2  # parts, each with what the rows are about
    assert max(map(len, printed.splitlines())) <= 30
    assert "n3" in as_text(frame)


@pytest.mark.parametrize(
    ("value", "error", "shown"),
    [(1.2341, 0.0567, "$1.234$"), (-0.001, 0.3, "$0.00$"), (float("nan"), 1.0, "--"),
     (123.4, 27.0, "$123$"), (-2.5, float("nan"), "$-2.50$"), (0.0, 0.0, "$0$")],
)  # fmt: skip
def test_numbers_have_the_digits_of_their_errors(value: float, error: float, shown: str) -> None:
    written = latex(table([((value, error),)], "", ["x"], {"x": to_error}))
    assert f"\n{shown} \\\\\n" in written
