"""Documents: sections of text, tables and figures, as HTML, Markdown, LaTeX and terminal output.

Texts hold `code`, **strong** words and links to a [section](#key), a [file](folder/name.html)
beside the page or [one](../name.html) above it; nothing else is marked up.  Tables hold values,
which columns format as plain text.  What else means something in a form is escaped in it;
control characters, marks of direction and lone surrogates are escaped in all.
"""

from __future__ import annotations

import io
import math
import re
from base64 import b64encode
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from hashlib import sha256
from importlib.resources import files
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Literal, NamedTuple, TypeVar
from weakref import WeakSet
from xml.etree import ElementTree

from pilotid.support.disk import write_file
from pilotid.support.format import (
    NONE,
    clean,
    for_latex,
    for_markdown,
    math_html,
    typeset,
)
from pilotid.support.format import inline as for_html
from pilotid.support.format import plain as for_terminal
from pilotid.support.terminal import PLAIN_WIDTH, print_table
from pilotid.support.types import InputError

if TYPE_CHECKING:
    from jinja2 import Environment
    from matplotlib.figure import Figure as Drawing
    from pandas import DataFrame
    from rich.console import Console
    from rich.table import Table as RichTable

LINK = r"\[([^\]]+)\]\((#[\w-]+|(?:[\w.-]+/)+[\w.+-]+|[\w-]+\.csv)\)"
LONGEST_LABEL = 200  # characters of a text in a figure


def clean_drawing(drawing: Drawing) -> None:
    """Make all texts of a figure such that they can be drawn; formulas that are none stay text."""
    from matplotlib.mathtext import MathTextParser
    from matplotlib.text import Text

    def cleaned(label: str) -> str:
        return "\n".join(map(clean, label.split("\n")))[:LONGEST_LABEL]

    for axis in (axis for axes in drawing.axes for axis in (axes.xaxis, axes.yaxis)):
        labels = [text.get_text() for text in axis.get_ticklabels()]
        if any(label != cleaned(label) for label in labels):  # a formatter sets them anew
            axis.set_ticks(axis.get_majorticklocs(), labels=[*map(cleaned, labels)])
    for text in drawing.findobj(Text):
        assert isinstance(text, Text)
        given = text.get_text()
        words = cleaned(given)
        if words != given:
            text.set_text(words)
        if "$" in words:
            try:
                MathTextParser("path").parse(words)
            except Exception:
                text.set_parse_math(False)


T = TypeVar("T")
Kinds = Sequence[Literal["svg", "pdf"]]

#: The folder of figures beside a page.
FIGURES = "figures"
MINUS, DASH = "\N{MINUS SIGN}", "\N{EN DASH}"
#: Text of figures stays text; a reader's machine sets it in the first of these that it has.
FONTS = ("DejaVu Sans", "Verdana", "sans-serif")
POINTS = 72.0  # an inch, in which matplotlib writes SVG
SVG, LINKS = "http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"
#: Colours of texts and rows in a terminal by their marks.
STYLES = {"heading": "bold", "warning": "yellow", "failure": "red"}
#: Columns between columns of a table, and width to which those of words may be folded.
GAP, FOLDED = 3, 16


class LogAxis(NamedTuple):
    """A logarithmic axis of dots and whiskers; its ends as powers of ten."""

    low: float
    high: float

    @classmethod
    def of(cls, intervals: Iterable[tuple[float, float, float]]) -> LogAxis:
        """An axis that shows 1 and all values with their lower and upper ends."""
        known = [each for each in intervals if each[0] > 0.0]
        values = [value for value, *_ in known]
        ends = [end for _, *own in known for end in own if end > 0.0 and math.isfinite(end)]
        low, high = min([0.8, *values, *ends]), max([2.0, *values, *ends])
        # One wild interval must not press all others together.
        high = min(high, 3.0 * max([1.0, *values]))
        return cls(math.log10(low) - 0.02, math.log10(high) + 0.02)

    def place(self, value: float) -> float:
        """Where a value lies [%]."""
        share = (math.log10(value) - self.low) / (self.high - self.low)
        return round(min(max(100.0 * share, 0.0), 100.0), 1)

    def whisker(self, value: float, lower: float, upper: float) -> tuple[float, ...] | None:
        """Places of a value and of the ends of its interval [%]; None without a value."""
        if not value > 0.0:
            return None
        ends = (end if end > 0.0 and math.isfinite(end) else value for end in (lower, upper))
        return tuple(map(self.place, (value, *ends)))

    @property
    def ticks(self) -> list[tuple[float, str]]:
        """Places [%] and labels."""
        values = [base * 10.0**power for power in range(-1, 6) for base in (1.0, 2.0, 5.0)]
        inside = [v for v in values if self.low <= math.log10(v) <= self.high]
        if self.high - self.low > 2.2:
            inside = [v for v in inside if math.log10(v).is_integer()]
        return [(self.place(v), f"{v:g}") for v in inside]


