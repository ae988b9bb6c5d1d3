"""What may import what, and how light the front door is."""

from __future__ import annotations

import ast
import os
import re
import tomllib
from collections.abc import Sequence
from graphlib import TopologicalSorter
from pathlib import Path

import numpy as np
import pytest
from helpers import python

from pilotid.datasets import scenario_named, simulate
from pilotid.recording.files import save_recording

ROOT = Path(__file__).parent.parent
SOURCE = ROOT / "src" / "pilotid"
FOLDERS = {"methods": ROOT / "methods", "datasets": ROOT / "datasets"}
COMMAND = "from pilotid.cli.main import main\ntry: "
HEAVY = (
    *("scipy.signal", "control", "pysindy", "emcee", "matplotlib", "pandas", "jinja2"),
    *("pebble", "cloudpickle", "sqlite3"),
)


def modules() -> dict[str, Path]:
    """Every module of the package by its dotted name."""
    files = {("pilotid", *f.relative_to(SOURCE).parts): f for f in SOURCE.rglob("*.py")}
    for name, folder in FOLDERS.items():
        files |= {("pilotid", name, *f.relative_to(folder).parts): f for f in folder.rglob("*.py")}
    named = {".".join(parts).removesuffix(".py"): f for parts, f in files.items()}
    return {name.removesuffix(".__init__"): f for name, f in named.items()}


MODULES = modules()


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


def own_modules(path: Path) -> set[str]:
    """The modules of this package that a file imports, by their dotted names."""
    found = set()
    for name in imported(path):
        if name in MODULES:
            found.add(name)
        elif name.rpartition(".")[0] in MODULES:
            found.add(name.rpartition(".")[0])
    return found


#: Modules that nothing in a package imports.
AT_THE_DOOR = {"pilotid.api", "pilotid.testing"}


def package_of(module: str) -> str:
    """The package, or the module at the top, that a module belongs to."""
    parts = module.split(".")
    return "pilotid" if len(parts) == 1 or module in AT_THE_DOOR else parts[1]


def packages_in_order() -> list[str]:
    """Packages from the bottom to the top, read from the map in CONTRIBUTING.md."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    table = text.split("## The map\n")[1].split("\n## ")[0]
    rows = [line.split("|")[2] for line in table.splitlines() if line.startswith("| ")]
    return [name for row in rows for name in re.findall(r"`([a-z_]+)`", row)]


ORDER = packages_in_order()
#: Levels of packages, and pairs of which one imports the other.
LEVELS, ARROWS_AT_MOST = 10, 80


def test_the_map_shows_every_package() -> None:
    packages_there = {package_of(name) for name in MODULES} - {"pilotid"}
    assert set(ORDER) - {"pilotid"} == packages_there
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    packages = {name for name, path in MODULES.items() if path.stem == "__init__"}
    assert set(listed["tool"]["setuptools"]["packages"]) == packages


#: An estimate holds numbers only; what it is asked to predict is imported when it is asked.
ASKED = {"pilotid.estimate.estimate": {"pilotid.likelihood.estimates"}}
ARROWS = {
    name: own_modules(path) - {name} - ASKED.get(name, set()) for name, path in MODULES.items()
}


def test_no_arrow_runs_against_the_order_of_the_map() -> None:
    wrong = []
    for module, used in sorted(ARROWS.items()):
        here = package_of(module)
        allowed = {*ORDER[: ORDER.index(here)], here}
        wrong += [
            f"{module} imports {name}" for name in sorted(used) if package_of(name) not in allowed
        ]
    assert not wrong, "the map in CONTRIBUTING.md forbids: " + "; ".join(wrong)


def test_packages_have_few_levels_and_arrows() -> None:
    between = {
        (package_of(name), package_of(used))
        for name, every in ARROWS.items()
        for used in every
        if package_of(used) != package_of(name)
    }
    levels: dict[str, int] = {}
    for package in ORDER:
        below = [levels[used] for name, used in between if name == package and used in levels]
        levels[package] = 1 + max(below, default=0)
    print(f"{max(levels.values())} levels, {len(between)} arrows between packages")
    assert max(levels.values()) <= LEVELS
    assert len(between) <= ARROWS_AT_MOST


def test_no_module_imports_itself_in_a_circle() -> None:
    TopologicalSorter(ARROWS).prepare()


def test_methods_do_not_import_one_another() -> None:
    methods = {m for m in MODULES if package_of(m) == "methods" and m != "pilotid.methods"}
    wrong = [f"{m} imports {n}" for m in methods for n in ARROWS[m] if package_of(n) == "methods"]
    assert not wrong, "; ".join(sorted(wrong))


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
    assert_light(statement, HEAVY)


def test_checks_of_settings_and_notes_wait_until_there_are_any() -> None:
    assert_light("import pilotid.cli.main, pilotid.recording.files", ["pydantic"])


@pytest.mark.parametrize("command", ["check", "fit"])
def test_heavy_libraries_are_for_what_is_asked(command: str, tmp_path: Path) -> None:
    recording = tmp_path / "one.csv"
    save_recording(simulate(scenario_named("nominal"), np.random.default_rng(1)), recording)
    run = f"{COMMAND}main([{command!r}, {str(recording)!r}])\nexcept SystemExit as end: "
    assert_light(f"{run}assert not end.code", (*HEAVY, "scipy.stats", "statsmodels"))


def assert_light(statement: str, libraries: Sequence[str]) -> None:
    """What a statement imports, in a process of its own, is none of these."""
    found = f"[m for m in {libraries!r} if m in sys.modules]"
    check = f"{statement}\nimport sys; print('HEAVY', {found})"
    done = python("-c", check, check=True)
    assert done.stdout.splitlines()[-1] == "HEAVY []"


def test_public_names_exist() -> None:
    import pilotid

    assert all(hasattr(pilotid, name) for name in pilotid.__all__)
    assert set(dir(pilotid)) == {*pilotid.__all__, "datasets", "methods", "plot", "__version__"}
    assert not hasattr(pilotid, "nothing_of_this_name")
    with pytest.raises(ImportError, match="cannot import name 'nothing'"):
        exec("from pilotid import nothing")


def test_the_front_door_is_open_at_once() -> None:
    check = (
        "import sys, pilotid\n"
        "print([m for m in sys.modules if m.startswith(('numpy', 'pilotid'))])\n"
        "print(pilotid.methods.__name__, pilotid.plot.__name__, pilotid.MLE.__module__)"
    )
    done = python("-c", check, check=True)
    assert done.stdout.splitlines() == [
        "['pilotid']",
        "pilotid.methods pilotid.plots.plots pilotid.methods.mle",
    ]


@pytest.mark.parametrize(("given", "expected"), [(None, "1"), ("3", "3")])
def test_the_command_has_one_thread_of_linear_algebra_unless_told(
    given: str | None, expected: str
) -> None:
    code = (
        "import os, sys; import pilotid.cli; assert 'numpy' not in sys.modules;"
        "print(os.environ['OMP_NUM_THREADS'], os.environ['OPENBLAS_NUM_THREADS'])"
    )
    kept = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")}
    own = kept if given is None else {**kept, "OMP_NUM_THREADS": given}
    answer = python("-c", code, env=own, check=True)
    assert answer.stdout.split() == [expected, "1"]
