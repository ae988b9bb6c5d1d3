"""Figures of fits, drawn with matplotlib and written as SVG."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from pilotid.estimates.estimate import Estimate
from pilotid.recordings.recording import Recording
from pilotid.show.style import colour_of
from pilotid.time_domain.output_error import LeastSquares
from pilotid.time_domain.prediction import predict
from pilotid.time_domain.prepare import prepare
from pilotid.types import ComplexArray, FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MARKERS = ("o", "s", "^", "D", "v")
#: Relative error beyond which a point says nothing of phase.
UNKNOWN = 1.0


def signals(recording: Recording, estimates: Sequence[Estimate]) -> Figure:
    """Control of the first run, what the models make of it, and what they leave."""
    from matplotlib.figure import Figure

    model = estimates[0].model
    problem = LeastSquares(predict(recording, model))
    prepared = prepare(recording, model)
    time, control = prepared.time[prepared.first :], problem.prediction.control[0]
    unit = recording.units.get("u", "")
    figure = Figure(figsize=(10.0, 5.0), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    above.plot(time, control, color="black", linewidth=0.8, label="recorded")
    for estimate in estimates:
        residual = problem.residual(estimate.values)[0]
        colour = colour_of(estimate.method)
        above.plot(time, control - residual, color=colour, linewidth=0.8, label=estimate.method)
        below.plot(time, residual, color=colour, linewidth=0.8)
    above.set_ylabel(f"control u [{unit}]" if unit else "control u")
    below.set_ylabel("residual")
    below.set_xlabel("time [s]")
    below.set_xlim(time[0], time[-1])
    above.legend(loc="upper right", ncols=4, fontsize="small")
    return figure


def bode(estimates: Sequence[Estimate], truth: FloatArray | None = None) -> Figure:
    """First-step frequency responses with error bars, and the models fitted to them.

    Parameters
    ----------
    estimates
        Estimates of one model, of which at least one has a frequency response.
    truth
        True parameters of a simulation, shape (parameters,).
    """
    from matplotlib.figure import Figure

    shown = [e for e in estimates if e.frequency_response is not None]
    model = shown[0].model
    every = np.concatenate([e.frequency_response.omega for e in shown if e.frequency_response])
    omega = np.geomspace(0.8 * every.min(), 1.25 * every.max(), 300)
    count = len(model.channels)
    figure = Figure(figsize=(5.0 * count + 0.5, 6.0), layout="constrained")
    axes = figure.subplots(2, count, sharex=True, squeeze=False, height_ratios=(3, 2))
    curves = [("", e.values, colour_of(e.method), "-") for e in shown]
    if truth is not None:
        curves.append(("truth", truth, "black", "--"))
    for channel, (above, below) in enumerate(axes.T):
        for label, values, colour, style in curves:
            if np.isfinite(values).all():
                response = model.response(omega, values)[channel]
                phase = np.rad2deg(np.unwrap(np.angle(response)))
                line = {"color": colour, "linestyle": style, "linewidth": 1.0}
                above.loglog(omega, np.abs(response), label=label or None, **line)
                below.semilogx(omega, phase, **line)
        limits = above.get_ylim()
        for number, estimate in enumerate(shown):
            _points((above, below), estimate, channel, number)
        sizes = np.concatenate([_sizes(e, channel) for e in shown])
        # A bar that reaches down to zero would reach to minus infinity here.
        above.set_ylim(min(limits[0], 0.5 * sizes.min()), max(limits[1], 2.0 * sizes.max()))
        above.set_title(f"{model.channels[channel].name} channel", fontsize="medium")
        below.set_xlabel("frequency [rad/s]")
        for axis in (above, below):
            axis.grid(color="#dddddd", linewidth=0.5)
            axis.set_axisbelow(True)
    axes[0, 0].set_ylabel("magnitude |H|")
    axes[1, 0].set_ylabel("phase [deg]")
    axes[0, 0].legend(fontsize="small")
    return figure


def _sizes(estimate: Estimate, channel: int) -> FloatArray:
    """Magnitudes of a channel's estimated responses."""
    found = estimate.frequency_response
    return np.abs(found.value[channel]) if found is not None else np.zeros(0)


def _points(axes: tuple[Axes, Axes], estimate: Estimate, channel: int, number: int) -> None:
    """Estimated responses of one channel with bars of one standard error."""
    from matplotlib.axes import Axes

    found = estimate.frequency_response
    if found is None:
        return
    value = found.value[channel]
    # Each part, real and imaginary, has half of the error's power.
    error = found.std[channel] / np.sqrt(2.0)
    share = error / np.abs(value)
    low = np.minimum(error, 0.98 * np.abs(value))
    draw = partial(
        Axes.errorbar,
        color=colour_of(estimate.method),
        fmt=MARKERS[number % len(MARKERS)],
        markersize=4.0,
        elinewidth=0.8,
        markerfacecolor="white",
    )
    bars = np.array([low, error])
    draw(axes[0], found.omega, np.abs(value), bars, label=estimate.method)
    known = share < UNKNOWN
    phase = _near(value, estimate, found.omega, channel)
    draw(axes[1], found.omega[known], phase[known], np.rad2deg(share[known]))


def _near(value: ComplexArray, estimate: Estimate, omega: FloatArray, channel: int) -> FloatArray:
    """Phase [deg] of points, on the turn that is nearest to the fitted model."""
    if not np.isfinite(estimate.values).all():
        return np.asarray(np.rad2deg(np.unwrap(np.angle(value))))
    fine = np.geomspace(omega[0] / 2.0, omega[-1], 1000)
    response = estimate.model.response(np.append(fine, omega), estimate.values)[channel]
    phase = np.interp(omega, fine, np.unwrap(np.angle(response[: fine.size])))
    return np.asarray(np.rad2deg(phase + np.angle(value * np.exp(-1j * phase))))
