"""The correlation matrix of an estimate's parameters as a map with numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pilotid.estimates.estimate import Estimate
from pilotid.show.named import new_axes
from pilotid.show.style import SMALLEST
from pilotid.types import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

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
