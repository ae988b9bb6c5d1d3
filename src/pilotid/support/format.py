"""Numbers, sentences and tables as text: for the terminal, pages, Markdown and LaTeX.

A sentence holds `code`, **strong** words and links to a [section](#key), a
[file](folder/name.html) beside the page or [one](../name.html) above it; nothing else is marked
up.  What else means something in a form is escaped in it;
control characters, marks of direction and lone surrogates are escaped in all.
"""

from __future__ import annotations

import io
import math
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import compress, pairwise, starmap
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from pilotid.support.types import one_line, printable

if TYPE_CHECKING:
    from markupsafe import Markup
    from rich.console import Console
    from rich.table import Table as RichTable

T = TypeVar("T")

# numbers

NONE = "-"


def decimals(value: float, digits: int = 2, most: int = 9) -> int:
    """Decimals with which a number that is not zero shows so many digits, at the most `most`."""
    return min(max(digits - 1 - math.floor(math.log10(abs(value))), 0), most)


def number(value: float, digits: int = 3) -> str:
    """A number with that many digits, without an exponent unless it is far off."""
    if not math.isfinite(value):
        return NONE
    if value == 0.0 or 1e-3 <= abs(value) < 1e5:
        places = decimals(value, digits, digits) if value else 0
        return f"{value:z.{places}f}"
    return f"{value:.1e}"


def to_error(value: float, error: float, most: int = 4) -> str:
    """A value with the decimals that its error allows, at the most `most`."""
    if not (math.isfinite(value) and math.isfinite(error) and error > 0.0):
        return number(value)
    return f"{value:z.{decimals(error, most=most)}f}"


def unsigned(value: float, error: float) -> str:
    """A value with its error, of which two digits are shown."""
    known = math.isfinite(value) and math.isfinite(error) and error > 0.0
    text = to_error(value, error)
    return f"{text} ± {to_error(error, error)}" if known else text


def plus_minus(value: float, error: float) -> str:
    """A difference, with its sign, and its error, of which two digits are shown."""
    text = unsigned(value, error)
    shown, known, _ = text.partition(" ± ")
    return f"+{text}" if known and float(shown) > 0.0 else text


def signed(value: float) -> str:
    """A percentage with its sign, and a decimal where that matters."""
    return f"{value:+.{0 if abs(value) >= 9.95 else 1}f}"


def share(value: float, interval: tuple[float, float]) -> str:
    """A share in %, with its interval."""
    if not math.isfinite(value):
        return NONE
    return f"{100.0 * value:.0f} ({100.0 * interval[0]:.0f}-{100.0 * interval[1]:.0f})"


def p_value(p: float) -> str:
    """A p-value as papers print it."""
    if not math.isfinite(p):
        return NONE
    return "< .001" if p < 0.001 else f"{p:.3f}".lstrip("0")


# signs

LINK = r"\[([^\]]+)\]\((#[\w-]+|(?:[\w.-]+/)+[\w.+-]+|[\w-]+\.csv)\)"
LATEX = {
    **{sign: f"\\{sign}" for sign in "{}$&#%_"},
    "\\": r"\textbackslash{}",
    "^": r"\textasciicircum{}",
    "~": r"\textasciitilde{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    "±": r"$\pm$",
}


#: Colours of lines in a terminal by their marks.
STYLES = {"heading": "bold", "warning": "yellow", "failure": "red"}
#: Columns between columns of a table, and width to which those of words may be folded.
GAP, FOLDED = 3, 16
PLAIN_WIDTH = 120  # columns of output that does not go to a terminal


def clean(text: str) -> str:
    """A text on one line, without anything that acts on a terminal or that XML cannot hold."""
    return text if text.isprintable() else printable(" ".join(text.splitlines()))


def plain(text: str) -> str:
    """A text without marks; its lines stay."""
    bare = re.sub(LINK, r"\1", text).replace("`", "").replace("**", "")
    return "\n".join(map(clean, bare.split("\n")))


