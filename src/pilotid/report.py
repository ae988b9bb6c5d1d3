"""A self-contained HTML report of fits: the tables of the terminal, and the signals."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pilotid import output
from pilotid.estimate import Estimate
from pilotid.fits import Fit, derived, parameters
from pilotid.prediction import LeastSquares, predict
from pilotid.prepare import prepare

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Colours that people with a colour vision deficiency tell apart (Okabe and Ito, 2008).
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#999999")


@dataclass(frozen=True)
class Section:
    """One recording in the report, as its template needs it."""

    heading: str
    methods: list[str]
    rows: list[tuple[str, str, list[tuple[str, str]]]]
    verdicts: list[str]
    figure: str


def html_report(fits: Sequence[Fit]) -> str:
    """The report as one HTML text that needs no network; equal fits give equal bytes."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("pilotid"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    sections = [_section(fit) for fit in fits]
    return environment.get_template("fit.html").render(sections=sections)


def _section(fit: Fit) -> Section:
    shown = [e for e in fit.estimates if np.isfinite(e.values).all()]
    columns = [[*parameters(e), *derived(e)] for e in shown]
    return Section(
        heading=output.heading(fit),
        methods=[e.method for e in shown],
        rows=[
            (row[0].key, row[0].unit, [output.figures(quantity) for quantity in row])
            for row in zip(*columns, strict=True)
        ],
        verdicts=[output.verdict(e, timed=False) for e in fit.estimates],
        figure=svg(_signals(fit, shown)) if shown else "",
    )


def _signals(fit: Fit, estimates: Sequence[Estimate]) -> Figure:
    """Control of the first run, what the models make of it, and what they leave."""
    from matplotlib.figure import Figure

    problem = LeastSquares(predict(fit.recording, fit.model))
    prepared = prepare(fit.recording, fit.model)
    time, control = prepared.time[prepared.first :], problem.prediction.control[0]
    unit = fit.recording.units.get("u", "")
    figure = Figure(figsize=(10.0, 5.0), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    above.plot(time, control, color="black", linewidth=0.8, label="recorded")
    for estimate, colour in zip(estimates, COLOURS * len(estimates), strict=False):
        residual = problem.residual(estimate.values)[0]
        above.plot(time, control - residual, color=colour, linewidth=0.8, label=estimate.method)
        below.plot(time, residual, color=colour, linewidth=0.8)
    above.set_ylabel(f"control u [{unit}]" if unit else "control u")
    below.set_ylabel("residual")
    below.set_xlabel("time [s]")
    below.set_xlim(time[0], time[-1])
    above.legend(loc="upper right", ncols=4, fontsize="small")
    return figure


def svg(figure: Figure) -> str:
    """A figure as an SVG element, the same bytes for the same figure."""
    from matplotlib import rc_context

    stream = io.StringIO()
    with rc_context({"svg.hashsalt": "pilotid", "svg.fonttype": "none"}):
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    text = stream.getvalue()
    return text[text.index("<svg") :]
