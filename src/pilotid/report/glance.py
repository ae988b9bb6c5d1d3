"""The figure of a study's summary: all methods and parameters of a scenario at a glance."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pilotid.chance import Z95
from pilotid.report.figures import BOUND, name_rows
from pilotid.show.style import INK, WIDTH, colour_of, journal_style, log_ticks, marker_of
from pilotid.study.comparison import Cell
from pilotid.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def glance(cells: Sequence[Cell]) -> Figure:
    """Bias and rmse over the bound, and coverage: a point for each parameter, a row a method."""
    from matplotlib.figure import Figure

    with journal_style():
        figure = Figure(figsize=(WIDTH, max(1.4, 0.75 + 0.3 * len(cells))), layout="constrained")
        bias, ratio, coverage = figure.subplots(1, 3, sharey=True)
        bias.axvspan(-0.25, 0.25, color=BOUND, linewidth=0)
        ratio.axvline(1.0, color=INK, linewidth=0.8)
        coverage.axvline(95.0, color=INK, linewidth=0.8)
        for row, cell in enumerate(cells):
            _glance_row((bias, ratio, coverage), row, cell)
        name_rows(bias, [c.method for c in cells], cells, named=True)
        bias.set_xscale("symlog", linthresh=1.0)
        bias.set_xlabel("bias / bound")
        low, high = bias.get_xlim()
        bias.set_xlim(min(low, -1.2), max(high, 1.2))
        powers = [10.0**p for p in range(4)]
        ticks = [-p for p in reversed(powers)] + [0.0] + powers
        bias.set_xticks(ticks, [f"{t:g}".replace("-", "\N{MINUS SIGN}") for t in ticks])
        bias.set_xlim(min(low, -1.2), max(high, 1.2))
        ratio.set_xscale("log")
        log_ticks(ratio, "x")
        ratio.set_xlabel("rmse / bound")
        coverage.set_xlim(-3.0, 103.0)
        coverage.set_xlabel("95 % intervals that hold the truth [%]")
        for axes in (bias, ratio, coverage):
            for row in range(len(cells) - 1):
                axes.axhline(row + 0.5, color="#dddddd", linewidth=0.5)
    return figure


def _glance_row(axes: tuple[Axes, Axes, Axes], row: int, cell: Cell) -> None:
    style: dict[str, Any] = {
        "color": colour_of(cell.method),
        "marker": marker_of(cell.method),
        "markersize": 3.2,
        "elinewidth": 0.7,
        "linewidth": 0.0,
    }
    scores = cell.percent
    places = row + np.linspace(-0.36, 0.36, len(scores))

    def points(panel: Axes, values: FloatArray, below: FloatArray, above: FloatArray) -> None:
        known = np.isfinite(values)  # what is not finite has no point
        panel.errorbar(values[known], places[known],
                       xerr=np.array([below, above])[:, known], **style)  # fmt: skip

    bias = np.array([score.bias / score.bound for score in scores])
    reach = np.array([Z95 * score.bias_se / score.bound for score in scores])
    points(axes[0], bias, reach, reach)
    ratio = np.array([score.ratio for score in scores])
    reach = np.array([Z95 * score.ratio_se for score in scores])
    points(axes[1], ratio, np.minimum(reach, 0.9 * ratio), reach)
    covered = 100.0 * np.array([score.coverage for score in scores])
    low, high = 100.0 * np.array([score.coverage_interval for score in scores]).reshape(-1, 2).T
    points(axes[2], covered, np.abs(low - covered), np.abs(high - covered))
