"""Figures that follow a score over a family of scenarios."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from pilotid.chance import Z95
from pilotid.report.figures import BOUND, grid, limits
from pilotid.show.style import INK, colour_of, journal_style, log_ticks, marker_of
from pilotid.study.comparison import Comparison
from pilotid.study.score import Score
from pilotid.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


#: A score and its Monte Carlo standard error.
Value = Callable[[Score], tuple[float, float]]
LINEAR = 10.0  # percent up to which the axis of `cases` is linear


def sweep(
    study: Comparison,
    points: Sequence[tuple[str, float]],
    value: Value,
    labels: tuple[str, str],
    *,
    log: bool = False,
    line: Callable[[Score], float] | None = None,
    line_label: str = "",
    tick: Callable[[str, float], str] = lambda _, x: f"{x:.3g}",
) -> Figure:
    """A score over what a family of scenarios varies: a panel a parameter, a line a method.

    Parameters
    ----------
    study
        The study's numbers.
    points
        Scenarios and where they lie on the abscissa.
    value
        What is drawn, with its Monte Carlo standard error.
    labels
        Of abscissa and ordinate, with units.
    log
        Whether both axes are logarithmic.
    line, line_label
        A reference to draw beside it, and its name.
    tick
        Label of a scenario on the abscissa.
    """
    from matplotlib.lines import Line2D

    keys = [p.parameter for p in study.entry(points[0][0]).parameters]
    with journal_style():
        figure, panels, spare = grid(len(keys), 1.75)
        for index, axes in enumerate(panels):
            if log:
                axes.set_xscale("log")
                axes.set_yscale("log")
            else:
                axes.axhline(0.0, color=INK, linewidth=0.6)
            curves = [_curve(study, points, m, index, value) for m in study.methods]
            for number, (method, curve) in enumerate(zip(study.methods, curves, strict=True)):
                _draw(axes, curve, method, number - 0.5 * (len(curves) - 1), log=log)
            _frame(axes, _ticks(points, tick), curves, study.methods, log=log)
            if line is not None:
                _reference(axes, study, points, index, line)
            axes.set_title(keys[index])
        figure.supxlabel(labels[0], fontsize=8.0)
        figure.supylabel(labels[1], fontsize=8.0)
        handles = [
            Line2D([], [], color=colour_of(m), marker=marker_of(m), markersize=4, label=m)
            for m in study.methods
        ]
        if line is not None:
            handles.append(Line2D([], [], color=INK, linestyle="--", linewidth=0.8,
                                  label=line_label))  # fmt: skip
        spare.legend(handles=handles, loc="center", frameon=False,
                     ncols=2 if len(handles) > 8 else 1, columnspacing=0.8)  # fmt: skip
    return figure


def _ticks(
    points: Sequence[tuple[str, float]], tick: Callable[[str, float], str]
) -> dict[float, str]:
    """Labels at all points of a few, at some of many."""
    ordered = sorted(points, key=lambda p: p[1])
    few = ordered if len(ordered) <= 5 else [ordered[i] for i in (0, len(ordered) // 2, -1)]
    return {x: tick(name, x) for name, x in few}


def _curve(
    study: Comparison, points: Sequence[tuple[str, float]], method: str, index: int, value: Value
) -> FloatArray:
    """Abscissa, value and Monte Carlo standard error, shape (points, 3)."""
    rows = []
    for scenario, x in points:
        cell = study.at(scenario, method)
        if cell is not None and cell.usable:
            rows.append((x, *value(cell.percent[index])))
    return np.array(rows, dtype=float).reshape(-1, 3)


def _draw(axes: Axes, curve: FloatArray, method: str, place: float, *, log: bool) -> None:
    """A method's line; a little beside the others, so that its bars are seen."""
    x, y, error = curve.T
    x = x * 1.02**place if log else x + place * 0.004
    reach = Z95 * np.nan_to_num(error)
    bars = np.array([np.minimum(reach, 0.9 * np.abs(y)) if log else reach, reach])
    axes.errorbar(x, y, bars, color=colour_of(method), marker=marker_of(method), markersize=3.2,
                  linewidth=0.9, elinewidth=0.7)  # fmt: skip


