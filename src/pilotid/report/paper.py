"""The page that repeats a paper: its tables and figures in their order, its numbers beside ours.

What is said about them is in the template; here are the numbers.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pilotid.datasets import SCENARIOS
from pilotid.datasets.signals import paper_disturbance, paper_target
from pilotid.plots.page import Figure, write_page
from pilotid.plots.style import INK, Style, draw_grid, journal_figure, style_of
from pilotid.report.study import panelled
from pilotid.study.paper import (
    BIAS,
    DEVIATION,
    FIGURE_5,
    FIGURE_9,
    KEYS,
    METHODS,
    MOTION,
    PEOPLE,
    PERIPHERAL,
    REMNANTS,
    TABLE_3,
)
from pilotid.study.run import recording_of
from pilotid.study.scores import ALL
from pilotid.study.table import Comparison
from pilotid.support.format import Table, number, plus_minus, signed, table
from pilotid.support.numbers import Z95
from pilotid.support.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing
    from pandas import DataFrame

#: The scenarios of Fig. 8 on an axis.
FORCING = ("both", "disturbance", "target", "dist. step", "target step")
#: An axis shows what lies no further from the median than so many interquartile ranges.
RANGES_SHOWN = 5.0
#: Trials with and without motion, and whose they are.
OF_MOTION = (("9", "simulated"), (PEOPLE, PEOPLE))
TRUTH = dict(zip(KEYS, SCENARIOS["nominal"].truth, strict=True))


def write_paper(folder: Path, study: Comparison, trials: DataFrame) -> Path:
    """Write paper.html.

    Parameters
    ----------
    folder
        Where to.
    study
        The scenarios of `pilotid.study.paper` by `METHODS`.
    trials
        What `pilotid.study.paper.fit_trials` gives.
    """
    every = study.scores.set_index(["scenario", "method", "parameter"])
    lost = every.loc["disturbance-only", "mmle3", ALL]
    alike = sum(
        every.loc[name, "mmle3", key].bias_percent * off > 0.0
        for name, paper in TABLE_3.items()
        for key, off in zip(KEYS, paper, strict=True)
    )
    path = folder / "paper.html"
    write_page(
        path,
        "paper.html",
        title="AIAA 2008-7109 repeated",
        figures=_figures(study, every, trials),
        tables=_tables(study, every, trials),
        failed=[f"{n.partition('-')[2]}: {every.loc[n, 'mmle3', ALL].failures}" for n in REMNANTS],
        recordings=study.replications(REMNANTS[0]),
        alike=f"{alike} of {len(TABLE_3) * len(KEYS)}",
        lost=f"{lost.failures} of {lost.recordings}",
        groups={figure: _failed(trials, figure) for figure in ("10", "11")},
    )
    return path


def _failed(trials: DataFrame, figure: str) -> str:
    """How many fits of a figure of groups failed, by method."""
    fits = trials[(trials.figure == figure) & (trials.parameter == KEYS[0])]
    counts = [f"`{m}` {fits[fits.method == m].value.isna().sum()}" for m in METHODS]
    return f"{len(fits) // len(METHODS)}: {', '.join(counts)}"


# -------------------------------------------------------------------------------- tables


def _tables(study: Comparison, every: DataFrame, trials: DataFrame) -> dict[str, Table]:
    """The tables by the numbers of the tables or figures that they stand beside."""
    return {
        "1": _guesses(),
        "2": _forcing(),
        "3": _runs(every),
        "5": _starts(study),
        "8": _biases(every),
        "9": _motion(trials),
        "10": _peripheral(trials, "10"),
        "11": _peripheral(trials, "11"),
    }


def _guesses() -> Table:
    single, multi = (
        dict(zip(SCENARIOS[n].model.keys, SCENARIOS[n].truth, strict=True))
        for n in ("single", "nominal")
    )
    units = {p.key: p.unit for p in SCENARIOS["nominal"].model.parameters}
    caption = "Table 1: the paper's initial guesses, and the truth of all its simulations"
    rows = [(key, units[key], single.get(key), multi[key]) for key in KEYS]
    return _table(caption, ("parameter", "unit", "single channel", "multi channel"), rows, 2)


def _forcing() -> Table:
    disturbance, target = paper_disturbance(), paper_target()
    columns = disturbance.lines, disturbance.amplitudes, target.lines, target.amplitudes
    rows = [[*map("{:g}".format, row)] for row in zip(*columns, strict=True)]
    titles = ("disturbance line", "amplitude [deg]", "target line", "amplitude of it [deg]")
    caption = "Table 2: lines k (k/81.92 Hz) and amplitudes; all phases are zero"
    return _table(caption, titles, rows, 0)


def _runs(every: DataFrame) -> Table:
    rows = []
    for key, bias, deviation in zip(KEYS, BIAS, DEVIATION, strict=True):
        scores = [every.loc["nominal", m, key] for m in METHODS]
        deviations = [100.0 * s["std"] / TRUTH[key] for s in scores]
        rows.append((key, bias, *map(_percent, scores), deviation, *deviations))
    columns = [f"{what}, {m}" for what in ("bias", "deviation") for m in ("paper", *METHODS)]
    caption = "Bias and standard deviation over the runs [% of the truth]"
    return _table(caption, ("parameter", *columns), rows)


def _starts(study: Comparison) -> Table:
    ends, rows = _numbered(study, "starts"), []
    for key, paper in zip(KEYS, FIGURE_5, strict=True):
        ended = [ends[(ends.method == m) & (ends.parameter == key)].value for m in METHODS]
        spreads = [100.0 * (values.max() - values.min()) / TRUTH[key] for values in ended]
        rows.append((key, paper, *(values.mean() - TRUTH[key] for values in ended), *spreads))
    columns = [f"error, {m}" for m in ("paper", *METHODS)]
    columns += [f"range of ends, {m} [%]" for m in METHODS]
    caption = "Error of the end, in the parameter's unit, and range of the ends"
    return _table(caption, ("parameter", *columns), rows)


def _biases(every: DataFrame) -> Table:
    rows: list[Sequence[object]] = []
    for name, paper in TABLE_3.items():
        rows.append((name, "paper", *map(signed, paper), None))
        for m in METHODS:
            percent = [_percent(every.loc[name, m, key]) for key in KEYS]
            rows.append((name, m, *percent, str(every.loc[name, m, ALL].failures)))
    caption = "Table 3: bias [%], of fits that did not fail"
    return _table(caption, ("forcing", "method", *KEYS, "failed"), rows, 2)


def _motion(trials: DataFrame) -> Table:
    columns = {(figure, m): f"{m}, {whose}" for figure, whose in OF_MOTION for m in METHODS}
    rows = [
        (key, way, *(_change(trials, *cell, key, "no motion", "full motion") for cell in columns))
        for key, way in FIGURE_9.items()
    ]
    caption = "Change from no motion to full motion, mean over subjects ± standard error"
    return _table(caption, ("parameter", "paper", *columns.values()), rows, 2)


def _peripheral(trials: DataFrame, figure: str) -> Table:
    rows = [(key, *(_change(trials, figure, m, key, *PERIPHERAL) for m in METHODS)) for key in KEYS]
    caption = "Change with peripheral cues, mean over groups ± standard error"
    return _table(f"{caption}; the paper: `Kvest` up", ("parameter", *METHODS), rows)


def _table(
    caption: str, titles: Sequence[str], rows: Iterable[Sequence[object]], heads: int = 1
) -> Table:
    """A table whose numbers stand behind its heads; texts are written already."""

    def text(value: Any) -> str:
        return value if isinstance(value, str) else number(value)

    return table(rows, caption, titles, dict.fromkeys(titles[heads:], text), heads=heads)


def _percent(score: Any) -> str:
    """A bias with its standard error [%]."""
    error = 100.0 * score.bias_se / abs(score.truth)
    return plus_minus(score.bias_percent, error) if np.isfinite(error) else "-"


def _change(
    trials: DataFrame, figure: str, method: str, key: str, before: str, after: str
) -> str | None:
    """Mean difference of two conditions over subjects, and its standard error."""
    rows = trials[(trials.figure == figure) & (trials.method == method) & (trials.parameter == key)]
    wide = rows.pivot(index="subject", columns="condition", values="value")
    if not {before, after} <= {*wide}:
        return None
    differences = (wide[after] - wide[before]).dropna()
    return plus_minus(differences.mean(), differences.sem()) if len(differences) > 1 else None


# ------------------------------------------------------------------------------- figures


def _figures(study: Comparison, every: DataFrame, trials: DataFrame) -> dict[str, Figure]:
    """The paper's figures by their numbers."""
    from pandas import DataFrame, concat

    def of_paper(place: float, values: Sequence[float] | FloatArray) -> DataFrame:
        head = {"method": "paper", "parameter": KEYS, "place": place, "std_error": 0.0}
        return DataFrame(head | {"value": values})

    power = {n: 100.0 * (study.scenarios[n].remnant or np.nan) for n in REMNANTS}
    truth, at = np.array([*TRUTH.values()]), power["remnant-0.4"]
    scored = every.reset_index()
    remnants = scored[scored.scenario.isin(REMNANTS)]
    remnants = remnants.assign(place=remnants.scenario.map(power))
    forcing = scored[scored.scenario.isin([*TABLE_3])]
    forcing = forcing.assign(
        place=forcing.scenario.map([*TABLE_3].index),
        value=forcing.truth + forcing.bias,
        std_error=Z95 * forcing.bias_se,
    )
    offs = [0.01 * np.array(percents) for percents in TABLE_3.values()]
    bias = concat([of_paper(at, BIAS), remnants.assign(value=remnants.bias_percent)])
    theirs = of_paper(at, (0.01 * truth * DEVIATION) ** 2)
    variance = concat([theirs, remnants.assign(value=remnants["std"] ** 2)])
    forcing = concat([forcing, *(of_paper(x, truth * (1.0 + off)) for x, off in enumerate(offs))])
    remnant = "remnant over control, power [%]"
    drawn = {
        "3": (_points(_numbered(study, "nominal"), "run", truth=True),
              "estimates of ten recordings with their claimed standard errors; grey: truth."),
        "4": (_signals(study), "signals of the first recording of `nominal`."),
        "5": (_points(_numbered(study, "starts"), "start", truth=True),
              "ends of ten fits of one recording from guesses within 40 % of the truth; grey: "
              "truth."),
        "6": (_points(bias, remnant, "bias [%]"), "bias [%] over the remnant."),
        "7": (_points(variance, remnant, "variance"), "variance over the remnant."),
        "8": (_points(forcing, "", truth=True, ticks=FORCING),
              "means with 95 % intervals; grey: truth; crosses: the paper's means, from its "
              "Table 3."),
        "9": _grouped(trials, "9", MOTION),
        "10": _grouped(trials, "10", PERIPHERAL),
        "11": _grouped(trials, "11", PERIPHERAL),
    }  # fmt: skip
    return {
        n: Figure(f"fig-{n}", figure, f"The paper's Fig. {n}: {words}")
        for n, (figure, words) in drawn.items()
    }


