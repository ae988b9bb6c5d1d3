"""The figures of a page of fits, each made of `plots`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from pilotid.estimates.estimate import Estimate
from pilotid.recordings.recording import Recording
from pilotid.show.plots import describing_function, remnant, residual, signals
from pilotid.show.style import WIDTH, journal_style
from pilotid.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def time_figure(recording: Recording, estimates: Sequence[Estimate]) -> Figure:
    """Control of the first run with what the models make of it, and what they leave."""
    from matplotlib.figure import Figure

    with journal_style():
        figure = Figure(figsize=(WIDTH, 3.6), layout="constrained")
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
        signals(recording, *estimates, axes=above).set_xlabel("")
        residual(recording, *estimates, axes=below)
        below.get_legend().remove()
    return figure


def response_figure(estimates: Sequence[Estimate], truth: FloatArray | None = None) -> Figure:
    """Describing functions of every channel side by side.

    Parameters
    ----------
    estimates
        Estimates of one model.
    truth
        True parameters of a simulation, shape (parameters,).
    """
    from matplotlib.figure import Figure

    channels = estimates[0].model.channels
    with journal_style():
        figure = Figure(figsize=(WIDTH, 4.2), layout="constrained")
        panels = figure.subplots(2, len(channels), sharex=True, squeeze=False, height_ratios=(3, 2))
        for channel, pair in zip(channels, panels.T, strict=True):
            describing_function(*estimates, channel=channel.name, truth=truth, axes=tuple(pair))
        _legend_above(figure)
    return figure


def remnant_figure(recording: Recording, estimates: Sequence[Estimate]) -> Figure:
    """The remnant's spectrum as models have it, and that of the residuals."""
    from matplotlib.figure import Figure

    with journal_style():
        figure = Figure(figsize=(WIDTH, 2.8), layout="constrained")
        remnant(*estimates, recording=recording, axes=figure.subplots())
        _legend_above(figure)
    return figure


def _legend_above(figure: Figure) -> None:
    """One legend for all axes, where it hides none of them."""
    handles, labels = figure.axes[0].get_legend_handles_labels()
    for axes in figure.axes:
        if (own := axes.get_legend()) is not None:
            own.remove()
    figure.legend(handles, labels, loc="outside upper right", ncols=5, frameon=False)
