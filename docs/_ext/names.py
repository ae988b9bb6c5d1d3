"""Names in backticks in docstrings: a link where the reference has an entry, else plain.

A dotted name of this package that has no entry must be there all the same; one that is not was
forgotten when something moved, and is a warning.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

from docutils import nodes
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment


def _is_there(name: str) -> bool:
    """Whether a dotted name is a module, or something in one."""
    parts = name.split(".")
    for length in range(len(parts), 0, -1):
        try:
            found: Any = import_module(".".join(parts[:length]))
        except ImportError:
            continue
        for attribute in parts[length:]:
            known = getattr(found, "__dataclass_fields__", {})
            if not hasattr(found, attribute) and attribute not in known:
                return False
            found = getattr(found, attribute, None)
        return True
    return False


def _plain(
    app: Sphinx, env: BuildEnvironment, node: pending_xref, content: nodes.TextElement
) -> nodes.TextElement | None:
    if node.get("refdomain") != "py" or node.get("reftype") != "obj":
        return None
    target = node["reftarget"]
    return None if target.startswith("pilotid.") and not _is_there(target) else content


def setup(app: Sphinx) -> dict[str, Any]:
    """Look at each name that has no entry."""
    app.connect("missing-reference", _plain)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
