"""Plots of tests of prediction errors, and of the correlations of parameters."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pilotid.estimate.estimate import Estimate
from pilotid.likelihood.diagnostics import Whitened, correlations, prediction_errors
from pilotid.plots.style import INK, SMALLEST, Named, draw_grid, legend, named, new_axes
from pilotid.recording.recording import Recording
from pilotid.support.numbers import Z95
from pilotid.support.types import FloatArray, InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes


SECONDS = 2.5  # of lags
SHADE = "#e8e8e8"
SHOWN = 400  # points of a normal plot


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
    for own, errors, limit in _whitened(recording, estimates):
        lags = range(1, 1 + _reach(errors))
        _line(axes, own, errors.dt, lags, correlations(errors.errors, errors.errors, lags))
        _limits(axes, limit)
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
    for own, errors, limit in _whitened(recording, estimates):
        if signal not in errors.inputs:
            taken = ", ".join(c.on for c in own.estimate.model.channels)
            raise InputError(
                f"no channel of model {own.estimate.model.name} acts on {signal}: choose {taken}"
            )
        reach = _reach(errors)
        lags = range(-reach // 2, 1 + reach)
        found = correlations(errors.errors, errors.inputs[signal], lags)
        _line(axes, own, errors.dt, lags, found)
        _limits(axes, limit)
    axes.axvspan(-0.5 * SECONDS, 0.0, color=SHADE, linewidth=0.0, zorder=-1.0)
    axes.set_ylabel(f"correlation with {signal} [-]")
    return _over_lags(axes, -0.5 * SECONDS)


def normal_plot(recording: Recording, *estimates: Estimate, axes: Axes | None = None) -> Axes:
    """Prediction errors in order, against what normal ones of the same variance would be.

    Parameters
    ----------
    recording, estimates, axes
        As for `autocorrelation`.
    """
    from scipy.special import ndtri

    axes = axes if axes is not None else new_axes()
    axes.axline((0.0, 0.0), slope=1.0, color=INK, linewidth=0.6)
    for own, errors, _ in _whitened(recording, estimates):
        ordered = np.sort(errors.errors.ravel()) / np.std(errors.errors)
        expected = ndtri((np.arange(ordered.size) + 0.5) / ordered.size)
        # All of the tails, where it is decided, and some of the middle.
        ends = 40
        middle = np.linspace(0, ordered.size - 1, SHOWN).round().astype(int)
        tails = np.arange(min(ends, ordered.size))
        kept = np.unique(np.concatenate([middle, tails, ordered.size - 1 - tails]))
        axes.plot(expected[kept], ordered[kept], own.marker, color=own.colour, markersize=2.5,
                  markerfacecolor="white", markeredgewidth=0.6, label=own.label)  # fmt: skip
    draw_grid(axes)
    axes.set(xlabel="normal quantile [-]", ylabel="prediction error [std. dev.]")
    if len(estimates) > 1:
        legend(axes)
    return axes


def _whitened(
    recording: Recording, estimates: tuple[Estimate, ...]
) -> list[tuple[Named, Whitened, float]]:
    """Estimates with values, their prediction errors, and the limit of 95 % of correlations."""
    found = []
    for own in named(estimates):
        if own.known:
            errors = prediction_errors(recording, own.estimate)
            found.append((own, errors, Z95 / float(np.sqrt(errors.errors.size))))
    return found


def _reach(errors: Whitened) -> int:
    """Lags shown, in samples."""
    return min(round(SECONDS / errors.dt), int(errors.errors.shape[1]) - 1)


def _line(axes: Axes, own: Named, dt: float, lags: range, found: FloatArray) -> None:
    (line,) = axes.plot(dt * np.array(lags), found, color=own.colour, label=own.label)
    line.set(linestyle=own.dash, linewidth=1.0)


def _limits(axes: Axes, limit: float) -> None:
    for side in (-limit, limit):
        axes.axhline(side, color=INK, linewidth=0.7, linestyle=(0, (4.0, 2.0)))


def _over_lags(axes: Axes, begin: float) -> Axes:
    axes.axhline(0.0, color=INK, linewidth=0.5)
    drawn = [np.asarray(line.get_ydata(), float) for line in axes.get_lines()]
    reach = 1.25 * max(float(np.max(np.abs(own))) for own in drawn)
    if reach > 0.0:
        axes.set_ylim(-reach, reach)
    axes.set_xlim(begin, SECONDS)
    draw_grid(axes)
    axes.set_xlabel("lag [s]")
    if len(axes.get_legend_handles_labels()[1]) > 1:
        legend(axes)
    return axes


DARK = 0.6  # size of a correlation from which on its field is too dark for dark numbers


def correlation(estimate: Estimate, axes: Axes | None = None) -> Axes:
    """Claimed correlations of all pairs of parameters, as colours and numbers.

    Dark fields are strong correlations of either sign; the number tells the sign.

    Parameters
    ----------
    estimate
        An estimate with values.
    axes
        Where to draw; None makes a new figure by pyplot.

    Raises
    ------
    InputError
        If the estimate has no values.
    """
    if not np.isfinite(estimate.values).all():
        raise InputError(f"{estimate.method} has no values, so that there are no correlations")
    axes = axes if axes is not None else new_axes(3.6, 3.8)
    with np.errstate(invalid="ignore", divide="ignore"):
        matrix = estimate.correlation
    keys = estimate.model.keys
    below = np.tril(np.ones(matrix.shape, dtype=bool), -1)[1:, :-1]
    shown = np.ma.masked_where(~below, matrix[1:, :-1])
    edges = np.arange(len(keys)) - 0.5
    axes.pcolormesh(edges, edges, shown, cmap="PuOr_r", vmin=-1.0, vmax=1.0, edgecolors="white",
                    linewidth=0.5)  # fmt: skip
    axes.invert_yaxis()
    for row, column in zip(*np.nonzero(below), strict=True):
        value = float(shown[row, column])
        if np.isfinite(value):
            axes.text(column, row, _number(value), ha="center", va="center", fontsize=SMALLEST,
                      color="white" if abs(value) > DARK else "black")  # fmt: skip
    axes.set_xticks(np.arange(len(keys) - 1), keys[:-1], rotation=45, ha="right",
                    rotation_mode="anchor")  # fmt: skip
    axes.set_yticks(np.arange(len(keys) - 1), keys[1:])
    axes.tick_params(length=0.0)
    for spine in axes.spines.values():
        spine.set_visible(False)
    axes.set_title(estimate.method, loc="left")
    return axes


def _number(value: float) -> str:
    """Two decimals without the zero in front: -.97."""
    text = f"{value:.2f}".replace("0.", ".").replace("-", "\N{MINUS SIGN}")
    return "0" if text.strip("\N{MINUS SIGN}") == ".00" else text
