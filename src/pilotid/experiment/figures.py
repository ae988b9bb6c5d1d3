"""Figures of an experiment: variances and their parts, estimates, and group responses."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

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
    from matplotlib.figure import Figure as Drawing

ACROSS = 4  # panels in a row
#: Of conditions or parts in their order, also for those who see few colours (Tol, 2021).
COLOURS = ("#4477AA", "#EE6677", "#228833", "#CCBB44", "#66CCEE", "#AA3377", "#BBBBBB")
MARKERS = "osD^vP"
#: What variances are made of.
PARTS = ("target", "disturbance", "remnant")


def figures(results: Results) -> Iterator[Figure]:
    """The responses of groups, and variances and estimates, of each stratum and method."""
    strata = results.responses.groupby("stratum", sort=False)
    for place, (stratum, rows) in enumerate(strata, 1):
        words = (
            f"Responses at the forcing lines{stratum and f', {stratum}'}: means over subjects, in "
            "which what is poorly known weighs little, 95 % intervals; no model of the pilot."
        )
        yield Figure(f"responses-{place}", responses_figure(rows), words)
    for place, (title, rows) in enumerate(results.groups(), 1):
        shown = (rows["kind"] != "measured") | rows["parameter"].str.startswith("var_")
        if len(rows := rows[shown & (rows["left_out"] == "")]):
            words = f"{title}: means over subjects, 95 % intervals. Dots are subjects."
            yield Figure(f"estimates-{place}", means_figure(rows), words)


def means_figure(rows: DataFrame) -> Drawing:
    """Means over subjects in each condition with 95 % intervals, a panel for each quantity.

    A variance that is split is a stack of its parts, with the interval of each at its top.

    Parameters
    ----------
    rows
        Rows of one stratum and method that count, with columns subject and condition.
    """
    units = dict(zip(rows["parameter"], rows["unit"], strict=True))
    parts_of = {key: [f"{key}_{p}" for p in PARTS if f"{key}_{p}" in units] for key in units}
    keys = [key for key in units if not any(key in parts for parts in parts_of.values())]
    table = rows.groupby(["parameter", "condition"])["value"].agg(["mean", "sem", "count"])
    conditions = in_order(rows["condition"])
    across, down = min(ACROSS, len(keys)), math.ceil(len(keys) / ACROSS)
    with journal_figure(1.75 * down + 0.65) as figure:
        for place, key in enumerate(keys, 1):
            axes, top = figure.add_subplot(down, across, place), np.zeros(len(conditions))
            for part, colour in zip(parts_of[key] or [key], COLOURS, strict=False):
                of = table.loc[part].reindex(conditions)
                label = part.removeprefix(f"{key}_") if part != key else None
                axes.bar(conditions, of["mean"], 0.7, bottom=top, color=colour, label=label)
                top += of["mean"].fillna(0.0).to_numpy()
                # Of one subject there is none.
                reach = np.nan_to_num(t.isf(0.025, of["count"] - 1) * of["sem"].to_numpy())
                axes.errorbar(conditions, top, reach, fmt="none", ecolor=INK, elinewidth=0.7)
            one = rows[rows["parameter"] == key]
            axes.plot(one["condition"], one["value"], ".", color=INK, markersize=3.0)
            axes.set_title(with_unit(symbol(key), unit_words(units[key])), loc="left")
            draw_grid(axes, "y")
        _legend(figure)
    return figure


def _legend(figure: Drawing) -> None:
    """What the first panel has names of, below."""
    names = figure.axes[0].get_legend_handles_labels()
    figure.legend(*names, loc="outside lower center", ncols=7, frameon=False)


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
                style = Style(COLOURS[place % 7], MARKERS[place // 7 % len(MARKERS)])
                bode.points(response, 0, style, condition)
            bode.frame()
            axes[0].set_title(f"{channel} channel, magnitude", loc="left")
        _legend(figure)
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
