"""The chapter on time: how long a fit takes, and which method is worth it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pilotid.numbers import NONE, number
from pilotid.report.content import Block, Bullets, Column, Picture, Section, Table, Text, entries
from pilotid.report.rules import ENOUGH
from pilotid.show.style import INK, WIDTH, colour_of, journal_style, log_ticks, marker_of
from pilotid.study.attempts import Attempts
from pilotid.study.comparison import Cell, Comparison
from pilotid.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: A method is as accurate as another if its rmse is no larger by more than this share.
ALIKE = 0.1
#: Family of the scenarios that differ in the length of the recording.
LENGTH, VARIED = "length", "duration"

TEXT = (
    "Time of one fit on one core, with all that it does: search, intervals, tests of what is left. "
    "Times are of the machine that ran the study and of what else it did; medians and ratios tell "
    "more than milliseconds."
)


@dataclass(frozen=True)
class Pace:
    """How fast and how accurate a method is.

    Attributes
    ----------
    method
        The method.
    milliseconds
        Median time of a fit.
    usual
        Times between which nine of ten fits lie [ms].
    rmse
        Root mean square error over the Cramér-Rao bound, median over the parameters.
    ends
        The smallest and the largest of these.
    """

    method: str
    milliseconds: float
    usual: tuple[float, float]
    rmse: float
    ends: tuple[float, float]

    def spares(self, other: Pace) -> bool:
        """Whether it is faster than another method, and as accurate."""
        return self.milliseconds < other.milliseconds and self.rmse <= (1.0 + ALIKE) * other.rmse


def pace(cell: Cell) -> Pace | None:
    """What a method's fits of a scenario took and gave; None without times or bounds."""
    known = _milliseconds(cell)
    ratios = np.array([s.ratio for s in cell.percent])
    ratios = ratios[np.isfinite(ratios)]
    if not known.size or not ratios.size:
        return None
    low, high = np.quantile(known, [0.05, 0.95]).tolist()
    return Pace(
        cell.method,
        cell.milliseconds,
        (low, high),
        float(np.median(ratios)),
        (float(ratios.min()), float(ratios.max())),
    )


def timing(study: Comparison, reference: str) -> list[Section]:
    """The chapter; nothing if the store has no times.

    Parameters
    ----------
    study
        The study's numbers.
    reference
        The scenario that the summary is about.
    """
    if not any(_milliseconds(each).size for each in study.every):
        return []
    blocks: list[Block] = [Text(TEXT)]
    if reference in study.names:
        cells = study.of(reference)
        paces = [found for cell in cells if (found := pace(cell))]
        if paces:
            enough = min(cell.usable for cell in cells if pace(cell)) >= ENOUGH
            blocks += _of_reference(reference, paces, enough=enough)
    lengths = _lengths(study)
    if lengths:
        caption = (
            "Median time of a fit over the length of the window. Grey: proportional to the length."
        )
        alt = "Time of a fit over the length of the recording, by method"
        blocks.append(Picture.of(_over_length(study, lengths), "time-length", alt, caption))
    blocks.append(_table(study))
    return [Section("timing", "Time", blocks)]


def _of_reference(name: str, paces: Sequence[Pace], *, enough: bool) -> list[Block]:
    alt = "Time of a fit and root mean square error over the bound, by method"
    caption = (
        f"Scenario {name}: median time of a fit, and rmse over the Cramér-Rao bound, median over "
        "the parameters with the range of all. Stepped line: what is not to be had faster."
    )
    fastest = min(p.milliseconds for p in paces)
    columns = [
        Column("method", text=True),
        Column("ms per fit", hint="median"),
        Column("9 of 10 fits", hint="5 % and 95 % quantiles"),
        Column("times the fastest"),
        Column("1000 fits", hint="on one core"),
        Column("rmse / bound", hint="median over the parameters"),
    ]
    rows = [
        [
            p.method,
            number(p.milliseconds),
            NONE.join(number(end, 2) for end in p.usual),
            number(p.milliseconds / fastest, 2),
            _duration(p.milliseconds),
            number(p.rmse),
        ]
        for p in paces
    ]
    return [
        Picture.of(_worth(paces), "time", alt, caption),
        *([Bullets(_sentences(paces))] if enough else []),
        Table(f"`{name}`: time and accuracy", columns, entries(rows)),
    ]


