"""A self-contained HTML report of fits: tables, signals and frequency responses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pilotid.estimates.quantities import Fitted, derived, parameters
from pilotid.show.figures import bode, signals
from pilotid.show.numbers import value_and_interval
from pilotid.show.svg import svg
from pilotid.show.words import heading, verdict
from pilotid.types import FloatArray

if TYPE_CHECKING:
    from jinja2 import Environment


@dataclass(frozen=True)
class Section:
    """One recording in the report, as its template needs it."""

    heading: str
    methods: list[str]
    rows: list[tuple[str, str, list[tuple[str, str]]]]
    verdicts: list[str]
    signals: str
    responses: str


def html_report(fits: Sequence[Fitted], truth: FloatArray | None = None) -> str:
    """The report as one HTML text that needs no network; equal fits give equal bytes.

    Parameters
    ----------
    fits
        What was fitted.
    truth
        True parameters of a simulation, to be drawn beside the frequency responses.
    """
    sections = [_section(fit, truth) for fit in fits]
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


def _section(fit: Fitted, truth: FloatArray | None) -> Section:
    shown = [e for e in fit.estimates if np.isfinite(e.values).all()]
    two_step = [e for e in fit.estimates if e.frequency_response is not None]
    columns = [[*parameters(e), *derived(e)] for e in shown]
    return Section(
        heading=heading(fit),
        methods=[e.method for e in shown],
        rows=[
            (row[0].key, row[0].unit, [value_and_interval(quantity) for quantity in row])
            for row in zip(*columns, strict=True)
        ],
        verdicts=[verdict(e, timed=False) for e in fit.estimates],
        signals=svg(signals(fit.recording, shown)) if shown else "",
        responses=svg(bode(two_step, truth)) if two_step else "",
    )
