"""Figures on populations: coverage by stratum, and standardised errors by parameter."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from pilotid.report.figures import BOUND, grid
from pilotid.show.style import GRID, INK, colour_of, journal_style, marker_of
from pilotid.study.population import ALL, PopulationCell
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

#: Replications by the values of a fact, None for all.
Panel = Mapping[str, frozenset[int] | None]


def by_stratum(cells: Sequence[PopulationCell]) -> Figure:
    """Coverage with its interval: a panel a fact, a row a value of it, a point a method."""
    panels: dict[str, Panel] = {"all recordings": {"": None}}
    panels |= {name: stratum for name, stratum in cells[0].strata.items() if len(stratum) > 1}
    longest = max(len(panel) for panel in panels.values())
    with journal_style():
        height = 0.6 + longest * max(0.19, 0.06 + 0.035 * len(cells))
        figure, every, spare = grid(len(panels), height, COLUMNS)
        points = [_points(cell, panels) for cell in cells]
        ends = [end for own in points for _, _, _, (end, _) in own if math.isfinite(end)]
        low = max(LOWEST, min([*ends, 90.0]) - 1.0)
        for (name, panel), axes in zip(panels.items(), every, strict=True):
            axes.axvspan(*BAND, color=BOUND, linewidth=0)
            axes.axvline(95.0, color=INK, linewidth=0.6)
            for row in range(len(panel) - 1):
                axes.axhline(row + 0.5, color=GRID, linewidth=0.5)
            for place, (cell, own) in zip(_dodged(len(cells)), zip(cells, points, strict=True),
                                          strict=True):  # fmt: skip
                for stratum, row, value, interval in own:
                    if stratum == name:
                        _point(axes, row + place, value, interval, cell.method, low)
            axes.set_title(name)
            axes.set_yticks(range(len(panel)), list(panel))
            axes.set_ylim(len(panel) - 0.45, -0.55)
            axes.set_xlim(low, 100.6)
            axes.tick_params(axis="y", length=0)
        figure.supxlabel("95 % intervals that hold the truth [%]", fontsize=8.0)
        _legend(spare, cells)
    return figure


def _points(
    cell: PopulationCell, panels: Mapping[str, Panel]
) -> list[tuple[str, int, float, tuple[float, float]]]:
    """Panel, row, coverage [%] and its interval [%]."""
    found = []
    for name, panel in panels.items():
        for row, members in enumerate(panel.values()):
            own = cell.standing(ALL, members)
            low, high = own.coverage_interval
            found.append((name, row, 100.0 * own.coverage.value, (100.0 * low, 100.0 * high)))
    return found


def _dodged(count: int) -> list[float]:
    """Places of methods within a row."""
    reach = min(0.34, 0.1 * (count - 1))
    return [float(place) for place in np.linspace(-reach, reach, count)]


def _point(
    axes: Axes, row: float, value: float, interval: tuple[float, float], method: str, low: float
) -> None:
    if not math.isfinite(value):
        return
    colour = colour_of(method)
    if value < low:
        # Hollow, since the marker of a method may be a triangle, too.
        axes.plot(low, row, "<", color=colour, markersize=3.5, markerfacecolor="white",
                  clip_on=False)  # fmt: skip
        return
    axes.plot(interval, [row, row], color=colour, linewidth=0.8, solid_capstyle="butt")
    axes.plot(value, row, marker_of(method), color=colour, markersize=3.2)


def by_parameter(cells: Sequence[PopulationCell]) -> Figure:
    """Standardised errors against normal quantiles: a panel a parameter, a line a method."""
    keys = list(dict.fromkeys(key for cell in cells for key in cell.keys))
    with journal_style():
        figure, every, spare = grid(len(keys), 1.75)
        for key, axes in zip(keys, every, strict=True):
            errors = [(cell.method, _errors(cell, key)) for cell in cells]
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


def _errors(cell: PopulationCell, key: str) -> FloatArray:
    """Standardised errors of a parameter in ascending order."""
    v = cell.values
    mine = (v.keys == key) & np.isfinite(v.claimed)
    return np.sort(v.error[mine] / v.claimed[mine])


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


def _legend(spare: Axes, cells: Sequence[PopulationCell]) -> None:
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=colour_of(c.method), marker=marker_of(c.method), markersize=4,
               linewidth=1, label=c.method)
        for c in cells
    ]  # fmt: skip
    spare.legend(handles=handles, loc="center", frameon=False)
