"""The page of a design, and what the terminal shows of it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pilotid.datasets.design import Design, sines_of
from pilotid.plots.page import Figure, write_page
from pilotid.plots.style import draw_grid, journal_figure, log_ticks, with_unit
from pilotid.support.format import Table, number, table

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing

NAMES = {"ft": "target", "fd": "disturbance"}
SECONDS = 20.0  # of the signals are shown


def write_report(folder: Path, made: Design, command: str) -> Path:
    """Write report.html, with the command that makes the design again; returns its place."""
    path, design = folder / "report.html", folder / "design.json"
    caption = "Amplitudes of the lines, and the first seconds of the measurement window"
    write_page(
        path,
        "design.html",
        title=f"Forcing functions for {made.reference.name}",
        sentences=sentences(made),
        errors=error_table(made),
        signals=Figure("signals", signals_figure(made), caption),
        command=command,
        compare=f"pilotid compare --scenario {design} --out DIR",
    )
    return path


def sentences(made: Design) -> Sequence[str]:
    """What to know of a design, a sentence each."""
    costs = ", ".join(f"{name} {cost:.2f}" for name, cost in made.costs.items())
    crests = ", ".join(f"{name} {new:.2f} ({old:.2f})" for name, (new, old) in made.crest.items())
    return (
        f"Reference: {made.reference.name}, {made.reference.description}; controlled element "
        f"{made.reference.element.name or 'of the fit'}; the remnant's power is held.",
        f"Variances over the reference's: {costs}. Limits reached: "
        f"{', '.join(made.binding) or 'none'}.",
        f"Crest factors, and the reference's: {crests}.",
    )


def error_table(made: Design) -> Table:
    """Predicted standard errors, of more time and runs too."""
    runs = made.scenario.runs
    caption = (
        f"Predicted standard errors in % of the true values, from the Cramer-Rao bounds of "
        f"{runs} run{'s' if runs > 1 else ''} of {made.scenario.duration:.2f} s"
    )
    columns = [made.errors[n] for n in ("reference_errors", "errors", "twice", "five_runs")]
    rows = [(key, *(100.0 * errors[key] for errors in columns)) for key in columns[0]]
    titles = ("parameter", "reference", "design", "twice the time", "five runs")
    return table(rows, caption, titles, dict.fromkeys(titles[1:], number))


def signals_figure(made: Design) -> Drawing:
    """Amplitudes of the lines beside those of the reference, and the signals over time."""
    signals, units = sines_of(made.scenario), dict(made.scenario.units)
    time = np.arange(0.0, min(SECONDS, made.scenario.duration), made.scenario.dt)
    with journal_figure(2.2 * len(signals)) as figure:
        panels = figure.subplots(len(signals), 2, squeeze=False)
        for (left, right), (name, sines) in zip(panels, signals.items(), strict=True):
            reference = sines_of(made.reference)[name]
            label = with_unit(f"{NAMES[name]} {name}", units.get(name, ""))
            left.loglog(reference.omega, reference.amplitudes, "s", color="#999999", markersize=4.0)
            left.loglog(sines.omega, sines.amplitudes, "o", color="#0072B2", markersize=4.0)
            left.legend(["reference", "design"], frameon=False)
            left.set(xlabel="frequency [rad/s]", ylabel=f"amplitude of {label}")
            right.plot(time, sines.at(time), color="#0072B2", linewidth=0.8)
            right.set(xlabel="time [s]", ylabel=label)
            log_ticks(left, "x")
            draw_grid(left)
    return figure
