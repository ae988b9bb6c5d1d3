"""Size: code lines (no blanks, comments, docstrings), modules, words of README and docs."""

from __future__ import annotations

import ast
import io
import json
import tokenize
from pathlib import Path

ROOT = Path(__file__).parents[2]
BLANK = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT}


def code_lines(text: str) -> int:
    """The lines of a module that hold code."""
    tokens = [t for t in tokenize.generate_tokens(io.StringIO(text).readline) if t.string]
    lines = {n for t in tokens if t.type not in BLANK for n in range(t.start[0], t.end[0] + 1)}
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(getattr(node.value, "value", None), str):
            lines -= set(range(node.lineno, (node.end_lineno or 0) + 1))
    return len(lines)


files = [f for top in ("src/pilotid", "methods", "datasets") for f in (ROOT / top).rglob("*.py")]
sizes = {f.relative_to(ROOT).as_posix(): code_lines(f.read_text("utf-8")) for f in files}
longest = max(sizes, key=sizes.__getitem__)


def text_of(page: Path) -> str:
    """A page as its author wrote it; of a notebook the cells, not what they printed."""
    text = page.read_text("utf-8")
    if page.suffix != ".ipynb":
        return text
    return "\n".join("".join(cell["source"]) for cell in json.loads(text)["cells"])


MADE = {"_build", "generated"}
pages = [p for p in (ROOT / "docs").rglob("*") if p.suffix in (".md", ".rst", ".ipynb")]
pages = [p for p in pages if not MADE & set(p.parts)]
words = len((ROOT / "README.md").read_text("utf-8").split())
print(
    f"{sum(sizes.values())} code lines in {len(sizes)} modules, the longest {longest} with "
    f"{sizes[longest]}; README: {words} words; docs: "
    f"{sum(len(text_of(page).split()) for page in pages)} words in {len(pages)} pages"
)
