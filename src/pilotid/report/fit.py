"""The report of fits: what was fitted, tables and figures, for each recording."""

from __future__ import annotations

import math
from collections.abc import Container, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pilotid.estimate.method import Fitted
from pilotid.estimate.quantities import quantity_tables
from pilotid.model.element import parsed_element
from pilotid.plots import plots
from pilotid.plots.style import leading
from pilotid.report.page import Figure, render
from pilotid.support.format import Line, show
from pilotid.support.remarks import counted_grades

if TYPE_CHECKING:
    from rich.console import Console


def html_report(fits: Sequence[Fitted]) -> str:
    """The report as one HTML text that needs no network; equal fits give equal bytes.

    Parameters
    ----------
    fits
        What was fitted.
    """
    shown = []
    for number, fit in enumerate(fits, start=1):
        figures = [replace(figure, name=f"{figure.name}-{number}") for figure in figures_of(fit)]
        content = {**words_of(fit), **tables_of(fit)}
        shown.append({"key": f"recording-{number}", **content, "figures": figures})
    contents = [(own["key"], own["heading"]) for own in shown]
    return render("fit.html", title="Identified pilot models", contents=contents, fits=shown)


def words_of(fit: Fitted) -> dict[str, Any]:
    """The sentences of a page on a fit, by the names that templates have for them."""
    return {
        "heading": fit.heading,
        "summary": summary(fit),
        "warnings": fit.warnings,
        "warned": _warned(fit),
        "verdicts": [e.verdict(timed=False) for e in fit.estimates],
    }


def tables_of(fit: Fitted) -> dict[str, Any]:
    """The numbers of a fit and what is said beside them, for pages and the terminal."""
    known = [(e.method, e.quantities) for e in fit.estimates if np.isfinite(e.values).any()]
    return {
        "specifications": [
            (f"{e.method}: {e.specification.sentence}", e.specification.agrees)
            for e in fit.estimates
            if e.specification
        ],
        "tables": quantity_tables(known),
        "held": fit.model.held_words,
        **_loops(fit),
    }


def _warned(fit: Fitted) -> str:
    """How many remarks of each grade there are, and what they ask."""
    grave = any(remark.grade != "note" for remark in fit.graded)
    what = "read before you use the numbers" if grave else "for information, no doubts"
    return f"{counted_grades(fit.graded)}: {what}"


def _loops(fit: Fitted) -> dict[str, Any]:
    """With what element loops were drawn, or why with none, their quantities, and notes."""
    own = fit.loop_element
    pairs = zip(fit.estimates, fit.loops, strict=False)  # without an element there are no loops
    known = [(e.method, loops) for e, loops in pairs if np.isfinite(e.values).any()]
    tabled = [
        (method, loops.quantities)
        for method, loops in known
        if any(math.isfinite(q.value) for q in loops.quantities)
    ]
    return {
        "element": "" if own is None else own.words if known else own.why,
        "loops": quantity_tables(tabled, "loop"),
        "loop_notes": [f"{method}: {note}" for method, loops in known for note in loops.notes],
    }


def print_fit(fit: Fitted, console: Console, said: Container[str] = ()) -> None:
    """Print tables, a line for each method, and what is wrong or in doubt.

    Parameters
    ----------
    fit
        What was fitted.
    console
        Where to.
    said
        Codes of remarks that were printed already and are not printed again.
    """
    found = tables_of(fit)
    remarks = {r: about for r, about in fit.graded.items() if r.code not in said}
    notes = dict.fromkeys(remark.code for remark in remarks if remark.grade == "note")
    show(
        console,
        Line(fit.heading, "heading"),
        *[fit.choice] * bool(fit.choice),
        *found["tables"],
        *found["held"],
        *(Line(words, "" if agrees else "failure") for words, agrees in found["specifications"]),
        *[found["element"]] * bool(found["element"]),
        *found["loops"],
        *found["loop_notes"],
        *(Line(e.verdict(), "" if e.outcome.usable else "failure") for e in fit.estimates),
        *(Line(r.line(about), "warning") for r, about in remarks.items() if r.grade != "note"),
        *[f"notes, in full with --json or --report: {', '.join(notes)}"] * bool(notes),
    )


# ---------------------------------------------------------------------------------- words


def summary(fit: Fitted) -> str:
    """What was fitted to what, in a sentence."""
    recording, model = fit.recording, fit.model
    channels = " and ".join(f"a {c.name} channel on {c.on}" for c in model.channels)
    runs = "one run" if recording.runs == 1 else f"{recording.runs} runs together, each"
    return (
        f"The pilot model {model.name} ({channels}; {len(model.parameters)} parameters) "
        f"was fitted to {runs} of {recording.duration:.4g} s at {1.0 / recording.dt:.4g} Hz, by "
        f"{', '.join(e.method for e in fit.estimates)}."
    )


# -------------------------------------------------------------------------------- figures


def figures_of(fit: Fitted) -> Iterator[Figure]:
    """All figures that a recording's estimates allow, in the order of a page.

    Open loops are drawn with the controlled element of the fit or, where nobody asked for loops,
    with that which the recording names.
    """
    from pilotid.methods.fourier import first_step_of

    recording = fit.recording
    shown = [e for e in fit.estimates if np.isfinite(e.values).all()]
    first_steps = [e for e in fit.estimates if e.frequency_response is not None]
    chosen = leading(shown)
    if chosen is not None:
        which = "The run" if recording.runs == 1 else f"Run 1 of {recording.runs}"
        caption = (
            f"{which}, its first seconds: the control and the response of the model "
            f"({chosen.method}) to the recorded inputs with 95 % of its remnant about it."
        )
        yield Figure("time", plots.time_figure(recording, chosen), caption)
    if shown or first_steps:
        drawn = [e for e in fit.estimates if e in shown or e in first_steps]
        points = None if first_steps else first_step_of(recording, fit.model)
        figure = plots.response_figure(drawn, points=points, units=recording.units)
        caption = "Describing functions of the fitted models"
        if chosen is not None:
            caption += f", with the 95 % band of {chosen.method}"
        if first_steps or points is not None:
            whose = ", ".join(e.method for e in first_steps)
            source = f"the first step of {whose}" if whose else "Fourier coefficients"
            caption += f"; points with bars of 95 %: {source}, without a model of the pilot"
        yield Figure("describing-function", figure, f"{caption}.")
    if chosen is None:
        return
    loop = fit.loop_element
    plant = loop.element if loop is not None else parsed_element(recording.controlled_element)
    if plant is not None and not chosen.model.no_loop:
        caption = (
            f"Open loops of the pilot ({chosen.method}) with the controlled element "
            f"{plant.name or 'given'}, with 95 % bands: that which the target sees and that which "
            "the disturbance sees. Marks: first crossovers."
        )
        yield Figure("open-loop", plots.open_loop_figure(chosen, plant), caption)
    modelled = [e for e in shown if e.remnant is not None or e is chosen]
    caption = (
        "Power density of the remnant as modelled (lines), and of what the model of the pilot "
        f"by {chosen.method} leaves of the control (points; by Welch's method)."
    )
    yield Figure("remnant", plots.remnant_figure(recording, modelled), caption)
    caption = (
        f"Prediction errors of {chosen.method}, whitened by a model of the remnant: their "
        "autocorrelation, and their correlation with the pilot's inputs some time before "
        "(shaded: after, which the loop explains). Dashed: 95 % of white errors lie within."
    )
    yield Figure("residual-tests", plots.whiteness_figure(recording, chosen), caption)
