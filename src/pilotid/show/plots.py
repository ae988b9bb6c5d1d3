"""Plots of recordings and estimates that take and return matplotlib axes.

For notebooks and for pages alike::

    plot.signals(recording, mle, fourier)
    plot.describing_function(mle, fourier, channel="visual")

Functions of several estimates draw what there is of those that failed.
"""

from __future__ import annotations

from pilotid.show.residuals import autocorrelation, correlation, cross_correlation, normal_plot
from pilotid.show.responses import describing_function, open_loop
from pilotid.show.signals import residual, signals
from pilotid.show.spectra import band, remnant

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
