"""Figures and pages of fits: which there are, what they say, and that they can be read."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from functools import cache
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from helpers import NOMINAL, PILOTS, SINGLE_LOOP
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

from pilotid.datasets import scenario_named, simulate
from pilotid.estimates.draws import Draws
from pilotid.estimates.estimate import Estimate, Outcome, failed, symmetric_intervals
from pilotid.estimates.fitted import Fitted, fit_all
from pilotid.estimates.loops import LoopElement
from pilotid.estimates.parts import RemnantEstimate
from pilotid.estimates.quantities import Quantity, quantity_tables
from pilotid.methods import method_named
from pilotid.methods.fourier import Fourier
from pilotid.pilot.catalogue import MULTI, SINGLE
from pilotid.pilot.element import double_integrator
from pilotid.pilot.loops import margins, open_loops
from pilotid.pilot.model import PilotModel
from pilotid.recordings.recording import Recording
from pilotid.report.fit import figures_of, fit_section, html_report, summary
from pilotid.report.posterior import convergence_words
from pilotid.show import plots
from pilotid.show.posterior_figures import corner
from pilotid.show.style import SMALLEST, STYLES
from pilotid.support.document import pdf, save_figures, to_html
from pilotid.support.types import InputError

ELEMENT = double_integrator(4.0)


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


def many() -> Fitted:
    """Ten estimates, two of them failed."""
    good = [
        estimate(name, remnant=RemnantEstimate("white", {}, 0.2, np.geomspace(0.1, 50.0, 9),
                                               np.ones(9)) if name == "mle" else None)
        for name in (*(m for m in STYLES if m != "sindy"), "other")
    ]  # fmt: skip
    lost = [failed("sindy", MULTI, Outcome.UNSTABLE_MODEL), failed("x", MULTI, Outcome.CRASHED)]
    return Fitted(recording(3), MULTI, (*good[:4], *lost, *good[4:]))


def texts(figure: Figure) -> list[tuple[str, float, tuple[float, float, float, float]]]:
    """All that is written in a figure: text, size, and the box around it [pixels]."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    beyond = {
        id(label)
        for axes in figure.axes
        for axis in (axes.xaxis, axes.yaxis)
        for tick in [*axis.get_major_ticks(), *axis.get_minor_ticks()]
        for label in (tick.label1, tick.label2)
        if not min(axis.get_view_interval()) <= tick.get_loc() <= max(axis.get_view_interval())
    }
    found = []
    for text in figure.findobj(Text):
        assert isinstance(text, Text)
        if text.get_visible() and text.get_text().strip() and id(text) not in beyond:
            box = text.get_window_extent(canvas.get_renderer())
            found.append((text.get_text(), float(text.get_fontsize()), box.extents))
    return found


def assert_readable(figure: Figure) -> None:
    """No text on another or beyond the figure, none too small, all of at most three sizes."""
    written = texts(figure)
    width, height = figure.bbox.size
    assert written
    for text, size, (left, low, right, high) in written:
        assert size >= SMALLEST, text
        assert left > -1.0 and low > -1.0, text  # noqa: PT018
        assert right < width + 1.0 and high < height + 1.0, text  # noqa: PT018
    assert len({size for _, size, _ in written}) <= 3
    upright = [(t, box) for t, _, box in written]
    for (one, a), (other, b) in combinations(upright, 2):
        apart = a[2] <= b[0] + 1 or b[2] <= a[0] + 1 or a[3] <= b[1] + 1 or b[3] <= a[1] + 1
        assert apart, f"{one!r} lies on {other!r}"


# --------------------------------------------------------------------------- which there are


def test_a_fit_has_every_figure_that_a_journal_asks_for() -> None:
    fit = fitted("mle")
    names = [f.name for f in figures_of(fit, element=ELEMENT)]
    assert names == [
        "time", "describing-function", "open-loop", "remnant", "band", "residual-tests",
        "correlations",
    ]  # fmt: skip
    assert "open-loop" not in [f.name for f in figures_of(fit)]
    named = replace(fit, recording=replace(recording(), controlled_element="4/s^2"))
    assert "open-loop" in [f.name for f in figures_of(named)]


def test_a_fit_that_failed_has_no_figure_and_many_have_readable_ones_on_a_page() -> None:
    lost = Fitted(recording(), MULTI, (failed("mle", MULTI, Outcome.SINGULAR),))
    assert not list(figures_of(lost, element=ELEMENT))
    shown = list(figures_of(many(), element=ELEMENT))
    correlations = [f.name for f in shown if f.name.startswith("correlations")]
    assert correlations[:2] == ["correlations", "correlations-2"]
    for figure in shown:
        assert_readable(figure.drawing)
    page = to_html("", [fit_section(many(), "one", shown)])
    good = sum(e.outcome.usable for e in many().estimates)
    assert page.count("<table ") == math.ceil(good / 3)
    assert page.count("<svg ") == page.count("<figcaption>") == len(shown)
    assert f"<strong>Figure {len(shown)}.</strong>" in page
    assert "sindy failed: the first-step model is unusable." in page
    ids = re.findall(r' id="([^"]+)"', page)
    assert len(ids) == len(set(ids))
    assert "@page { size: A4" in page


