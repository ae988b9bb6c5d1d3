"""Figures of a study: one panel for each parameter, one colour and marker for each method."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from pilotid.chance import Z95
from pilotid.show.style import INK, WIDTH, colour_of, journal_style, log_ticks, marker_of
from pilotid.study.comparison import Cell

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


def _outside(axes: Axes, row: float, value: float, colour: str, words: str = "") -> bool:
    """A triangle at the edge for a point that lies outside the axis, with its value."""
    low, high = axes.get_xlim()
    if low <= value <= high or not math.isfinite(value):
        return False
    right = value > high
    place, inside = (high, -5) if right else (low, 5)
    axes.plot(place, row, ">" if right else "<", color=colour, markersize=4.5, clip_on=False)
    axes.annotate(words or f"{value:.3g}".replace("-", "\N{MINUS SIGN}"), (place, row),
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

    scores = cells[0].percent
    labels = [c.method for c in cells] + ([label] if paper else [])
    with journal_style():
        figure, panels, spare = grid(len(scores), _height(len(labels)))
        for index, axes in enumerate(panels):
            bound = scores[index].bound
            if math.isfinite(bound):
                axes.axvspan(-bound, bound, color=BOUND, linewidth=0)
            axes.axvline(0.0, color=INK, linewidth=0.6)
            own = [c.percent[index] for c in cells]
            ranges = [_reach(s.bias, s.std, s.claimed) for s in own]
            axes.set_xlim(
                *limits([*ranges, *(_reach(*p) for p in paper[index : index + 1])], bound)
            )
            seen = [
                (row, cell.method, score)
                for row, (cell, score) in enumerate(zip(cells, own, strict=True))
                if not _outside(axes, row, score.bias, colour_of(cell.method))
            ]
            rows, colours = [row for row, _, _ in seen], [colour_of(name) for _, name, _ in seen]
            claimed = [_around(score.bias, score.claimed) for _, _, score in seen]
            bars(axes, rows, claimed, colours, width=5.0, alpha=0.45)
            bars(axes, rows, [_around(score.bias, score.std) for _, _, score in seen], colours)
            means = [_around(score.bias, Z95 * score.bias_se) for _, _, score in seen]
            bars(axes, rows, means, INK, cap=4.4)
            for row, name, score in seen:
                axes.plot(score.bias, row, marker_of(name), color=colour_of(name), markersize=4.0,
                          markeredgecolor="white", markeredgewidth=0.4)  # fmt: skip
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


def scatter(cells: Sequence[Cell]) -> Figure:
    """Standard deviation, claimed standard error and posterior spread beside the bound."""
    from matplotlib.lines import Line2D

    scores = cells[0].percent
    with journal_style():
        figure, panels, spare = grid(len(scores), _height(len(cells)))
        for index, axes in enumerate(panels):
            axes.axvline(scores[index].bound, color=INK, linewidth=0.8, linestyle="--")
            axes.set_xscale("log")
            own = [cell.percent[index] for cell in cells]
            reach = [Z95 * float(np.nan_to_num(score.std_se)) for score in own]
            ends = [
                (score.std - min(r, 0.8 * score.std), score.std + r)
                for score, r in zip(own, reach, strict=True)
            ]
            colours = [colour_of(cell.method) for cell in cells]
            bars(axes, range(len(cells)), ends, colours, cap=4.0)
            for row, (cell, score) in enumerate(zip(cells, own, strict=True)):
                axes.plot(score.std, row, marker_of(cell.method), color=colours[row],
                          markersize=4.0)  # fmt: skip
                posterior = math.isfinite(score.posterior)
                axes.plot(score.claimed, row, "D" if posterior else "|", color=INK, markersize=6.0,
                          markerfacecolor="none", markeredgewidth=1.2)  # fmt: skip
            axes.set_title(scores[index].parameter)
            log_ticks(axes, "x")
            name_rows(axes, [c.method for c in cells], cells, named=index % COLUMNS == 0)
        figure.supxlabel("spread [% of true value]", fontsize=8.0)
        handles = [
            Line2D([], [], color="#888888", marker="o", markersize=4, linewidth=1,
                   label="standard deviation,\n95 % interval"),
            Line2D([], [], color=INK, marker="|", markersize=6, linewidth=0, markeredgewidth=1.2,
                   label="claimed standard\nerror (mean)"),
        ]  # fmt: skip
        if any(math.isfinite(s.posterior) for c in cells for s in c.percent):
            handles.append(Line2D([], [], color=INK, marker="D", markersize=6, linewidth=0,
                                  markerfacecolor="none", label="posterior spread"))  # fmt: skip
        handles.append(
            Line2D([], [], color=INK, linestyle="--", linewidth=0.8, label="Cramér-Rao bound")
        )
        spare.legend(handles=handles, loc="center", frameon=False)
    return figure


def starts(cells: Sequence[Cell], paper: Sequence[float] = ()) -> Figure:
    """Where fits of one recording end, a dot for each start."""
    from matplotlib.lines import Line2D

    scores = cells[0].percent
    labels = [f"{c.method} {c.agreeing}/{c.tried}" for c in cells]
    with journal_style():
        figure, panels, spare = grid(len(scores), _height(len(labels)))
        found = [c.errors for c in cells]
        for index, axes in enumerate(panels):
            bound = scores[index].bound
            if math.isfinite(bound):
                axes.axvspan(-bound, bound, color=BOUND, linewidth=0)
            axes.axvline(0.0, color=INK, linewidth=0.6)
            middles = [np.quantile(f[:, index], (0.1, 0.9)) for f in found if len(f)]
            ranges = [(float(low), float(high)) for low, high in middles]
            axes.set_xlim(
                *limits([*ranges, *((p, p) for p in paper[index : index + 1])], bound, 20)
            )
            if paper:
                axes.axvline(paper[index], color="black", linewidth=0.9, linestyle=":")
            for row, (cell, own) in enumerate(zip(cells, found, strict=True)):
                low, high = axes.get_xlim()
                inside = own[(own[:, index] >= low) & (own[:, index] <= high), index]
                # Of hundreds of starts that end in one place, one dot is enough.
                shown = np.unique(np.round(150.0 * inside / (high - low))) * (high - low) / 150.0
                axes.plot(shown, np.full(shown.size, row), marker_of(cell.method), markersize=4.5,
                          color=colour_of(cell.method), alpha=0.5, markeredgewidth=0.0)  # fmt: skip
                for far in (own[own[:, index] < low, index], own[own[:, index] > high, index]):
                    if far.size:
                        _outside(axes, row, far[0], colour_of(cell.method), f"{far.size}")
            axes.set_title(scores[index].parameter)
            axes.locator_params(axis="x", nbins=5)
            name_rows(axes, labels, cells, named=index % COLUMNS == 0)
        figure.supxlabel("error [% of true value]", fontsize=8.0)
        handles: list[object] = [
            Line2D([], [], color="#888888", marker="o", markersize=4.5, alpha=0.5, linewidth=0,
                   label="end of one start"),
            Line2D([], [], color=BOUND, linewidth=6, label="± Cramér-Rao bound"),
        ]  # fmt: skip
        if paper:
            handles.append(
                Line2D([], [], color="black", linestyle=":", linewidth=0.9, label="paper")
            )
        spare.legend(handles=handles, loc="center", frameon=False)
    return figure
