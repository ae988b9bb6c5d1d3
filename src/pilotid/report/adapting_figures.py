"""Figures of pilots who change: what methods make of them, beside the truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from pilotid.show.style import INK, WIDTH, colour_of, journal_style
from pilotid.study.comparison import Cell
from pilotid.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: An axis shows this many times the span of the truth at the most.
ROOM = 4.0
ABREAST = 4  # methods side by side
UNITS = {"tlead": "s", "tdvis": "s", "fnm": "rad/s"}


def paths(cells: Sequence[Cell], truth: Mapping[str, Sequence[float]]) -> Figure:
    """Median and 5 to 95 % range of trajectories: a row a parameter, a column a method.

    Parameters
    ----------
    cells
        Methods in one scenario, with trajectories.
    truth
        Times, by the name ``time``, and the true parameters at them.
    """
    from matplotlib.figure import Figure

    keys = [key for key in truth if key != "time" and np.ptp(truth[key]) > 0.0]
    time = np.array(truth["time"])
    columns = min(ABREAST, len(cells))
    blocks = [cells[i : i + columns] for i in range(0, len(cells), columns)]
    with journal_style():
        height = 0.4 + (1.25 * len(keys) + 0.2) * len(blocks)
        figure = Figure(figsize=(WIDTH, height), layout="constrained")
        panels = figure.subplots(len(blocks) * len(keys), columns, squeeze=False, sharex=True)
        for number, row in enumerate(panels):
            block, key = blocks[number // len(keys)], keys[number % len(keys)]
            for place, axes in enumerate(row):
                if place >= len(block):
                    axes.axis("off")
                    continue
                _panel(axes, time, np.array(truth[key]), block[place], key)
                if place:
                    axes.set_yticklabels([])
                if key == keys[0]:
                    method = block[place].method
                    axes.set_title(method, color=colour_of(method))
            unit = UNITS.get(key, "")
            row[0].set_ylabel(f"{key} [{unit}]" if unit else key)
        figure.supxlabel("time from the start of the measurement window [s]", fontsize=8.0)
    return figure


def _panel(axes: Axes, time: FloatArray, truth: FloatArray, cell: Cell, key: str) -> None:
    own = cell.paths(key)
    known = np.isfinite(own).any(axis=0) if own.size else np.zeros(time.size, dtype=bool)
    if known.any():
        low, middle, high = np.nanquantile(own[:, known], (0.05, 0.5, 0.95), axis=0)
        colour = colour_of(cell.method)
        axes.fill_between(time[known], low, high, color=colour, alpha=0.25, linewidth=0)
        axes.plot(time[known], middle, color=colour, linewidth=1.2)
    axes.plot(time, truth, color=INK, linewidth=0.9, linestyle=(0, (3, 2)))
    axes.set_xlim(float(time[0]), float(time[-1]))
    axes.locator_params(axis="x", nbins=5)
    low, high = float(truth.min()), float(truth.max())
    reach = 0.5 * (ROOM - 1.0) * (high - low)
    axes.set_ylim(max(0.0, low - reach), high + reach)
