"""Figures of populations and of pilots whose parameters vary in time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from pilotid.report.figures import BOUND, grid
from pilotid.show.style import GRID, INK, WIDTH, colour_of, journal_style, marker_of
from pilotid.study.comparison import Cell, Score
from pilotid.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLUMNS = 3
#: Coverage [%] that is as good as it can be asked for.
BAND = (93.5, 96.5)
#: The axis of coverage [%] goes on to the left as far as this, if need be.
LOWEST = 60.0
#: Reach of the axes of standardised errors and of normal quantiles.
REACH, QUANTILES = 4.0, 3.2

#: An axis of trajectories shows this many times the span of the truth at the most.
ROOM = 4.0
ABREAST = 4  # methods side by side
UNITS = {"tlead": "s", "tdvis": "s", "fnm": "rad/s"}


def by_stratum(cells: Sequence[Cell]) -> Figure:
    """Coverage with its interval: a panel a fact, a row a value of it, a point a method."""
    panels: dict[str, Sequence[str]] = {"all recordings": [""]}
    panels |= {name: list(own) for name, own in cells[0].strata.items() if len(own) > 1}
    longest = max(len(panel) for panel in panels.values())
    with journal_style():
        height = 0.6 + longest * max(0.19, 0.06 + 0.035 * len(cells))
        figure, every, spare = grid(len(panels), height, COLUMNS)
        points = [_points(cell, panels) for cell in cells]
        ends = [100.0 * score.coverage_interval[0] for own in points for score in own.values()]
        low = max(LOWEST, min([*(end for end in ends if math.isfinite(end)), 90.0]) - 1.0)
        for (name, panel), axes in zip(panels.items(), every, strict=True):
            axes.axvspan(*BAND, color=BOUND, linewidth=0)
            axes.axvline(95.0, color=INK, linewidth=0.6)
            for row in range(len(panel) - 1):
                axes.axhline(row + 0.5, color=GRID, linewidth=0.5)
            for place, (cell, own) in zip(_dodged(len(cells)), zip(cells, points, strict=True),
                                          strict=True):  # fmt: skip
                for row in range(len(panel)):
                    _point(axes, row + place, own[name, row], cell.method, low)
            axes.set_title(name)
            axes.set_yticks(range(len(panel)), list(panel))
            axes.set_ylim(len(panel) - 0.45, -0.55)
            axes.set_xlim(low, 100.6)
            axes.tick_params(axis="y", length=0)
        figure.supxlabel("95 % intervals that hold the truth [%]", fontsize=8.0)
        _legend(spare, cells)
    return figure


def _points(cell: Cell, panels: Mapping[str, Sequence[str]]) -> dict[tuple[str, int], Score]:
    """Scores of all parameters by panel and row."""
    return {
        (name, row): cell.parts[name, value][0] if value else cell.overall
        for name, panel in panels.items()
        for row, value in enumerate(panel)
    }


def _dodged(count: int) -> list[float]:
    """Places of methods within a row."""
    reach = min(0.34, 0.1 * (count - 1))
    return [float(place) for place in np.linspace(-reach, reach, count)]


def _point(axes: Axes, row: float, score: Score, method: str, low: float) -> None:
    value, colour = 100.0 * score.coverage.value, colour_of(method)
    if not math.isfinite(value):
        return
    if value < low:
        # Hollow, since the marker of a method may be a triangle, too.
        axes.plot(low, row, "<", color=colour, markersize=3.5, markerfacecolor="white",
                  clip_on=False)  # fmt: skip
        return
    ends = [100.0 * end for end in score.coverage_interval]
    axes.plot(ends, [row, row], color=colour, linewidth=0.8, solid_capstyle="butt")
    axes.plot(value, row, marker_of(method), color=colour, markersize=3.2)


def by_parameter(cells: Sequence[Cell]) -> Figure:
    """Standardised errors against normal quantiles: a panel a parameter, a line a method."""
    keys = list(dict.fromkeys(key for cell in cells for key in cell.keys))
    with journal_style():
        figure, every, spare = grid(len(keys), 1.75)
        for key, axes in zip(keys, every, strict=True):
            errors = [(cell.method, cell.errors_over_claim(key)) for cell in cells]
            _band(axes, max((z.size for _, z in errors), default=0))
            axes.plot([-REACH, REACH], [-REACH, REACH], color=INK, linewidth=0.6)
            for method, z in errors:
                axes.plot(_quantiles(z.size), z, color=colour_of(method), linewidth=0.9,
                          marker=marker_of(method) if z.size <= 60 else "",
                          markersize=2.4)  # fmt: skip
            axes.set_xlim(-QUANTILES, QUANTILES)
            axes.set_ylim(-REACH, REACH)
            axes.set_xticks([-2.0, 0.0, 2.0])
            axes.set_title(key)
        figure.supxlabel("quantile of a normal distribution", fontsize=8.0)
        figure.supylabel("error over claimed error", fontsize=8.0)
        _legend(spare, cells)
    return figure


def _quantiles(count: int) -> FloatArray:
    from scipy.special import ndtri

    return np.asarray(ndtri((np.arange(count) + 0.5) / count)) if count else np.zeros(0)


def _band(axes: Axes, count: int) -> None:
    """Where each of so many ordered normal variables lies 95 % of the time."""
    from scipy.special import betaincinv, ndtri

    if not count:
        return
    place = np.arange(1, count + 1)
    low, high = (ndtri(betaincinv(place, count + 1 - place, p)) for p in (0.025, 0.975))
    axes.fill_between(_quantiles(count), low, high, color=BOUND, linewidth=0)


def _legend(spare: Axes, cells: Sequence[Cell]) -> None:
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=colour_of(c.method), marker=marker_of(c.method), markersize=4,
               linewidth=1, label=c.method)
        for c in cells
    ]  # fmt: skip
    spare.legend(handles=handles, loc="center", frameon=False)


def paths(cells: Sequence[Cell], truth: Mapping[str, Sequence[float]]) -> Figure:
    """Median and 5 to 95 % range of trajectories: a row a parameter, a column a method.

    Parameters
    ----------
    cells
        Methods in one scenario, with trajectories.
    truth
        Times, by the name ``time``, and the true parameters at them.
    """
    from matplotlib.figure import Figure

    keys = [key for key in truth if key != "time" and np.ptp(truth[key]) > 0.0]
    time = np.array(truth["time"])
    columns = min(ABREAST, len(cells))
    blocks = [cells[i : i + columns] for i in range(0, len(cells), columns)]
    with journal_style():
        height = 0.4 + (1.25 * len(keys) + 0.2) * len(blocks)
        figure = Figure(figsize=(WIDTH, height), layout="constrained")
        panels = figure.subplots(len(blocks) * len(keys), columns, squeeze=False, sharex=True)
        for number, row in enumerate(panels):
            block, key = blocks[number // len(keys)], keys[number % len(keys)]
            for place, axes in enumerate(row):
                if place >= len(block):
                    axes.axis("off")
                    continue
                _panel(axes, time, np.array(truth[key]), block[place], key)
                if place:
                    axes.set_yticklabels([])
                if key == keys[0]:
                    method = block[place].method
                    axes.set_title(method, color=colour_of(method))
            unit = UNITS.get(key, "")
            row[0].set_ylabel(f"{key} [{unit}]" if unit else key)
        figure.supxlabel("time from the start of the measurement window [s]", fontsize=8.0)
    return figure


def _panel(axes: Axes, time: FloatArray, truth: FloatArray, cell: Cell, key: str) -> None:
    own = cell.paths(key)
    known = np.isfinite(own).any(axis=0) if own.size else np.zeros(time.size, dtype=bool)
    if known.any():
        low, middle, high = np.nanquantile(own[:, known], (0.05, 0.5, 0.95), axis=0)
        colour = colour_of(cell.method)
        axes.fill_between(time[known], low, high, color=colour, alpha=0.25, linewidth=0)
        axes.plot(time[known], middle, color=colour, linewidth=1.2)
    axes.plot(time, truth, color=INK, linewidth=0.9, linestyle=(0, (3, 2)))
    axes.set_xlim(float(time[0]), float(time[-1]))
    axes.locator_params(axis="x", nbins=5)
    low, high = float(truth.min()), float(truth.max())
    reach = 0.5 * (ROOM - 1.0) * (high - low)
    axes.set_ylim(max(0.0, low - reach), high + reach)