def inline(text: str) -> Markup:
    """A text as HTML."""
    from markupsafe import Markup, escape

    safe = str(escape(clean(text)))
    safe = re.sub(r"`([^`]+)`", r"<code>\1</code>", safe)
    safe = re.sub(r"\*\*([^*]+)\*\*", r"<strong>\1</strong>", safe)
    safe = safe.replace(" %", "&nbsp;%")
    return Markup(re.sub(LINK, r'<a href="\2">\1</a>', safe))


def for_markdown(text: str) -> str:
    """A text as Markdown, in which no other link, image or tag is one."""
    words, *linked = re.split(LINK, clean(text))
    return _signs(words) + "".join(
        f"[{_signs(name)}]({place}){_signs(words)}"
        for name, place, words in zip(linked[::3], linked[1::3], linked[2::3], strict=True)
    )


def _signs(text: str) -> str:
    text = text.replace("&", "&amp;").replace("<", "&lt;")
    return re.sub(r"[\[\]]", r"\\\g<0>", text)


def for_latex(text: str) -> str:
    """A text as LaTeX sets it, letter by letter."""
    return "".join(LATEX.get(letter, letter) for letter in clean(text))


# tables


class Table(NamedTuple):
    """A table of text.

    Attributes
    ----------
    columns, rows
        Titles, and the texts of each row.
    numeric
        Which columns hold numbers.
    caption
        What it shows.
    heads
        How many columns in front say what a row is about.
    marks
        By title, how good the value of each row is, which a page colours: ``good``, ``partly``,
        ``poor``, ``bad`` or nothing.
    """

    columns: tuple[str, ...]
    rows: list[tuple[str, ...]]
    numeric: tuple[bool, ...]
    caption: str = ""
    heads: int = 1
    marks: Mapping[str, Sequence[str]] = {}


def table(
    rows: Iterable[Sequence[object]],
    caption: str,
    columns: Sequence[str],
    forms: Mapping[str, Callable[..., str]] | None = None,
    *,
    heads: int = 1,
    marks: Mapping[str, Sequence[str]] | None = None,
) -> Table:
    """A table to show: values as text, without columns that say nothing.

    Parameters
    ----------
    rows
        The values by row; None and NaN are shown as "-".
    caption
        What the table shows.
    columns
        Titles of the columns.
    forms
        By title, what writes a value as a number, in ASCII but for ±; a tuple's members are its
        arguments.  Columns without one hold words.
    heads
        How many columns in front say what a row is about.
    marks
        See `Table`.
    """
    known = forms or {}
    writers = [known.get(title, str) for title in columns]
    texts = [tuple(starmap(_text_of, zip(row, writers, strict=True))) for row in rows]
    kept = [
        place < heads or any(row[place] not in ("", "0", NONE) for row in texts)
        for place in range(len(columns))
    ]
    return Table(
        tuple(compress(columns, kept)),
        [tuple(compress(row, kept)) for row in texts],
        tuple(title in known for title in compress(columns, kept)),
        caption,
        heads,
        marks or {},
    )


def _text_of(value: object, form: Callable[..., str]) -> str:
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return NONE
    return form(*value) if isinstance(value, tuple) else form(value)


def markdown(table: Table) -> str:
    """A table as Markdown, its caption above it."""

    def line(texts: Iterable[str]) -> str:
        return f"| {' | '.join(for_markdown(text).replace('|', chr(92) + '|') for text in texts)} |"

    rule = f"| {' | '.join('---:' if number else '---' for number in table.numeric)} |"
    lines = [line(table.columns), rule, *map(line, table.rows)]
    caption = for_markdown(table.caption.replace("**", ""))
    return "\n".join([*([f"**{caption}**", ""] if caption else []), *lines])


def latex(table: Table, symbol: Callable[[str], str] = str) -> str:
    """A table as a booktabs longtable without its caption.

    Parameters
    ----------
    table
        The table.
    symbol
        Gives a word's symbol between dollar signs, or the word itself.
    """
    from pandas import DataFrame

    number = r"(?:(?<!\d)-)?\d*\.?\d+(?:e[-+]\d+)?"

    def cell(text: str, numeric: bool) -> str:
        if text == NONE:
            return "--"
        if numeric:
            return re.sub(number, r"$\g<0>$", for_latex(text))
        known = symbol(text)
        return known if known != text else for_latex(text)

    rows = [map(cell, row, table.numeric) for row in table.rows]
    frame = DataFrame(rows, columns=[*map(for_latex, table.columns)])
    places = "".join("r" if is_number else "l" for is_number in table.numeric)
    return str(frame.to_latex(index=False, longtable=True, column_format=places))


