"""Figures of a study: one colour and marker for each method."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from pilotid.chance import Z95
from pilotid.show.style import (
    GRID,
    INK,
    WIDTH,
    colour_of,
    journal_figure,
    journal_style,
    log_ticks,
    marker_of,
)
from pilotid.study.comparison import Cell, Comparison, Score
from pilotid.study.scores import Mean
from pilotid.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


COLUMNS = 4
BOUND = "#c9ced6"


def grid(count: int, height: float, columns: int = COLUMNS) -> tuple[Figure, list[Axes], Axes]:
    """Axes for each parameter, and those in the spare place for the legend."""
    from matplotlib.figure import Figure

    rows = -(-(count + 1) // columns)
    figure = Figure(figsize=(WIDTH, height * rows), layout="constrained")
    every = list(figure.subplots(rows, columns, squeeze=False).flat)
    for axes in every[count:]:
        axes.axis("off")
    return figure, every[:count], every[count]


def _height(rows: int) -> float:
    """Inches that a dot plot's panel needs; the legend needs some, too."""
    return max(1.35, 0.62 + 0.155 * rows)


def limits(
    ranges: Sequence[tuple[float, float]], floor: float, most: float = 4.0
) -> tuple[float, float]:
    """Ends of an axis that shows zero and most methods, where some are far off.

    Parameters
    ----------
    ranges
        What each method would like to see.
    floor
        Distance from zero that is always seen, for example the bound; NaN for none.
    most
        Multiple of the typical method's reach at which the axis ends at the latest.
    """
    ends = np.array([r for r in ranges if np.isfinite(r).all()]).reshape(-1, 2)
    floor = 1.2 * floor if math.isfinite(floor) else 0.0
    reaches = np.sort(np.max(np.abs(ends), axis=1))
    reach = max(most * float(reaches[len(ends) // 2]), floor) if len(ends) else floor
    low = max(min([*ends[:, 0], -floor]), -reach)
    high = min(max([*ends[:, 1], floor]), reach)
    room = 0.06 * (high - low) or 1.0
    return float(low - room), float(high + room)


def name_rows(axes: Axes, labels: Sequence[str], cells: Sequence[Cell], *, named: bool) -> None:
    """Rows of a dot plot from the top down, with labels in the first column."""
    for row, cell in enumerate(cells):
        if not cell.usable:
            axes.text(0.5, row, "no result", transform=axes.get_yaxis_transform(), ha="center",
                      va="center", fontsize=7.0, color="#777777", style="italic")  # fmt: skip
    axes.set_ylim(len(labels) - 0.4, -0.6)
    axes.set_yticks(range(len(labels)), labels if named else [""] * len(labels))
    axes.tick_params(axis="y", length=0)


def _outside(axes: Axes, row: float, value: float, colour: str) -> bool:
    """A triangle at the edge for a point that lies outside the axis, with its value."""
    low, high = axes.get_xlim()
    if low <= value <= high or not math.isfinite(value):
        return False
    right = value > high
    place, inside = (high, -5) if right else (low, 5)
    axes.plot(place, row, ">" if right else "<", color=colour, markersize=4.5, clip_on=False)
    axes.annotate(f"{value:.3g}".replace("-", "\N{MINUS SIGN}"), (place, row),
                  (inside, 0), textcoords="offset points", ha="right" if right else "left",
                  va="center", fontsize=7.0)  # fmt: skip
    return True


def bars(
    axes: Axes,
    rows: Sequence[float],
    ends: Sequence[tuple[float, float]],
    colours: Sequence[str] | str,
    *,
    width: float = 1.0,
    cap: float = 0.0,
    alpha: float = 1.0,
) -> None:
    """Horizontal bars of a dot plot, all at once: an artist for each takes most of a report's time.

    Parameters
    ----------
    axes
        Where they are drawn; its limits are set already.
    rows
        Their places.
    ends
        Left and right end of each; what is not finite is left out.
    colours
        One for each, or one for all.
    width
        Width of the lines, in points.
    cap
        Height of the caps at the ends, in points.
    alpha
        Opacity.
    """
    left, right = np.array(ends, dtype=float).reshape(-1, 2).T
    axes.hlines(rows, left, right, colors=colours, linewidth=width, alpha=alpha)
    if cap:
        caps = np.concatenate([left, right])
        each = [colours] * len(rows) if isinstance(colours, str) else list(colours)
        axes.scatter(caps, [*rows, *rows], s=cap**2, c=each * 2, marker="|", linewidths=width)


def _around(value: float, spread: float) -> tuple[float, float]:
    return value - spread, value + spread


def _reach(value: float, *spreads: float) -> tuple[float, float]:
    """Ends of a value with the larger of its spreads."""
    spread = max([s for s in spreads if math.isfinite(s)], default=0.0)
    return _around(value, spread)


def errors(
    cells: Sequence[Cell], paper: Sequence[tuple[float, float]] = (), label: str = ""
) -> Figure:
    """Mean error, scatter and claimed standard error beside the bound, by parameter and method.

    Parameters
    ----------
    cells
        Methods in one scenario.
    paper
        Bias and standard deviation that a paper gives for each parameter [%].
    label
        How that paper is named in the figure.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    every = [cell.percent for cell in cells]
    scores = every[0]
    labels = [c.method for c in cells] + ([label] if paper else [])
    with journal_style():
        figure, panels, spare = grid(len(scores), _height(len(labels)))
        for index, axes in enumerate(panels):
            bound = scores[index].bound
            if math.isfinite(bound):
                axes.axvspan(-bound, bound, color=BOUND, linewidth=0)
            axes.axvline(0.0, color=INK, linewidth=0.6)
            own = [each[index] for each in every]
            ranges = [_reach(s.bias.value, s.std.value, s.claimed) for s in own]
            axes.set_xlim(
                *limits([*ranges, *(_reach(*p) for p in paper[index : index + 1])], bound)
            )
            seen = [
                (row, cell.method, score)
                for row, (cell, score) in enumerate(zip(cells, own, strict=True))
                if not _outside(axes, row, score.bias.value, colour_of(cell.method))
            ]
            rows, colours = [row for row, _, _ in seen], [colour_of(name) for _, name, _ in seen]
            claimed = [_around(score.bias.value, score.claimed) for _, _, score in seen]
            bars(axes, rows, claimed, colours, width=5.0, alpha=0.45)
            bars(
                axes,
                rows,
                [_around(score.bias.value, score.std.value) for _, _, score in seen],
                colours,
            )
            means = [_around(score.bias.value, Z95 * score.bias.error) for _, _, score in seen]
            bars(axes, rows, means, INK, cap=4.4)
            for row, name, score in seen:
                axes.plot(score.bias.value, row, marker_of(name), color=colour_of(name),
                          markersize=4.0, markeredgecolor="white", markeredgewidth=0.4)  # fmt: skip
            if paper:
                bars(axes, [len(cells)], [_around(*paper[index])], "black")
                axes.plot(paper[index][0], len(cells), "x", color="black", markersize=4.5)
                _outside(axes, len(cells), paper[index][0], "black")
            axes.set_title(scores[index].parameter)
            axes.locator_params(axis="x", nbins=5)
            name_rows(axes, labels, cells, named=index % COLUMNS == 0)
        figure.supxlabel("error [% of true value]", fontsize=8.0)
        handles = [
            Line2D([], [], color=INK, marker="o", markersize=4, markerfacecolor="#888888",
                   markeredgecolor="white", linewidth=0, label="mean error"),
            Line2D([], [], color=INK, marker="|", markersize=5, linewidth=1,
                   label="its 95 % interval\n(Monte Carlo)"),
            Line2D([], [], color="#888888", linewidth=1, label="± standard deviation"),
            Line2D([], [], color="#888888", alpha=0.45, linewidth=5,
                   label="± claimed standard\nerror (mean)"),
            Patch(color=BOUND, linewidth=0, label="± Cramér-Rao bound"),
        ]  # fmt: skip
        spare.legend(handles=handles, loc="center", frameon=False)
    return figure


def sweep(
    study: Comparison,
    points: Sequence[tuple[str, float]],
    value: Callable[[Score], Mean],
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
        _legend(spare, study.methods, line_label if line is not None else "")
    return figure


def _ticks(
    points: Sequence[tuple[str, float]], tick: Callable[[str, float], str]
) -> dict[float, str]:
    """Labels at all points of a few, at some of many."""
    ordered = sorted(points, key=lambda p: p[1])
    few = ordered if len(ordered) <= 5 else [ordered[i] for i in (0, len(ordered) // 2, -1)]
    return {x: tick(name, x) for name, x in few}


def _curve(
    study: Comparison,
    points: Sequence[tuple[str, float]],
    method: str,
    index: int,
    value: Callable[[Score], Mean],
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


def cost(cells: Sequence[Cell]) -> Figure:
    """Loss with its interval over the median time of a fit; a line joins what nothing beats."""
    known = [c for c in cells if math.isfinite(c.overall.loss.value) and c.seconds > 0.0]
    known.sort(key=lambda cell: cell.seconds)
    frontier: list[Cell] = []
    for cell in known:
        if not frontier or cell.overall.loss.value < frontier[-1].overall.loss.value:
            frontier.append(cell)
    with journal_figure(2.7) as figure:
        axes = figure.subplots()
        axes.axhline(1.0, color=INK, linewidth=0.8)
        axes.step([c.seconds for c in frontier], [c.overall.loss.value for c in frontier],
                  where="post", color="#8a94a3", linewidth=0.9, zorder=0)  # fmt: skip
        for cell in known:
            loss = cell.overall.loss
            reach = np.nan_to_num([[loss.value - loss.lower], [loss.upper - loss.value]])
            axes.errorbar(cell.seconds, loss.value, reach, color=colour_of(cell.method),
                          marker=marker_of(cell.method), markersize=5.0, linewidth=0.0,
                          elinewidth=0.9, label=cell.method)  # fmt: skip
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.margins(0.08)
        log_ticks(axes, "x")
        log_ticks(axes, "y")
        axes.set_xlabel("median time of a fit [s]")
        axes.set_ylabel("loss (1: Cramér-Rao bound)")
        figure.legend(loc="outside right upper")
    return figure


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
    panels: dict[str, list[str]] = {"all recordings": [""]}
    for cell in cells:  # studies side by side may have drawn other pilots
        for name, stratum in cell.strata.items():
            if len(stratum) > 1:
                panels[name] = list(dict.fromkeys([*panels.get(name, []), *stratum]))
    longest = max(len(panel) for panel in panels.values())
    with journal_style():
        height = 0.6 + longest * max(0.19, 0.06 + 0.035 * len(cells))
        figure, every, spare = grid(len(panels), height, 3)
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
                    if (name, row) in own:
                        _point(axes, row + place, own[name, row], cell.method, low)
            axes.set_title(name)
            axes.set_yticks(range(len(panel)), list(panel))
            axes.set_ylim(len(panel) - 0.45, -0.55)
            axes.set_xlim(low, 100.6)
            axes.tick_params(axis="y", length=0)
        figure.supxlabel("95 % intervals that hold the truth [%]", fontsize=8.0)
        _legend(spare, [cell.method for cell in cells])
    return figure


def _points(cell: Cell, panels: Mapping[str, Sequence[str]]) -> dict[tuple[str, int], Score]:
    """Scores of all parameters by panel and row."""
    return {
        (name, row): cell.parts[name, value][0] if value else cell.overall
        for name, panel in panels.items()
        for row, value in enumerate(panel)
        if not value or (name, value) in cell.parts
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
        _legend(spare, [cell.method for cell in cells])
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


def _legend(spare: Axes, methods: Sequence[str], reference: str = "") -> None:
    """Names of methods, and of a dashed line of reference."""
    for name in methods:
        spare.plot([], [], color=colour_of(name), marker=marker_of(name), markersize=4, label=name)
    if reference:
        spare.plot([], [], color=INK, linestyle="--", linewidth=0.8, label=reference)
    columns = 2 if len(methods) > 8 else 1
    spare.legend(loc="center", frameon=False, ncols=columns, columnspacing=0.8)


def paths(cells: Sequence[Cell], truth: Mapping[str, Sequence[float]]) -> Figure:
    """Median and 5 to 95 % range of trajectories: a row a parameter, a column a method.

    Parameters
    ----------
    cells
        Methods in one scenario, with trajectories.
    truth
        Times, by the name ``time``, and the true parameters at them.
    """
    keys = [key for key in truth if key != "time" and np.ptp(truth[key]) > 0.0]
    time = np.array(truth["time"])
    columns = min(ABREAST, len(cells))
    blocks = [cells[i : i + columns] for i in range(0, len(cells), columns)]
    height = 0.4 + (1.25 * len(keys) + 0.2) * len(blocks)
    with journal_figure(height) as figure:
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
