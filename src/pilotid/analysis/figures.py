"""Figures of an analysis: estimates over conditions, and how runs differ."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple
from typing import TYPE_CHECKING

import numpy as np

from pilotid.analysis.contrasts import Contrast
from pilotid.analysis.responses import LINES, Response, over_subjects
from pilotid.analysis.rows import Cell, Layout, in_order
from pilotid.analysis.spread import ConditionSpread
from pilotid.estimates.quantities import symbol, unit_words
from pilotid.show.style import INK, draw_grid, journal_figure, log_ticks, with_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ACROSS = 4  # panels in a row
#: Of subjects in their order, told apart with a colour vision deficiency, too (Tol, 2021).
COLOURS = ("#4477AA", "#EE6677", "#228833", "#CCBB44", "#66CCEE", "#AA3377", "#BBBBBB")
MARKERS = "osD^vP"
#: What variances are made of.
PARTS = ("target", "disturbance", "remnant")
#: Positive values that span more than this ratio are shown on a logarithmic axis.
WIDE = 8.0
#: An interval that reaches further than so many times the range of the values is cut.
FAR = 1.0


def estimates_figure(layouts: Sequence[Layout]) -> Figure:
    """Estimates over conditions, a panel for each quantity and a line for each subject.

    Parameters
    ----------
    layouts
        Quantities of one stratum and method.
    """
    rows = math.ceil(len(layouts) / ACROSS)
    conditions = in_order([c for layout in layouts for c in layout.conditions])
    subjects = in_order([s for lay in layouts for cells in lay.cells.values() for s in cells])
    with journal_figure(1.75 * rows + 0.4) as figure:
        panels = figure.subplots(rows, min(ACROSS, len(layouts)), squeeze=False).ravel()
        for axes, layout in zip(panels, layouts, strict=False):
            _panel(axes, layout, conditions, subjects)
        for axes in panels[len(layouts) :]:
            axes.set_axis_off()
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=7, frameon=False)
    return figure


def _panel(axes: Axes, layout: Layout, conditions: Sequence[str], subjects: Sequence[str]) -> None:
    offsets = np.linspace(-0.24, 0.24, len(subjects)) if len(subjects) > 1 else np.zeros(1)
    shown: list[float] = []
    for number, (subject, offset) in enumerate(zip(subjects, offsets, strict=True)):
        colour = COLOURS[number % len(COLOURS)]
        marker = MARKERS[number // len(COLOURS) % len(MARKERS)] if len(subjects) > 7 else "o"
        found = [
            (place + offset, cell)
            for place, condition in enumerate(conditions)
            if (cell := layout.cells.get(condition, {}).get(subject)) and not cell.fault
        ]
        x = [place for place, _ in found]
        y = [cell.value for _, cell in found]
        reach = np.array([_reach(cell) for _, cell in found]).reshape(-1, 2).T
        axes.plot(x, y, color=colour, linewidth=0.5, alpha=0.5)
        axes.errorbar(
            x, y, reach, fmt=marker, color=colour, markersize=3.0, elinewidth=0.9, capsize=0.0,
            label=f"subject {subject}" if subject else "recording",
        )  # fmt: skip
        shown += y
    for place, condition in enumerate(conditions):
        cells = layout.cells.get(condition, {}).values()
        values = [cell.value for cell in cells if not cell.fault]
        if len(values) > 1:
            axes.plot(
                [place - 0.36, place + 0.36], [np.mean(values)] * 2, color=INK, linewidth=1.2,
                label="mean over subjects" if place == len(conditions) - 1 else None,
            )  # fmt: skip
    axes.set_xticks(range(len(conditions)), list(conditions))
    axes.set_xlim(-0.6, len(conditions) - 0.4)
    draw_grid(axes, "y")
    _scale(axes, shown)
    logarithmic = ", log. axis" if axes.get_yscale() == "log" else ""
    title = with_unit(symbol(layout.parameter), unit_words(layout.unit))
    axes.set_title(f"{title}{logarithmic}", loc="left")


def _reach(cell: Cell) -> tuple[float, float]:
    """How far the interval reaches below and above the value."""
    low, high = cell.interval
    if not (math.isfinite(low) and math.isfinite(high)):
        return 0.0, 0.0
    return max(cell.value - low, 0.0), max(high - cell.value, 0.0)


def _scale(axes: Axes, values: Sequence[float]) -> None:
    """Choose the axis's scale, and cut intervals that would squeeze the values together."""
    if not values:
        return
    low, high = min(values), max(values)
    if low > 0.0 and high > WIDE * low:
        axes.set(yscale="log", ylim=(0.7 * low, 1.4 * high))
        log_ticks(axes, "y")
        return
    room = FAR * (high - low) or 0.5 * abs(high) or 1.0
    bottom, top = axes.get_ylim()
    axes.set_ylim(max(bottom, low - room), min(top, high + room))


