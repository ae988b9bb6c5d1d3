"""The page that repeats a paper: its tables and figures in their order, its numbers beside ours."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pilotid.datasets import SCENARIOS
from pilotid.datasets.forcing import paper_disturbance, paper_target
from pilotid.plots.style import INK, colour_of, draw_grid, journal_figure, marker_of
from pilotid.report.page import Figure, write_page
from pilotid.report.study_figures import panelled
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
from pilotid.study.table import Comparison
from pilotid.support.format import Table, number, plus_minus, signed, table
from pilotid.support.numbers import Z95
from pilotid.support.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Drawing
    from pandas import DataFrame

WORDS = {"nominal": "both", "disturbance-only": "disturbance", "target-only": "target",
         "disturbance-step": "dist. step", "target-step": "target step"}  # fmt: skip
#: An axis shows what lies within so many medians of its values.
REACH = 4.0


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
    sections = [
        _section("tables", "Tables 1 and 2: guesses and forcing functions", tables=_given()),
        _runs(study),
        _signals(study),
        _starts(study),
        _remnant(study),
        _forcing(study),
        _lumped(trials),
        *(_groups(trials, figure, task) for figure, task in (("10", "disturbance rejection"),
                                                             ("11", "target following"))),
    ]  # fmt: skip
    path = folder / "paper.html"
    contents = [(own["key"], own["title"].partition(":")[0]) for own in sections]
    title = "AIAA 2008-7109 repeated"
    write_page(path, "paper.html", title=title, contents=contents, sections=sections)
    return path


def _section(
    key: str,
    title: str,
    *sentences: str,
    figures: Sequence[Figure] = (),
    tables: Sequence[Table] = (),
) -> dict[str, Any]:
    return {"key": key, "title": title, "sentences": sentences, "figures": figures,
            "tables": tables}  # fmt: skip


def _given() -> list[Table]:
    """The paper's Tables 1 and 2, from the scenarios that are simulated."""
    pilots = [dict(zip(SCENARIOS[n].model.keys, SCENARIOS[n].truth, strict=True))
              for n in ("single", "nominal")]  # fmt: skip
    units = {p.key: p.unit for p in SCENARIOS["nominal"].model.parameters}
    guesses = table(
        [(key, units[key], *(pilot.get(key) for pilot in pilots)) for key in KEYS],
        "Table 1: the paper's initial guesses, and the truth of all its simulations",
        ("parameter", "unit", "single channel", "multi channel"),
        {"single channel": number, "multi channel": number},
    )
    parts = [(f.lines, f.amplitudes) for f in (paper_disturbance(), paper_target())]
    rows = zip(*parts[0], *parts[1], strict=True)
    titles = ("disturbance line", "amplitude [deg]", "target line", "amplitude of it [deg]")
    caption = "Table 2: lines k (k/81.92 Hz) and amplitudes; all phases are zero"
    return [guesses, table(rows, caption, titles, dict.fromkeys(titles, "{:g}".format))]


def _runs(study: Comparison) -> dict[str, Any]:
    """Fig. 3."""
    shown = _numbered(study, "nominal")
    figure = _figure("3", _points(KEYS, shown, "run", _truth()),
                     "estimates of ten recordings with their claimed standard errors; grey: "
                    "truth.")  # fmt: skip
    rows = []
    for place, key in enumerate(KEYS):
        own = [_score(study, "nominal", method, key) for method in METHODS]
        truth = own[0].truth
        spreads = [100.0 * s["std"] / truth for s in own]
        biases = [_percent(s) for s in own]
        rows.append((key, BIAS[place], *biases, DEVIATION[place], *spreads))
    titles = ("parameter", "bias, paper", *(f"bias, {m}" for m in METHODS),
              "deviation, paper", *(f"deviation, {m}" for m in METHODS))  # fmt: skip
    forms = {t: number if "deviation" in t or "paper" in t else str for t in titles[1:]}
    caption = "Bias and standard deviation over the runs [% of the truth]"
    gain, lead = (DEVIATION[i] / math.sqrt(10.0) for i in (0, 1))
    return _section(
        "fig-3",
        "Figure 3: ten simulations",
        f"The paper's standard deviations make the standard error of its mean {gain:.0f} % for "
        f"`Kvis` and {lead:.0f} % for `tlead`: the signs that it has for these two are not "
        "significant. Ours depend on the remnant's filter, which is inferred.",
        "Methods start from generic guesses here, not from the truth as in the paper.",
        figures=[figure],
        tables=[table(rows, caption, titles, forms)],
    )


