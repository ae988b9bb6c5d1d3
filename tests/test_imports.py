"""What may import what, and how light the front door is."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
METHODS = sorted((ROOT / "methods").glob("*.py"))
CORE = sorted((ROOT / "src" / "pilotid").glob("*.py"))
DATASETS = sorted((ROOT / "datasets").glob("*.py"))
# The command line, and where truth meets estimate.
FRONT = {"cli", "study", "arguments", "inference"}
COMMAND = "from pilotid.cli import main\ntry: "
HEAVY = ("scipy.signal", "control", "pysindy", "emcee", "matplotlib", "pandas", "jinja2")


def imported(path: Path) -> set[str]:
    """Dotted names of all that a file imports, wherever in it."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name}: imports are absolute"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def within(names: set[str], package: str) -> set[str]:
    return {n for n in names if n == package or n.startswith(f"{package}.")}


@pytest.mark.parametrize("path", METHODS, ids=lambda p: p.stem)
def test_methods_import_neither_datasets_nor_one_another(path: Path) -> None:
    names = imported(path)
    assert not within(names, "pilotid.datasets")
    if path.stem != "__init__":
        assert not within(names, "pilotid.methods")


@pytest.mark.parametrize("path", DATASETS, ids=lambda p: p.stem)
def test_datasets_import_no_methods(path: Path) -> None:
    assert not within(imported(path), "pilotid.methods")


@pytest.mark.parametrize("path", [p for p in CORE if p.stem not in FRONT], ids=lambda p: p.stem)
def test_the_core_imports_neither_methods_nor_datasets(path: Path) -> None:
    names = imported(path)
    assert not within(names, "pilotid.methods") | within(names, "pilotid.datasets")


@pytest.mark.parametrize(
    "path", [*CORE, *METHODS, *DATASETS, *sorted(Path(__file__).parent.rglob("*.py"))], ids=str
)
def test_nothing_imports_the_top_level_folders(path: Path) -> None:
    # They would be a second copy of the same modules, with classes that are not equal.
    names = imported(path)
    assert not within(names, "methods") | within(names, "datasets") | within(names, "src")


@pytest.mark.parametrize(
    "statement",
    [
        "import pilotid",
        "import pilotid.methods, pilotid.datasets",
        f"{COMMAND}main(['list'])\nexcept SystemExit as end: assert not end.code",
        f"{COMMAND}main(['--help'])\nexcept SystemExit as end: assert not end.code",
    ],
    ids=["pilotid", "subpackages", "list", "help"],
)
def test_heavy_libraries_wait_until_they_are_used(statement: str) -> None:
    check = f"{statement}\nimport sys; print('HEAVY', [m for m in {HEAVY!r} if m in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", check], capture_output=True, text=True, check=True, timeout=60
    )
    assert done.stdout.splitlines()[-1] == "HEAVY []"


def test_public_names_exist() -> None:
    import pilotid

    assert all(hasattr(pilotid, name) for name in pilotid.__all__)