def parts_figure(layouts: Sequence[Layout]) -> Figure | None:
    """Variances of e, u and x over conditions, as stacked bars; None without forcing lines.

    Parameters
    ----------
    layouts
        Quantities of one stratum that are measured.
    """
    by_key = {layout.parameter: layout for layout in layouts}
    signals = [name for name in ("e", "u", "x") if f"var_{name}_remnant" in by_key]
    if not signals:
        return None
    with journal_figure(2.4) as figure:
        panels = figure.subplots(1, len(signals), squeeze=False)[0]
        for axes, name in zip(panels, signals, strict=True):
            conditions = by_key[f"var_{name}"].conditions
            top = np.zeros(len(conditions))
            for part, colour in zip(PARTS, COLOURS, strict=False):
                layout = by_key.get(f"var_{name}_{part}")
                if layout is None:
                    continue
                cells = [layout.cells.get(c, {}).values() for c in conditions]
                height = np.array(
                    [np.mean([x.value for x in own]) if own else 0.0 for own in cells]
                )
                axes.bar(conditions, height, 0.7, bottom=top, color=colour, label=part)
                top = top + height
            unit = unit_words(by_key[f"var_{name}"].unit)
            axes.set_title(with_unit(symbol(f"var_{name}"), unit), loc="left")
            draw_grid(axes, "y")
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False)
    return figure


def responses_figure(subjects: Sequence[Sequence[Response]]) -> Figure:
    """Describing functions and open loops of one condition, a column for each.

    Parameters
    ----------
    subjects
        The responses of each subject's fit by one method, and of the coefficients at the lines.
    """
    every = [own for some in subjects for own in some]
    names = list(dict.fromkeys(own.what for own in every))
    columns: dict[str, list[str]] = {}
    for name in names:
        title = "open loops" if name.endswith(" loop") else name.partition(",")[0]
        columns.setdefault(title, []).append(name)
    with journal_figure(3.4) as figure:
        figure.set_layout_engine("none")  # to search for places takes as long as to draw
        edges = {"left": 0.08, "bottom": 0.21, "right": 0.995, "top": 0.93}
        grid = {**edges, "wspace": 0.24, "hspace": 0.12}
        panels = figure.subplots(2, len(columns), squeeze=False, sharex="col", gridspec_kw=grid)
        for (above, below), (title, own) in zip(panels.T, columns.items(), strict=True):
            for name, colour in zip(own, COLOURS, strict=False):
                _response_lines(above, below, [r for r in every if r.what == name], colour)
            above.set_title(title, loc="left")
            above.set(xscale="log", yscale="log")
            below.set_xlabel("ω [rad/s], log. axis")
            for axes in (above, below):
                draw_grid(axes)
            log_ticks(above, "x")
            log_ticks(above, "y")
        panels[0, 0].set_ylabel("magnitude, log. axis")
        panels[1, 0].set_ylabel("phase [deg]")
        handles = {
            label: handle
            for axes in panels[0]
            for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
        }
        figure.legend([*handles.values()], [*handles], loc="lower center", ncols=4, frameon=False)
    return figure


