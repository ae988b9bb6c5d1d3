"""Figures of a study: one colour and marker for each method."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from pilotid.plots.style import (
    GRID,
    INK,
    WIDTH,
    colour_of,
    journal_figure,
    journal_style,
    log_ticks,
    marker_of,
)
from pilotid.study.scores import ALL, parameters_of
from pilotid.study.table import Comparison
from pilotid.support.numbers import Z95
from pilotid.support.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame

COLUMNS = 4
LONGEST = 34  # characters of a method's label
#: Multiple of the typical method's reach at which an axis of errors ends at the latest.
MOST = 4.0
BOUND = "#c9ced6"
#: Coverage [%] that is as good as it can be asked for, and the lowest that an axis shows.
BAND, LOWEST = (93.5, 96.5), 60.0
#: Reach of the axes of standardised errors and of normal quantiles.
REACH, QUANTILES = 4.0, 3.2


@contextmanager
def panelled(
    titles: Sequence[str], height: float, labels: tuple[str, str], columns: int = COLUMNS
) -> Iterator[tuple[Figure, list[Axes], Axes]]:
    """A figure with a panel for each title, and axes in the spare place for the legend."""
    from matplotlib.figure import Figure

    rows = -(-(len(titles) + 1) // columns)
    with journal_style():
        figure = Figure(figsize=(WIDTH, height * rows), layout="constrained")
        panels = list(figure.subplots(rows, columns, squeeze=False).flat)
        for title, axes in zip(titles, panels, strict=False):
            axes.set_title(title)
        for axes in panels[len(titles) :]:
            axes.axis("off")
        figure.supxlabel(labels[0], fontsize=8.0)
        if labels[1]:
            figure.supylabel(labels[1], fontsize=8.0)
        yield figure, panels[: len(titles)], panels[len(titles)]


def short(label: str) -> str:
    """A method's label as a figure has room for it, its middle left out where it is long."""
    return label if len(label) <= LONGEST else f"{label[: LONGEST - 13]}...{label[-10:]}"


