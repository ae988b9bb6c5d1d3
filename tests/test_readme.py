"""What the README says is so."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import pytest
from checks import front
from helpers import python

from pilotid.methods import METHODS
from pilotid.model.catalogue import MODELS

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)


def test_the_example_runs() -> None:
    (example,) = EXAMPLES
    done = python("-W", "error", "-c", example)
    assert done.returncode == 0, done.stderr
    assert "mle: converged" in done.stdout


@pytest.mark.numerical
@pytest.mark.parametrize("name", ["onestart", "smoothed"])
def test_the_method_and_the_factor_in_the_guide_work(name: str, tmp_path: Path) -> None:
    text = (ROOT / "docs/guide/own.md").read_text(encoding="utf-8")
    (own,) = re.findall(rf"%%writefile {name}.py\n(.*?)```", text, flags=re.DOTALL)
    (check,) = re.findall(r"```\{code-cell\}\n(from pilotid.testing.*?)```", text, flags=re.DOTALL)
    if name == "smoothed":
        check = """import numpy, pilotid; from dataclasses import replace
from smoothed import SMOOTHED; true = 0.16, 1.68, 0.2, 0.3, 12.0, 0.3
pilot = replace(pilotid.SCENARIOS["single"], model=SMOOTHED, truth=true)
fit = pilotid.identify("mle", pilotid.simulate(pilot, numpy.random.default_rng(1)), SMOOTHED)
assert numpy.all(abs(fit.values - true) < 4 * fit.std_error), fit"""
    (tmp_path / f"{name}.py").write_text(own, encoding="utf-8")
    done = python("-c", check, cwd=tmp_path)
    assert done.returncode == 0, done.stderr


def test_the_tables_are_those_of_the_reference() -> None:
    scores = front.reference()
    table = front.ranking(scores)
    assert table in README
    assert table in (ROOT / "paper/paper.md").read_text(encoding="utf-8")
    # By hand: the scatter of mle over its bound, parameter by parameter.
    with (ROOT / "results/reference/summary.csv").open(encoding="utf-8", newline="") as file:
        own = [
            r for r in csv.DictReader(file) if (r["scenario"], r["method"]) == ("nominal", "mle")
        ]
    ratios = [float(r["std"]) / float(r["crlb"]) for r in own if r["crlb"]]
    scatter = (sum(ratio**2 for ratio in ratios) / len(ratios)) ** 0.5
    assert len(ratios) == 7
    assert re.search(rf"(?m)^\| `mle` \|[^|]*\|[^|]*\| {scatter:.1f} \|", README)


def rows(text: str, title: str) -> list[list[str]]:
    """The body of the table under a heading, cell by cell."""
    section = text.split(f"## {title}\n")[1].split("\n## ")[0]
    lines = [line for line in section.splitlines() if line.startswith("|")]
    return [[cell.strip(" `") for cell in line.strip("|").split("|")] for line in lines[2:]]


def test_the_tables_name_every_model_and_method() -> None:
    models, methods = (
        (ROOT / f"docs/guide/{page}.md").read_text(encoding="utf-8")
        for page in ("models", "methods")
    )
    assert {row[0]: row[2] for row in rows(models, "All models")} == {
        name: ", ".join(model.keys) for name, model in MODELS.items()
    }
    names = [re.match(r"\[`(.+)`\]", row[0]) for row in rows(methods, "All methods")]
    assert {name[1] for name in names if name} == set(METHODS)