# the terminal


class Line(NamedTuple):
    """A line for a terminal; its mark is empty, ``heading``, ``warning`` or ``failure``."""

    text: str
    mark: str = ""


def show(console: Console, *blocks: str | Line | Table) -> None:
    """Print lines, and tables between empty lines; wide tables come in parts."""
    for before, block in pairwise((None, *blocks)):
        if before is not None and Table in (type(before), type(block)):
            console.print()
        if isinstance(block, Table):
            print_frame(console, block)
        elif block is not None:
            text, mark = (block, "") if isinstance(block, str) else block
            console.print(plain(text), style=STYLES.get(mark), soft_wrap=True)


def as_text(*blocks: str | Line | Table) -> str:
    """What `show` prints, as plain text."""
    from rich.console import Console

    stream = io.StringIO()
    console = Console(file=stream, width=PLAIN_WIDTH, highlight=False, markup=False, emoji=False)
    show(console, *blocks)
    return stream.getvalue().strip("\n")


def print_frame(console: Console, table: Table) -> None:
    """Print a table with its caption, in parts where it is wide: no number is cut."""
    if table.caption:
        console.print(plain(table.caption), soft_wrap=True)
    for number, part in enumerate(_parts(table, console.width)):
        if number:
            console.print()
        console.print(_rich(table, console.encoding, part))


def _parts(table: Table, width: int) -> list[list[int]]:
    """The columns that fit beside one another, the first ones in each part."""
    from rich.cells import cell_len

    heads = list(range(min(table.heads, len(table.columns))))

    def wide(place: int) -> int:
        longest = max(cell_len(plain(row[place])) for row in (table.columns, *table.rows))
        whole = place in heads or table.numeric[place]
        return GAP + (longest if whole else min(longest, FOLDED))

    widths = [wide(place) for place in range(len(table.columns))]
    parts = [[*heads]]
    for place in range(len(heads), len(widths)):
        wanted = sum(widths[beside] for beside in (*parts[-1], place))
        if wanted > width + GAP and parts[-1] != heads:
            parts.append([*heads])
        parts[-1].append(place)
    return parts


def _rich(table: Table, encoding: str, places: Sequence[int]) -> RichTable:
    from rich.box import SIMPLE_HEAD
    from rich.table import Table as RichTable

    drawn = RichTable(box=SIMPLE_HEAD, show_edge=False, pad_edge=False)
    sign = "±" if encoding == "utf-8" else "+-"
    for place in places:
        number = table.numeric[place]
        drawn.add_column(
            plain(table.columns[place]),
            justify="right" if number else "left",
            # What rows are about is kept whole, and so are numbers.
            no_wrap=place < table.heads or number,
            overflow="fold",
        )
    for row in table.rows:
        drawn.add_row(*(plain(row[place]).replace("±", sign) for place in places))
    return drawn


def make_console(*, errors: bool = False) -> Console:
    """A console that neither colours nor breaks lines where it does not face a terminal."""
    from rich.console import Console

    stream, asked = sys.stderr if errors else sys.stdout, os.environ.get("COLUMNS", "")
    width = None if stream.isatty() or asked.isdecimal() else PLAIN_WIDTH
    return Console(stderr=errors, highlight=False, markup=False, emoji=False, width=width)


def with_bar(items: Iterable[T], what: str, total: int) -> Iterator[T]:
    """The items, with a bar on standard error while they come, if that is a terminal."""
    console = make_console(errors=True)
    if console.is_terminal and total > 1:
        from rich.progress import track

        items = track(items, what, total, console=console, transient=True)
    yield from items


def show_warning(message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
    """Print a warning as one sentence."""
    sys.stderr.write(f"pilotid: {category.__name__}: {one_line(str(message))}\n")