def _numbered(study: Comparison, scenario: str) -> DataFrame:
    """Estimates of a scenario, each at the number of its replication from 1."""
    fits = study.frame[study.frame.usable & (study.frame.scenario == scenario)]
    return fits.assign(place=fits.replication + 1)


def _signals(study: Comparison) -> Drawing:
    """All signals of a recording over time."""
    recording = recording_of(SCENARIOS["nominal"], int(study.about.get("seed", "1")), 0)
    time, window = recording.time, slice(recording.run_in, None)
    acceleration = np.gradient(np.gradient(recording.x[0], time), time)
    drawn = {"target [deg]": recording.input("ft")[0],
             "disturbance [deg]": recording.input("fd")[0],
             "error [deg]": recording.e[0],
             "acceleration [deg/s²]": acceleration,
             "control [deg]": recording.u[0], "response [deg]": recording.x[0]}  # fmt: skip
    with journal_figure(6.0) as figure:
        panels = figure.subplots(len(drawn), 1, sharex=True)
        for axes, (label, signal) in zip(panels, drawn.items(), strict=True):
            axes.plot(time[window], signal[window], color=INK, lw=0.6)
            axes.set_ylabel(label, fontsize=7.5)
            draw_grid(axes)
        axes.set_xlabel("t [s]")
    return figure