@dataclass(frozen=True)
class Column(Generic[T]):
    """A column of a table.

    Attributes
    ----------
    title
        Its heading.
    value
        The value of a row's item; None for nothing.
    form
        Writes a value as a number, in ASCII but for ±; a tuple's members are its arguments.  None
        for words, which are set to the left.
    hint
        What the heading means, where it is short.
    mark
        How good an item's value is, which a page colours: ``good``, ``partly``, ``poor``, ``bad``
        or ``none``.
    axis
        Of a column of whiskers, whose values are intervals: the axis; pages alone draw it.
    symbol
        Of a column of keys: what gives a key's symbol between dollar signs, or the key itself;
        pages show it before the key, LaTeX in its place.
    """

    title: str
    value: Callable[[T], object]
    form: Callable[..., str] | None = None
    hint: str = ""
    mark: Callable[[T], str] | None = None
    axis: LogAxis | None = None
    symbol: Callable[[str], str] | None = None

    def cell(self, item: T) -> Cell:
        """What the table shows of an item."""
        value, mark = self.value(item), self.mark(item) if self.mark else ""
        if self.axis is not None and isinstance(value, tuple):
            return Cell("", mark, self.axis.whisker(*value))
        if value is None:
            text = NONE
        elif self.form is None:
            text = str(value)
        else:
            text = self.form(*value) if isinstance(value, tuple) else self.form(value)
        return Cell(text, mark)


class Cell(NamedTuple):
    """A cell of a table: its text, its mark and the places of its whisker."""

    text: str
    mark: str = ""
    whisker: tuple[float, ...] | None = None


@dataclass(frozen=True)
class Table(Generic[T]):
    """A table with a row for each item; columns that say nothing of any item are left out.

    Attributes
    ----------
    caption
        What it shows.
    columns
        Its columns; the first `heads` hold what the rows are about.
    items
        What the rows are about.
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
    columns: Sequence[Column[T]]
    items: Sequence[T]
    heads: int = 1
    folded: bool = False
    filters: tuple[int, ...] = ()
    upright: bool = False

    @cached_property
    def shown(self) -> list[tuple[Column[T], list[Cell]]]:
        """The columns that say something, with their cells."""
        every = [(column, [column.cell(item) for item in self.items]) for column in self.columns]
        return [
            (column, cells)
            for place, (column, cells) in enumerate(every)
            if place < self.heads
            or column.axis
            or any(cell.text not in ("", "0", NONE) for cell in cells)
        ]

    @property
    def titles(self) -> list[Column[T]]:
        """The columns that say something."""
        return [column for column, _ in self.shown]

    @property
    def rows(self) -> list[list[Cell]]:
        """Cells by row."""
        return [list(row) for row in zip(*(cells for _, cells in self.shown), strict=True)]

    def begins_group(self, number: int) -> bool:
        """Whether a row is the first of those with the same first entry."""
        if self.heads < 2 or not number:
            return False
        first = self.shown[0][1]
        return first[number].text != first[number - 1].text

    def to_dataframe(self) -> DataFrame:
        """The values, a column for each title."""
        from pandas import DataFrame

        return DataFrame({c.title: [c.value(item) for item in self.items] for c in self.columns})


def table_of(
    caption: str,
    heads: Sequence[tuple[Any, ...]],
    rows: Sequence[Sequence[Any]],
    number_of_heads: int = 1,
    *,
    folded: bool = False,
) -> Table[Any]:
    """A table of rows of values; each head has the title and, if need be, form and hint."""
    columns = [
        Column(title, itemgetter(place), *more) for place, (title, *more) in enumerate(heads)
    ]
    return Table(caption, columns, rows, number_of_heads, folded)


@dataclass(frozen=True)
class Figure:
    """A figure; its SVG is part of a page.

    Attributes
    ----------
    name
        What its files are called.
    drawing
        What matplotlib drew.
    caption
        What it shows.
    alt
        The same in short, for those who do not see it; empty for the caption.
    """

    name: str
    drawing: Drawing = field(repr=False)
    caption: str
    alt: str = ""

    @property
    def file(self) -> str:
        """Its name as that of a file: the name may hold a scenario's."""
        return re.sub(r"[^\w.,()=+ -]", "-", self.name)

    @cached_property
    def svg(self) -> str:
        """The figure as an SVG element."""
        return svg(self.drawing, self.file, self.alt or self.caption)


