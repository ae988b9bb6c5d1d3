"""Figures of an experiment: variances and their parts, estimates, and group responses."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from pandas import DataFrame
from scipy.stats import t

from pilotid.estimate.quantities import FrequencyResponse, symbol, unit_words
from pilotid.experiment.files import in_order
from pilotid.experiment.results import Results
from pilotid.plots.page import Figure
from pilotid.plots.responses import Bode
from pilotid.plots.style import INK, Style, draw_grid, journal_figure, with_unit
from pilotid.support.numbers import Z95

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Drawing

ACROSS = 4  # panels in a row
#: Of subjects in their order, told apart with a colour vision deficiency, too (Tol, 2021).
COLOURS = ("#4477AA", "#EE6677", "#228833", "#CCBB44", "#66CCEE", "#AA3377", "#BBBBBB")
MARKERS = "osD^vP"
#: What variances are made of.
PARTS = ("target", "disturbance", "remnant")


def figures(results: Results) -> Iterator[Figure]:
    """Variances and estimates of each stratum and method, and the responses of groups."""
    groups = [(title, rows[rows["left_out"] == ""]) for title, rows in results.groups()]
    split = [(title, rows) for title, rows in groups if "var_e_remnant" in {*rows["parameter"]}]
    for place, (title, rows) in enumerate(split, 1):
        words = f"What variances are made of ({title}): means over subjects, 95 % intervals."
        yield Figure(f"variances-{place}", variances_figure(rows), words)
    strata = results.responses.groupby("stratum", sort=False)
    for place, (stratum, rows) in enumerate(strata, 1):
        words = (
            f"{', '.join(filter(None, ['Responses at the forcing lines', stratum]))}: means over "
            "subjects, in which coefficients that are poorly known weigh little, 95 % intervals; "
            "no model of the pilot."
        )
        yield Figure(f"responses-{place}", responses_figure(rows), words)
    fits = [(title, rows) for title, rows in groups if len(rows[rows["method"] != "measured"])]
    for place, (title, rows) in enumerate(fits, 1):  # the tall ones last, for fewer pages
        words = f"{title}. Bars: 95 % from the claimed errors."
        yield Figure(f"estimates-{place}", estimates_figure(rows), words)


def estimates_figure(rows: DataFrame) -> Drawing:
    """Estimates over conditions, a panel for each quantity.

    Parameters
    ----------
    rows
        Rows of one stratum and method that count, with columns subject and condition.
    """
    keys = [*dict.fromkeys(rows["parameter"])]
    conditions, subjects = in_order(rows["condition"]), in_order(rows["subject"])
    rows = rows.assign(at=rows["condition"].map(conditions.index))
    across, down = min(ACROSS, len(keys)), math.ceil(len(keys) / ACROSS)
    with journal_figure(1.75 * down + 0.4) as figure:
        for place, key in enumerate(keys, 1):
            axes = figure.add_subplot(down, across, place)
            _panel(axes, rows[rows["parameter"] == key], subjects)
            axes.set_xticks(range(len(conditions)), conditions)
            axes.set_xlim(-0.6, len(conditions) - 0.4)
        _legend(figure, *figure.axes[0].get_legend_handles_labels())
    return figure


def _look(place: int) -> Style:
    """Colour and marker of a subject or condition; no two of 42 look alike."""
    return Style(COLOURS[place % 7], MARKERS[place // 7 % len(MARKERS)])


def _legend(figure: Drawing, handles: Iterable[Any], labels: Iterable[str]) -> None:
    figure.legend([*handles], [*labels], loc="outside lower center", ncols=7, frameon=False)


def _panel(axes: Axes, rows: DataFrame, subjects: Sequence[str]) -> None:
    for who, subject in enumerate(subjects):
        one = rows[rows["subject"] == subject]
        reach = one[["lower_95", "upper_95"]].sub(one["value"], axis=0).abs().fillna(0.0)
        colour, marker, _ = _look(who)
        x = one["at"] + 0.48 * ((who + 0.5) / len(subjects) - 0.5)
        axes.errorbar(x.to_numpy(), one["value"].to_numpy(), reach.to_numpy().T, color=colour,
                      fmt=f"-{marker}", linewidth=0.5, markersize=3.0, elinewidth=0.9,
                      label=f"subject {subject}")  # fmt: skip
    means = rows.groupby("at")["value"].mean()
    ends = means.index - 0.36, means.index + 0.36
    axes.hlines(means, *ends, color=INK, linewidth=1.2, label="mean over subjects")
    draw_grid(axes, "y")
    first = rows.iloc[0]
    axes.set_title(with_unit(symbol(first["parameter"]), unit_words(first["unit"])), loc="left")


def variances_figure(rows: DataFrame) -> Drawing:
    """Variances of e, u and x over conditions, stacked.

    Bars are 95 % intervals of the mean over subjects: of a total, and of each part.

    Parameters
    ----------
    rows
        Measured rows of one stratum that count.
    """
    conditions = in_order(rows["condition"])
    table = rows.groupby(["parameter", "condition"])["value"].agg(["mean", "sem", "count"])
    signals = [name for name in "eux" if f"var_{name}_remnant" in table.index]
    with journal_figure(2.4) as figure:
        panels = figure.subplots(1, len(signals), squeeze=False)[0]
        for axes, name in zip(panels, signals, strict=True):
            top = np.zeros(len(conditions))
            for part, colour in zip(PARTS, COLOURS, strict=False):
                if f"var_{name}_{part}" not in table.index:
                    continue
                parts = table.loc[f"var_{name}_{part}"].reindex(conditions)
                axes.bar(conditions, parts["mean"], 0.7, bottom=top, color=colour, label=part)
                top = top + parts["mean"].to_numpy()
                # Of one subject there is none.
                reach = np.nan_to_num(t.isf(0.025, parts["count"] - 1) * parts["sem"].to_numpy())
                axes.errorbar(conditions, top, reach, fmt="none", ecolor=INK, elinewidth=0.7)
            unit = rows.loc[rows["parameter"] == f"var_{name}", "unit"].iloc[0]
            title = with_unit(symbol(f"var_{name}"), unit_words(unit) or f"{name}²")
            axes.set_title(title, loc="left")
            draw_grid(axes, "y")
        _legend(figure, *panels[0].get_legend_handles_labels())
    return figure


def responses_figure(responses: DataFrame) -> Drawing:
    """The group's frequency responses at the forcing lines, magnitude above phase, by channel.

    Parameters
    ----------
    responses
        Rows of one stratum that count: condition, channel, omega [rad/s], real, imag, std.

    Notes
    -----
    The mean over subjects weighs a coefficient by its inverse variance, which is that of its own
    error and of the subjects' scatter at the line together, so that one that is poorly known counts
    little; bars are 95 % intervals.
    """
    channels = [*dict.fromkeys(responses["channel"])]
    conditions = in_order(responses["condition"])
    lines = np.array([0.9, 1.1]) * [responses["omega"].min(), responses["omega"].max()]
    with journal_figure(3.0) as figure:
        panels = figure.subplots(2, len(channels), squeeze=False, sharex=True, height_ratios=(3, 2))
        for axes, channel in zip(panels.T, channels, strict=True):
            of_channel, bode = responses[responses["channel"] == channel], Bode(tuple(axes), lines)
            for condition, rows in of_channel.groupby("condition"):
                place, by_line = conditions.index(condition), rows.groupby("omega")
                mean, error = zip(*(_weighted(of) for _, of in by_line), strict=True)
                omega = np.array([*by_line.groups]) * (1.0 + 0.02 * (place - len(conditions) / 2))
                covariance = np.diag(np.tile(np.square(error) / Z95**2, 2))
                response = FrequencyResponse(omega, np.array([mean]), covariance)
                bode.points(response, 0, _look(place), condition)
            bode.frame()
            axes[0].set_title(f"{channel} channel, magnitude", loc="left")
        _legend(figure, *panels[0, 0].get_legend_handles_labels())
    return figure


def _weighted(of: DataFrame) -> tuple[complex, float]:
    """Mean of coefficients weighted by their inverse variance, and half of its 95 % interval."""
    values = of["real"].to_numpy() + 1j * of["imag"].to_numpy()
    errors = of["std"].to_numpy() ** 2
    middle = np.median(values.real) + 1j * np.median(values.imag)
    between = max(float(np.median(np.abs(values - middle) ** 2 - errors)), 0.0)
    weights, others = 1.0 / (errors + between + 1e-300), len(values) - 1
    mean = complex(np.average(values, weights=weights))
    scatter = float(np.average(np.abs(values - mean) ** 2, weights=weights)) / max(others, 1)
    reach = float(t.isf(0.025, others)) if others else Z95
    return mean, reach * math.sqrt(max(scatter, 1.0 / float(weights.sum())) / 2.0)