def _sentences(paces: Sequence[Pace]) -> list[str]:
    """Which methods are worth their time, and what spares that of the others."""
    worth, spared = [], []
    for own in paces:
        others = [other for other in paces if other.spares(own)]
        if not others:
            worth.append(f"`{own.method}`")
            continue
        best = min(others, key=lambda other: other.milliseconds)
        factor = own.milliseconds / best.milliseconds
        spared.append(
            f"`{own.method}` takes {number(factor, 2)} times as long as `{best.method}`, which is "
            f"at least as accurate here (rmse/bound {number(best.rmse)}, not {number(own.rmse)})."
        )
    first = (
        f"Worth their time, since nothing faster is as accurate to {100.0 * ALIKE:.0f} %: "
        f"{', '.join(worth)}. What a method gives beside values (intervals that hold, a posterior, "
        "frequency responses) does not count in this."
    )
    return [first, *spared]


def _worth(paces: Sequence[Pace]) -> Figure:
    """Accuracy over time, a point for each method."""
    from matplotlib.figure import Figure

    with journal_style():
        figure = Figure(figsize=(WIDTH, 2.9), layout="constrained")
        axes = figure.subplots()
        axes.axhline(1.0, color=INK, linewidth=0.8)
        for p in paces:
            colour = colour_of(p.method)
            axes.plot([p.milliseconds] * 2, p.ends, color=colour, linewidth=0.8, alpha=0.6)
            axes.plot(
                p.milliseconds,
                p.rmse,
                marker_of(p.method),
                color=colour,
                markersize=5.0,
                linewidth=0.0,
                label=p.method,
            )
        front = sorted(
            (p for p in paces if not any(_beats(other, p) for other in paces)),
            key=lambda p: p.milliseconds,
        )
        axes.step(
            [p.milliseconds for p in front],
            [p.rmse for p in front],
            where="post",
            color="#8a94a3",
            linewidth=0.8,
            zorder=0,
        )
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.margins(0.08)
        log_ticks(axes, "x")
        log_ticks(axes, "y")
        axes.set_xlabel("median time of a fit [ms]")
        axes.set_ylabel("rmse / bound")
        figure.legend(loc="outside right upper")
    return figure


def _beats(one: Pace, other: Pace) -> bool:
    return one.milliseconds < other.milliseconds and one.rmse <= other.rmse


def _lengths(study: Comparison) -> list[tuple[str, float]]:
    """Scenarios that differ in length, and the nominal one, with their windows [s]."""
    own = [name for name in study.names if study.entry(name).family == LENGTH]
    if not own:
        return []
    names = [name for name in study.names if name in ("nominal", *own)]
    known = [(name, study.entry(name).number(VARIED)) for name in names]
    return sorted((p for p in known if math.isfinite(p[1])), key=lambda p: p[1])


def _over_length(study: Comparison, lengths: Sequence[tuple[str, float]]) -> Figure:
    from matplotlib.figure import Figure

    with journal_style():
        figure = Figure(figsize=(WIDTH, 2.9), layout="constrained")
        axes = figure.subplots()
        for method in study.methods:
            cells = [(x, study.at(name, method)) for name, x in lengths]
            points = [
                (x, cell.milliseconds)
                for x, cell in cells
                if cell and math.isfinite(cell.milliseconds)
            ]
            if points:
                axes.plot(
                    *zip(*points, strict=True),
                    marker=marker_of(method),
                    color=colour_of(method),
                    markersize=3.5,
                    linewidth=0.9,
                    label=method,
                )
        axes.set_xscale("log")
        axes.set_yscale("log")
        windows = np.array([x for _, x in lengths])
        bottom = axes.get_ylim()[0]
        for start in (1.0, 10.0, 100.0, 1000.0):
            axes.plot(windows, bottom * start * windows / windows[0], color="#dddddd", zorder=0,
                      linewidth=0.7, scaley=False)  # fmt: skip
        log_ticks(axes, "x")
        log_ticks(axes, "y")
        axes.set_xlabel("window [s]")
        axes.set_ylabel("median time of a fit [ms]")
        figure.legend(loc="outside right upper")
    return figure


def _table(study: Comparison) -> Table:
    """Median time of a fit everywhere, a column for each method."""
    columns = [Column("scenario", text=True), *(Column(m) for m in study.methods)]
    rows = []
    for name in study.all_names:
        own = {each.method: each.milliseconds for each in study.tried_on(name)}
        rows.append([name, *(number(own.get(method, math.nan)) for method in study.methods)])
    return Table("Median time of a fit [ms]", columns, entries(rows), folded=len(rows) > 4)


def _milliseconds(each: Attempts) -> FloatArray:
    return 1e3 * np.array([r.seconds for r in each.results if r.seconds is not None])


def _duration(seconds: float) -> str:
    """Seconds in words."""
    if seconds < 100.0:
        return f"{number(seconds, 2)} s"
    if seconds < 6000.0:
        return f"{number(seconds / 60.0, 2)} min"
    return f"{number(seconds / 3600.0, 2)} h"
