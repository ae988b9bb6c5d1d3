"""Pictures of the gallery: what the page says first, for those who do not see them."""

from __future__ import annotations

from typing import Any

from docutils import nodes
from sphinx.application import Sphinx


def _described(app: Sphinx, doctree: nodes.document) -> None:
    page = app.env.docname
    if not page.startswith("auto_gallery/plot_"):
        return
    title = next(iter(doctree.findall(nodes.title)), None)
    section = title.parent if title is not None else doctree
    said = (p.astext() for p in section.findall(nodes.paragraph))
    words = next((text for text in said if "Go to the end" not in text), "")
    heading = title.astext() if title is not None else page
    for node in doctree.findall(nodes.Element):
        if node.tagname == "imgsgnode":
            shown = node.get("alt", "")
            own = "" if not shown or shown.startswith("plot ") else f" ({shown})"
            node["alt"] = f"{heading}{own}. {words}".replace("\n", " ")


def setup(app: Sphinx) -> dict[str, Any]:
    """Describe pictures when a page was read."""
    app.connect("doctree-read", _described)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
