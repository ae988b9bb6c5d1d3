"""Figures of a posterior: corner plot and predictive band."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pilotid.estimate.draws import TAILS, Draws
from pilotid.plots.style import (
    INK,
    WIDTH,
    colour_of,
    journal_figure,
    journal_style,
    legend,
    with_unit,
)
from pilotid.posterior.sampling import PredictiveBand
from pilotid.support.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOUR = colour_of("bayes")
GREY = "#999999"
SHOWN = 20_000  # draws in a corner plot
INSIDE = (0.95, 0.5)  # shares of the draws that contours enclose


def corner(draws: Draws, units: dict[str, str]) -> Figure:
    """Marginal densities on the diagonal, and of every pair of parameters below it.

    Contours enclose 50 and 95 % of the draws; dashed lines mark the mean and the
    equal-tailed 95 % interval.
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    count = len(draws.keys)
    values = draws.thinned(min(SHOWN, len(draws.values)))
    low, high = np.quantile(values, (0.002, 0.998), axis=0)
    limits = np.stack([low - 0.08 * (high - low), high + 0.08 * (high - low)], axis=1)
    with journal_style():
        figure = Figure(figsize=(WIDTH, WIDTH))
        # Not matplotlib's own layout, which takes seconds for so many panels.
        grid = figure.add_gridspec(
            count, count, left=0.1, bottom=0.11, right=0.985, top=0.995, wspace=0.07, hspace=0.07
        )
        for i in range(count):
            for j in range(i + 1):
                axes = figure.add_subplot(grid[i, j])
                if i == j:
                    _marginal(axes, draws, i, limits[i])
                else:
                    _pair(axes, values[:, j], values[:, i], limits[j], limits[i])
                    axes.yaxis.set_major_locator(MaxNLocator(2, prune="both"))
                axes.set_xlim(*limits[j].tolist())
                axes.xaxis.set_major_locator(MaxNLocator(2, prune="both"))
                axes.tick_params(labelbottom=i == count - 1, labelleft=i > j == 0)
                axes.tick_params(axis="x", rotation=45)
                if i == count - 1:
                    axes.set_xlabel(f"{draws.keys[j]}\n[{units.get(draws.keys[j]) or '-'}]")
                    axes.xaxis.set_label_coords(0.5, -0.5 * count / 7)
                if j == 0 < i:
                    axes.set_ylabel(f"{draws.keys[i]}\n[{units.get(draws.keys[i]) or '-'}]")
                    axes.yaxis.set_label_coords(-0.48 * count / 7, 0.5)
    return figure


def _marginal(axes: Axes, draws: Draws, index: int, limits: FloatArray) -> None:
    own = draws.values[:, index]
    axes.hist(own, bins=40, range=tuple(limits), color=COLOUR, histtype="step")
    for place in (own.mean(), *np.quantile(own, TAILS)):
        axes.axvline(place, color=GREY, linestyle="--", linewidth=0.7)
    axes.set_yticks([])


def _pair(
    axes: Axes, x: FloatArray, y: FloatArray, x_range: FloatArray, y_range: FloatArray
) -> None:
    bins = 26
    counts, x_edges, y_edges = np.histogram2d(x, y, bins=bins, range=[x_range, y_range])
    # A little smoothing: contours of raw counts are ragged.
    kernel = np.array([1.0, 2.0, 1.0]) / 4.0
    for axis in (0, 1):
        counts = np.apply_along_axis(np.convolve, axis, counts, kernel, "same")
    ordered = np.sort(counts.ravel())[::-1]
    shares = np.cumsum(ordered) / ordered.sum()
    levels = sorted({float(ordered[np.searchsorted(shares, share)]) for share in INSIDE})
    x_middle, y_middle = (0.5 * (e[1:] + e[:-1]) for e in (x_edges, y_edges))
    top = float(counts.max())
    if levels[-1] < top:
        axes.contourf(x_middle, y_middle, counts.T, [*levels, top], colors=COLOUR, alpha=0.25)
    axes.contour(x_middle, y_middle, counts.T, levels, colors=COLOUR, linewidths=0.8)
    axes.set_ylim(*y_range.tolist())


def band(predictive: PredictiveBand, unit: str = "", seconds: float = 30.0) -> Figure:
    """Recorded control of the first run inside its posterior predictive band."""
    shown = predictive.time <= seconds
    time = predictive.time[shown]
    with journal_figure(2.8) as figure:
        axes = figure.subplots()
        for limits, colour, alpha, label in (
            (predictive.with_remnant, GREY, 0.3, "95 % band with remnant"),
            (predictive.model, COLOUR, 0.6, "95 % band of the model's answer"),
        ):
            low, high = limits[:, 0, shown]
            axes.fill_between(
                time, low, high, color=colour, alpha=alpha, linewidth=0.0, label=label
            )
        axes.plot(time, predictive.control[0, shown], color=INK, linewidth=0.9, label="recorded")
        axes.set_xlabel("time from the first scored sample [s]")
        axes.set(ylabel=with_unit("control u", unit), xlim=(0.0, time[-1]))
        legend(axes, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, borderaxespad=0.1)
    return figure
