"""A self-contained HTML report of fits: a summary in words, tables, and figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pilotid.estimates.fitted import Fitted
from pilotid.estimates.parts import FrequencyResponse
from pilotid.estimates.tables import Columns
from pilotid.pilot.element import ControlledElement
from pilotid.show.figures import Shown, figures_of
from pilotid.show.svg import svg
from pilotid.show.words import summary
from pilotid.types import FloatArray

if TYPE_CHECKING:
    from jinja2 import Environment

#: Estimates side by side in a table, as many as a page of paper holds.
ABREAST = 3


@dataclass(frozen=True)
class Table:
    """Quantities of some methods side by side: key, unit, and value and interval of each."""

    methods: list[str]
    rows: list[tuple[str, str, list[tuple[str, str]]]]


@dataclass(frozen=True)
class Section:
    """One recording in the report, as its template needs it: figures are SVG with captions."""

    heading: str
    summary: list[str]
    parameters: list[Table]
    loop_words: list[str]
    loops: list[Table]
    verdicts: list[str]
    remarks: list[str]
    figures: list[tuple[str, str]]


def html_report(
    fits: Sequence[Fitted],
    truth: FloatArray | None = None,
    *,
    points: Sequence[FrequencyResponse | None] | None = None,
    element: ControlledElement | None = None,
) -> str:
    """The report as one HTML text that needs no network; equal fits give equal bytes.

    Parameters
    ----------
    fits
        What was fitted.
    truth
        True parameters of a simulation, to be drawn beside the frequency responses.
    points
        For each fit an estimate of the responses without a model of the pilot, or None; see
        `figures_of`.
    element
        The controlled element; None for that of each fit, see `figures_of`.
    """
    behind = points if points is not None else [None] * len(fits)
    sections = [
        section(fit, figures_of(fit, points=own, element=element, truth=truth), str(number))
        for number, (fit, own) in enumerate(zip(fits, behind, strict=True))
    ]
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


def section(fit: Fitted, figures: Sequence[Shown], number: str) -> Section:
    """One recording's part of a page.

    Parameters
    ----------
    fit
        What was fitted.
    figures
        What `figures_of` gave.
    number
        Tells its figures from those of other sections of the page.
    """
    loop_words, loops = _loops(fit)
    known = [(e.method, e.quantities) for e in fit.estimates if np.isfinite(e.values).all()]
    return Section(
        heading=fit.heading,
        summary=summary(fit),
        parameters=tables_of(known),
        loop_words=loop_words,
        loops=loops,
        verdicts=[
            *(f"{e.method}: {e.specification.sentence}" for e in fit.estimates if e.specification),
            *(e.verdict(timed=False) for e in fit.estimates),
        ],
        remarks=fit.warnings,
        figures=embedded(figures, number),
    )


def embedded(figures: Sequence[Shown], number: str) -> list[tuple[str, str]]:
    """Figures as SVG elements of a page, with their captions."""
    return [(svg(f.figure, f"{f.name}-{number}", f.caption), f.caption) for f in figures]


def _loops(fit: Fitted) -> tuple[list[str], list[Table]]:
    """Crossovers and margins of each method: with what element, what to know, and tables."""
    given = fit.loop_element
    if given is None:
        return [], []
    pairs = [
        (estimate.method, loops)
        for estimate, loops in zip(fit.estimates, fit.loops, strict=False)
        if np.isfinite(estimate.values).all()
    ]
    notes = [f"{method}: {note}" for method, loops in pairs for note in loops.notes]
    return [given.words, *notes], tables_of([(m, loops.quantities) for m, loops in pairs])


def tables_of(columns: Columns) -> list[Table]:
    """Quantities of estimates side by side, a few in each table."""
    tables = []
    for begin in range(0, len(columns), ABREAST):
        some = columns[begin : begin + ABREAST]
        rows = zip(*(quantities for _, quantities in some), strict=True)
        cells = [(row[0].key, row[0].unit, [q.shown() for q in row]) for row in rows]
        tables.append(Table([name for name, _ in some], cells))
    return tables