def _signals(study: Comparison) -> dict[str, Any]:
    """Fig. 4."""
    recording = recording_of(SCENARIOS["nominal"], int(study.about.get("seed", "1")), 0)
    time = recording.time
    acceleration = np.gradient(np.gradient(recording.x[0], time), time)
    drawn = {"target [deg]": recording.input("ft")[0],
             "disturbance [deg]": recording.input("fd")[0],
             "error [deg]": recording.e[0],
             "acceleration [deg/s²]": acceleration,
             "control [deg]": recording.u[0], "response [deg]": recording.x[0]}  # fmt: skip
    with journal_figure(6.0) as figure:
        for axes, (label, signal) in zip(figure.subplots(6, 1, sharex=True), drawn.items(),
                                         strict=True):  # fmt: skip
            axes.plot(time[recording.run_in :], signal[recording.run_in :], color=INK, lw=0.6)
            axes.set_ylabel(label, fontsize=7.5)
            draw_grid(axes)
        axes.set_xlabel("t [s]")
    shown = Figure(
        "fig-4", figure, "The paper's Fig. 4: signals of the first recording of `nominal`."
    )
    return _section("fig-4", "Figure 4: one simulation", figures=[shown])


def _starts(study: Comparison) -> dict[str, Any]:
    """Fig. 5."""
    shown = _numbered(study, "starts")
    figure = _figure("5", _points(KEYS, shown, "start", _truth()),
                     "ends of ten fits of one recording from guesses within 40 % of the "
                    "truth; grey: truth.")  # fmt: skip
    rows = []
    for key, paper in zip(KEYS, FIGURE_5, strict=True):
        own = [shown[(shown.method == m) & (shown.parameter == key)].value for m in METHODS]
        truth = _truth()[key]
        rows.append((key, paper, *(v.mean() - truth for v in own),
                     *(100.0 * (v.max() - v.min()) / truth for v in own)))  # fmt: skip
    titles = ("parameter", "error, paper", *(f"error, {m}" for m in METHODS),
              *(f"range of ends, {m} [%]" for m in METHODS))  # fmt: skip
    return _section(
        "fig-5",
        "Figure 5: initial guesses",
        "The paper's ten fits end in one place (variance about 1e-17). Its recording is another "
        "one, so that its errors compare with ours in size only.",
        figures=[figure],
        tables=[table(rows, "Error of the end, in the parameter's unit, and range of the ends",
                      titles, dict.fromkeys(titles[1:], number))],
    )  # fmt: skip


def _remnant(study: Comparison) -> dict[str, Any]:
    """Figs 6 and 7."""
    power = {name: 100.0 * (study.scenarios[name].remnant or math.nan) for name in REMNANTS}
    drawn = []
    for number_, column, label in (("6", "bias", "bias [%]"), ("7", "std", "variance")):
        with panelled(KEYS, 1.75, ("remnant over control, power [%]", label)) as (
            figure, panels, spare):  # fmt: skip
            for place, (key, axes) in enumerate(zip(KEYS, panels, strict=True)):
                for method in METHODS:
                    scores = [_score(study, name, method, key) for name in REMNANTS]
                    bias = [s.bias_percent for s in scores]
                    values = bias if column == "bias" else [s["std"] ** 2 for s in scores]
                    axes.plot([*power.values()], values, color=colour_of(method),
                              marker=marker_of(method), markersize=3.0, lw=0.9)  # fmt: skip
                own = (0.01 * DEVIATION[place] * _truth()[key]) ** 2
                paper = BIAS[place] if column == "bias" else own
                axes.plot(power["remnant-0.4"], paper, "x", color=INK, markersize=5.0)
                draw_grid(axes)
            _legend(spare, paper="paper, gain .4")
        drawn.append(_figure(number_, figure, f"{label} over the remnant."))
    failed = [f"{name.partition('-')[2]}: {_score(study, name, 'mmle3', 'all').failures}"
              for name in REMNANTS]  # fmt: skip
    return _section(
        "fig-6",
        "Figures 6 and 7: power of the remnant",
        f"Failed fits of `mmle3` in {study.replications(REMNANTS[0])} by remnant gain: "
        f"{', '.join(failed)}. As in the paper they are left out, which lowers bias and variance "
        "where many fail. The paper prints numbers for gain 0.4 alone (crosses); its curves are "
        "pictures.",
        figures=drawn,
    )


