"""Figures of a posterior: corner, trace, autocorrelation and predictive band."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pilotid.estimates.draws import Draws, equal_tailed_interval
from pilotid.posterior.predictive import PredictiveBand
from pilotid.show.style import colour_of
from pilotid.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOUR, OTHER = colour_of("bayes"), colour_of("mle")
GREY = "#999999"
SHOWN = 20_000  # draws in a corner plot
STEPS = 600  # points of a trace
INSIDE = (0.95, 0.5)  # shares of the draws that contours enclose


def corner(draws: Draws, units: dict[str, str], size: float = 1.35) -> Figure:
    """Marginal densities on the diagonal, and of every pair of parameters below it.

    Contours enclose 50 and 95 % of the draws; dashed lines mark the mean and the
    equal-tailed 95 % interval.
    """
    from matplotlib.figure import Figure

    count = len(draws.keys)
    values = draws.equally_weighted(min(SHOWN, len(draws.values)))
    width, margin = size * count + 1.0, 0.6
    figure = Figure(figsize=(width, width))
    # Not matplotlib's own layout, which takes seconds for so many panels.
    near, far = margin / width, 1.0 - 0.1 / width
    grid = figure.add_gridspec(
        count, count, left=near, bottom=near, right=far, top=far, wspace=0.07, hspace=0.07
    )
    low, high = np.quantile(values, (0.002, 0.998), axis=0)
    limits = np.stack([low - 0.08 * (high - low), high + 0.08 * (high - low)], axis=1)
    for i in range(count):
        for j in range(i + 1):
            axes = figure.add_subplot(grid[i, j])
            if i == j:
                _marginal(axes, draws, i, limits[i])
            else:
                _pair(axes, values[:, j], values[:, i], limits[j], limits[i])
            axes.set_xlim(*limits[j].tolist())
            axes.locator_params(nbins=3)
            axes.tick_params(labelsize=6, labelbottom=i == count - 1, labelleft=i > j == 0)
            if i == count - 1:
                axes.set_xlabel(_label(draws.keys[j], units), fontsize=8)
                axes.xaxis.set_label_coords(0.5, -0.22)
            if j == 0 < i:
                axes.set_ylabel(_label(draws.keys[i], units), fontsize=8)
                axes.yaxis.set_label_coords(-0.35, 0.5)
    return figure


def _label(key: str, units: dict[str, str]) -> str:
    return f"{key} [{units[key]}]" if units.get(key) else key


def _marginal(axes: Axes, draws: Draws, index: int, limits: FloatArray) -> None:
    own = draws.values[:, index]
    axes.hist(
        own, bins=40, range=tuple(limits), weights=draws.weights, color=COLOUR, histtype="step"
    )
    low, high = equal_tailed_interval(own, draws.weights)
    for place in (low, float(draws.weights @ own), high):
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
    levels = [float(ordered[np.searchsorted(shares, share)]) for share in INSIDE]
    levels = sorted(set(levels))
    x_middle, y_middle = (0.5 * (e[1:] + e[:-1]) for e in (x_edges, y_edges))
    top = float(counts.max())
    if levels[-1] < top:
        axes.contourf(x_middle, y_middle, counts.T, [*levels, top], colors=COLOUR, alpha=0.25)
    axes.contour(x_middle, y_middle, counts.T, levels, colors=COLOUR, linewidths=0.8)
    axes.set_ylim(*y_range.tolist())


def trace(draws: Draws) -> Figure:
    """Mean of the walkers of every ensemble, step by step, and the range of nine tenths."""
    from matplotlib.figure import Figure

    chains = _chains(draws)
    stride = max(1, chains.shape[1] // STEPS)
    chains = chains[:, ::stride]
    steps = np.arange(chains.shape[1]) * stride
    figure = Figure(figsize=(9.0, 1.1 * len(draws.keys) + 0.6), layout="constrained")
    panels = figure.subplots(len(draws.keys), 1, sharex=True, squeeze=False)[:, 0]
    colours = (COLOUR, OTHER, colour_of("arx"), colour_of("fourier"))
    for i, (axes, key) in enumerate(zip(panels, draws.keys, strict=True)):
        low, high = np.quantile(chains[..., i], (0.05, 0.95), axis=(0, 2))
        axes.fill_between(steps, low, high, color=GREY, alpha=0.25, linewidth=0.0)
        for number, own in enumerate(chains[..., i]):
            colour = colours[number % len(colours)]
            axes.plot(steps, own.mean(axis=1), color=colour, linewidth=0.7)
        axes.set_ylabel(key, fontsize=8)
        axes.tick_params(labelsize=7)
    panels[-1].set_xlabel(
        "step: mean of each ensemble's walkers, over the middle nine tenths of all", fontsize=8
    )
    panels[-1].set_xlim(0, max(1, steps[-1]))
    return figure


def autocorrelation(draws: Draws, lags: int = 60) -> Figure:
    """Autocorrelation of every parameter along the chains, walkers averaged."""
    from matplotlib.figure import Figure

    chains = _chains(draws)
    lags = min(lags, chains.shape[1] - 1)
    offset = chains - chains.mean(axis=(0, 1, 2))
    power = np.mean(offset**2, axis=(0, 1, 2))
    figure = Figure(figsize=(6.0, 3.4), layout="constrained")
    axes = figure.subplots()
    for i, key in enumerate(draws.keys):
        own = offset[..., i]
        products = [np.mean(own[:, : own.shape[1] - k] * own[:, k:]) for k in range(lags + 1)]
        label = f"{key}: {draws.autocorrelation[i]:.1f} steps"
        axes.plot(np.array(products) / power[i], linewidth=0.9, label=label)
    axes.axhline(0.0, color=GREY, linewidth=0.7)
    axes.set_xlabel("lag [steps]")
    axes.set_ylabel("autocorrelation")
    axes.set_xlim(0, lags)
    axes.legend(fontsize=7, ncols=2, title="integrated autocorrelation time", title_fontsize=7)
    return figure


def _chains(draws: Draws) -> FloatArray:
    """Draws by ensemble, step and walker, shape (ensembles, steps, walkers, parameters)."""
    return draws.values.reshape(*draws.chains, -1)


def band(predictive: PredictiveBand, unit: str = "", seconds: float = 40.0) -> Figure:
    """Recorded control of the first run inside its posterior predictive band."""
    from matplotlib.figure import Figure

    shown = predictive.time <= seconds
    time = predictive.time[shown]
    figure = Figure(figsize=(10.0, 3.6), layout="constrained")
    axes = figure.subplots()
    for limits, colour, alpha, label in (
        (predictive.with_remnant, GREY, 0.3, "95 % band with remnant"),
        (predictive.model, COLOUR, 0.6, "95 % band of the model's answer"),
    ):
        low, high = limits[:, 0, shown]
        axes.fill_between(time, low, high, color=colour, alpha=alpha, linewidth=0.0, label=label)
    recorded = predictive.control[0, shown]
    axes.plot(time, recorded, color="black", linewidth=0.7, label="recorded")
    axes.set_xlabel("time from the first scored sample [s]")
    axes.set_ylabel(f"control u [{unit}]" if unit else "control u")
    axes.set_xlim(0.0, time[-1])
    axes.legend(loc="upper right", ncols=3, fontsize="small")
    return figure
