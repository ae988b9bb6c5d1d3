"""Methods and scenarios of other packages and files, from the command line to the report."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tomllib
import warnings
from collections.abc import Callable
from importlib.metadata import EntryPoint
from pathlib import Path
from types import SimpleNamespace

import pytest

from pilotid.methods import METHODS, label_of, method_named, methods
from pilotid.methods.mle_white import MLEWhite
from pilotid.naming.code import PluginWarning, taken
from pilotid.support.types import InputError

HERE = Path(__file__).parent
PACKAGE = HERE.parent / "examples" / "plugin"
#: A second entry point of the package, which is broken: it costs a line of warning.
BROKEN = 'not-there = "line_fit_that_is_not_there:Nothing"\n'


@pytest.fixture(scope="module")
def beside(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that looks like the package installed, for PYTHONPATH."""
    folder = tmp_path_factory.mktemp("beside")
    shutil.copy(PACKAGE / "line_fit.py", folder)
    about = folder / "line_fit-0.1.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: line-fit\nVersion: 0.1\n")
    entries = tomllib.loads((PACKAGE / "pyproject.toml").read_text())["project"]["entry-points"]
    ((group, methods),) = entries.items()
    lines = "".join(f"{name} = {place}\n" for name, place in methods.items())
    broken = BROKEN.replace('"', "")
    (about / "entry_points.txt").write_text(f"[{group}]\n{lines}{broken}")
    return folder


def pilotid(*arguments: object, cwd: Path, beside: Path) -> subprocess.CompletedProcess[str]:
    program = "from pilotid.cli.main import main; main()"
    return subprocess.run(
        [sys.executable, "-c", program, *map(str, arguments)],
        capture_output=True,
        text=True,
        cwd=cwd,
        env=os.environ | {"PYTHONPATH": str(beside)},
        timeout=300,
    )


LEFT_OUT = (
    "pilotid: the method 'not-there' of package line-fit is left out: "
    "line_fit_that_is_not_there:Nothing: ModuleNotFoundError: No module named "
    "'line_fit_that_is_not_there'\n"
)


def test_a_package_s_method_is_listed_and_a_broken_one_costs_a_line(
    beside: Path, tmp_path: Path
) -> None:
    done = pilotid("list", cwd=tmp_path, beside=beside)
    assert done.returncode == 0, done.stderr
    words = "Least squares at the forcing lines, weighted by the remnant beside them. [line_fit]"
    assert f"\n  line-fit             {words}\n" in done.stdout
    assert "  arx  " in done.stdout
    assert "scenarios" in done.stdout
    assert done.stderr == LEFT_OUT


@pytest.mark.long
def test_a_package_s_method_goes_through_a_study_to_its_report(
    beside: Path, tmp_path: Path
) -> None:
    installed = shutil.copytree(beside, tmp_path / "installed")
    usual = ("compare", "--scenario", "single", "--workers", 1, "--out", "out")
    chosen = ("--replications", 2, "--method", "line-fit,line-fit(neighbours=8),mmle3")
    done = pilotid(*usual, *chosen, cwd=tmp_path, beside=installed)
    assert (done.returncode, done.stderr) == (0, LEFT_OUT)
    report = (tmp_path / "out" / "report.md").read_text(encoding="utf-8")
    assert "--method 'mmle3,line-fit,line-fit(neighbours=8)' --replications 2" in report
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "<code>LineFit(neighbours=8)</code>" in page
    # When the package changes, its results are not mixed with the old ones; those of others are.
    file = installed / "line_fit.py"
    file.write_text(f"{file.read_text()}\n# another version\n")
    more = (*usual, "--replications", 3, "--method")
    refused = pilotid(*more, "line-fit,mmle3", cwd=tmp_path, beside=installed)
    assert refused.returncode == 2
    assert "other code or settings (different: line-fit)" in refused.stderr
    assert pilotid(*more, "mmle3", cwd=tmp_path, beside=installed).returncode == 0


@pytest.mark.long
def test_the_package_s_own_tests_pass(beside: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-W", "ignore", "-p", "no:cacheprovider", PACKAGE],
        capture_output=True,
        text=True,
        cwd=beside,
        env=os.environ | {"PYTHONPATH": str(beside)},
        timeout=300,
    )
    assert done.returncode == 0, done.stdout
    assert "2 passed" in done.stdout


# ----------------------------------------------------------------------------- entry points


class Fine(MLEWhite):
    """A method of others."""

    name = "fine"


class Nameless(MLEWhite):
    """Its name would spoil tables."""

    name = "a | b\n"


class Taken(MLEWhite):
    """Its name is not free."""

    name = "mle"


class Fitless:
    """Has a name only."""

    name = "fitless"


def leaves() -> None:
    sys.exit(1)


Entries = Callable[..., None]


@pytest.fixture
def entries(monkeypatch: pytest.MonkeyPatch) -> Entries:
    """Register things of this module, as packages do."""

    def register(*names: str) -> None:
        found = [EntryPoint(n, f"{__name__}:{n}", "pilotid.methods") for n in names]
        monkeypatch.setattr("pilotid.methods.entry_points", lambda group: found)
        methods.cache_clear()

    yield register
    monkeypatch.undo()
    methods.cache_clear()


def test_registered_methods_come_behind_those_of_this_package(entries: Entries) -> None:
    entries("Fine")
    assert list(methods()) == [*(m.name for m in METHODS), "fine"]
    assert label_of(method_named("fine(band=3)")) == "fine(band=3)"


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("Nameless", "needs a `name` of letters"),
        ("Taken", "there is a method 'mle' already"),
        ("Fitless", "needs a function `fit`"),
        ("leaves", "SystemExit: 1"),
        ("nothing", "has no attribute 'nothing'"),
        ("SimpleNamespace", "needs a `name`"),
    ],
)
def test_what_is_no_method_is_left_out_with_a_warning(
    entries: Entries, name: str, words: str
) -> None:
    entries("Fine", name)
    with pytest.warns(PluginWarning) as told:
        found = methods()
    assert list(found) == [*(m.name for m in METHODS), "fine"]
    (warning,) = told
    assert str(warning.message).startswith(f"the method '{name}' is left out: ")
    assert words in str(warning.message)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        methods()  # it is said once


def test_a_method_cannot_pass_for_another(tmp_path: Path) -> None:
    copy = tmp_path / "copy.py"
    copy.write_text("from pilotid.methods.arx import ARX\nclass Copy(ARX):\n    pass\n")
    with pytest.raises(InputError, match="has the name 'arx' of another one"):
        label_of(method_named(f"{copy}:Copy"))
    with pytest.raises(InputError, match="is no method"):
        method_named(f"{__name__}:SimpleNamespace")
    assert taken(f"{__name__}:SimpleNamespace") == SimpleNamespace()
