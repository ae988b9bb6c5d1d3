"""The report's chapter on pilots who change, from stores filled by hand."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from helpers import written

from pilotid.report.study_figures import paths
from pilotid.study.comparison import Comparison, comparison_of
from pilotid.study.entries import (
    TRAJECTORY,
    MethodEntry,
    ParameterTruth,
    Result,
    ScenarioEntry,
    Track,
    Unit,
)
from pilotid.study.store import Store

TIMES = 42
TRUTH = {
    "time": np.linspace(0.0, 80.0, TIMES).tolist(),
    "K": np.linspace(2.0, 1.0, TIMES).tolist(),
    "d": [0.3] * TIMES,
}
NAME = "harder"


class Made:
    """A study with its report."""

    def __init__(self, study: Comparison, text: str, folder: Path) -> None:
        self.study, self.text, self.folder = study, text, folder


def filled(folder: Path, methods: dict[str, tuple[float, float, float]], count: int = 30) -> Made:
    """A report on methods whose error, lag and coverage are given, with some scatter."""
    parameters = (ParameterTruth("K1", "", 2.0, 0.1), ParameterTruth("K2", "", 1.0, 0.1))
    rng = np.random.default_rng(1)
    with Store(folder, create=True) as store:
        store.describe({"seed": "1", f"{TRAJECTORY} {NAME}": json.dumps(TRUTH)})
        store.add_scenario(ScenarioEntry(NAME, 0, "it becomes harder", "own", {}, parameters))
        for place, (method, (error, lag, held)) in enumerate(methods.items()):
            store.add_method(MethodEntry(method, place, {}))
            for i in range(count):
                off, moved = error * (1.0 + 0.1 * rng.standard_normal()), lag + rng.normal(0, 0.2)
                tracks = [
                    Track("K", (off,) * 4, moved, held, tuple(TRUTH["K"])),
                    Track("d", (off, off, None, off), None, held, (None, *TRUTH["d"][1:])),
                ]
                estimates = [
                    (p.parameter, p.truth + 0.1 * rng.standard_normal(), 0.1, 0.0, 3.0)
                    for p in parameters
                ]
                result = Result(
                    Unit(NAME, method, i), "converged", usable=True, seconds=0.1,
                    estimates=tuple(estimates), tracks=tuple(tracks),
                )  # fmt: skip
                store.add(result)
        study = comparison_of(store)
        _, text = written(folder, study)
    return Made(study, text, folder)


def test_what_is_late_or_ahead_stands_in_the_ranking(tmp_path: Path) -> None:
    made = filled(
        tmp_path,
        {"mle": (0.1, 0.1, 0.95), "rarx": (0.5, 4.0, 0.93), "mle-white": (0.15, -3.0, 0.4)},
    )
    table = made.text.partition("methods by their loss")[2].partition("**")[2]
    lags = {}
    for line in table.partition("\n\n")[2].splitlines():
        if line.startswith("| "):
            entries = [entry.strip() for entry in line.strip("|").split("|")]
            lags.setdefault(entries[0], entries[-2])
    assert lags["mle"] == "none"
    assert lags["rarx"].startswith("K 4") or lags["rarx"].startswith("K 3.9")
    assert lags["rarx"].endswith("late")
    assert lags["mle-white"].endswith("ahead")


def test_numbers_in_the_table_are_those_of_the_scores(tmp_path: Path) -> None:
    made = filled(tmp_path, {"mle": (0.1, 2.0, 0.9)})
    cell = made.study.at(NAME, "mle")
    assert cell is not None
    gain, damping = cell.tracks
    assert gain.lag.value == pytest.approx(2.0, abs=0.2)
    assert np.isnan(damping.lag.value)
    (row,) = [x for x in made.text.splitlines() if x.startswith("| K | mle |")]
    assert f"{100.0 * gain.median:.3g}" in row
    assert "90.0" in row or "| 90" in row


@pytest.mark.long
def test_the_figure_has_a_panel_for_each_method_and_what_changes(tmp_path: Path) -> None:
    many = {f"m{i}": (0.1, 0.0, 0.95) for i in range(6)}
    made = filled(tmp_path, many, count=3)
    figure = paths(made.study.of(NAME), TRUTH)
    drawn = [axes for axes in figure.axes if axes.lines]
    assert len(drawn) == 6  # one parameter changes
    assert {axes.get_title() for axes in drawn} == set(many)
    assert (tmp_path / "figures" / f"trajectories-{NAME}.svg").exists()
