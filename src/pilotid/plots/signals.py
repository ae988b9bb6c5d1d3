"""Plots over time: the control, what models make of it and leave, and parameters."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pilotid.estimate.estimate import Estimate
from pilotid.likelihood.prediction import predict
from pilotid.likelihood.prepare import prepare
from pilotid.plots.style import INK, Named, legend, named, new_axes, with_unit
from pilotid.recording.recording import Recording
from pilotid.support.numbers import Z95
from pilotid.support.types import BoolArray, FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes


ALONE = 1.6  # points, width of a model's line that is told from the recorded one in grey, too


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
    ends = span or (0.0, float(recording.time[-1]))
    time, control = recording.time[recording.run_in :], recording.window(recording.u)[run]
    inside = _inside(time, ends)
    axes.plot(time[inside], control[inside], color=INK, linewidth=0.7, label="recorded")
    widths = [ALONE] if len(estimates) == 1 else _widths(len(estimates))
    for own, width in zip(named(estimates), widths, strict=True):
        if own.known:
            scored, output, left = simulated(recording, own.estimate)
            inside = _inside(scored, ends)
            drawn = output[run, inside]
            if band:
                reach, band = Z95 * float(np.std(left[run])), False
                axes.fill_between(scored[inside], drawn - reach, drawn + reach, color=own.colour,
                                  alpha=0.2, linewidth=0.0)  # fmt: skip
            _line(axes, scored[inside], drawn, own, width)
    return _over_time(axes, recording, "control u", ends)


def residual(
    recording: Recording,
    *estimates: Estimate,
    run: int = 0,
    span: tuple[float, float] | None = None,
    axes: Axes | None = None,
) -> Axes:
    """What the models leave of the control of a run: remnant, and what they do not describe.

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
    axes
        Where to draw; None makes a new figure by pyplot.
    """
    axes = axes if axes is not None else new_axes()
    ends = span or (0.0, float(recording.time[-1]))
    axes.axhline(0.0, color=INK, linewidth=0.5)
    for own, width in zip(named(estimates), _widths(len(estimates)), strict=True):
        if own.known:
            scored, _, left = simulated(recording, own.estimate)
            inside = _inside(scored, ends)
            _line(axes, scored[inside], left[run, inside], own, width)
    return _over_time(axes, recording, "residual", ends)


def simulated(
    recording: Recording, estimate: Estimate
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What a fitted model answers to the inputs, and what it leaves of the control.

    Parameters
    ----------
    recording
        What was fitted.
    estimate
        An estimate with values.

    Returns
    -------
    time, answer, residual
        Times of the scored samples [s], shape (samples,), and the model's control and what it
        leaves, each in the control's unit and of shape (runs, samples).
    """
    prepared = prepare(recording, estimate.model)
    prediction = predict(recording, estimate.model)
    left = prediction.errors(estimate.values)
    return prepared.scored_time, prediction.control - left, left


def _inside(time: FloatArray, ends: tuple[float, float]) -> BoolArray:
    """Which samples are shown, shape (samples,)."""
    return (time >= ends[0]) & (time <= ends[1])


def _line(axes: Axes, time: FloatArray, signal: FloatArray, own: Named, width: float) -> None:
    (line,) = axes.plot(time, signal, color=own.colour, linewidth=width, label=own.label)
    line.set_linestyle(own.dash)


def _widths(count: int) -> list[float]:
    """Widths of lines that leave the first to be seen beneath the last."""
    return [float(w) for w in np.linspace(min(0.5 + 0.4 * count, 2.0), 0.9, count)]


def _over_time(axes: Axes, recording: Recording, what: str, span: tuple[float, float]) -> Axes:
    """Labels of a signal in the unit of the control."""
    axes.set(ylabel=with_unit(what, recording.units.get("u", "")), xlabel="time [s]", xlim=span)
    # Above the axes, since signals are everywhere inside them.
    legend(axes, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=5, borderaxespad=0.1)
    return axes
