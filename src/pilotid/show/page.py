"""A self-contained HTML report of fits: tables, and figures of signals, responses and remnant."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pilotid.estimates.estimate import Estimate
from pilotid.estimates.fitted import Fitted
from pilotid.show.figures import remnant_figure, response_figure, time_figure
from pilotid.show.svg import svg
from pilotid.types import FloatArray

if TYPE_CHECKING:
    from jinja2 import Environment


@dataclass(frozen=True)
class Section:
    """One recording in the report, as its template needs it: figures are SVG with captions."""

    heading: str
    methods: list[str]
    rows: list[tuple[str, str, list[tuple[str, str]]]]
    verdicts: list[str]
    remarks: list[str]
    figures: list[tuple[str, str]]


def html_report(fits: Sequence[Fitted], truth: FloatArray | None = None) -> str:
    """The report as one HTML text that needs no network; equal fits give equal bytes.

    Parameters
    ----------
    fits
        What was fitted.
    truth
        True parameters of a simulation, to be drawn beside the frequency responses.
    """
    sections = [_section(fit, truth, number) for number, fit in enumerate(fits)]
    template = templates_of("pilotid.show").get_template("fit.html")
    return template.render(sections=sections)


def templates_of(package: str) -> Environment:
    """The page templates of a package, everything that they print escaped."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    return Environment(
        loader=PackageLoader(package),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def _section(fit: Fitted, truth: FloatArray | None, number: int) -> Section:
    shown = [e for e in fit.estimates if np.isfinite(e.values).all()]
    columns = [e.quantities for e in shown]
    return Section(
        heading=fit.heading,
        methods=[e.method for e in shown],
        rows=[
            (row[0].key, row[0].unit, [quantity.shown() for quantity in row])
            for row in zip(*columns, strict=True)
        ],
        verdicts=[e.verdict(timed=False) for e in fit.estimates],
        remarks=fit.warnings,
        figures=list(_figures(fit, shown, truth, number)),
    )


def _figures(
    fit: Fitted, shown: Sequence[Estimate], truth: FloatArray | None, number: int
) -> Iterator[tuple[str, str]]:
    """The figures that a recording's estimates allow, with captions."""
    first_steps = [e for e in fit.estimates if e.frequency_response is not None]
    if shown:
        caption = (
            "First run: the control, the models' responses to the recorded inputs, and what they "
            "leave."
        )
        figure = time_figure(fit.recording, shown)
        yield svg(figure, f"signals-{number}", caption), caption
    if shown or first_steps:
        caption = "Describing functions of the fitted models, with their 95 % bands"
        if first_steps:
            names = ", ".join(e.method for e in first_steps)
            caption += f"; points: the first step of {names}, with bars that hold 95 %"
        drawn = [e for e in fit.estimates if e in shown or e in first_steps]
        yield svg(response_figure(drawn, truth), f"responses-{number}", caption), f"{caption}."
    modelled = [e for e in shown if e.remnant is not None]
    if modelled:
        caption = (
            "Power density of the remnant as the methods model it (lines), and that of what their "
            "models of the pilot leave of the control (points; smoothed periodogram)."
        )
        figure = remnant_figure(fit.recording, modelled)
        yield svg(figure, f"remnant-{number}", caption), caption