@dataclass(frozen=True)
class Text:
    """A paragraph; its mark is empty, ``heading``, ``warning`` or ``failure``."""

    text: str
    mark: str = ""


@dataclass(frozen=True)
class Bullets:
    """A list; in a terminal a line for each item."""

    items: Sequence[str]


@dataclass(frozen=True)
class Command:
    """Something to type, and what it does."""

    text: str
    command: str


Block = Table[Any] | Figure | Text | Bullets | Command


@dataclass(frozen=True)
class Section:
    """A part of a document with a heading; its key is the target of links.

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


def _symbol_html(column: Column[Any], cell: Cell) -> str:
    """The symbol of a key as HTML; nothing where there is none."""
    found = column.symbol(cell.text) if column.symbol else cell.text
    return math_html(found) if found != cell.text else ""


def _cell_text(column: Column[Any], cell: Cell) -> str:
    return typeset(cell.text) if column.form or cell.text == NONE else cell.text


# -------------------------------------------------------------------------------------- HTML


def _templates() -> Environment:
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup

    environment = Environment(
        loader=PackageLoader("pilotid"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=lambda value: clean(value) if type(value) is str else value,
    )
    environment.filters["inline"] = lambda text: Markup(for_html(text))
    environment.globals["symbol"] = lambda *cell: Markup(_symbol_html(*cell))
    environment.filters["kind"] = lambda block: type(block).__name__
    environment.globals["cell_text"] = _cell_text
    # The one script that a page may run is known by its digest.
    script = files("pilotid").joinpath("templates", "page.js").read_text("utf-8")
    digest = b64encode(sha256(script.encode()).digest()).decode()
    environment.globals |= {"script": Markup(script), "digest": Markup(digest)}
    return environment


def to_html(title: str, sections: Sequence[Section], kinds: Kinds = ()) -> str:
    """A document as one HTML text that needs no network; equal documents give equal bytes.

    Parameters
    ----------
    title
        Its heading.
    sections
        What it consists of.
    kinds
        Files of each figure beside the page, to which it links.
    """
    template = _templates().get_template("document.html")
    return template.render(title=title, sections=sections, kinds=kinds, figures=FIGURES)


def table_html(table: Table[Any]) -> str:
    """A table as HTML, for notebooks."""
    macros: Any = _templates().get_template("table.html").module
    return str(macros.table_of(table))


def blocks_html(*blocks: Text | Bullets | Table[Any]) -> str:
    """Texts, lists and tables as HTML, for notebooks."""
    parts = []
    for block in blocks:
        if isinstance(block, Table):
            parts.append(table_html(block))
        else:
            lines = [block.text] if isinstance(block, Text) else block.items
            parts += [f"<p>{for_html(line)}</p>" for line in lines]
    return "".join(parts)


def write_page(path: Path, title: str, sections: Sequence[Section], kinds: Kinds = ()) -> None:
    """Write a document as a page, and the figures of these kinds in a folder beside it.

    Raises
    ------
    InputError
        If they cannot be written.
    """
    if kinds:
        figures = [b for section in sections for b in section.blocks if isinstance(b, Figure)]
        save_figures(path.parent / FIGURES, figures, kinds)
    write_file(path, to_html(title, sections, kinds).encode("utf-8", "replace"))


# ---------------------------------------------------------------------------------- Markdown


def to_markdown(title: str, sections: Sequence[Section]) -> str:
    """A document as Markdown, with figures from the folder beside it."""
    titles = {s.key: for_markdown(s.title) for s in sections}
    parts = [f"# {for_markdown(title)}"]
    parts.append("\n".join(f"- [{words}](#{key})" for key, words in titles.items()))
    for section in sections:
        parts.append(f'<a id="{section.key}"></a>\n\n## {titles[section.key]}')
        parts += map(_block_markdown, section.blocks)
    keys = {section.key for section in sections}
    text = "\n\n".join(parts) + "\n"
    # What links to a section that is left out stays as words.
    return re.sub(r"\[([^\]]+)\]\(#([\w-]+)\)", lambda m: m[0] if m[2] in keys else m[1], text)


def _block_markdown(block: Block) -> str:
    if isinstance(block, Table):
        return _table_markdown(block)
    if isinstance(block, Figure):
        words, place = for_markdown(block.alt or block.caption), f"{FIGURES}/{block.file}.svg"
        return f"![{words}]({place})\n\n*{for_markdown(block.caption)}*"
    if isinstance(block, Bullets):
        return "\n".join(f"- {for_markdown(item)}" for item in block.items)
    if isinstance(block, Command):
        return f"{for_markdown(block.text)}\n\n    {clean(block.command)}"
    return for_markdown(block.text)


def _table_markdown(table: Table[Any]) -> str:
    def line(cells: Iterable[str]) -> str:
        return f"| {' | '.join(for_markdown(cell).replace('|', chr(92) + '|') for cell in cells)} |"

    shown = [(column, cells) for column, cells in table.shown if not column.axis]
    columns = [[_cell_text(column, cell) for cell in cells] for column, cells in shown]
    head = line(column.title for column, _ in shown)
    rule = line("---:" if column.form else "---" for column, _ in shown)
    rows = (line(row) for row in zip(*columns, strict=True))
    return "\n".join([f"**{for_markdown(table.caption)}**", "", head, rule, *rows])


# ------------------------------------------------------------------------------------- LaTeX


def table_latex(table: Table[Any]) -> str:
    """A table as a booktabs tabular without its caption."""

    def cell(column: Column[Any], text: str) -> str:
        if text == NONE:
            return "--"
        if column.form is None:
            own = column.symbol(text) if column.symbol else text
            return own if own != text else for_latex(text)
        number = r"(?:(?<!\d)-)?\d*\.?\d+(?:e[-+]\d+)?"
        return re.sub(number, r"$\g<0>$", for_latex(text))

    def line(cells: Iterable[str]) -> str:
        return " & ".join(cells) + r" \\"

    shown = [(column, cells) for column, cells in table.shown if not column.axis]
    columns = [[cell(column, each.text) for each in cells] for column, cells in shown]
    begin = rf"\begin{{tabular}}{{{''.join('r' if c.form else 'l' for c, _ in shown)}}}"
    head = line(for_latex(column.title) for column, _ in shown)
    rows = (line(row) for row in zip(*columns, strict=True))
    end = r"\bottomrule", r"\end{tabular}", ""
    return "\n".join([begin, r"\toprule", head, r"\midrule", *rows, *end])


# ---------------------------------------------------------------------------------- terminal


def print_blocks(console: Console, *blocks: Text | Bullets | Table[Any]) -> None:
    """Print texts, lists, and tables without whiskers between empty lines."""
    lines = 0
    for block in blocks:
        if isinstance(block, Table):
            if lines:
                console.print()
            if block.caption:
                console.print(for_terminal(block.caption), soft_wrap=True)
            for number, part in enumerate(_parts(block, console.width)):
                if number:
                    console.print()
                print_table(console, table_rich(block, console.encoding, part))
            lines = -1
            continue
        texts = [block.text] if isinstance(block, Text) else block.items
        style = STYLES.get(block.mark) if isinstance(block, Text) else None
        for text in texts:
            if lines < 0:
                console.print()
            console.print(for_terminal(text), style=style, soft_wrap=True)
            lines = 1


def blocks_text(*blocks: Text | Bullets | Table[Any]) -> str:
    """What `print_blocks` prints, as plain text."""
    from rich.console import Console

    stream = io.StringIO()
    console = Console(file=stream, width=PLAIN_WIDTH, highlight=False, markup=False, emoji=False)
    print_blocks(console, *blocks)
    return stream.getvalue().strip("\n")


def _parts(table: Table[Any], width: int) -> list[list[int]]:
    """The columns that fit beside one another, the first ones in each part: none is cut."""
    from rich.cells import cell_len

    def wide(column: Column[Any], cells: Sequence[Cell], head: bool) -> int:
        longest = max(cell_len(for_terminal(t)) for t in (column.title, *(c.text for c in cells)))
        return GAP + (longest if head or column.form else min(longest, FOLDED))

    shown = [(column, cells) for column, cells in table.shown if not column.axis]
    widths = [wide(c, cells, n < table.heads) for n, (c, cells) in enumerate(shown)]
    heads = list(range(min(table.heads, len(shown))))
    parts, left = [[*heads]], width + GAP - sum(widths[n] for n in heads)
    room = left
    for n in range(len(heads), len(shown)):
        if widths[n] > room and len(parts[-1]) > len(heads):
            parts.append([*heads])
            room = left
        parts[-1].append(n)
        room -= widths[n]
    return parts


def table_rich(
    table: Table[Any], encoding: str = "utf-8", places: Sequence[int] | None = None
) -> RichTable:
    """A table for the terminal, or some of its columns."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table as RichTable

    shown = [(column, cells) for column, cells in table.shown if not column.axis]
    places = range(len(shown)) if places is None else places
    found = RichTable(box=SIMPLE_HEAD, show_edge=False, pad_edge=False)
    sign = "±" if encoding == "utf-8" else "+-"
    for place in places:
        column = shown[place][0]
        # What rows are about is kept whole, and so are numbers.
        whole = place < table.heads or column.form is not None
        justify: Literal["left", "right"] = "right" if column.form else "left"
        title = for_terminal(column.title)
        found.add_column(title, justify=justify, no_wrap=whole, overflow="fold")
    for row in zip(*(shown[place][1] for place in places), strict=True):
        found.add_row(*(for_terminal(cell.text).replace("±", sign) for cell in row))
    return found


