"""What a report consists of, and its form as a page and as Markdown.

Texts hold `code`, **strong** words and links to a [section](#key), a [file](folder/name.html)
beside the report or [one](../name.html) above it; nothing else is marked up.
"""

from __future__ import annotations

import html
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from pilotid.disk import write_file
from pilotid.numbers import MINUS, NONE
from pilotid.show.figures import pdf
from pilotid.show.page import templates_of
from pilotid.show.svg import svg
from pilotid.types import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.table import Table as RichTable

#: The folder of figures beside a page.
FIGURES = "figures"
LINK = r"\[([^\]]+)\]\((#[\w-]+|(?:\.\./)?[\w-]+/[\w.+-]+|\.\./[\w.+-]+|[\w-]+\.csv)\)"


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes
    ----------
    title
        Its heading.
    text
        Whether it holds words, which are set to the left.
    paper
        Whether its numbers are those of the paper that a study repeats.
    hint
        What the heading means, where it is short.
    ticks
        Of a column of whiskers: places along the axis [%] and labels.
    """

    title: str
    text: bool = False
    paper: bool = False
    hint: str = ""
    ticks: tuple[tuple[float, str], ...] = ()


@dataclass(frozen=True)
class Entry:
    """An entry of a table.

    Attributes
    ----------
    text
        What it says.
    mark
        How good that is, which a page colours: ``good``, ``partly``, ``poor``, ``bad`` or
        ``none``.
    whisker
        Places of a value and of the ends of its interval along an axis [%], which a page draws.
    """

    text: str
    mark: str = ""
    whisker: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class Table:
    """A table.

    Attributes
    ----------
    caption
        What it shows.
    columns
        Its columns; the first `heads` hold what the rows are about.
    rows
        Rows of entries.
    heads
        Number of columns in front.
    folded
        Whether a page shows it only when asked.
    filters
        Columns by whose entries a page can choose rows.
    upright
        Whether a page sets headings upright, above many narrow columns.
    """

    caption: str
    columns: Sequence[Column]
    rows: Sequence[Sequence[Entry]]
    heads: int = 1
    folded: bool = False
    filters: tuple[int, ...] = ()
    upright: bool = False
    kind: str = field(default="table", init=False)

    @property
    def left(self) -> str:
        """Classes that set the columns of words to the left."""
        return " ".join(f"t{i}" for i, c in enumerate(self.columns, start=1) if c.text)

    def begins_group(self, number: int) -> bool:
        """Whether a row is the first of those with the same first entry."""
        rows = self.rows
        return self.heads > 1 and number > 0 and rows[number][0].text != rows[number - 1][0].text


@dataclass(frozen=True)
class Picture:
    """A figure; its SVG is part of a page and a file beside it, as is its PDF if there is one.

    Attributes
    ----------
    name, svg, alt, caption
        What its files are called, what it looks like, and what it shows.
    pdf
        The same as PDF, empty for none.
    figure
        What it was made of, where that is known.
    """

    name: str
    svg: str
    alt: str
    caption: str
    pdf: bytes = b""
    kind: str = field(default="picture", init=False)
    figure: Figure | None = field(default=None, repr=False, compare=False)

    @classmethod
    def of(cls, figure: Figure, name: str, alt: str, caption: str) -> Picture:
        """A picture of a figure; of its name, which may hold a scenario's, files are made."""
        name = re.sub(r"[^\w.,()=+ -]", "-", name)
        return cls(name, svg(figure, name, alt), alt, caption, figure=figure)

    def with_pdf(self) -> Picture:
        """The same with a PDF beside the page, which takes most of the time."""
        if self.pdf or self.figure is None:
            return self
        self.figure.set_layout_engine("none")  # all has its place since it was drawn as SVG
        return replace(self, pdf=pdf(self.figure))


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    text: str
    kind: str = field(default="text", init=False)


@dataclass(frozen=True)
class Bullets:
    """A list."""

    items: Sequence[str]
    kind: str = field(default="bullets", init=False)


@dataclass(frozen=True)
class Command:
    """Something to type, and what it does."""

    text: str
    command: str
    kind: str = field(default="command", init=False)


Block = Table | Picture | Text | Bullets | Command


