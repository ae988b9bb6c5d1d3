"""A plot of what a recording tells at each frequency: signals, the recorder's floors, weights."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from pilotid.estimates.estimate import Estimate
from pilotid.recordings.recording import INPUTS, Recording
from pilotid.recordings.spectra import NotMultisineError, floors_of, forcing_lines
from pilotid.show.named import legend, new_pair
from pilotid.show.style import GRID, INK, log_ticks

if TYPE_CHECKING:
    from matplotlib.axes import Axes

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
    acted = dict.fromkeys(INPUTS[channel.input] for channel in estimate.model.channels)
    for name in (*acted, "u"):
        colour, stroke = SIGNALS[name]
        variance = floors.variance[name]
        if variance == 0.0:
            continue
        above.plot(
            floors.omega, floors.power[name] / variance, color=colour, linestyle=stroke, label=name
        )
        if floors.floor[name] > 0.0:
            above.axhline(floors.floor[name] / variance, color=colour, linewidth=0.6, alpha=0.6)
    try:
        lines = forcing_lines(recording)
    except NotMultisineError:
        lines = {}
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
        each.set_xscale("log")
        each.set_xlim(LOWEST, nyquist)
        each.grid(color=GRID, linewidth=0.5)
        each.set_axisbelow(True)
        each.minorticks_off()
    above.set_yscale("log")
    log_ticks(below, "x")
    above.set_ylabel("power density / variance [s/rad]")
    below.set_ylim(0.0, 1.0)
    below.set_ylabel("weight [-]")
    below.set_xlabel("frequency [rad/s]")
    legend(above)
    return above, below