# ----------------------------------------------------------------------------------- figures


def save_figures(
    folder: Path, figures: Sequence[Figure], kinds: Kinds = ("svg", "pdf"), prefix: str = ""
) -> list[Path]:
    """Write each figure as SVG and as PDF; equal figures give equal bytes.

    Parameters
    ----------
    folder
        Where to; it is made.
    figures
        The figures.
    kinds
        Which files to write; most of the time goes into the fonts of PDF.
    prefix
        Before the names of all files, such as ``subject1-C3-``.

    Returns
    -------
    The files.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror}); free the name") from error
    written: list[Path] = []
    for figure in figures:
        paths = {kind: folder / f"{prefix}{figure.file}.{kind}" for kind in kinds}
        # Of a figure whose SVG is there already, byte by byte, the PDF is as well.
        content = figure.svg.encode() if "svg" in kinds else b""
        same = "svg" in kinds and all(path.is_file() for path in paths.values())
        if not (same and paths["svg"].read_bytes() == content):
            for kind, path in paths.items():
                write_file(path, pdf(figure.drawing) if kind == "pdf" else content)
        written += paths.values()
    return written


#: Figures whose axes have their places already.
_LAID_OUT: WeakSet[Drawing] = WeakSet()


def _lay_out(drawing: Drawing) -> None:
    """Find places for all axes once and for all: each drawing would find them anew."""
    if drawing in _LAID_OUT:
        return
    _LAID_OUT.add(drawing)
    clean_drawing(drawing)
    engine = drawing.get_layout_engine()
    if engine is not None:
        drawing.set_dpi(POINTS)
        engine.execute(drawing)
        drawing.set_layout_engine("none")


def pdf(drawing: Drawing) -> bytes:
    """A figure as PDF, its text as text, without a date."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_pdf import FigureCanvasPdf

    _lay_out(drawing)
    stream = io.BytesIO()
    nothing = dict.fromkeys(("Creator", "Producer", "CreationDate"))
    with rc_context({"pdf.fonttype": 42}):
        # Not `savefig`, which draws everything twice; matplotlib's backends have no types.
        FigureCanvasPdf(drawing).print_pdf(stream, metadata=nothing)  # type: ignore[no-untyped-call]
    return stream.getvalue()