def limits(ranges: Sequence[tuple[float, float]], floor: float) -> tuple[float, float]:
    """Ends of an axis that shows zero and most methods, where some are far off.

    Parameters
    ----------
    ranges
        What each method would like to see.
    floor
        Distance from zero that is always seen, for example the bound; NaN for none.
    """
    ends = np.array([r for r in ranges if np.isfinite(r).all()]).reshape(-1, 2)
    floor = 1.2 * floor if math.isfinite(floor) else 0.0
    reaches = np.sort(np.max(np.abs(ends), axis=1))
    reach = max(MOST * float(reaches[len(ends) // 2]), floor) if len(ends) else floor
    low = max(min([*ends[:, 0], -floor]), -reach)
    high = min(max([*ends[:, 1], floor]), reach)
    room = 0.06 * (high - low) or 1.0
    return float(low - room), float(high + room)


def _is_outside(axes: Axes, row: float, value: float, colour: str) -> bool:
    """Whether a point lies outside the axis: then a triangle at the edge has its value."""
    low, high = axes.get_xlim()
    if low <= value <= high or not math.isfinite(value):
        return False
    right = value > high
    place, inside = (high, -5) if right else (low, 5)
    axes.plot(place, row, ">" if right else "<", color=colour, markersize=4.5, clip_on=False)
    axes.annotate(f"{value:.3g}".replace("-", "\N{MINUS SIGN}"), (place, row),
                  (inside, 0), textcoords="offset points", ha="right" if right else "left",
                  va="center", fontsize=7.0)  # fmt: skip
    return True


def percent(rows: DataFrame) -> DataFrame:
    """Scores of a parameter by each method, with what has its unit in % of the true value.

    Parameters
    ----------
    rows
        Scores of one parameter, see `pilotid.study.scores.score`.
    """
    scale = 100.0 / rows.truth.abs().where(rows.truth != 0.0)
    sized = ["bias_se", "std", "rmse", "rmse_se", "mean_std_error", "crlb"]
    return rows.assign(bias=rows.bias_percent, **{name: scale * rows[name] for name in sized})


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
    labels, colours = [short(method) for method in methods], [colour_of(m) for m in methods]
    scored = study.scores[(study.scores.scenario == name) & study.scores.method.isin(methods)]
    panels_of = dict(iter(scored[scored.parameter != ALL].groupby("parameter", sort=False)))
    # The legend needs some inches, too.
    height = max(1.35, 0.62 + 0.155 * len(labels))
    label = ("error [% of true value]", "")
    with panelled(list(panels_of), height, label) as (figure, panels, spare):
        for index, (axes, rows) in enumerate(zip(panels, panels_of.values(), strict=True)):
            own = percent(rows)
            bound = own.crlb.iloc[0]
            if math.isfinite(bound):
                axes.axvspan(-bound, bound, color=BOUND, linewidth=0)
            axes.axvline(0.0, color=INK, linewidth=0.6)
            bias, error, std, claimed = (
                own[column].to_numpy(dtype=float)
                for column in ("bias", "bias_se", "std", "mean_std_error")
            )
            reach = np.nan_to_num(np.fmax(std, claimed))
            ranges = np.stack([bias - reach, bias + reach], axis=1)
            axes.set_xlim(*limits([(low, high) for low, high in ranges], bound))
            rows = np.array([
                row for row, value in enumerate(bias)
                if not _is_outside(axes, row, value, colours[row])
            ], dtype=int)  # fmt: skip
            own_colours = [colours[row] for row in rows]
            _draw_bars(axes, rows, bias[rows], claimed[rows], own_colours, 5.0, alpha=0.45)
            _draw_bars(axes, rows, bias[rows], std[rows], own_colours)
            _draw_bars(axes, rows, bias[rows], Z95 * error[rows], INK, cap=4.4)
            for row in rows:
                axes.plot(bias[row], row, marker_of(methods[row]), color=colours[row],
                          markersize=4.0, markeredgecolor="white", markeredgewidth=0.4)  # fmt: skip
            axes.locator_params(axis="x", nbins=5)
            axes.set_ylim(len(labels) - 0.4, -0.6)
            axes.set_yticks(range(len(labels)), [""] * len(labels) if index % COLUMNS else labels)
            axes.tick_params(axis="y", length=0)
        grey = "#888888"
        handles = [
            Line2D([], [], color=INK, marker="o", markersize=4, markerfacecolor=grey,
                   markeredgecolor="white", linewidth=0, label="mean error"),
            Line2D([], [], color=INK, marker="|", markersize=5, linewidth=1,
                   label="its 95 % interval\n(Monte Carlo)"),
            Line2D([], [], color=grey, linewidth=1, label="± standard deviation"),
            Line2D([], [], color=grey, alpha=0.45, linewidth=5,
                   label="± claimed standard\nerror (mean)"),
            Patch(color=BOUND, linewidth=0, label="± Cramér-Rao bound"),
        ]  # fmt: skip
        spare.legend(handles=handles, loc="center", frameon=False)
    return figure


def _draw_bars(
    axes: Axes,
    rows: FloatArray,
    middle: FloatArray | float,
    reach: FloatArray | float,
    colours: Sequence[str] | str,
    width: float = 1.0,
    *,
    cap: float = 0.0,
    alpha: float = 1.0,
) -> None:
    """Horizontal bars, all at once: an artist for each takes most of a report's time."""
    ends = (middle - reach, middle + reach)
    axes.hlines(rows, *ends, colors=colours, linewidth=width, alpha=alpha)
    if cap:
        axes.scatter(np.append(*ends), [*rows, *rows], s=cap**2, c=colours, marker="|",
                     linewidths=width)  # fmt: skip


def sweep(
    study: Comparison,
    points: Sequence[tuple[str, float]],
    labels: tuple[str, str],
) -> Figure:
    """Errors over what a family of scenarios varies, beside the bound.

    A panel a parameter, a line a method, all axes logarithmic.

    Parameters
    ----------
    study
        The study's numbers.
    points
        Scenarios and where they lie on the abscissa.
    labels
        Of abscissa and ordinate, with units.
    """
    points = sorted(points, key=lambda point: point[1])
    few = points if len(points) <= 5 else [points[i] for i in (0, len(points) // 2, -1)]
    place_of = dict(points)
    rows = study.scores[study.scores.scenario.isin(place_of) & (study.scores.parameter != ALL)]
    rows = rows.assign(x=rows.scenario.map(place_of)).sort_values("x", kind="stable")
    keys = list(rows.parameter[rows.scenario == points[0][0]].unique())
    with panelled(keys, 1.75, labels) as (figure, panels, spare):
        for key, axes in zip(keys, panels, strict=True):
            axes.set(xscale="log", yscale="log")
            own = percent(rows[rows.parameter == key])
            bounds = own.drop_duplicates("x")
            axes.plot(bounds.x, bounds.crlb, color=INK, linestyle="--",
                      linewidth=0.8, zorder=0)  # fmt: skip
            for place, method in enumerate(study.methods):
                curve = own.loc[(own.method == method) & (own.n > 0), ["x", "rmse", "rmse_se"]]
                shift = place - 0.5 * (len(study.methods) - 1)
                _draw_curve(axes, curve.to_numpy(dtype=float), method, shift)
            axes.set_xticks([x for _, x in few], [f"{x:.3g}" for _, x in few])
            axes.minorticks_off()
            log_ticks(axes, "y")
        _add_legend(spare, list(study.methods), "bound")
    return figure


def _draw_curve(axes: Axes, curve: FloatArray, method: str, place: float) -> None:
    """A method's line; a little beside the others, so that its bars are seen."""
    x, y, error = curve.T
    x = x * 1.02**place
    reach = Z95 * np.nan_to_num(error)
    bars = np.array([np.minimum(reach, 0.9 * np.abs(y)), reach])
    axes.errorbar(x, y, bars, color=colour_of(method), marker=marker_of(method), markersize=3.2,
                  linewidth=0.9, elinewidth=0.7)  # fmt: skip


def cost(rows: Sequence[Any]) -> Figure:
    """Loss with its interval over the median time of a fit; a line joins what nothing beats.

    Parameters
    ----------
    rows
        Scores of each method.
    """
    known = [row for row in rows if math.isfinite(row.loss) and row.seconds > 0.0]
    known.sort(key=lambda row: row.seconds)
    frontier: list[Any] = []
    for row in known:
        if not frontier or row.loss < frontier[-1].loss:
            frontier.append(row)
    with journal_figure(2.7) as figure:
        axes = figure.subplots()
        axes.axhline(1.0, color=INK, linewidth=0.8)
        axes.step([row.seconds for row in frontier], [row.loss for row in frontier],
                  where="post", color="#8a94a3", linewidth=0.9, zorder=0)  # fmt: skip
        for row in known:
            reach = np.nan_to_num([[row.loss - row.loss_lower], [row.loss_upper - row.loss]])
            axes.errorbar(row.seconds, row.loss, reach, color=colour_of(row.method),
                          marker=marker_of(row.method), markersize=5.0, linewidth=0.0,
                          elinewidth=0.9, label=short(row.method))  # fmt: skip
        axes.set(xscale="log", yscale="log")
        axes.margins(0.08)
        log_ticks(axes, "x")
        log_ticks(axes, "y")
        axes.set(xlabel="median time of a fit [s]", ylabel="loss (1: Cramér-Rao bound)")
        figure.legend(loc="outside right upper")
    return figure


def by_stratum(study: Comparison, name: str, methods: Sequence[str]) -> Figure:
    """Coverage with its interval: a panel a fact, a row a value of it, a point a method."""
    s = study.scores
    rows = s[(s.scenario == name) & (s.parameter == ALL) & s.method.isin(methods)]
    panels = {
        stratum: list(own.value.unique())
        for stratum, own in rows.groupby("stratum", sort=False)
        if stratum == ALL or own.value.nunique() > 1
    }
    low = max(LOWEST, min(90.0, 100.0 * rows.coverage_lower.min()) - 1.0)
    longest = max(map(len, panels.values()))
    height = 0.6 + longest * max(0.19, 0.06 + 0.035 * len(methods))
    dodge = min(0.34, 0.1 * (len(methods) - 1))
    shifts = dict(zip(methods, np.linspace(-dodge, dodge, len(methods)), strict=True))
    label = "95 % intervals that hold the truth [%]"
    titles = [f"{stratum} recordings" if stratum == ALL else stratum for stratum in panels]
    with panelled(titles, height, (label, ""), 3) as (figure, drawn, spare):
        for (stratum, values), axes in zip(panels.items(), drawn, strict=True):
            axes.axvspan(*BAND, color=BOUND, linewidth=0)
            axes.axvline(95.0, color=INK, linewidth=0.6)
            for place in range(len(values) - 1):
                axes.axhline(place + 0.5, color=GRID, linewidth=0.5)
            for row in rows[rows.stratum == stratum].itertuples():
                _draw_coverage(axes, values.index(row.value) + shifts[row.method], row, low)
            axes.set_yticks(range(len(values)), ["" if v == ALL else v for v in values])
            axes.set(ylim=(len(values) - 0.45, -0.55), xlim=(low, 100.6))
            axes.tick_params(axis="y", length=0)
        _add_legend(spare, methods)
    return figure


def _draw_coverage(axes: Axes, place: float, row: Any, low: float) -> None:
    value, colour = 100.0 * row.coverage_95, colour_of(row.method)
    if value < low:
        # Hollow, since the marker of a method may be a triangle, too.
        axes.plot(low, place, "<", color=colour, markersize=3.5, markerfacecolor="white",
                  clip_on=False)  # fmt: skip
    elif math.isfinite(value):
        ends = [100.0 * row.coverage_lower, 100.0 * row.coverage_upper]
        axes.plot(ends, [place, place], color=colour, linewidth=0.8, solid_capstyle="butt")
        axes.plot(value, place, marker_of(row.method), color=colour, markersize=3.2)


def by_parameter(study: Comparison, name: str, methods: Sequence[str]) -> Figure:
    """Standardised errors against normal quantiles: a panel a parameter, a line a method."""
    from scipy.special import betaincinv, ndtri

    def quantiles(count: int) -> FloatArray:
        return np.asarray(ndtri((np.arange(count) + 0.5) / count))

    rows = study.measured[study.measured.scenario == name]
    labels = ("quantile of a normal distribution", "error over claimed error")
    keys = parameters_of(rows)
    with panelled(keys, 1.75, labels) as (figure, panels, spare):
        for key, axes in zip(keys, panels, strict=True):
            own = rows[rows.parameter == key].dropna(subset="z")
            errors = {m: np.sort(own.z[own.method == m].to_numpy()) for m in methods}
            if count := max(z.size for z in errors.values()):
                # Where each of so many ordered normal variables lies 95 % of the time.
                place = np.arange(1, count + 1)
                low, high = (ndtri(betaincinv(place, place[::-1], p)) for p in (0.025, 0.975))
                axes.fill_between(quantiles(count), low, high, color=BOUND, linewidth=0)
            axes.plot([-REACH, REACH], [-REACH, REACH], color=INK, linewidth=0.6)
            for method, z in errors.items():
                axes.plot(quantiles(z.size), z, color=colour_of(method), linewidth=0.9,
                          marker=marker_of(method) if z.size <= 60 else "",
                          markersize=2.4)  # fmt: skip
            axes.set(xlim=(-QUANTILES, QUANTILES), ylim=(-REACH, REACH))
            axes.set_xticks([-2.0, 0.0, 2.0])
        _add_legend(spare, methods)
    return figure


def _add_legend(spare: Axes, methods: Sequence[str], reference: str = "") -> None:
    """Names of methods, and of a dashed line of reference."""
    for name in methods:
        spare.plot([], [], color=colour_of(name), marker=marker_of(name), markersize=4,
                   label=short(name))  # fmt: skip
    if reference:
        spare.plot([], [], color=INK, linestyle="--", linewidth=0.8, label=reference)
    columns = 2 if len(methods) > 8 else 1
    spare.legend(loc="center", frameon=False, ncols=columns, columnspacing=0.8)
