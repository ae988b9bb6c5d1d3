"""Frequency responses on a pair of axes: lines, bands and points, all on the same turn."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from pilotid.chance import Z95
from pilotid.show.style import GRID, Dash, log_ticks
from pilotid.types import ComplexArray, FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TURNS = (15.0, 45.0, 90.0, 180.0, 360.0)  # degrees between ticks


class Bode:
    """Magnitude and phase over frequency.

    Parameters
    ----------
    axes
        Of magnitude and phase.
    omega
        Frequencies of lines and bands [rad/s], ascending, shape (n,).
    """

    def __init__(self, axes: tuple[Axes, Axes], omega: FloatArray) -> None:
        self.above, self.below = axes
        self.omega = omega
        self._phase: FloatArray | None = None

    def line(self, response: ComplexArray, color: str, label: str, linestyle: Dash = "-") -> None:
        """Draw a response at `omega`, shape (n,)."""
        phase = np.rad2deg(self._turned(response))
        for axes, y in ((self.above, np.abs(response)), (self.below, phase)):
            axes.plot(self.omega, y, color=color, linestyle=linestyle, linewidth=1.2, label=label)

    def band(self, response: ComplexArray, errors: FloatArray, color: str) -> None:
        """Shade 95 % about a response at `omega`.

        Parameters
        ----------
        response
            The response, shape (n,).
        errors
            Standard errors of log-magnitude and phase [rad], shape (2, n).
        color
            Of the shade.
        """
        size, phase, reach = np.abs(response), self._turned(response), Z95 * errors
        # Further than this the axes never reach, and exponentials might.
        ratio = np.exp(np.minimum(reach[0], 50.0))
        low, high = np.rad2deg(phase - reach[1]), np.rad2deg(phase + reach[1])
        for axes, ends in ((self.above, (size / ratio, size * ratio)), (self.below, (low, high))):
            axes.fill_between(self.omega, *ends, color=color, alpha=0.2, linewidth=0.0)

    def points(
        self,
        omega: FloatArray,
        response: ComplexArray,
        errors: FloatArray,
        near: ComplexArray | None,
        color: str,
        marker: str,
        label: str,
    ) -> None:
        """Draw estimated responses with bars that hold 95 %.

        Parameters
        ----------
        omega, response
            Frequencies [rad/s] and responses, shape (points,).
        errors
            Root mean square of |response - true response|, shape (points,).
        near
            Response at `self.omega` on whose turn the points belong; None if there is none.
        color, marker, label
            How they look, and what they are called.
        """
        from matplotlib.axes import Axes

        size = np.abs(response)
        # Each part, real and imaginary, has half of the error's power.
        reach = Z95 * errors / np.sqrt(2.0)
        if near is None:
            phase = self._turned(response)
        else:
            line = np.interp(omega, self.omega, self._turned(near))
            phase = line + np.angle(response * np.exp(-1j * line))
        draw = partial(
            Axes.errorbar,
            color=color,
            fmt=marker,
            markersize=4.0,
            ecolor=(color, 0.5),
            elinewidth=0.8,
            markerfacecolor="white",
        )
        # A bar that reached down to zero would reach to minus infinity here.
        bars = np.array([np.minimum(reach, 0.98 * size), reach])
        draw(self.above, omega, size, bars, label=label or None)
        known = reach < size  # others say nothing of the phase
        turned, share = np.rad2deg(phase[known]), np.rad2deg((reach / size)[known])
        draw(self.below, omega[known], turned, share)

    def _turned(self, response: ComplexArray) -> FloatArray:
        """Phase [rad] without jumps, on the turn on which the first response began."""
        phase = np.unwrap(np.angle(response))
        if self._phase is None:
            self._phase = phase
        turns = np.round((self._phase[0] - phase[0]) / (2.0 * np.pi))
        return np.asarray(phase + 2.0 * np.pi * turns)

    def frame(self) -> None:
        """Scales, labels and limits; lines and points decide on these, bands and bars do not."""
        from matplotlib.ticker import MultipleLocator

        self.above.set_yscale("log")
        for axes in (self.above, self.below):
            axes.set_xscale("log")
            axes.set_xlim(self.omega[0], self.omega[-1])
            axes.grid(color=GRID, linewidth=0.5)
            axes.set_axisbelow(True)
            axes.minorticks_off()
            log_ticks(axes, "x")
        sizes, phases = _drawn(self.above), _drawn(self.below)
        sizes = sizes[sizes > 0.0]
        if sizes.size:
            self.above.set_ylim(0.6 * np.min(sizes), 1.7 * np.max(sizes))
        if phases.size:
            low, high = np.min(phases) - 20.0, np.max(phases) + 20.0
            self.below.set_ylim(low, high)
            step = next((s for s in TURNS if high - low < 7.0 * s), TURNS[-1])
            self.below.yaxis.set_major_locator(MultipleLocator(step))
        log_ticks(self.above, "y")
        self.above.tick_params(axis="x", labelbottom=False)
        self.below.set_ylabel("phase [deg]")
        self.below.set_xlabel("frequency [rad/s]")


def _drawn(axes: Axes) -> FloatArray:
    """All ordinates of lines and points."""
    every = [np.asarray(line.get_ydata(), float) for line in axes.get_lines()]
    return np.concatenate([np.zeros(0), *every])
