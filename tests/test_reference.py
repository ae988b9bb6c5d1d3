"""What users import is in the reference."""

from __future__ import annotations

import ast
import inspect
import json
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from pkgutil import resolve_name

import yaml

import pilotid

ROOT = Path(__file__).parent.parent
PAGES = sorted((ROOT / "docs" / "api").glob("*.md"))
DIRECTIVE = re.compile(r"^\.\. (?:auto)?(?:data|function|class):: ([\w.]+)", re.MULTILINE)
LISTED = [name for page in PAGES for name in DIRECTIVE.findall(page.read_text("utf-8"))]
ENTRIES = set(LISTED)
#: By object, for a name that is imported from a room and documented at the top.
DOCUMENTED = {id(resolve_name(name)) for name in ENTRIES}


def imports(code: str) -> Iterator[str]:
    """Dotted names that a piece of code takes from this package, but for its modules."""
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "pilotid":
            for alias in node.names:
                name = f"{node.module}.{alias.name}"
                if not inspect.ismodule(resolve_name(name)):
                    yield name


def codes() -> dict[str, list[str]]:
    """The Python of each page and script that users copy from."""
    pages = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")]
    pages = [page for page in pages if "_build" not in page.parts]
    fence = re.compile(r"```(?:python|\{code-cell\}[^\n]*)\n(.*?)```", re.DOTALL)
    found = {}
    for page in pages:
        cells = [cell for cell in fence.findall(page.read_text("utf-8")) if "pilotid" in cell]
        # Without the cells' options, and what goes to a shell.
        cells = [re.sub(r"\A---\n.*?\n---\n", "", cell, flags=re.DOTALL) for cell in cells]
        found[str(page.relative_to(ROOT))] = [
            "\n".join(line for line in cell.splitlines() if not re.match(r"\s*[!%:]", line))
            for cell in cells
        ]
    return {name: own for name, own in found.items() if own}


#: What has no numbers to tell of: names for types.
TYPES = {"pilotid.support.types.FloatArray", "pilotid.support.types.ComplexArray"}


def test_all_that_is_at_the_top_is_in_the_reference_once() -> None:
    assert len(LISTED) == len(ENTRIES)
    assert {f"pilotid.{name}" for name in pilotid.__all__} - {"pilotid.plot"} <= ENTRIES
    assert {f"pilotid.plot.{name}" for name in pilotid.plot.__all__} <= ENTRIES


def test_what_pages_and_scripts_import_is_in_the_reference() -> None:
    lacking = []
    for place, own in codes().items():
        names = {name for code in own for name in imports(code)} - TYPES
        unknown = {n for n in names if n not in ENTRIES and id(resolve_name(n)) not in DOCUMENTED}
        lacking += [f"{name} of {place}" for name in sorted(unknown)]
    assert not lacking, f"put into a page of docs/api: {'; '.join(lacking)}"


def test_the_citation_is_of_this_version() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    assert citation["cff-version"] == "1.2.0"
    assert citation["title"] == project["name"]
    assert citation["version"] == pilotid.__version__
    assert citation["license"] == project["license"]
    assert citation["authors"] == project["authors"]
    archive = json.loads((ROOT / ".zenodo.json").read_text("utf-8"))
    assert archive["version"] == pilotid.__version__
    assert archive["creators"] == project["authors"]
    assert archive["license"] == project["license"]