def svg(drawing: Drawing, name: str, alt: str) -> str:
    """A figure as an SVG element, the same bytes for the same figure.

    Parameters
    ----------
    drawing
        The figure.
    name
        Tells it from the other figures of a page: no two of them share an id.
    alt
        What the figure shows, for those who do not see it.
    """
    from matplotlib import rc_context
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    stream = io.StringIO()
    nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    with rc_context({"svg.hashsalt": name, "svg.fonttype": "none", "font.sans-serif": FONTS}):
        canvas = FigureCanvasSVG(drawing)
        _lay_out(drawing)
        canvas.print_svg(stream, metadata=nothing)  # type: ignore[no-untyped-call]
    root = ElementTree.fromstring(stream.getvalue())
    for element in root.iter():
        if element.tag == f"{{{SVG}}}g":
            # Groups are numbered in each figure from one, and nothing refers to them.
            element.attrib.pop("id", None)
        element.text = element.text if (element.text or "").strip() else None
        element.tail = "\n"
        if "d" in element.attrib:
            element.set("d", " ".join(element.attrib["d"].split()))
    root.set("role", "img")
    root.set("aria-label", clean(alt))
    ElementTree.register_namespace("", SVG)
    ElementTree.register_namespace("xlink", LINKS)
    return ElementTree.tostring(root, encoding="unicode")