def _grouped(
    trials: DataFrame, figure: str, conditions: Mapping[str, float]
) -> tuple[Drawing, str]:
    """Estimates by subject, conditions from left to right; and what that is."""
    names, rows = [*conditions], trials[trials.figure == figure]
    rows = rows[rows.parameter.isin([*FIGURE_9] if figure == "9" else KEYS)]
    shifts = rows.condition.map(names.index) / (len(names) + 1.0) - 0.3
    drawing = _points(rows.assign(place=rows.subject + shifts).dropna(), "subject")
    return drawing, f"from left to right {', '.join(names)}; failed fits are missing."


def _points(
    frame: DataFrame, label: str, curve: str = "", *, truth: bool = False, ticks: Sequence[str] = ()
) -> Drawing:
    """A panel for each parameter: values over their place, with error bars.

    With a word for what they are of, `curve`, values are joined, but for those of the paper.
    """
    methods = [method for method in ("paper", *METHODS) if method in {*frame.method}]
    keys = [key for key in KEYS if key in {*frame.parameter}]
    with panelled(keys, 1.75, (label, curve)) as (figure, panels, spare):
        for key, axes in zip(keys, panels, strict=True):
            chosen = frame[frame.parameter == key]
            if truth:
                axes.axhline(TRUTH[key], color="#999999", lw=0.8)
            for count, method in enumerate(methods):
                rows = chosen[chosen.method == method]
                paper = method == "paper"
                colour, marker, _ = Style(INK, "x") if paper else style_of(method)
                axes.errorbar(
                    rows.place + 0.12 * count, rows.value, rows.std_error.fillna(0.0), lw=0.9,
                    fmt=f"{marker}-" if curve and not paper else marker, color=colour,
                    markersize=3.0, elinewidth=0.7, label=method,
                )  # fmt: skip
            bars = chosen.std_error.fillna(0.0)
            axes.set_ylim(*_limits(np.concatenate([chosen.value - bars, chosen.value + bars])))
            if ticks:
                axes.set_xticks(range(len(ticks)), ticks, rotation=60, fontsize=6.5)
            draw_grid(axes, "y")
        spare.legend(*axes.get_legend_handles_labels(), loc="center", frameon=False)
    return figure


def _limits(values: FloatArray) -> tuple[float, float]:
    """Ends of an axis that leaves out what lies far from the middle half of the values."""
    known = values[np.isfinite(values)]
    low, middle, high = np.quantile(known, [0.25, 0.5, 0.75]).tolist()
    near = np.abs(known - middle) <= RANGES_SHOWN * (high - low)
    inside = known[near] if high > low else known
    room = 0.15 * float(np.ptp(inside)) + 0.02 * abs(middle) or 1.0
    return float(inside.min()) - room, float(inside.max()) + room
