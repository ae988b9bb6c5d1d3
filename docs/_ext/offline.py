"""A page that loads anything from the network is a warning, and so ends the build."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx
from sphinx.util import logging

# What a browser fetches by itself; a link that a reader may follow is no such thing.
LOADED = (
    re.compile(r"<(?:script|img|iframe|source|video|embed)\b[^>]*\ssrc\s*=\s*[\"']?(?:https?:)?//"),
    re.compile(r"<link\b(?=[^>]*(?:stylesheet|preload|icon))[^>]*href\s*=\s*[\"']?(?:https?:)?//"),
    re.compile(r"(?:@import\s+|url\()\s*[\"']?(?:https?:)?//"),
)


def _look(app: Sphinx, fault: Exception | None) -> None:
    if fault is not None or app.builder.format != "html":
        return
    for file in sorted(Path(app.outdir).rglob("*")):
        if file.suffix in (".html", ".css"):
            text = file.read_text(encoding="utf-8")
            for pattern in LOADED:
                if found := pattern.search(text):
                    name = file.relative_to(app.outdir)
                    logging.getLogger(__name__).warning("%s loads %s", name, found[0])


def setup(app: Sphinx) -> dict[str, Any]:
    """Look at all pages when they are written."""
    app.connect("build-finished", _look)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
