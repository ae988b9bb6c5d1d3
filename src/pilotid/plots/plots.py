"""Plots of recordings and estimates that take and return matplotlib axes.

For notebooks and for pages alike; below are the figures of pages, put together from them::

    plot.signals(recording, mle, fourier)
    plot.describing_function(mle, fourier, channel="visual")

Functions of several estimates draw what there is of those that failed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from pilotid.estimate.estimate import Estimate
from pilotid.estimate.parts import FrequencyResponse
from pilotid.likelihood.estimates import Whitened, correlations, prediction_errors
from pilotid.model.element import ControlledElement
from pilotid.plots.responses import NO_UNITS, describing_function, open_loop
from pilotid.plots.style import (
    INK,
    Named,
    draw_grid,
    journal_figure,
    leading,
    legend,
    log_ticks,
    named,
    new_axes,
    square_unit,
    with_unit,
)
from pilotid.recording.recording import Recording
from pilotid.support.numbers import Z95
from pilotid.support.types import FloatArray, InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "autocorrelation",
    "cross_correlation",
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
    for own in named(estimates):
        if not own.known:
            continue
        frame = own.estimate.simulate(recording)
        frame = frame[frame.run == run + 1]
        reach = Z95 * float(np.std(frame.control - frame.simulated))
        frame = frame[frame.time.between(begin, end)]
        response = frame.simulated
        if band:
            axes.fill_between(frame.time, response - reach, response + reach, color=own.colour,
                              alpha=0.2, linewidth=0.0)  # fmt: skip
            band = False
        axes.plot(frame.time, response, color=own.colour, linestyle=own.dash, linewidth=1.4,
                  label=own.label)  # fmt: skip
    label = with_unit("control u", recording.units.get("u", ""))
    axes.set(ylabel=label, xlabel="time [s]", xlim=(begin, end))
    # Above the axes, since signals are everywhere inside them.
    legend(axes, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=5, borderaxespad=0.1)
    return axes


# the remnant

INSIDE = 0.8  # share of an analysis band that its filter leaves alone
BAND = 30.0  # rad/s, up to which a residual's spectrum is shown where no model says how far
#: A periodogram is averaged over this share of the frequency, and over so many lines at least.
SMOOTHING, FEWEST = 1.0 / 6.0, 4


def remnant(
    *estimates: Estimate, recording: Recording | None = None, axes: Axes | None = None
) -> Axes:
    """The remnant's power density as the methods model it, and that of the `leading` residual.

    Parameters
    ----------
    estimates
        Estimates; without a recording, at least one of them has a model of the remnant.
    recording
        What they were estimated from, for the smoothed periodogram of the residual (points).
    axes
        Where to draw; None makes a new figure by pyplot.

    Raises
    ------
    InputError
        If there is nothing to draw.
    """
    if recording is None and all(e.remnant is None for e in estimates):
        raise InputError(
            "none of these estimates has a model of the remnant; name the recording, too, to see "
            "the spectra of their residuals"
        )
    axes, chosen = axes if axes is not None else new_axes(), leading(estimates)
    for own in named(estimates):
        model, highest = own.estimate.remnant, BAND
        if model is not None:
            highest = INSIDE * float(model.omega[-1])
            shown = model.omega <= highest
            axes.plot(model.omega[shown], model.density[shown], color=own.colour,
                      linestyle=own.dash, linewidth=1.4, label=own.label)  # fmt: skip
        if recording is not None and own.estimate is chosen:
            omega, density = _periodogram(recording, own.estimate)
            shown = omega <= highest
            axes.plot(omega[shown], density[shown], own.marker, color=own.colour,
                      markersize=3.5, markerfacecolor="white",
                      label=f"{own.label}: residual")  # fmt: skip
    axes.set(xscale="log", yscale="log")
    draw_grid(axes)
    axes.minorticks_off()
    log_ticks(axes, "x")
    axes.set_xlabel("frequency [rad/s]")
    unit = square_unit(recording.units if recording is not None else {}, "u")
    axes.set_ylabel(f"power density [{unit} s/rad]")
    legend(axes)
    return axes


def _periodogram(recording: Recording, estimate: Estimate) -> tuple[FloatArray, FloatArray]:
    """One-sided power density of the residual over frequency [rad/s], all runs averaged."""
    frame = estimate.simulate(recording)
    left = (frame.control - frame.simulated).to_numpy().reshape(recording.runs, -1)
    count = left.shape[1]
    taper = np.hanning(count)
    spectrum = np.fft.rfft(taper * left)
    power = np.mean(np.abs(spectrum) ** 2, axis=0) * recording.dt / (np.pi * np.sum(taper**2))
    omega = 2.0 * np.pi * np.fft.rfftfreq(count, recording.dt)
    edges = [1]
    while edges[-1] < omega.size:
        edges.append(edges[-1] + max(FEWEST, round(SMOOTHING * edges[-1])))
    sizes = np.diff([*edges[:-1], omega.size])
    places = np.add.reduceat(omega, edges[:-1]) / sizes
    return places, np.add.reduceat(power, edges[:-1]) / sizes


# prediction errors

LAGS = 2.5  # seconds
SHADE = "#e8e8e8"


def autocorrelation(recording: Recording, *estimates: Estimate, axes: Axes | None = None) -> Axes:
    """Autocorrelation of the prediction errors, and the limits that hold 95 % if they are white.

    Parameters
    ----------
    recording
        What the estimates come from.
    estimates
        Estimates from it; those without values are left out.  Errors are whitened by each
        estimate's own model of the remnant, or else by one fitted to what it leaves.
    axes
        Where to draw; None makes a new figure by pyplot.
    """
    axes = axes if axes is not None else new_axes()
    for own in filter(lambda own: own.known, named(estimates)):
        errors = prediction_errors(recording, own.estimate)
        _draw_correlations(axes, own, errors, errors.errors, range(1, 1 + _longest(errors)))
    axes.set_ylabel("autocorrelation [-]")
    return _over_lags(axes, 0.0)


def cross_correlation(
    recording: Recording, *estimates: Estimate, signal: str = "e", axes: Axes | None = None
) -> Axes:
    """Correlation of the prediction errors with an input of the pilot some time before.

    Within the limits, which hold 95 %, nothing in the input explains the errors.  Lags below zero
    (shaded) are inputs after the error, which hold it through the loop: no fault.

    Parameters
    ----------
    recording, estimates, axes
        As for `autocorrelation`.
    signal
        ``e`` or ``x``, on which a channel of the models acts.

    Raises
    ------
    InputError
        If no channel acts on that signal.
    """
    axes = axes if axes is not None else new_axes()
    for own in filter(lambda own: own.known, named(estimates)):
        errors = prediction_errors(recording, own.estimate)
        if signal not in errors.inputs:
            taken = ", ".join(c.on for c in own.estimate.model.channels)
            raise InputError(
                f"no channel of model {own.estimate.model.name} acts on {signal}: choose {taken}"
            )
        lags = range(-_longest(errors) // 2, 1 + _longest(errors))
        _draw_correlations(axes, own, errors, errors.inputs[signal], lags)
    axes.axvspan(-0.5 * LAGS, 0.0, color=SHADE, linewidth=0.0, zorder=-1.0)
    axes.set_ylabel(f"correlation with {signal} [-]")
    return _over_lags(axes, -0.5 * LAGS)


def _longest(errors: Whitened) -> int:
    """The longest lag that is shown, in samples."""
    return min(round(LAGS / errors.dt), int(errors.errors.shape[1]) - 1)


def _draw_correlations(
    axes: Axes, own: Named, errors: Whitened, signal: FloatArray, lags: range
) -> None:
    found, times = correlations(errors.errors, signal, lags), errors.dt * np.array(lags)
    axes.plot(times, found, color=own.colour, linestyle=own.dash, label=own.label)
    limit = Z95 / float(np.sqrt(errors.errors.size))
    for side in (-limit, limit):
        axes.axhline(side, color=INK, linewidth=0.7, linestyle=(0, (4.0, 2.0)))


def _over_lags(axes: Axes, begin: float) -> Axes:
    axes.axhline(0.0, color=INK, linewidth=0.5)
    drawn = [np.asarray(line.get_ydata(), float) for line in axes.get_lines()]
    reach = 1.25 * max(float(np.max(np.abs(own))) for own in drawn)
    if reach > 0.0:
        axes.set_ylim(-reach, reach)
    axes.set(xlim=(begin, LAGS), xlabel="lag [s]")
    draw_grid(axes)
    if len(axes.get_legend_handles_labels()[1]) > 1:
        legend(axes)
    return axes


# figures of pages

SECONDS = 30.0  # of the control that are shown: beyond, strokes run into one another


def time_figure(recording: Recording, estimate: Estimate) -> Figure:
    """The control of the first run, and what a model makes of it."""
    span = (0.0, min(SECONDS, float(recording.time[-1])))
    with journal_figure(2.5) as figure:
        signals(recording, estimate, span=span, band=True, axes=figure.subplots())
    return figure


def response_figure(
    estimates: Sequence[Estimate],
    truth: FloatArray | None = None,
    *,
    points: FrequencyResponse | None = None,
    units: Mapping[str, str] = NO_UNITS,
) -> Figure:
    """Describing functions of every channel side by side; see `describing_function`."""
    channels = estimates[0].model.channels
    with journal_figure(4.2) as figure:
        panels = figure.subplots(2, len(channels), sharex=True, squeeze=False, height_ratios=(3, 2))
        describing_function(
            *estimates, truth=truth, points=points, units=units, axes=[*panels.T.ravel()]
        )
        figure.align_ylabels()
        _legend_above(figure, 5)
    return figure


def open_loop_figure(estimate: Estimate, element: ControlledElement) -> Figure:
    """Target and disturbance open loops."""
    with journal_figure(4.2) as figure:
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=(4, 5))
        open_loop(estimate, element, (above, below))
        figure.align_ylabels()
        _legend_above(figure, 1)
    return figure


def remnant_figure(recording: Recording, estimates: Sequence[Estimate]) -> Figure:
    """The remnant's spectrum as models have it, and that of a residual."""
    with journal_figure(2.9) as figure:
        remnant(*estimates, recording=recording, axes=figure.subplots())
    return figure


def whiteness_figure(recording: Recording, estimate: Estimate) -> Figure:
    """Tests of the prediction errors of one estimate."""
    inputs = dict.fromkeys(channel.on for channel in estimate.model.channels)
    with journal_figure(2.4) as figure:
        panels = figure.subplots(1, 1 + len(inputs))
        autocorrelation(recording, estimate, axes=panels[0])
        for name, axes in zip(inputs, panels[1:], strict=True):
            cross_correlation(recording, estimate, signal=name, axes=axes)
    return figure


def _legend_above(figure: Figure, columns: int) -> None:
    """One legend for all axes, where it hides none of them."""
    handles, labels = figure.axes[0].get_legend_handles_labels()
    for axes in figure.axes:
        if (own := axes.get_legend()) is not None:
            own.remove()
    if labels:
        figure.legend(handles, labels, loc="outside upper left", ncols=columns, frameon=False)