def _frame(
    axes: Axes,
    ticks: dict[float, str],
    curves: Sequence[FloatArray],
    methods: Sequence[str],
    *,
    log: bool,
) -> None:
    """Axes that show most methods; a triangle stands for a point outside."""
    axes.set_xticks(list(ticks), list(ticks.values()))
    axes.minorticks_off()
    if log:
        log_ticks(axes, "y")
        return
    ranges = []
    for curve in curves:
        reach = Z95 * np.nan_to_num(curve[:, 2])
        if len(curve):
            ends = np.min(curve[:, 1] - reach), np.max(curve[:, 1] + reach)
            ranges.append((float(ends[0]), float(ends[1])))
    axes.set_ylim(*limits(ranges, math.nan, 3.0))
    low, high = axes.get_ylim()
    for curve, method in zip(curves, methods, strict=True):
        for x, y, _ in curve:
            if not low <= y <= high:
                axes.plot(x, min(max(y, low), high), "^" if y > high else "v", markersize=4,
                          color=colour_of(method), clip_on=False)  # fmt: skip


def _reference(
    axes: Axes,
    study: Comparison,
    points: Sequence[tuple[str, float]],
    index: int,
    line: Callable[[Score], float],
) -> None:
    """The reference curve, from any method that has the scenario."""
    found = [(x, line(study.of(name)[0].percent[index])) for name, x in points]
    at, values = zip(*sorted(found), strict=True)
    axes.plot(at, values, color=INK, linestyle="--", linewidth=0.8, zorder=0)


def cases(
    study: Comparison,
    scenarios: Sequence[tuple[str, str]],
    paper: Mapping[str, Sequence[float]],
    label: str,
) -> Figure:
    """Bias of each parameter in a few scenarios side by side, on a symmetric logarithmic axis.

    Parameters
    ----------
    study
        The study's numbers.
    scenarios
        Scenarios and their short names.
    paper
        Biases [%] that a paper gives, by scenario.
    label
        How that paper is named in the figure.
    """
    from matplotlib.lines import Line2D
    from matplotlib.ticker import FuncFormatter

    keys = [p.parameter for p in study.entry(scenarios[0][0]).parameters]
    offsets = np.linspace(-0.36, 0.36, len(study.methods) + 1)
    with journal_style():
        figure, panels, spare = grid(len(keys), 1.6, columns=2)
        for index, axes in enumerate(panels):
            axes.axhspan(-LINEAR, LINEAR, color=BOUND, alpha=0.35, linewidth=0)
            axes.axhline(0.0, color=INK, linewidth=0.6)
            for place, (name, _) in enumerate(scenarios):
                if place:
                    axes.axvline(place - 0.5, color="#dddddd", linewidth=0.5)
                if name in paper:
                    axes.plot(place + offsets[0], paper[name][index], "x", color="black",
                              markersize=4.5)  # fmt: skip
                for offset, method in zip(offsets[1:], study.methods, strict=True):
                    cell = study.at(name, method)
                    if cell is None or not cell.usable:
                        continue
                    score = cell.percent[index]
                    axes.errorbar(place + offset, score.bias,
                                  Z95 * np.nan_to_num(score.bias_se), color=colour_of(method),
                                  marker=marker_of(method), markersize=3.4, linewidth=0.0,
                                  elinewidth=0.8)  # fmt: skip
            axes.set_yscale("symlog", linthresh=LINEAR, linscale=1.0)
            low, high = axes.get_ylim()
            axes.set_ylim(min(low, -12.0), max(high, 12.0))
            ticks = [
                t
                for t in (-1000, -300, -100, -30, -10, 0, 10, 30, 100, 300, 1000)
                if low <= t <= high or abs(t) <= 10
            ]
            axes.set_yticks(ticks)
            axes.yaxis.set_major_formatter(
                FuncFormatter(lambda v, _: f"{v:g}".replace("-", "\N{MINUS SIGN}"))
            )
            axes.set_xlim(-0.5, len(scenarios) - 0.5)
            axes.set_xticks(range(len(scenarios)), [short for _, short in scenarios])
            axes.tick_params(axis="x", length=0)
            axes.set_title(keys[index])
        figure.supylabel("bias [% of true value]", fontsize=8.0)
        handles = [
            Line2D([], [], color=colour_of(m), marker=marker_of(m), markersize=4, linewidth=0,
                   label=m)
            for m in study.methods
        ]  # fmt: skip
        handles.insert(0, Line2D([], [], color="black", marker="x", linewidth=0, label=label))
        spare.legend(handles=handles, loc="center", frameon=False, ncols=2)
    return figure
