"""How easily README and guide are read: Flesch's reading ease, by page and in the median.

    python tests/checks/reading_ease.py

90 is very easy, 50 fairly difficult, 30 difficult.  Nothing is asserted.  `nox -s docs` prints it.
"""

from __future__ import annotations

import re
import statistics
import sys
from pathlib import Path

import textstat

TREE = Path(__file__).parents[2]


def prose(text: str) -> str:
    """The sentences of a page, without headings, code, tables, formulas and targets of links."""
    text = re.sub(r"\A---\n.*?\n---\n", "", text, flags=re.DOTALL)
    text = re.sub(r"(?ms)^(`{3,}|:{3,}).*?^\1\s*$", "", text)
    text = re.sub(r"\$\$.*?\$\$|\$[^$\n]+\$", "x", text, flags=re.DOTALL)
    text = re.sub(r"(?m)^(    |#|\||!\[).*$", "", text)
    text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", text)
    text = re.sub(r"`[^`\n]+`", "x", text)
    lines = re.sub(r"(?m)^\s*(?:[-*]|\d+\.)\s+(.*[^.:;\s])\s*$", r"\1.", text)  # items end
    return re.sub(r"[*_]", "", lines)


def main() -> None:
    pages = [TREE / "README.md", *sorted((TREE / "docs/guide").glob("*.md"))]
    pages.append(TREE / "docs/index.md")
    ease = {page: textstat.flesch_reading_ease(prose(page.read_text("utf-8"))) for page in pages}
    for page, value in sorted(ease.items(), key=lambda pair: pair[1]):
        sys.stdout.write(f"{value:6.1f}  {page.relative_to(TREE)}\n")
    sys.stdout.write(f"{statistics.median(ease.values()):6.1f}  median of {len(ease)} pages\n")


if __name__ == "__main__":
    main()
