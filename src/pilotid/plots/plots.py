"""Plots of recordings and estimates that take and return matplotlib axes.

For notebooks and for pages alike::

    plot.signals(recording, mle, fourier)
    plot.describing_function(mle, fourier)

Functions of several estimates draw what there is of those that failed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pilotid.estimate.estimate import Estimate
from pilotid.estimate.quantities import TAILS, Draws
from pilotid.likelihood.estimates import prediction_errors
from pilotid.likelihood.prediction import Prediction
from pilotid.plots.responses import describing_function, open_loop
from pilotid.plots.style import (
    INK,
    WIDTH,
    draw_grid,
    journal_figure,
    leading,
    legend,
    log_ticks,
    named,
    new_axes,
    square_unit,
    style_of,
    with_unit,
)
from pilotid.recording.recording import Recording
from pilotid.support.numbers import Z95
from pilotid.support.types import FloatArray, InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "correlation",
    "describing_function",
    "open_loop",
    "remnant",
    "signals",
]

# over time


def signals(
    recording: Recording,
    *estimates: Estimate,
    run: int = 0,
    span: tuple[float, float] | None = None,
    band: bool = False,
    axes: Axes | None = None,
) -> Axes:
    """The recorded control of a run, and what the models make of the recorded inputs.

    Parameters
    ----------
    recording
        The recording.
    estimates
        Estimates from it.
    run
        Number of the run, from 0.
    span
        First and last time shown [s]; None shows all of the window.
    band
        Whether to shade 95 % of the first estimate's remnant about its output: 1.96 standard
        deviations of what it leaves in that run.
    axes
        Where to draw; None makes a new figure by pyplot.
    """
    axes = axes if axes is not None else new_axes()
    time, control = recording.time[recording.run_in :], recording.window(recording.u)[run]
    begin, end = span or (0.0, float(time[-1]))
    inside = (time >= begin) & (time <= end)
    axes.plot(time[inside], control[inside], color=INK, linewidth=0.7, label="recorded")
    for shown in named(estimates):
        if not shown.known:
            continue
        frame = shown.estimate.simulate(recording)
        frame = frame[frame.run == run + 1]
        reach = Z95 * float(np.std(frame.control - frame.simulated))
        frame = frame[frame.time.between(begin, end)]
        response = frame.simulated
        if band:
            axes.fill_between(frame.time, response - reach, response + reach, alpha=0.2,
                              color=shown.style.colour, linewidth=0.0)  # fmt: skip
            band = False
        axes.plot(frame.time, response, color=shown.style.colour, linestyle=shown.style.dash,
                  linewidth=1.4, label=shown.label)  # fmt: skip
    label = with_unit("control u", recording.units.get("u", ""))
    axes.set(ylabel=label, xlabel="time [s]", xlim=(begin, end))
    # Above the axes, since signals are everywhere inside them.
    legend(axes, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=5, borderaxespad=0.1)
    return axes


# the remnant

INSIDE = 0.8  # share of an analysis band that its filter leaves alone
SEGMENTS = 4  # of a run whose spectra are averaged
BAND = 30.0  # rad/s, up to which a residual's spectrum is shown where no model says how far


def remnant(
    *estimates: Estimate, recording: Recording | None = None, axes: Axes | None = None
) -> Axes:
    """The remnant's power density as the methods model it, and that of the `leading` residual.

    Parameters
    ----------
    estimates
        The estimates.
    recording
        What they were estimated from, for the residual's spectrum (points), after Welch (1967).
    axes
        Where to draw; None makes a new figure by pyplot.
    """
    axes, chosen = axes if axes is not None else new_axes(), leading(estimates)
    for estimate, label, style in named(estimates):
        model, highest = estimate.remnant, BAND
        if model is not None:
            highest = INSIDE * float(model.omega[-1])
            shown = model.omega <= highest
            axes.plot(model.omega[shown], model.density[shown], color=style.colour,
                      linestyle=style.dash, linewidth=1.4, label=label)  # fmt: skip
        if recording is not None and estimate is chosen:
            omega, density = _spectrum(recording, estimate)
            shown = omega <= highest
            axes.plot(omega[shown], density[shown], style.marker, color=style.colour,
                      markersize=3.5, markerfacecolor="white",
                      label=f"{label}: residual")  # fmt: skip
    axes.set(xscale="log", yscale="log")
    draw_grid(axes)
    axes.minorticks_off()
    log_ticks(axes, "x")
    axes.set_xlabel("frequency [rad/s]")
    unit = square_unit(recording.units if recording is not None else {}, "u")
    axes.set_ylabel(f"power density [{unit} s/rad]")
    legend(axes)
    return axes


def _spectrum(recording: Recording, estimate: Estimate) -> tuple[FloatArray, FloatArray]:
    """Frequency [rad/s] and one-sided power density of the residual, all runs averaged."""
    from scipy.signal import welch

    frame = estimate.simulate(recording)
    left = (frame.control - frame.simulated).to_numpy().reshape(recording.runs, -1)
    omega, density = welch(left, 2.0 * np.pi / recording.dt, nperseg=left.shape[1] // SEGMENTS)
    return omega[1:], density.mean(axis=0)[1:]


# prediction errors

LAGS = 2.5  # seconds
SHADE = "#e8e8e8"


def correlation(
    recording: Recording,
    *estimates: Estimate,
    signal: str | None = None,
    axes: Axes | None = None,
) -> Axes:
    """Autocorrelation of the prediction errors, or their correlation with an earlier input.

    Dashed limits hold 95 % if errors are white, and nothing in the input explains them.  Lags below
    zero (shaded) are inputs after the error, which hold it through the loop: no fault.

    Parameters
    ----------
    recording
        What the estimates come from.
    estimates
        Estimates from it; those without values are left out.  Errors are whitened by each
        estimate's own model of the remnant, or else by one fitted to what it leaves.
    signal
        ``e`` or ``x``, on which a channel of the models acts; None for the errors themselves.
    axes
        Where to draw; None makes a new figure by pyplot.

    Raises
    ------
    InputError
        If no channel acts on that signal.
    """
    axes = axes if axes is not None else new_axes()
    begin, reach = (-0.5 * LAGS if signal else 0.0), 0.0
    for shown in named(estimates):
        if not shown.known:
            continue
        fitted_to = None if shown.estimate.remnant else recording
        prediction, errors, _ = prediction_errors(recording, shown.estimate, fitted_to)
        inputs = inputs_of(recording, prediction)
        against = inputs.get(signal) if signal else errors
        if against is None:
            raise InputError(
                f"no channel of model {shown.estimate.model.name} acts on {signal}: choose "
                f"{', '.join(inputs)}"
            )
        longest = min(round(LAGS / prediction.dt), int(errors.shape[1]) - 1)
        lags = range(-longest // 2, 1 + longest) if signal else range(1, 1 + longest)
        drawn = correlations(errors, against, lags)
        times, limit = prediction.dt * np.array(lags), Z95 / float(np.sqrt(errors.size))
        style = shown.style
        axes.plot(times, drawn, color=style.colour, linestyle=style.dash, label=shown.label)
        for side in (-limit, limit):
            axes.axhline(side, color=INK, linewidth=0.7, linestyle=(0, (4.0, 2.0)))
        reach = max(reach, 1.25 * limit, 1.25 * float(np.max(np.abs(drawn))))
    axes.axvspan(begin, 0.0, color=SHADE, linewidth=0.0, zorder=-1.0)
    axes.axhline(0.0, color=INK, linewidth=0.5)
    axes.set(xlim=(begin, LAGS), ylim=(-reach, reach) if reach else None, xlabel="lag [s]")
    axes.set_ylabel(f"correlation with {signal} [-]" if signal else "autocorrelation [-]")
    draw_grid(axes)
    if len(axes.get_legend_handles_labels()[1]) > 1:
        legend(axes)
    return axes


def inputs_of(recording: Recording, prediction: Prediction) -> dict[str, FloatArray]:
    """What a model's channels act on in the band of a prediction, each of shape (runs, samples).

    By the signal's name, low-passed to the band and without its mean.
    """
    inputs = {}
    for key in dict.fromkeys(channel.on for channel in prediction.model.channels):
        signal = prediction.samples_of(prediction.window.transformed(recording.input(key)))
        inputs[key] = signal - signal.mean(axis=1, keepdims=True)
    return inputs


def correlations(errors: FloatArray, signal: FloatArray, lags: range) -> FloatArray:
    """Correlation coefficients of errors with a signal some samples before, all runs together.

    Parameters
    ----------
    errors, signal
        Shape (runs, samples), both without a mean.
    lags
        Whole numbers of samples; negative ones for a signal after the error.

    Returns
    -------
    FloatArray
        Shape (lags,).
    """
    from scipy.signal import correlate  # when it is needed

    sums = np.sum([correlate(*each) for each in zip(errors, signal, strict=True)], axis=0)
    at = errors.shape[1] - 1 + np.array(lags)
    return np.asarray(sums[at] / np.sqrt(np.sum(errors**2) * np.sum(signal**2)))


# figures of a posterior

COLOUR = style_of("bayes").colour
GREY = "#999999"
SHOWN = 20_000  # draws in a corner plot
CONTOURS = (0.95, 0.5)  # shares of the draws that contours enclose


def corner(draws: Draws, units: dict[str, str]) -> Figure:
    """Marginal densities on the diagonal, and of every pair of parameters below it.

    Contours enclose 50 and 95 % of the draws; dashed lines mark the mean and the
    equal-tailed 95 % interval.
    """
    from matplotlib.ticker import MaxNLocator

    count = len(draws.keys)
    values = draws.thinned(min(SHOWN, len(draws.values)))
    low, high = np.quantile(values, (0.002, 0.998), axis=0)
    limits = np.stack([low - 0.08 * (high - low), high + 0.08 * (high - low)], axis=1)
    # Not matplotlib's own layout, which takes seconds for so many panels.
    with journal_figure(WIDTH, layout=None) as figure:
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
    sample = draws.values[:, index]
    axes.hist(sample, bins=40, range=tuple(limits), color=COLOUR, histtype="step")
    for place in (sample.mean(), *np.quantile(sample, TAILS)):
        axes.axvline(place, color=GREY, linestyle="--", linewidth=0.7)
    axes.set_yticks([])


def _pair(
    axes: Axes, x: FloatArray, y: FloatArray, x_range: FloatArray, y_range: FloatArray
) -> None:
    from scipy.ndimage import gaussian_filter

    counts, x_edges, y_edges = np.histogram2d(x, y, bins=26, range=[x_range, y_range])
    counts = gaussian_filter(counts, 0.7)  # contours of raw counts are ragged
    ordered = np.sort(counts.ravel())[::-1]
    shares = np.cumsum(ordered) / ordered.sum()
    levels = sorted({float(ordered[np.searchsorted(shares, share)]) for share in CONTOURS})
    x_middle, y_middle = (0.5 * (e[1:] + e[:-1]) for e in (x_edges, y_edges))
    top = float(counts.max())
    if levels[-1] < top:
        axes.contourf(x_middle, y_middle, counts.T, [*levels, top], colors=COLOUR, alpha=0.25)
    axes.contour(x_middle, y_middle, counts.T, levels, colors=COLOUR, linewidths=0.8)
    axes.set_ylim(*y_range.tolist())