@pytest.mark.parametrize("method", ["mle", "fourier"])
def test_text_in_figures_can_be_read(method: str) -> None:
    with_units = replace(recording(), units={"u": "deg", "e": "rad", "x": "rad"})
    fit = replace(fitted(method), recording=with_units)
    points = Fourier().first_step(recording(), MULTI)
    shown_by_name = {f.name: f for f in figures_of(fit, points=points, element=ELEMENT)}
    response = shown_by_name["describing-function"]
    # Points stand behind an estimate without a first step only.
    labels = [text for text, *_ in texts(response.drawing)]
    assert ("Fourier coefficients" in labels) == (method == "mle")
    assert ("without a model of the pilot" in response.caption) == (method == "mle")
    for shown in shown_by_name.values():
        assert_readable(shown.drawing)
        assert shown.caption.endswith(".")
        for axes in shown.drawing.axes:
            for label in (axes.get_xlabel(), axes.get_ylabel()):
                assert not label or re.search(r"\[.+\]$", label), label


def test_a_short_single_run_of_one_channel_is_drawn() -> None:
    short = simulate(SINGLE_LOOP, np.random.default_rng(3))
    keep = {name: getattr(short, name)[:, : short.run_in + 1200] for name in ("e", "u", "x")}
    short = replace(short, **keep, ft=None, fd=None, lines={})
    fit = Fitted(short, SINGLE, (estimate(model=SINGLE),))
    shown = {f.name: f for f in figures_of(fit, element=ELEMENT)}
    assert shown["time"].drawing.axes[0].get_xlim()[1] == pytest.approx(short.time[-1])
    assert any("target and disturbance" in text for text, *_ in texts(shown["open-loop"].drawing))
    for figure in shown.values():
        assert_readable(figure.drawing)


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
        bars = [np.asarray(line.get_ydata(), float) for line in below.get_lines()]
        spans = [float(b[0] - b[1]) for b in bars if b.size == 2]
        assert any(span == pytest.approx(margin.phase_margin, abs=0.5) for span in spans)
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
    with pytest.raises(InputError, match="no correlations"):
        plots.correlation(lost)
    with pytest.raises(InputError, match="no channel of model single acts on x: choose e"):
        plots.cross_correlation(
            recording(), estimate(model=SINGLE), signal="x", axes=Figure().subplots()
        )


def test_the_limits_hold_white_errors_and_not_those_of_another_pilot() -> None:
    def outside(found: Estimate) -> float:
        axes = plots.autocorrelation(recording(), found, axes=Figure().subplots())
        lines = axes.get_lines()
        limit = float(np.max(np.asarray(lines[1].get_ydata(), float)))
        limit = max(limit, float(np.max(np.asarray(lines[2].get_ydata(), float))))
        return float(np.mean(np.abs(np.asarray(lines[0].get_ydata(), float)) > limit))

    found = fitted("mle").estimates[0]
    assert outside(found) < 0.2
    slow = found.values.copy()
    slow[MULTI.keys.index("tdvis")] += 0.25
    assert outside(replace(found, values=slow)) > 0.2


def test_correlations_are_written_as_numbers() -> None:
    values = estimate().values
    correlation = np.eye(values.size)
    correlation[1, 0] = correlation[0, 1] = -0.974
    covariance = correlation * np.outer(values, values)
    axes = plots.correlation(replace(estimate(), covariance=covariance), Figure().subplots())
    written = {(round(t.get_position()[0]), round(t.get_position()[1])): t for t in axes.texts}
    assert written[0, 0].get_text() == "\N{MINUS SIGN}.97"
    assert written[0, 1].get_text() == "0"
    assert [t.get_text() for t in axes.get_yticklabels()] == list(MULTI.keys[1:])
    assert len(written) == values.size * (values.size - 1) // 2


def test_every_method_has_a_stroke_of_its_own() -> None:
    assert len({str(style.dash) for style in STYLES.values()}) == len(STYLES)


# ------------------------------------------------------------------------------- as files


@pytest.mark.long
def test_figures_are_files_of_the_same_bytes_each_time(tmp_path: Path) -> None:
    fit = fitted("mle")
    kept = []
    for number in (1, 2):
        folder = tmp_path / str(number)
        folder.mkdir()
        files = save_figures(folder, list(figures_of(fit, element=ELEMENT)))
        kept.append({f.name: f.read_bytes() for f in files})
    assert kept[0] == kept[1]
    assert len(kept[0]) == 14
    assert kept[0]["time.svg"].startswith(b"<svg")
    for name, content in kept[0].items():
        if name.endswith(".pdf"):
            assert content.startswith(b"%PDF")
            assert b"Date" not in content


def test_a_drawn_figure_does_not_move_when_it_is_drawn_again() -> None:
    (shown, *_) = figures_of(fitted("mle"))
    assert pdf(shown.drawing) == pdf(shown.drawing)


# ------------------------------------------------------------------------------- in words