def _response_lines(above: Axes, below: Axes, own: Sequence[Response], colour: str) -> None:
    """One response: of subjects thin, their mean with a band, and the mean at the lines."""
    fits = [one for one in own if one.method != LINES]
    points = [one for one in own if one.method == LINES]
    for one in fits:
        above.plot(one.omega, one.magnitude, color=colour, linewidth=0.4, alpha=0.5)
        below.plot(one.omega, one.phase, color=colour, linewidth=0.4, alpha=0.5)
    if fits:
        mean, spread = over_subjects(fits)
        (low, low_phase), (high, high_phase) = mean - spread, mean + spread
        omega, label = fits[0].omega, "mean of fits" if points else f"mean, {fits[0].what}"
        above.plot(omega, np.exp(mean[0]), color=colour, label=label)
        below.plot(omega, mean[1], color=colour)
        above.fill_between(omega, np.exp(low), np.exp(high), color=colour, alpha=0.2, lw=0.0)
        below.fill_between(omega, low_phase, high_phase, color=colour, alpha=0.2, lw=0.0)
    if points and len({tuple(one.omega) for one in points}) == 1:
        mean, _ = over_subjects(points)
        omega = points[0].omega
        above.plot(
            omega, np.exp(mean[0]), "o", label="mean at lines", color=INK, ms=3.0, mfc="none"
        )
        below.plot(omega, mean[1], "o", color=INK, ms=3.0, mfc="none")


def standardised(found: Sequence[Contrast]) -> list[float]:
    """Paired differences less their means, over their standard deviations, of three or more."""
    result: list[float] = []
    for contrast in found:
        own = np.array([pair.difference for pair in contrast.pairs])
        if len(own) > 2 and contrast.std_error > 0.0 and not contrast.within:
            result += ((own - own.mean()) / own.std(ddof=1)).tolist()
    return result


def normal_figure(values: Sequence[float]) -> Figure:
    """Numbers in order against normal quantiles."""
    from scipy.special import ndtri

    ordered = np.sort(values)
    quantiles = ndtri((np.arange(len(ordered)) + 0.5) / len(ordered))
    with journal_figure(2.8) as figure:
        axes = figure.subplots()
        axes.plot(quantiles, quantiles, color=INK, linewidth=0.8)
        axes.plot(quantiles, ordered, "o", color=COLOURS[0], markersize=2.5)
        axes.set(xlabel="normal quantile", ylabel="standardised difference")
        draw_grid(axes)
    return figure


def spread_figure(spreads: Sequence[ConditionSpread]) -> Figure:
    """How many times as much as claimed runs differ, by parameter and condition.

    Parameters
    ----------
    spreads
        Those of one stratum and method.
    """
    keys = list(dict.fromkeys(s.first.parameter for s in spreads))
    conditions = in_order([s.first.condition for s in spreads])
    offsets = np.linspace(-0.3, 0.3, len(conditions)) if len(conditions) > 1 else np.zeros(1)
    with journal_figure(2.5) as figure:
        axes = figure.subplots()
        axes.axhline(1.0, color=INK, linewidth=0.8)
        for number, condition in enumerate(conditions):
            own = [s for s in spreads if s.first.condition == condition]
            own = [s for s in own if math.isfinite(s.ratio.value)]
            x = [keys.index(s.first.parameter) + offsets[number] for s in own]
            y, low, high = np.array([astuple(s.ratio)[:3] for s in own]).reshape(-1, 3).T
            axes.errorbar(
                x, y, [y - low, high - y], fmt="o", color=COLOURS[number % len(COLOURS)],
                markersize=3.0, elinewidth=0.9, label=condition or "all recordings",
            )  # fmt: skip
        axes.set_yscale("log")
        axes.set_yticks([0.5, 1.0, 2.0, 3.0, 5.0], ["0.5", "1", "2", "3", "5"])
        axes.minorticks_off()
        axes.set_xticks(range(len(keys)), [symbol(key) for key in keys])
        if len(keys) > 8:
            axes.tick_params("x", rotation=30)
        axes.set_ylabel("scatter of runs / claimed error (log. axis)")
        draw_grid(axes, "y")
        figure.legend(*axes.get_legend_handles_labels(), loc="outside upper right", ncols=6,
                      frameon=False)  # fmt: skip
    return figure
