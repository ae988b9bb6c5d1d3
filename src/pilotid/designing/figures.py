"""Figures of a design, as functions of axes, and the figures made of them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pilotid.designing.design import Design
from pilotid.designing.lines import multisine
from pilotid.show.style import INK, draw_grid, journal_figure, log_ticks

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DESIGN, REFERENCE = ("#0072B2", "o"), ("#999999", "s")
NAMES = {"ft": "target ft", "fd": "disturbance fd"}
SECONDS = 20.0  # of the signals are shown


def spectrum(axes: Axes, made: Design, signal: str) -> Axes:
    """Amplitudes of a signal's lines beside those of the reference."""
    for scenario, (colour, marker), label in (
        (made.reference, REFERENCE, "reference"),
        (made.scenario, DESIGN, "design"),
    ):
        forcing = multisine(scenario, scenario.target if signal == "ft" else scenario.disturbance)
        if forcing is not None:
            axes.plot(
                forcing.omega,
                forcing.amplitudes,
                color=colour,
                marker=marker,
                markersize=4.0,
                linewidth=0.7,
                label=label,
            )
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="rad/s",
        ylabel="deg",
        title=f"amplitudes of {NAMES[signal]}",
    )
    log_ticks(axes, "x")
    draw_grid(axes)
    return axes


def relative_errors(axes: Axes, made: Design) -> Axes:
    """Predicted standard errors in %, design and reference, on a logarithmic axis."""
    keys = list(made.errors)
    for errors, (colour, marker), label, shift in (
        (made.reference_errors, REFERENCE, "reference", -0.12),
        (made.errors, DESIGN, "design", 0.12),
    ):
        axes.plot(
            np.arange(len(keys)) + shift,
            [100.0 * errors[key] for key in keys],
            color=colour,
            marker=marker,
            markersize=5.0,
            linestyle="none",
            label=label,
        )
    axes.set_xticks(range(len(keys)), keys)
    axes.set(yscale="log", title="predicted standard errors [%]")
    log_ticks(axes, "y")
    draw_grid(axes, "y")
    axes.legend(frameon=False)
    return axes


def signal(axes: Axes, made: Design, name: str) -> Axes:
    """The first seconds of a forcing function, with its peaks over the whole period."""
    forcing = made.scenario.target if name == "ft" else made.scenario.disturbance
    assert forcing is not None
    time = np.arange(0.0, min(SECONDS, made.scenario.duration), made.scenario.dt)
    whole = forcing.at(np.arange(0.0, made.lines.period, made.scenario.dt))
    peak = float(np.max(np.abs(whole)))
    for level in (-peak, peak):
        axes.axhline(level, color=INK, linewidth=0.5, linestyle=":")
    axes.plot(time, forcing.at(time), color=DESIGN[0], linewidth=0.8)
    axes.set(xlabel="s", ylabel="deg", title=f"{NAMES[name]}; dotted: peaks of a period")
    return axes


def spectra_figure(made: Design) -> Figure:
    """Spectra of both signals, and the predicted errors."""
    with journal_figure(4.4) as figure:
        above, below = figure.subfigures(2, 1, squeeze=False).ravel()
        names = [name for name, _ in made.lines.signals]
        for axes, name in zip(
            above.subplots(1, len(names), squeeze=False).ravel(), names, strict=True
        ):
            spectrum(axes, made, name).legend(frameon=False)
        relative_errors(below.subplots(), made)
    return figure


def signals_figure(made: Design) -> Figure:
    """Both signals over time."""
    names = [name for name, _ in made.lines.signals]
    with journal_figure(1.5 * len(names)) as figure:
        for axes, name in zip(
            figure.subplots(len(names), 1, squeeze=False).ravel(), names, strict=True
        ):
            signal(axes, made, name)
    return figure
