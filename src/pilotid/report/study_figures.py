"""Figures of a study: one colour and marker for each method."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from pilotid.plots.style import INK, WIDTH, colour_of, journal_style, marker_of
from pilotid.study.scores import ALL
from pilotid.study.table import Comparison
from pilotid.support.numbers import Z95
from pilotid.support.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame

COLUMNS = 4
LONGEST = 34  # characters of a method's label
#: Multiple of the typical method's extent at which an axis of errors ends at the latest.
MEDIANS = 4.0
BOUND = "#c9ced6"


@contextmanager
def panelled(
    titles: Sequence[str], height: float, labels: tuple[str, str]
) -> Iterator[tuple[Figure, list[Axes], Axes]]:
    """A figure with a panel for each title, and axes in the spare place for the legend."""
    from matplotlib.figure import Figure

    rows = -(-(len(titles) + 1) // COLUMNS)
    with journal_style():
        figure = Figure(figsize=(WIDTH, height * rows), layout="constrained")
        panels = list(figure.subplots(rows, COLUMNS, squeeze=False).flat)
        for title, axes in zip(titles, panels, strict=False):
            axes.set_title(title)
        for axes in panels[len(titles) :]:
            axes.axis("off")
        figure.supxlabel(labels[0], fontsize=8.0)
        if labels[1]:
            figure.supylabel(labels[1], fontsize=8.0)
        yield figure, panels[: len(titles)], panels[len(titles)]


def errors(study: Comparison, name: str) -> Figure:
    """Mean error, scatter and claimed standard error beside the bound, by parameter and method.

    Parameters
    ----------
    study, name
        The study, and a scenario that is no population.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    tried = study.of(name)
    methods = list(tried.method[tried.usable > 0])
    scored = study.scores[(study.scores.scenario == name) & study.scores.method.isin(methods)]
    panels_of = dict(iter(scored[scored.parameter != ALL].groupby("parameter", sort=False)))
    labels = [m if len(m) <= LONGEST else f"{m[: LONGEST - 13]}...{m[-10:]}" for m in methods]
    # The legend needs some inches, too.
    height = max(1.35, 0.62 + 0.155 * len(methods))
    label = ("error [% of true value]", "")
    with panelled(list(panels_of), height, label) as (figure, panels, spare):
        for index, (axes, rows) in enumerate(zip(panels, panels_of.values(), strict=True)):
            _draw_errors(axes, rows)
            axes.set_ylim(len(labels) - 0.4, -0.6)
            axes.set_yticks(range(len(labels)), [""] * len(labels) if index % COLUMNS else labels)
        grey: dict[str, Any] = {"color": "#888888"}
        handles = [
            Line2D([], [], **grey, marker="o", linewidth=0, label="mean error"),
            Line2D([], [], color=INK, marker="|", label="its 95 % interval\n(Monte Carlo)"),
            Line2D([], [], **grey, label="± standard deviation"),
            Line2D([], [], **grey, alpha=0.45, linewidth=5, label="± claimed standard\nerror"),
            Patch(color=BOUND, linewidth=0, label="± Cramér-Rao bound"),
        ]
        spare.legend(handles=handles, loc="center", frameon=False)
    return figure


def _draw_errors(axes: Axes, scores: DataFrame) -> None:
    """One parameter's errors [% of the truth], a row a method; what lies far off at the edge."""
    scale = 100.0 / scores.truth.abs().where(scores.truth != 0.0)
    columns = ("bias", "bias_se", "std", "mean_std_error", "crlb")
    scaled = (scale * scores[column] for column in columns)
    bias, error, std, claimed, bounds = (own.to_numpy(dtype=float) for own in scaled)
    extents = np.abs(bias) + np.nan_to_num(np.fmax(std, claimed))
    reach = reach_of(extents, float(bounds[0]))
    if math.isfinite(bounds[0]):
        axes.axvspan(-bounds[0], bounds[0], color=BOUND, linewidth=0)
    axes.axvline(0.0, color=INK, linewidth=0.6)
    axes.set_xlim(-reach, reach)
    for row, method in enumerate(scores.method):
        colour, middle = colour_of(method), bias[row]
        if abs(middle) > reach:
            right = middle > 0.0
            axes.plot(math.copysign(reach, middle), row, ">" if right else "<", color=colour,
                      markersize=4.5, clip_on=False)  # fmt: skip
            axes.annotate(f"{middle:.3g}", (math.copysign(reach, middle), row),
                          (-5 if right else 5, 0), textcoords="offset points", va="center",
                          ha="right" if right else "left", fontsize=7.0)  # fmt: skip
            continue
        for half, width, alpha in ((claimed[row], 5.0, 0.45), (std[row], 1.0, 1.0)):
            axes.plot([middle - half, middle + half], [row, row], color=colour, linewidth=width,
                      alpha=alpha, solid_capstyle="butt")  # fmt: skip
        half = Z95 * error[row]
        axes.plot([middle - half, middle + half], [row, row], "|-", color=INK, linewidth=1.0,
                  markersize=4.4)  # fmt: skip
        axes.plot(middle, row, marker_of(method), color=colour, markersize=4.0,
                  markeredgecolor="white", markeredgewidth=0.4)  # fmt: skip
    axes.locator_params(axis="x", nbins=5)
    axes.tick_params(axis="y", length=0)


def reach_of(extents: FloatArray, bound: float) -> float:
    """Half of an axis about zero that shows most methods, and the bound, where some are far off."""
    known = extents[np.isfinite(extents)]
    typical = min(float(known.max()), MEDIANS * float(np.median(known))) if known.size else 0.0
    return 1.06 * max(typical, 1.2 * bound if math.isfinite(bound) else 0.0) or 1.0
