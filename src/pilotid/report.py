"""A self-contained HTML report of fits: tables, signals and frequency responses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pilotid import output
from pilotid.figures import bode, signals, svg
from pilotid.fits import Fit, derived, parameters
from pilotid.types import FloatArray


@dataclass(frozen=True)
class Section:
    """One recording in the report, as its template needs it."""

    heading: str
    methods: list[str]
    rows: list[tuple[str, str, list[tuple[str, str]]]]
    verdicts: list[str]
    signals: str
    responses: str


def html_report(fits: Sequence[Fit], truth: FloatArray | None = None) -> str:
    """The report as one HTML text that needs no network; equal fits give equal bytes.

    Parameters
    ----------
    fits
        What was fitted.
    truth
        True parameters of a simulation, to be drawn beside the frequency responses.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("pilotid"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    sections = [_section(fit, truth) for fit in fits]
    return environment.get_template("fit.html").render(sections=sections)


def _section(fit: Fit, truth: FloatArray | None) -> Section:
    shown = [e for e in fit.estimates if np.isfinite(e.values).all()]
    two_step = [e for e in fit.estimates if e.frequency_response is not None]
    columns = [[*parameters(e), *derived(e)] for e in shown]
    return Section(
        heading=output.heading(fit),
        methods=[e.method for e in shown],
        rows=[
            (row[0].key, row[0].unit, [output.figures(quantity) for quantity in row])
            for row in zip(*columns, strict=True)
        ],
        verdicts=[output.verdict(e, timed=False) for e in fit.estimates],
        signals=svg(signals(fit.recording, shown)) if shown else "",
        responses=svg(bode(two_step, truth)) if two_step else "",
    )