@dataclass(frozen=True)
class Section:
    """A part of the report with a heading; its key is the target of links.

    A page shows one that is `folded` when asked.
    """

    key: str
    title: str
    blocks: Sequence[Block]
    folded: bool = False

    def in_short(self) -> Section:
        """The same without folded tables."""
        blocks = [b for b in self.blocks if not (isinstance(b, Table) and b.folded)]
        return replace(self, blocks=blocks)

    def with_pdfs(self) -> Section:
        """The same with each figure as PDF beside the page."""
        blocks = [b.with_pdf() if isinstance(b, Picture) else b for b in self.blocks]
        return replace(self, blocks=blocks)


def write_pictures(folder: Path, sections: Sequence[Section]) -> None:
    """Write the figures of sections into a folder of their own, as SVG and PDF.

    Raises
    ------
    InputError
        If they cannot be written.
    """
    pictures = folder / FIGURES
    try:
        pictures.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{pictures}: cannot be made ({error.strerror}); free the name") from error
    for block in (block for section in sections for block in section.blocks):
        if isinstance(block, Picture):
            write_file(pictures / f"{block.name}.svg", block.svg.encode())
            if block.pdf:
                write_file(pictures / f"{block.name}.pdf", block.pdf)


def entries(rows: Iterable[Sequence[str | Entry]]) -> list[list[Entry]]:
    """Rows of a table, from words or entries."""
    return [[cell if isinstance(cell, Entry) else Entry(cell) for cell in row] for row in rows]


def inline_html(text: str) -> str:
    """A text as HTML."""
    safe = html.escape(text, quote=True)
    safe = re.sub(r"`([^`]+)`", r"<code>\1</code>", safe)
    safe = re.sub(r"\*\*([^*]+)\*\*", r"<strong>\1</strong>", safe)
    safe = safe.replace(" %", "&nbsp;%")
    return re.sub(LINK, r'<a href="\2">\1</a>', safe)


def web_page(title: str, sections: Sequence[Section], above: str = "") -> str:
    """The report as one HTML text that needs no network.

    Parameters
    ----------
    title
        Its heading.
    sections
        What it consists of.
    above
        The page above it, if there is one: of several studies, for example.
    """
    from markupsafe import Markup

    environment = templates_of("pilotid.report")
    environment.filters["inline"] = lambda text: Markup(inline_html(text))
    return environment.get_template("study.html").render(
        title=title, sections=sections, above=above
    )


def terminal_table(table: Table) -> RichTable:
    """A table for the terminal, without whiskers and marks of text."""
    from pilotid.terminal import make_table

    shown = [i for i, column in enumerate(table.columns) if not column.ticks]
    found = make_table()
    found.title, found.title_justify, found.title_style = plain(table.caption), "left", ""
    for i in shown:
        column = table.columns[i]
        found.add_column(plain(column.title), justify="left" if column.text else "right")
    for row in table.rows:
        found.add_row(*(plain(row[i].text) for i in shown))
    return found


def plain(text: str) -> str:
    """A text without marks, and with signs that every terminal has."""
    text = re.sub(LINK, r"\1", text).replace("`", "").replace("**", "")
    return text.replace(MINUS, "-").replace(NONE, "-")


def markdown(title: str, sections: Sequence[Section]) -> str:
    """The report as Markdown, with figures from the folder beside it."""
    parts = [f"# {title}", "\n".join(f"- [{s.title}](#{s.key})" for s in sections)]
    for section in sections:
        parts.append(f'<a id="{section.key}"></a>\n\n## {section.title}')
        parts += [_block(block) for block in section.blocks]
    keys = {section.key for section in sections}
    text = "\n\n".join(parts) + "\n"
    # What links to a section that is left out stays as words.
    return re.sub(r"\[([^\]]+)\]\(#([\w-]+)\)", lambda m: m[0] if m[2] in keys else m[1], text)


def _block(block: Block) -> str:
    if isinstance(block, Table):
        return _table(block)
    if isinstance(block, Picture):
        return f"![{block.alt}]({FIGURES}/{block.name}.svg)\n\n*{block.caption}*"
    if isinstance(block, Bullets):
        return "\n".join(f"- {item}" for item in block.items)
    if isinstance(block, Command):
        return f"{block.text}\n\n    {block.command}"
    return block.text


def _table(table: Table) -> str:
    def line(cells: Iterable[str]) -> str:
        return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"

    rules = ["---" if c.text else "---:" for c in table.columns if not c.ticks]
    shown = [i for i, column in enumerate(table.columns) if not column.ticks]
    head = [line(table.columns[i].title for i in shown), line(rules)]
    rows = [line(row[i].text.replace("<", "&lt;") for i in shown) for row in table.rows]
    return "\n".join([f"**{table.caption}**", "", *head, *rows])