def _forcing(study: Comparison) -> dict[str, Any]:
    """Fig. 8 and Table 3."""
    from pandas import DataFrame

    points, rows = [], []
    for place, (name, paper) in enumerate(TABLE_3.items()):
        rows.append((name, "paper", *map(signed, paper), None))
        for key, off in zip(KEYS, paper, strict=True):
            points.append(("paper", key, place, _truth()[key] * (1.0 + off / 100.0), 0.0))
        for method in METHODS:
            own = [_score(study, name, method, key) for key in KEYS]
            points += [(method, key, place, s.truth + s.bias, Z95 * s.bias_se)
                       for key, s in zip(KEYS, own, strict=True)]  # fmt: skip
            failures = _score(study, name, method, "all").failures
            rows.append((name, method, *map(_percent, own), failures))
    frame = DataFrame(points, columns=["method", "parameter", "place", "value", "std_error"])
    ticks = dict(enumerate(WORDS.values()))
    figure = _figure("8", _points(KEYS, frame, "", _truth(), ticks),
                     "means with 95 % intervals; grey: truth; crosses: the paper's means, "
                    "from its Table 3.")  # fmt: skip
    titles = ("forcing", "method", *KEYS, "failed")
    caption = "Table 3: bias [%], of fits that did not fail"
    alike = sum(
        _score(study, name, "mmle3", key).bias_percent * off > 0.0
        for name, paper in TABLE_3.items()
        for key, off in zip(KEYS, paper, strict=True)
    )
    lost = _score(study, "disturbance-only", "mmle3", "all")
    return _section(
        "fig-8",
        "Figure 8 and Table 3: forcing functions",
        f"`mmle3` has the sign of the paper's bias in {alike} of {5 * len(KEYS)} cells.",
        f"The bias of `tdvis` of 407 % with the disturbance alone is not found: {lost.failures} of "
        f"{lost.recordings} fits fail there. Without a target e = -x, and both channels act on one "
        "signal: estimates rest on little, and the paper's fits probably ended in another optimum, "
        "with a visual delay above one second.",
        figures=[figure],
        tables=[table(rows, caption, titles, dict.fromkeys(titles[2:], str), heads=2)],
    )


def _lumped(trials: DataFrame) -> dict[str, Any]:
    """Fig. 9."""
    own = trials[trials.figure == "9"]
    rows = []
    for key, direction in FIGURE_9.items():
        cells: list[str | None] = [key, direction]
        for figure in ("9", PEOPLE):
            for method in METHODS:
                pairs = trials[(trials.figure == figure) & (trials.method == method)]
                cells.append(_change(pairs[pairs.parameter == key], "no motion", "full motion"))
        rows.append(cells)
    titles = ("parameter", "paper", *(f"{m}, simulated" for m in METHODS),
              *(f"{m}, {PEOPLE}" for m in METHODS))  # fmt: skip
    caption = "Change from no motion to full motion, mean over subjects ± standard error"
    return _section(
        "fig-9",
        "Figure 9: a lumped model with and without motion",
        "The paper's recordings are not public. **Simulated** here: five subjects who reject a "
        "disturbance, between the paper's pilot at rest and its pilot in motion, 10 % apart. The "
        "fitted model has the visual channel alone. Columns on people are of published recordings "
        "in yaw (element 15/s²), if `pilotid fetch-data yaw` has fetched them.",
        "The motion channel feeds back what the model does not have, and the fit makes up for it "
        "by the other parameters: how depends on pilot and element, so that other directions than "
        "the paper's are no contradiction.",
        figures=[_grouped("9", own, FIGURE_9, MOTION)],
        tables=[table(rows, caption, titles, dict.fromkeys(titles[2:], str))],
    )


def _groups(trials: DataFrame, figure: str, task: str) -> dict[str, Any]:
    """Figs 10 and 11."""
    own, rows = trials[trials.figure == figure], []
    for key in KEYS:
        cells: list[str | None] = [key]
        for method in METHODS:
            pairs = own[(own.method == method) & (own.parameter == key)]
            cells.append(_change(pairs, *PERIPHERAL))
        rows.append(cells)
    one = own[own.parameter == KEYS[0]]
    failed = ", ".join(f"`{m}` {one[one.method == m].value.isna().sum()}" for m in METHODS)
    titles = ("parameter", *METHODS)
    return _section(
        f"fig-{figure}",
        f"Figure {figure}: {task}, ten groups",
        f"**Simulated**: ten pilots 10 % apart about the paper's, one forcing function, the gain "
        f"on motion 25 % higher with peripheral cues. Failed fits of {len(one) // 2}: {failed}; in "
        "the paper as well, mostly because a delay became negative.",
        figures=[_grouped(figure, own, KEYS, PERIPHERAL)],
        tables=[table(rows, "Change with peripheral cues, mean over groups ± standard error; the "
                      "paper: `Kvest` up", titles, dict.fromkeys(titles[1:], str))],
    )  # fmt: skip


