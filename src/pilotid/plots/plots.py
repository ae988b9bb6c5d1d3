"""Plots of recordings and estimates that take and return matplotlib axes.

For notebooks and for pages alike; below are the figures of pages, put together from them::

    plot.signals(recording, mle, fourier)
    plot.describing_function(mle, fourier, channel="visual")

Functions of several estimates draw what there is of those that failed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from pilotid.estimate.estimate import Estimate
from pilotid.estimate.parts import FrequencyResponse
from pilotid.model.element import ControlledElement
from pilotid.plots.residuals import autocorrelation, correlation, cross_correlation, normal_plot
from pilotid.plots.responses import NO_UNITS, describing_function, open_loop
from pilotid.plots.signals import residual, signals
from pilotid.plots.spectra import band, remnant
from pilotid.plots.style import SMALLEST, journal_figure, with_unit
from pilotid.recording.recording import Recording
from pilotid.support.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "autocorrelation",
    "band",
    "correlation",
    "cross_correlation",
    "describing_function",
    "normal_plot",
    "open_loop",
    "remnant",
    "residual",
    "signals",
]


SECONDS = 30.0  # of the control that are shown: beyond, strokes run into one another


def time_figure(recording: Recording, estimates: Sequence[Estimate], chosen: Estimate) -> Figure:
    """Control of the first run with what one model makes of it, and what each leaves.

    Parameters
    ----------
    recording, estimates
        The recording, and estimates from it with values.
    chosen
        The estimate whose response is drawn.
    """
    count = len(estimates)
    span = (0.0, min(SECONDS, float(recording.time[-1])))
    row = 0.9 if count < 4 else 0.55
    with journal_figure(2.5 + row * count) as figure:
        panels = figure.subplots(1 + count, 1, sharex=True, height_ratios=[1.9, *[row] * count])
        signals(recording, chosen, span=span, band=True, axes=panels[0]).set_xlabel("")
        reach = 0.0
        for estimate, axes in zip(estimates, panels[1:], strict=True):
            residual(recording, estimate, span=span, axes=axes).set_xlabel("")
            drawn = np.asarray(axes.get_lines()[-1].get_ydata())
            reach = max(reach, 1.05 * float(np.quantile(np.abs(drawn), 0.999)))
            axes.get_legend().remove()
            axes.set_ylabel("")
            told = f", VAF {estimate.vaf:.1f} %" if math.isfinite(estimate.vaf) else ""
            axes.annotate(f"{estimate.method}{told}", (1.0, 1.0), xycoords="axes fraction",
                          ha="right", va="bottom", fontsize=SMALLEST)  # fmt: skip
        for axes in panels[1:]:
            axes.set_ylim(-reach, reach)
            axes.locator_params(axis="y", nbins=3)
        label = with_unit("residual", recording.units.get("u", ""))
        panels[1 + (count - 1) // 2].set_ylabel(label)
        panels[-1].set_xlabel("time [s]")
        figure.align_ylabels()
    return figure


def response_figure(
    estimates: Sequence[Estimate],
    truth: FloatArray | None = None,
    *,
    points: FrequencyResponse | None = None,
    units: Mapping[str, str] = NO_UNITS,
) -> Figure:
    """Describing functions of every channel side by side.

    Parameters
    ----------
    estimates
        Estimates of one model.
    truth
        True parameters of a simulation, shape (parameters,).
    points, units
        See `describing_function`.
    """
    channels = estimates[0].model.channels
    with journal_figure(4.2) as figure:
        panels = figure.subplots(2, len(channels), sharex=True, squeeze=False, height_ratios=(3, 2))
        describing_function(
            *estimates, truth=truth, points=points, units=units, axes=[*panels.T.ravel()]
        )
        figure.align_ylabels()
        _legend_above(figure)
    return figure


def open_loop_figure(estimate: Estimate, element: ControlledElement) -> Figure:
    """Target and disturbance open loops."""
    with journal_figure(4.2) as figure:
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=(4, 5))
        open_loop(estimate, element, (above, below))
        above.set_title("", loc="left")
        figure.align_ylabels()
        _legend_above(figure, 1)
    return figure


def remnant_figure(recording: Recording, estimates: Sequence[Estimate]) -> Figure:
    """The remnant's spectrum as models have it, and that of the residuals."""
    with journal_figure(2.9) as figure:
        remnant(*estimates, recording=recording, axes=figure.subplots())
        _legend_above(figure)
    return figure


def band_figure(recording: Recording, estimate: Estimate) -> Figure:
    """What the recording tells at each frequency, and what an estimate makes of that."""
    with journal_figure(3.4) as figure:
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=(5, 2))
        band(recording, estimate, axes=(above, below))
        _legend_above(figure)
    return figure


def whiteness_figure(recording: Recording, estimate: Estimate) -> Figure:
    """Tests of the prediction errors of one estimate."""
    inputs = dict.fromkeys(channel.on for channel in estimate.model.channels)
    rows = 1 if len(inputs) == 1 else 2
    columns = 3 if rows == 1 else 2
    with journal_figure(2.2 * rows + 0.2) as figure:
        figure.set_layout_engine("constrained", w_pad=0.08, h_pad=0.06)
        panels = iter(figure.subplots(rows, columns, squeeze=False).ravel())
        autocorrelation(recording, estimate, axes=next(panels))
        for name in inputs:
            cross_correlation(recording, estimate, signal=name, axes=next(panels))
        normal_plot(recording, estimate, axes=next(panels))
        for rest in panels:
            rest.set_axis_off()
    return figure


def correlation_figure(estimates: Sequence[Estimate]) -> Figure:
    """Correlation matrices of estimates of one model, three or two in a row."""
    across = 3 if len(estimates[0].values) <= 7 else 2
    rows = math.ceil(len(estimates) / across)
    with journal_figure(2.5 * 3 / across * rows) as figure:
        panels = figure.subplots(rows, across, squeeze=False).ravel()
        for estimate, axes in zip(estimates, panels, strict=False):
            correlation(estimate, axes)
        for rest in panels[len(estimates) :]:
            rest.set_axis_off()
    return figure


def _legend_above(figure: Figure, columns: int = 5) -> None:
    """One legend for all axes, where it hides none of them."""
    handles, labels = figure.axes[0].get_legend_handles_labels()
    for axes in figure.axes:
        if (own := axes.get_legend()) is not None:
            own.remove()
    if labels:
        figure.legend(handles, labels, loc="outside upper left", ncols=columns, frameon=False)
