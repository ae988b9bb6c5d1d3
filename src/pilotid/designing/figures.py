"""Figures of a design."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pilotid.designing.design import Design
from pilotid.designing.lines import sines_of
from pilotid.show.style import INK, draw_grid, journal_figure, log_ticks

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DESIGN, REFERENCE = ("#0072B2", "o"), ("#999999", "s")
NAMES = {"ft": "target ft", "fd": "disturbance fd"}
SECONDS = 20.0  # of the signals are shown


def spectra_figure(made: Design) -> Figure:
    """Amplitudes of both signals' lines, and the predicted errors, beside the reference's."""
    with journal_figure(4.4) as figure:
        above, below = figure.subfigures(2, 1, squeeze=False).ravel()
        names = [name for name, _ in made.lines.signals]
        panels = above.subplots(1, len(names), squeeze=False).ravel()
        for axes, name in zip(panels, names, strict=True):
            for scenario, style, label in (
                (made.reference, REFERENCE, "reference"),
                (made.scenario, DESIGN, "design"),
            ):
                if sines := sines_of(scenario, name):
                    axes.plot(sines.omega, sines.amplitudes, color=style[0], marker=style[1],
                              markersize=4.0, linewidth=0.7, label=label)  # fmt: skip
            axes.set(xscale="log", yscale="log", xlabel="rad/s", ylabel="deg")
            axes.set_title(f"amplitudes of {NAMES[name]}")
            log_ticks(axes, "x")
            draw_grid(axes)
            axes.legend(frameon=False)
        _draw_errors(below.subplots(), made)
    return figure


def _draw_errors(axes: Axes, made: Design) -> None:
    """Predicted standard errors in %, design and reference, on a logarithmic axis."""
    places = np.arange(len(made.errors))
    for errors, (colour, marker), label, shift in (
        (made.reference_errors, REFERENCE, "reference", -0.12),
        (made.errors, DESIGN, "design", 0.12),
    ):
        percents = 100.0 * np.array(list(errors.values()))
        axes.plot(places + shift, percents, color=colour, marker=marker, markersize=5.0,
                  linestyle="none", label=label)  # fmt: skip
    axes.set_xticks(places, list(made.errors))
    axes.set(yscale="log", title="predicted standard errors [%]")
    log_ticks(axes, "y")
    draw_grid(axes, "y")
    axes.legend(frameon=False)


def signals_figure(made: Design) -> Figure:
    """The first seconds of both forcing functions, with their peaks over the whole period."""
    names = [name for name, _ in made.lines.signals]
    step = made.scenario.dt
    with journal_figure(1.5 * len(names)) as figure:
        panels = figure.subplots(len(names), 1, squeeze=False).ravel()
        for axes, name in zip(panels, names, strict=True):
            sines = sines_of(made.scenario, name)
            assert sines is not None
            time = np.arange(0.0, min(SECONDS, made.scenario.duration), step)
            peak = float(np.max(np.abs(sines.at(np.arange(0.0, made.lines.period, step)))))
            for level in (-peak, peak):
                axes.axhline(level, color=INK, linewidth=0.5, linestyle=":")
            axes.plot(time, sines.at(time), color=DESIGN[0], linewidth=0.8)
            axes.set(xlabel="s", ylabel="deg", title=f"{NAMES[name]}; dotted: peaks of a period")
    return figure
