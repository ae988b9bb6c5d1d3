"""The page that repeats the paper: what it fits, and that it shows what it was given."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import Run
from pandas import DataFrame
from stores import comparison

from pilotid.datasets import SCENARIOS
from pilotid.model.catalogue import SINGLE
from pilotid.model.loops import is_stable
from pilotid.report.paper import write_paper
from pilotid.study.paper import KEYS, METHODS, MOTION, PEOPLE, PERIPHERAL, fit_trial, trials
from pilotid.study.run import with_truth
from pilotid.study.study import PROFILES
from pilotid.study.table import Comparison, Entry, Fit

PAPER = PROFILES["paper"]


@pytest.fixture(autouse=True)
def nobody(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No recordings of people were fetched."""
    monkeypatch.setenv("PILOTID_DATA", str(tmp_path / "data"))


def study() -> Comparison:
    """Three fits of each scenario by each method that are 10 % above the truth; one failed."""
    fits = []
    for name in PAPER.scenarios:
        scenario = SCENARIOS[name]
        for method in METHODS:
            for replication, factor in enumerate((1.05, 1.1, 1.15)):
                found = {
                    key: (factor * truth, 0.1 * truth, 0.9 * truth, 1.3 * truth)
                    for key, truth in zip(KEYS, scenario.truth, strict=True)
                }
                fit = Fit(name, method, replication, "converged", "", True, seconds=1.0)
                fits.append(with_truth(fit, scenario, found))
    fits[0] = replace(fits[0], usable=False, outcome="negative-delay")
    made = comparison(fits)
    scenarios = {name: Entry(name, 0, {}, remnant=0.2) for name in PAPER.scenarios}
    return replace(made, scenarios=scenarios)


def test_what_is_simulated_for_figures_9_to_11() -> None:
    found = [*trials(1)]
    assert len(found) == len(METHODS) * (5 * 3 + 2 * 10 * 2)
    for trial in found:
        assert not isinstance(trial.source, Path)
        assert is_stable(trial.source.model, trial.source.values, trial.source.element)
        assert (trial.model == SINGLE) == (trial.figure == "9")
        forced = trial.source.target is None, trial.source.disturbance is None
        assert forced == ((False, True) if trial.figure == "11" else (True, False))
    truths = {t.condition: t.source.values for t in found if (t.figure, t.subject) == ("10", 3)}  # type: ignore[union-attr]
    ratio = truths["and peripheral"] / truths["central and motion"]
    assert ratio == pytest.approx([1.25 if key == "Kvest" else 1.0 for key in KEYS])
    again = [*trials(1)]
    assert [t.source for t in again] == [t.source for t in found]


@pytest.mark.numerical
def test_a_lumped_fit_has_a_row_for_each_parameter() -> None:
    trial = next(t for t in trials(1) if (t.method, t.condition) == ("mle", "no motion"))
    rows = fit_trial(trial)
    assert [row["parameter"] for row in rows] == list(SINGLE.keys)
    # Without motion the pilot is as the model says.
    truth = np.delete(trial.source.values, [3, 4])  # type: ignore[union-attr]
    values = np.array([row["value"] for row in rows])
    assert np.all(np.abs(values - truth) < 5.0 * np.array([row["std_error"] for row in rows]))


def test_the_page_has_the_paper_in_its_order(tmp_path: Path) -> None:
    rows = [
        {"figure": figure, "subject": subject, "condition": condition, "method": method,
         "parameter": key, "value": 1.0 + 0.1 * place * subject, "std_error": 0.1}
        for figure, conditions, keys in (
            ("9", MOTION, SINGLE.keys), ("10", PERIPHERAL, KEYS), ("11", PERIPHERAL, KEYS))
        for subject in (1, 2, 3)
        for place, condition in enumerate(conditions)
        for method in METHODS
        for key in keys
    ]  # fmt: skip
    page = write_paper(tmp_path, study(), DataFrame(rows)).read_text()
    keys = ["tables", *(f"fig-{number}" for number in (3, 4, 5, 6, 8, 9, 10, 11))]
    order = [page.index(f'<section id="{key}"') for key in keys]
    assert order == sorted(order)
    figures = re.findall(r'<figure id="figure-(fig-\d+)"', page)
    assert figures == [f"fig-{number}" for number in (3, 4, 5, 6, 7, 8, 9, 10, 11)]
    text = re.sub(r"\s+", " ", re.sub("<[^>]+>", " ", page))
    # 10 % above the truth; the paper's numbers beside it; changes between conditions.
    assert "+10.0" in text
    for paper in ("+407", "0.0876", "+145", "16.0"):
        assert paper in text, paper
    assert re.search(r"0\.4\d* ± 0\.1", text)  # from no motion to full motion
    assert "not public" in text
    assert PEOPLE not in re.sub("Columns on people.*", "", text)


@pytest.mark.numerical
@pytest.mark.long
def test_one_command_makes_the_page(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = [t for t in trials(1) if t.method == "mle" and t.subject < 3]
    monkeypatch.setattr("pilotid.study.paper.trials", lambda seed: iter(own))
    out = tmp_path / "out"
    told = run("compare", "--profile", "paper", "--replications", 2, "--workers", 2, "--out", out)
    assert told.status == 0, told.err
    assert "paper.html" in told.out
    page = (out / "paper.html").read_text()
    assert page.count("<figure ") == 9
    assert (out / "report.html").exists()
