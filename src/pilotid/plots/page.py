"""Pages: templates filled with sentences, tables and figures, in one file that opens offline."""

from __future__ import annotations

import io
import re
from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from hashlib import sha256
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Literal
from xml.etree import ElementTree

from pilotid.support.disk import make_folder, write_file
from pilotid.support.format import clean, for_markdown, inline, markdown

if TYPE_CHECKING:
    from jinja2 import Environment
    from matplotlib.figure import Figure as Drawing

Kinds = Sequence[Literal["svg", "pdf"]]

#: The folder of figures beside a page.
FIGURES = "figures"
LONGEST_LABEL = 200  # characters of a text in a figure
#: Text of figures stays text; a reader's machine sets it in the first of these that it has.
FONTS = ("DejaVu Sans", "Verdana", "sans-serif")
#: Key and title of a section of a page that is not folded.
SECTION = re.compile(r'<section id="([^"]*)">\s*<h2>(.*?)</h2>')
POINTS = 72.0  # an inch, in which matplotlib writes SVG
SVG, LINKS = "http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"


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
    """

    name: str
    drawing: Drawing = field(repr=False)
    caption: str

    @property
    def file(self) -> str:
        """Its name as that of a file: the name may hold a scenario's."""
        return re.sub(r"[^\w.,()=+ -]", "-", self.name)

    @cached_property
    def svg(self) -> str:
        """The figure as an SVG element."""
        return svg(self.drawing, self.file, self.caption)


@cache
def environment() -> Environment:
    """Where templates come from, and what they can call."""
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup

    templates = Environment(
        loader=PackageLoader("pilotid"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=lambda value: clean(value) if type(value) is str else value,
    )

    templates.filters |= {
        "inline": inline,
        "sections": lambda page: [(key, Markup(name)) for key, name in SECTION.findall(page)],
        "markdown": lambda text: Markup(for_markdown(text)),
        "verbatim": lambda text: Markup(clean(text)),  # behind four spaces
    }
    templates.filters["markdown_table"] = lambda table: Markup(markdown(table))
    # The one script that a page may run is known by its digest.
    script = files("pilotid").joinpath("templates", "page.js").read_text("utf-8")
    digest = b64encode(sha256(script.encode()).digest()).decode()
    templates.globals |= {"script": Markup(script), "digest": Markup(digest)}
    return templates


def render(template: str, **context: object) -> str:
    """A template filled in; equal contexts give equal texts.

    Parameters
    ----------
    template
        Its name in the folder of templates.
    context
        What it shows: sentences, tables of `pilotid.support.format.table`, and figures.
    """
    return environment().get_template(template).render(context)


def write_page(path: Path, template: str, **context: object) -> None:
    """Write a page.

    Raises
    ------
    InputError
        If it cannot be written.
    """
    write_file(path, render(template, **context).encode("utf-8", "replace"))


def save_figures(
    folder: Path, figures: Sequence[Figure], kinds: Kinds = ("svg", "pdf")
) -> list[Path]:
    """Write each figure as SVG and PDF; equal figures give equal bytes.

    Parameters
    ----------
    folder
        Where to; it is made.
    figures
        The figures.
    kinds
        Which files to write, SVG first; most of the time goes into the fonts of PDF.

    Returns
    -------
    The files.
    """
    make_folder(folder)
    written: list[Path] = []
    for figure in figures:
        paths = [folder / f"{figure.file}.{kind}" for kind in kinds]
        content = figure.svg.encode()
        # Of a figure whose SVG is there already, byte by byte, the PDF is as well.
        if not all(path.is_file() for path in paths) or paths[0].read_bytes() != content:
            for path in paths:
                write_file(path, pdf(figure.drawing) if path.suffix == ".pdf" else content)
        written += paths
    return written


def _lay_out(drawing: Drawing) -> None:
    """Find places for all axes once and for all: each drawing would find them anew."""
    clean_drawing(drawing)
    engine = drawing.get_layout_engine()
    if engine is not None:
        drawing.set_dpi(POINTS)
        engine.execute(drawing)
        drawing.set_layout_engine("none")


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
