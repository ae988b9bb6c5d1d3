"""What the README says is so."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from pilotid.methods import METHODS
from pilotid.pilot.catalogue import MODELS

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)


def test_there_are_examples() -> None:
    assert len(EXAMPLES) == 2


@pytest.mark.parametrize("number", range(len(EXAMPLES)))
def test_examples_run(number: int) -> None:
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", EXAMPLES[number]],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    assert ("mle: converged", "('Kvis', 'tlag', 'tdvis', 'fnm', 'dnm')")[number] in done.stdout


def rows(title: str) -> list[list[str]]:
    """The body of the table under a heading, cell by cell."""
    section = README.split(f"## {title}\n")[1].split("\n## ")[0]
    lines = [line for line in section.splitlines() if line.startswith("|")]
    return [[cell.strip(" `") for cell in line.strip("|").split("|")] for line in lines[2:]]


def knots(found: re.Match[str]) -> str:
    """All of `Kvis00 .. Kvis12`."""
    return ", ".join(f"{found[1]}{knot:02d}" for knot in range(int(found[2]) + 1))


def test_the_tables_name_every_model_and_method() -> None:
    assert {
        row[0]: re.sub(r"([a-z]+)00 \.\. \1(\d\d)", knots, row[2], flags=re.I)
        for row in rows("Models")
    } == {name: ", ".join(model.keys) for name, model in MODELS.items()}
    assert {row[0] for row in rows("Methods")} == {method.name for method in METHODS}


def test_ci_runs_the_readme_s_test_command() -> None:
    (command,) = (line.strip() for line in README.splitlines() if line.endswith("nox -s tests"))
    assert f"\n{command}\n" in (ROOT / ".ci" / "run").read_text(encoding="utf-8")


def test_every_command_in_the_readme_exists() -> None:
    from pilotid.cli.main import app

    known = {
        command.name or command.callback.__name__.replace("_", "-")
        for command in app.registered_commands
        if command.callback
    }
    assert set(re.findall(r"^    pilotid ([\w-]+)", README, flags=re.MULTILINE)) == known