def test_the_summary_says_what_was_fitted_and_what_is_known() -> None:
    found = estimate(vaf=81.26)
    errors = 0.01 * found.values
    errors[1] = 0.4 * found.values[1]
    covariance = np.diag(errors**2)
    intervals = symmetric_intervals(found.values, covariance)
    found = replace(found, covariance=covariance, intervals=intervals)
    text = " ".join(summary(Fitted(recording(3), MULTI, (found,))))
    assert "(a visual channel on e and a vestibular channel on x; 7 parameters)" in text
    assert "fitted to 3 runs together, each of 81.92 s at 50 Hz, by mle." in text
    assert "The fit converged." in text
    assert "accounts for 81.3 % of the variance" in text
    assert "Poorly identified (above 50 %): tlead and Kvis*tlead." in text
    assert "Kvis 2 %, " in text
    assert "No check of recording or fit found a fault." in text


def test_the_summary_names_failures_disagreement_and_remarks() -> None:
    good = estimate(remarks=("something is odd",))
    moved = replace(good, method="arx", values=1.5 * good.values, intervals=1.5 * good.intervals)
    held = replace(estimate("bayes"), outcome=Outcome.AT_BOUND, message="dnm at 0.05")
    lost = failed("sindy", MULTI, Outcome.UNSTABLE_MODEL, "it runs away")
    text = " ".join(summary(Fitted(recording(), MULTI, (good, moved, held, lost))))
    assert "mle and arx converged." in text
    assert "bayes converged with a parameter at its bound (dnm at 0.05)." in text
    assert "sindy failed: the first-step model is unusable (it runs away)." in text
    assert f"do not overlap those of mle: arx ({', '.join(MULTI.keys)})." in text
    assert "Below, 1 note: for information, no doubts." in text  # of two methods


def test_the_summary_says_which_numbers_mean_nothing() -> None:
    found = estimate()
    values = found.values.copy()
    values[-1] = MULTI.upper[-1]
    intervals = symmetric_intervals(values, found.covariance)
    held = replace(found, outcome=Outcome.AT_BOUND, values=values, intervals=intervals)
    text = " ".join(summary(Fitted(recording(), MULTI, (held,))))
    assert f"At a bound: {MULTI.keys[-1]}." in text
    assert text.count(MULTI.keys[-1]) == 1
    astray = replace(found, outcome=Outcome.NOT_CONVERGED)
    text = " ".join(summary(Fitted(recording(), MULTI, (astray,))))
    assert "No numbers here are to be used." in text
    assert "over the value" not in text


def test_a_page_of_several_recordings_has_contents_and_loops_where_there_are_some() -> None:
    lost = failed("arx", MULTI, Outcome.SINGULAR)
    fit = Fitted(recording(), MULTI, (lost, estimate()))
    known = replace(fit, loop_element=LoopElement(ELEMENT, "given"))
    page = html_report([fit, known])
    assert '<a href="#recording-2">' in page
    assert page.count(">Loops</p>") == page.count("(target_crossover)</th>") == 1
    assert page.count("loops with the controlled element 4/s^2, as given") == 1
    assert page.count("Open loops of the pilot (mle) with the controlled element 4/s^2") == 2
    none = replace(fit, loop_element=LoopElement(why="x does not tell the element"))
    page = to_html("", [fit_section(none, "one", [])])
    assert "<li>x does not tell the element</li>" in page


def test_a_table_has_value_and_interval_of_each_method() -> None:
    crossover = Quantity("target_crossover", "rad/s", 2.38, 0.1, 2.2, 2.6)
    (table,) = quantity_tables([("mle", [crossover])], 3)
    texts = [[cell.text for cell in row] for row in table.rows]
    assert texts == [["target_crossover", "rad/s", "2.38 ± 0.10", "2.20 .. 2.60"]]


# ------------------------------------------------------------------------------ posteriors


def draws(r_hat: float = 1.002) -> Draws:
    keys = (*MULTI.keys, "frequency", "damping")
    rng = np.random.default_rng(1)
    values = 1.0 + 0.1 * rng.normal(size=(4 * 20 * 10, len(keys)))
    count = len(keys)
    return Draws(
        "emcee", keys, np.ones(count, dtype=bool), values, np.zeros(len(values)),
        np.full(len(values), 1.0 / len(values)), (4, 20, 10), np.full(count, 300.0),
        np.full(count, r_hat), np.full(count, 5.0), 0.4,
    )  # fmt: skip


def test_a_corner_of_nine_parameters_can_be_read() -> None:
    assert_readable(corner(draws(), {"tlead": "s", "fnm": "rad/s"}))


def test_convergence_is_told_in_words() -> None:
    good, bad = " ".join(convergence_words(draws())), " ".join(convergence_words(draws(1.2)))
    assert "4 ensembles of 10 walkers" in good
    assert "1.0020, at most 1.01: the ensembles agree" in good
    assert "1.2000, above 1.01: the ensembles do not agree, and nothing here is to be used" in bad
    assert "at least 300 independent ones (Kvis), fewer than the 400" in good
