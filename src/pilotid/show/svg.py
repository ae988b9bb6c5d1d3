"""Figures as SVG elements of a page."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING
from xml.etree import ElementTree

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Text stays text; a reader's machine sets it in the first of these that it has.
FONTS = ("DejaVu Sans", "Verdana", "sans-serif")
POINTS = 72.0  # an inch, in which matplotlib writes SVG
SVG, LINKS = "http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"


def svg(figure: Figure, name: str, alt: str) -> str:
    """A figure as an SVG element, the same bytes for the same figure.

    Parameters
    ----------
    figure
        The figure.
    name
        Tells it from the other figures of a page: no two of them share an id.
    alt
        What the figure shows, for those who do not see it.
    """
    from matplotlib import rc_context
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.layout_engine import PlaceHolderLayoutEngine

    stream = io.StringIO()
    nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    with rc_context({"svg.hashsalt": name, "svg.fonttype": "none", "font.sans-serif": FONTS}):
        # What `savefig` does, which draws everything once more to find places for it all;
        # matplotlib's backends have no types.
        canvas = FigureCanvasSVG(figure)
        engine = figure.get_layout_engine()
        if engine is not None and not isinstance(engine, PlaceHolderLayoutEngine):
            figure.set_dpi(POINTS)
            engine.execute(figure)
            figure.set_layout_engine("none")
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
    root.set("aria-label", alt)
    ElementTree.register_namespace("", SVG)
    ElementTree.register_namespace("xlink", LINKS)
    return ElementTree.tostring(root, encoding="unicode")
