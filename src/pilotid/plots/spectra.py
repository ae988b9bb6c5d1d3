"""Plots of spectra: the remnant, and what a recording tells at each frequency."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from pilotid.estimate.estimate import Estimate
from pilotid.plots.signals import simulated
from pilotid.plots.style import (
    INK,
    draw_grid,
    leading,
    legend,
    log_ticks,
    named,
    new_axes,
    new_pair,
    square_unit,
)
from pilotid.recording.recording import Recording
from pilotid.recording.spectra import floors_of, known_lines
from pilotid.support.types import FloatArray, InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes


INSIDE = 0.8  # share of an analysis band that its filter leaves alone
BAND = 30.0  # rad/s, up to which a residual's spectrum is shown where no model says how far
RESIDUALS = 2  # spectra of residuals that can be told apart
#: A periodogram is averaged over this share of the frequency, and over so many lines at least.
SMOOTHING, FEWEST = 1.0 / 6.0, 4


def remnant(
    *estimates: Estimate, recording: Recording | None = None, axes: Axes | None = None
) -> Axes:
    """The remnant's power density as the methods model it, and that of their residuals.

    Of more than two estimates the `leading` one's residual is drawn alone.

    Parameters
    ----------
    estimates
        Estimates; without a recording, at least one of them has a model of the remnant.
    recording
        What they were estimated from, for smoothed periodograms of the residuals (points).
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
    axes = axes if axes is not None else new_axes()
    several = leading(estimates) if len(estimates) > RESIDUALS else None
    for estimate in named(estimates):
        own, highest = estimate.estimate.remnant, BAND
        if own is not None:
            highest = INSIDE * float(own.omega[-1])
            shown = own.omega <= highest
            model = own.omega[shown], own.density[shown]
            line = axes.plot(*model, color=estimate.colour, linewidth=1.4, label=estimate.label)
            line[0].set_linestyle(estimate.dash)
        drawn = several is None or estimate.estimate is several
        if recording is not None and estimate.known and drawn:
            omega, density = _periodogram(recording, estimate.estimate)
            shown = omega <= highest
            axes.plot(omega[shown], density[shown], estimate.marker, color=estimate.colour,
                      markersize=3.5, markerfacecolor="white",
                      label=f"{estimate.label}: residual")  # fmt: skip
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
    _, _, left = simulated(recording, estimate)
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


LOWEST = 0.3  # rad/s that are shown
#: Colour and stroke by signal.
SIGNALS = {"e": ("#0072B2", "-"), "x": ("#D55E00", "--"), "ft": ("#CC8400", "-."), "u": (INK, ":")}


def band(
    recording: Recording, estimate: Estimate, axes: tuple[Axes, Axes] | None = None
) -> tuple[Axes, Axes]:
    """Spectra of what the pilot acts on and of the control, their floors, and what counts.

    Spectra are smoothed by running medians, which leave lines of forcing functions out, and
    divided by the signal's variance.

    Parameters
    ----------
    recording
        The recording.
    estimate
        An estimate from it, whose weights are drawn.
    axes
        Where to draw, above and below; None makes a new figure by pyplot.

    Returns
    -------
    The axes of the spectra, and those of the weights.
    """
    above, below = axes or new_pair()
    floors, nyquist = floors_of(recording), math.pi / recording.dt
    acted = dict.fromkeys(channel.on for channel in estimate.model.channels)
    for name in (*acted, "u"):
        colour, stroke = SIGNALS.get(name, (INK, "-"))
        variance = floors.variance[name]
        if variance == 0.0:
            continue
        above.plot(
            floors.omega, floors.power[name] / variance, color=colour, linestyle=stroke, label=name
        )
        if floors.floor[name] > 0.0:
            above.axhline(floors.floor[name] / variance, color=colour, linewidth=0.6, alpha=0.6)
    lines = known_lines(recording)
    for name, mark in (("ft", "v"), ("fd", "^")):
        if name in lines:
            omega = 2.0 * math.pi / recording.duration * lines[name]
            transform = below.get_xaxis_transform()
            below.plot(omega, np.full(omega.size, 1.05), mark, color=INK, markersize=3.0,
                       transform=transform, clip_on=False, label=f"lines of {name}")  # fmt: skip
    analysed = estimate.band
    if analysed is not None and analysed.omega.size:
        omega = np.concatenate([[LOWEST], analysed.omega])
        weights = np.concatenate([analysed.weights[:1], analysed.weights])
        below.fill_between(omega, weights, color="#9ecae1", linewidth=0.0)
        below.plot(omega, weights, color="#0072B2", linewidth=1.0)
    elif analysed is not None:
        below.axvspan(0.0, analysed.highest, color="#9ecae1", linewidth=0.0)
    for each in (above, below):
        each.set(xscale="log", xlim=(LOWEST, nyquist))
        draw_grid(each)
        each.minorticks_off()
    above.set_yscale("log")
    log_ticks(below, "x")
    above.set_ylabel("power density / variance [s/rad]")
    below.set(ylim=(0.0, 1.0), ylabel="weight [-]", xlabel="frequency [rad/s]")
    legend(above)
    return above, below
