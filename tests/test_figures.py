"""Figures and pages of fits: which there are, what they say, and that they can be read."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from helpers import NOMINAL, PILOTS
from matplotlib.figure import Figure

from pilotid.checks.element_fit import ElementChoice
from pilotid.datasets import scenario_named, simulate
from pilotid.estimate.estimate import Estimate, Outcome, failed, symmetric_intervals
from pilotid.estimate.method import Fitted, fit_all
from pilotid.methods import method_named
from pilotid.model.catalogue import MULTI, SINGLE
from pilotid.model.element import element_named
from pilotid.model.loops import margins, open_loops
from pilotid.model.model import PilotModel
from pilotid.plots import plots
from pilotid.plots.page import save_figures
from pilotid.recording.recording import Recording
from pilotid.report.fit import figures_of
from pilotid.support.types import InputError

ELEMENT = element_named("4/s^2")


@cache
def recording(runs: int = 1) -> Recording:
    scenario = replace(scenario_named("nominal"), runs=runs)
    made = simulate(scenario, np.random.default_rng(1))
    return replace(made, controlled_element="")


@cache
def fitted(*methods: str, model: PilotModel = MULTI) -> Fitted:
    return fit_all(recording(), model, {name: method_named(name) for name in methods}, 1)


def estimate(method: str = "mle", model: PilotModel = MULTI, **fields: object) -> Estimate:
    """An estimate at a pilot's truth, every parameter known to 4 %."""
    values = PILOTS[model.name].values
    covariance = np.diag((0.04 * values) ** 2)
    return Estimate(
        method,
        model,
        Outcome.CONVERGED,
        values,
        covariance,
        symmetric_intervals(values, covariance),
        **fields,  # type: ignore[arg-type]
    )


# --------------------------------------------------------------------------- which there are


def test_a_fit_has_every_figure_that_a_journal_asks_for() -> None:
    fit = fitted("mle")
    unknown = replace(fit, loop_element=ElementChoice())
    assert "open-loop" not in [f.name for f in figures_of(unknown)]
    assert [f.name for f in figures_of(fit)] == [
        *("time", "describing-function", "open-loop", "remnant", "residual-tests"),
    ]


# ------------------------------------------------------------------------- what they show


def test_the_open_loops_are_those_of_the_element_with_their_margins() -> None:
    above, below = Figure().subplots(2, 1)
    plots.open_loop(estimate(), ELEMENT, (above, below))
    curves = {str(line.get_label()).split(":")[0]: line for line in above.get_lines()}
    omega = np.asarray(curves["target"].get_xdata(), float)
    target, disturbance = open_loops(MULTI, NOMINAL.values, ELEMENT, omega)
    np.testing.assert_allclose(curves["target"].get_ydata(), np.abs(target))
    np.testing.assert_allclose(curves["disturbance"].get_ydata(), np.abs(disturbance))
    for margin in margins(MULTI, NOMINAL.values, ELEMENT):
        words = f"crossover {margin.crossover:.2f} rad/s, phase margin {margin.phase_margin:.0f}°"
        assert any(words in str(line.get_label()) for line in above.get_lines())
    assert above.get_ylabel() == "magnitude |L| [-]"


def test_the_band_of_an_open_loop_of_an_uncertain_gain_is_one_of_magnitude_alone() -> None:
    values = PILOTS["single"].values
    covariance = np.zeros((values.size, values.size))
    covariance[0, 0] = (0.1 * values[0]) ** 2
    found = replace(estimate(model=SINGLE), covariance=covariance)
    above, below = Figure().subplots(2, 1)
    plots.open_loop(found, ELEMENT, (above, below))
    size = np.asarray(above.get_lines()[1].get_ydata(), float)
    edges = above.collections[0].get_paths()[0].vertices[:, 1]
    assert edges.max() / size.max() == pytest.approx(np.exp(0.196), rel=1e-3)
    phases = below.collections[0].get_paths()[0].vertices
    first = phases[np.isclose(phases[:, 0], phases[:, 0].min()), 1]
    assert np.ptp(first) < 1e-3


def test_plots_of_one_estimate_refuse_one_without_values() -> None:
    lost = failed("mle", MULTI, Outcome.SINGULAR)
    with pytest.raises(InputError, match="no loop to draw"):
        plots.open_loop(lost, ELEMENT)
    with pytest.raises(InputError, match="no channel of model single acts on x: choose e"):
        plots.correlation(recording(), estimate(model=SINGLE), signal="x", axes=Figure().subplots())


def test_the_limits_hold_white_errors_and_not_those_of_another_pilot() -> None:
    def outside(found: Estimate) -> float:
        axes = plots.correlation(recording(), found, axes=Figure().subplots())
        lines = axes.get_lines()
        limit = float(np.max(np.asarray(lines[1].get_ydata(), float)))
        limit = max(limit, float(np.max(np.asarray(lines[2].get_ydata(), float))))
        return float(np.mean(np.abs(np.asarray(lines[0].get_ydata(), float)) > limit))

    found = fitted("mle").estimates[0]
    assert outside(found) < 0.2
    slow = found.values.copy()
    slow[MULTI.keys.index("tdvis")] += 0.25
    assert outside(replace(found, values=slow)) > 0.2


# ------------------------------------------------------------------------------- as files


@pytest.mark.long
def test_figures_are_files_of_the_same_bytes_each_time(tmp_path: Path) -> None:
    named = replace(recording(), controlled_element="4/s^2")
    fit = replace(fitted("mle"), recording=named)
    kept = []
    for number in (1, 2):
        folder = tmp_path / str(number)
        folder.mkdir()
        files = save_figures(folder, list(figures_of(fit)))
        kept.append({f.name: f.read_bytes() for f in files})
    assert kept[0] == kept[1]
    assert len(kept[0]) == 10
    assert kept[0]["time.svg"].startswith(b"<svg")
    for name, content in kept[0].items():
        if name.endswith(".pdf"):
            assert content.startswith(b"%PDF")
            assert b"Date" not in content
