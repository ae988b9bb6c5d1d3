"""A page for each method: from the docstring of its module, and its rows of the reference study."""

from __future__ import annotations

import csv
import inspect
import re
import sys
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

from pilotid.methods import METHODS

ROOT = Path(__file__).parents[2]
#: Paragraphs of a docstring that have a section, by how they begin.
SECTIONS = {"Assumes": "What it assumes", "Use it": "When to use it", "Do not use it": "When not"}
SCENARIOS = (
    "nominal",
    "single",
    "white-remnant",
    "target-step",
    "population-usual",
    "population-recorded",
    "population-aperiodic",
    "population-short",
    "population-exotic",
)


def page_of(method: Any, rows: list[dict[str, str]]) -> str:
    """The page of a method, as Markdown."""
    text = inspect.getdoc(sys.modules[type(method).__module__]) or ""
    text = re.sub(r"(?m)^References\n-+\n", "References: ", text)
    summary, *rest = text.split("\n\n")
    parts = [f"# {method.name}", summary]
    for beginning, title in SECTIONS.items():
        parts += [f"## {title}", *[p for p in rest if p.startswith(beginning)]]
    parts += ["## How it ranks", _ranking(method.name, rows)]
    parts.append("## How it works and where it is from")
    parts += [p for p in rest if not p.startswith(tuple(SECTIONS))]
    parts.append(f"Settings: {{py:class}}`pilotid.{type(method).__qualname__}`.")
    return "\n\n".join(parts) + "\n"


def _ranking(name: str, rows: list[dict[str, str]]) -> str:
    lines = ["| scenario | rank | loss (95 % interval) | coverage | failed |"]
    lines += ["| --- | ---: | ---: | ---: | ---: |"]
    for scenario in SCENARIOS:
        every = [r for r in rows if (r["scenario"], r["parameter"]) == (scenario, "all")]
        every = sorted((r for r in every if r["loss"]), key=lambda r: float(r["loss"]))
        for rank, r in enumerate(every, start=1):
            if r["method"] == name:
                loss, low, high = (f"{float(r[f'loss{e}']):.3g}" for e in ("", "_lower", "_upper"))
                cover = f"{100.0 * float(r['coverage_95']):.0f} %" if r["coverage_95"] else ""
                tried = int(r["n"]) + int(r["failures"])
                lines.append(
                    f"| `{scenario}` | {rank} of {len(every)} | {loss} ({low} to {high}) | {cover} "
                    f"| {r['failures']} of {tried} |"
                )
    if len(lines) == 2:
        return "The reference study does not have it."
    words = "Loss: 1 is an exact, efficient estimator ([how to read it](../../guide/comparing.md))."
    return "\n".join(lines) + f"\n\n{words} From `results/reference/summary.csv`."


def ranking(rows: list[dict[str, str]], scenario: str) -> str:
    """All methods on a scenario, as a table in the order of their losses."""
    every = [r for r in rows if (r["scenario"], r["parameter"]) == (scenario, "all") and r["loss"]]
    lines = ["| method | loss (95 % interval) | coverage |", "| --- | ---: | ---: |"]
    for r in sorted(every, key=lambda r: float(r["loss"])):
        loss, low, high = (f"{float(r[f'loss{e}']):.3g}" for e in ("", "_lower", "_upper"))
        cover = f"{100.0 * float(r['coverage_95']):.0f} %" if r["coverage_95"] else ""
        link = f"[`{r['method']}`](../methods/generated/{r['method']}.md)"
        lines.append(f"| {link} | {loss} ({low} to {high}) | {cover} |")
    return "\n".join(lines) + "\n"


def _write(app: Sphinx) -> None:
    folder = Path(app.srcdir) / "methods" / "generated"
    folder.mkdir(parents=True, exist_ok=True)
    with (ROOT / "results/reference/summary.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    texts = {f"{method.name}.md": page_of(method, rows) for method in METHODS.values()}
    texts["ranking.txt"] = ranking(rows, "population-usual")
    for name, text in texts.items():
        path = folder / name
        if not path.exists() or path.read_text("utf-8") != text:  # else it is built anew
            path.write_text(text, "utf-8")


def setup(app: Sphinx) -> dict[str, Any]:
    """Write the pages before the build looks for pages."""
    app.connect("builder-inited", _write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