# ------------------------------------------------------------------------------------ helpers


def _figure(number_: str, drawing: Drawing, words: str) -> Figure:
    return Figure(f"fig-{number_}", drawing, f"The paper's Fig. {number_}: {words}")


def _truth() -> dict[str, float]:
    return dict(zip(KEYS, SCENARIOS["nominal"].truth, strict=True))


def _score(study: Comparison, scenario: str, method: str, key: str) -> Any:
    scores = study.scored(scenario, method)
    return scores[scores.parameter == key].iloc[0]


def _percent(score: Any) -> str:
    """A bias with its standard error [%]."""
    error = 100.0 * score.bias_se / abs(score.truth)
    return plus_minus(score.bias_percent, error) if math.isfinite(error) else "-"


def _numbered(study: Comparison, scenario: str) -> DataFrame:
    """Estimates of a scenario, each at the number of its replication from 1."""
    own = study.frame[study.frame.usable & (study.frame.scenario == scenario)]
    return own.assign(place=own.replication + 1)


def _change(rows: DataFrame, before: str, after: str) -> str | None:
    """Mean difference of two conditions over subjects, and its standard error."""
    wide = rows.pivot(index="subject", columns="condition", values="value")
    if not {before, after} <= {*wide}:
        return None
    differences = (wide[after] - wide[before]).dropna()
    return plus_minus(differences.mean(), differences.sem()) if len(differences) > 1 else None


def _grouped(figure: str, own: DataFrame, keys: Iterable[str], conditions: Iterable[str]) -> Figure:
    """Estimates by subject, conditions from left to right."""
    names = [*conditions]
    shifts = own.condition.map(names.index) / (len(names) + 1.0) - 0.3
    drawing = _points([*keys], own.assign(place=own.subject + shifts).dropna(), "subject", {})
    words = f"from left to right {', '.join(names)}; failed fits are missing."
    return _figure(figure, drawing, words)


def _points(
    keys: Sequence[str],
    frame: DataFrame,
    label: str,
    truth: Mapping[str, float],
    ticks: Mapping[int, str] | None = None,
) -> Drawing:
    """A panel for each parameter: values over their place, with error bars."""
    methods = [method for method in ("paper", *METHODS) if method in {*frame.method}]
    with panelled(keys, 1.75, (label, "")) as (figure, panels, spare):
        for key, axes in zip(keys, panels, strict=True):
            own = frame[frame.parameter == key]
            if key in truth:
                axes.axhline(truth[key], color="#999999", lw=0.8)
            for number_, method in enumerate(methods):
                rows = own[own.method == method]
                marker = "x" if method == "paper" else marker_of(method)
                colour = INK if method == "paper" else colour_of(method)
                axes.errorbar(rows.place + 0.12 * number_, rows.value, rows.std_error.fillna(0.0),
                              fmt=marker, color=colour, markersize=3.0, elinewidth=0.7)  # fmt: skip
            axes.set_ylim(*_limits(own.value.to_numpy()))
            if ticks:
                axes.set_xticks([*ticks], [*ticks.values()], rotation=60, fontsize=6.5)
            draw_grid(axes, "y")
        _legend(spare, methods)
    return figure


def _limits(values: FloatArray) -> tuple[float, float]:
    """Ends of an axis that leaves out what lies far from most values."""
    known = values[np.isfinite(values)]
    if not known.size:
        return 0.0, 1.0
    middle = float(np.median(known))
    near = known[np.abs(known - middle) <= REACH * abs(middle)]
    inside = near if near.size else known
    room = 0.15 * float(np.ptp(inside)) + 0.05 * abs(middle)
    return float(inside.min()) - room, float(inside.max()) + room


def _legend(spare: Axes, methods: Sequence[str] = METHODS, paper: str = "paper") -> None:
    for method in (*(m for m in methods if m != "paper"), *["paper"] * (paper != "paper")):
        own = method == "paper"
        spare.plot([], [], "x" if own else marker_of(method), color=INK if own else
                   colour_of(method), markersize=4, label=paper if own else method)  # fmt: skip
    spare.legend(loc="center", frameon=False)
