"""Size: code lines (no blanks, comments, docstrings), modules, README's words."""

from __future__ import annotations

import ast
import io
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
words = len((ROOT / "README.md").read_text("utf-8").split())
print(
    f"{sum(sizes.values())} code lines in {len(sizes)} modules, the longest {longest} with "
    f"{sizes[longest]}; README: {words} words"
)
