"""The reports of fits and of posteriors: what was fitted, tables and figures."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.lib.recfunctions import unstructured_to_structured

from pilotid.estimate.loops import COUNT
from pilotid.estimate.method import Fitted
from pilotid.estimate.quantities import Draws, Quantity, quantity_tables, sampled
from pilotid.likelihood.estimates import VAF_BAND, simulated_vaf
from pilotid.likelihood.prediction import predict
from pilotid.plots import plots
from pilotid.plots.page import Figure, render, save_figures
from pilotid.plots.plots import corner
from pilotid.plots.style import journal_figure, leading
from pilotid.support.disk import strict_json, table_bytes, write_file
from pilotid.support.format import Line, Table, make_console, show, table
from pilotid.support.remarks import counted_grades

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing
    from rich.console import Console

SECONDS = 30.0  # of the control that are shown: beyond, strokes run into one another


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
        shown.append((f"recording-{number}", fit, tables_of(fit), figures))
    title = "Identified pilot models"
    return render("fit.html", title=title, fits=shown, summary=summary, remarked=remarked)


def remarked(fit: Fitted) -> str:
    """How many remarks of each grade there are, and what they ask."""
    grave = any(remark.grade != "note" for remark in fit.graded)
    what = "read before you use the numbers" if grave else "for information, no doubts"
    return f"{counted_grades(fit.graded)}: {what}"


def tables_of(fit: Fitted) -> dict[str, Any]:
    """The numbers of a fit and its loops, and what is said beside them: pages and terminal."""
    choice, known = fit.loop_element, [e for e in fit.estimates if np.isfinite(e.values).any()]
    pairs = zip(fit.estimates, fit.loops, strict=False)  # without an element there are no loops
    loops = [(e.method, loop) for e, loop in pairs if e in known]
    tabled = [
        (method, loop.quantities)
        for method, loop in loops
        if any(math.isfinite(q.value) for q in loop.quantities)
    ]
    return {
        "specifications": [
            (f"{e.method}: {e.specification.sentence}", e.specification.agrees)
            for e in fit.estimates
            if e.specification
        ],
        "tables": quantity_tables([(e.method, e.quantities) for e in known]),
        "held": fit.model.held_words,
        "element": f"loops with the controlled element {choice.words}" if loops else choice.why,
        "loops": quantity_tables(tabled, "loop"),
        "loop_notes": [f"{method}: {note}" for method, loop in loops for note in loop.notes],
    }


def print_fit(fit: Fitted, console: Console) -> None:
    """Print tables, a line for each method, and what is wrong or in doubt.

    Parameters
    ----------
    fit
        What was fitted.
    console
        Where to.
    """
    content = tables_of(fit)
    notes = dict.fromkeys(remark.code for remark in fit.graded if remark.grade == "note")
    show(
        console,
        Line(fit.heading, "heading"),
        *[fit.choice] * bool(fit.choice),
        *content["tables"],
        *content["held"],
        *(Line(words, "" if agrees else "failure") for words, agrees in content["specifications"]),
        *[content["element"]] * bool(content["element"]),
        *content["loops"],
        *content["loop_notes"],
        *(Line(e.verdict(), "" if e.outcome.usable else "failure") for e in fit.estimates),
        *(Line(r.line(about), "warning") for r, about in fit.graded.items() if r.grade != "note"),
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
    """All figures that a recording's estimates allow, in the order of a page."""
    recording, chosen = fit.recording, leading(fit.estimates)
    if chosen is not None:
        which = "The run" if recording.runs == 1 else f"Run 1 of {recording.runs}"
        caption = (
            f"{which}, its first seconds: the control and the response of the model "
            f"({chosen.method}) to the recorded inputs with 95 % of its remnant about it."
        )
        span = (0.0, min(SECONDS, float(recording.time[-1])))
        with journal_figure(2.5) as drawing:
            plots.signals(recording, chosen, span=span, band=True, axes=drawing.subplots())
        yield Figure("time", drawing, caption)
    yield from _describing_functions(fit)
    if chosen is None:
        return
    plant = fit.loop_element.element
    if plant is not None and not chosen.model.no_loop:
        caption = (
            f"Open loops of the pilot ({chosen.method}) with the controlled element "
            f"{plant.name or 'given'}, with 95 % bands: that which the target sees and that which "
            "the disturbance sees. Marks: first crossovers."
        )
        with journal_figure(4.2) as drawing:
            above, below = drawing.subplots(2, 1, sharex=True, height_ratios=(4, 5))
            plots.open_loop(chosen, plant, (above, below))
            _legend_above(drawing, 1)
        yield Figure("open-loop", drawing, caption)
    modelled = [e for e in fit.estimates if e.remnant is not None or e is chosen]
    caption = (
        "Power density of the remnant as modelled (lines), and of what the model of the pilot "
        f"by {chosen.method} leaves of the control (points; by Welch's method)."
    )
    with journal_figure(2.9) as drawing:
        plots.remnant(*modelled, recording=recording, axes=drawing.subplots())
    yield Figure("remnant", drawing, caption)
    caption = (
        f"Prediction errors of {chosen.method}, whitened by a model of the remnant: their "
        "autocorrelation, and their correlation with the pilot's inputs some time before "
        "(shaded: after, which the loop explains). Dashed: 95 % of white errors lie within."
    )
    signals = (None, *dict.fromkeys(channel.on for channel in chosen.model.channels))
    with journal_figure(2.4) as drawing:
        for name, axes in zip(signals, drawing.subplots(1, len(signals)), strict=True):
            plots.correlation(recording, chosen, signal=name, axes=axes)
    yield Figure("residual-tests", drawing, caption)


def _describing_functions(fit: Fitted) -> Iterator[Figure]:
    """The channels of all estimates that have something to show, side by side."""
    from pilotid.likelihood.second_step import first_step_of

    drawn = [e for e in fit.estimates if np.isfinite(e.values).all() or e.frequency_response]
    if not drawn:
        return
    whose = ", ".join(e.method for e in drawn if e.frequency_response)
    points = None if whose else first_step_of(fit.recording, fit.model)
    units, columns = fit.recording.units, len(fit.model.channels)
    with journal_figure(4.2) as drawing:
        panels = drawing.subplots(2, columns, sharex=True, squeeze=False, height_ratios=(3, 2))
        plots.describing_function(*drawn, points=points, units=units, axes=[*panels.T.ravel()])
        _legend_above(drawing, 5)
    caption = "Describing functions of the fitted models"
    if chosen := leading(drawn):
        caption += f", with the 95 % band of {chosen.method}"
    if whose or points is not None:
        source = f"the first step of {whose}" if whose else "Fourier coefficients"
        caption += f"; points with bars of 95 %: {source}, without a model of the pilot"
    yield Figure("describing-function", drawing, f"{caption}.")


def _legend_above(figure: Drawing, columns: int) -> None:
    """One legend for all axes, where it hides none of them, and their labels in line."""
    figure.align_ylabels()
    handles, labels = figure.axes[0].get_legend_handles_labels()
    for axes in figure.axes:
        if (legend := axes.get_legend()) is not None:
            legend.remove()
    if labels:
        figure.legend(handles, labels, loc="outside upper left", ncols=columns, frameon=False)


# -------------------------------------------------------------------------------------- posteriors


CSV_COLUMNS = (
    *("quantity", "unit", "mean", "std", "equal_tailed_lower", "equal_tailed_upper"),
    *("effective_size", "r_hat"),
)


def quantity_table(quantities: Sequence[Quantity]) -> Table:
    """A row for each quantity."""
    forms: dict[str, Callable[..., str]] = {
        **dict.fromkeys(("mean", "95 % interval"), str),
        "effective": "{:.0f}".format,
        "R-hat": "{:.4f}".format,
    }
    rows = [(s.key, s.unit, *s.shown(), s.effective, s.r_hat) for s in quantities]
    return table(rows, "", ("quantity", "unit", *forms), forms)


def quantities_of(fit: Fitted) -> list[Quantity]:
    """Parameters, the remnant's after the pilot's, and what follows from them; empty without draws.

    These are products and sums of parameters, the VAF, and the margins of the loops.

    Parameters
    ----------
    fit
        What was fitted, with one estimate.
    """
    recording, (estimate,) = fit.recording, fit.estimates
    draws, model = estimate.draws, estimate.model
    if draws is None:
        return []
    units = {p.key: p.unit for p in model.parameters} | {"frequency": "rad/s"}
    facts = draws.effective.tolist(), draws.r_hat.tolist(), draws.positive.tolist()
    parameters = [
        sampled(key, units.get(key, ""), own, effective=effective, r_hat=r_hat, positive=positive)
        for key, own, effective, r_hat, positive in zip(
            draws.keys, draws.values.T, *facts, strict=True
        )
    ]
    prediction = predict(recording, model, VAF_BAND)
    some = draws.thinned(COUNT)[:, : len(model.parameters)]
    vafs = [simulated_vaf(recording, model, values, prediction) for values in some]
    margins = [
        replace(quantity, key=quantity.key.replace("_", " "))
        for loops in fit.loops
        for quantity in loops.quantities
        if math.isfinite(quantity.value)
    ]
    return [*parameters, *estimate.derived, sampled("VAF", "%", np.array(vafs)), *margins]


def print_posterior(fit: Fitted, quantities: Sequence[Quantity], written: Sequence[Path]) -> None:
    """Print the table of a posterior, if it was sampled, and what should be known of it."""
    estimate = fit.estimates[0]
    show(
        make_console(),
        *[fit.choice] * bool(fit.choice),
        Line(fit.heading, "heading"),
        *[quantity_table(quantities)] * bool(quantities),
        Line(estimate.verdict(), "" if estimate.outcome.usable else "failure"),
        *([] if estimate.draws is None else convergence_words(estimate.draws)),
        *(Line(warning, "warning") for warning in fit.warnings),
        *(loop_words(fit) if quantities else []),
        *map(str, written),
    )


def loop_words(fit: Fitted) -> list[str]:
    """With what element loops are drawn, and what should be known of them, a sentence each."""
    words = tables_of(fit)
    return [words["element"], *words["loop_notes"]]


def write_posterior(folder: Path, fit: Fitted, quantities: Sequence[Quantity]) -> list[Path]:
    """Write draws, summary, figures (SVG and PDF) and page; each file is complete or not there.

    Parameters
    ----------
    folder
        Where to; it exists.
    fit, quantities
        What was fitted, with one estimate that has draws, and what follows from these.

    Returns
    -------
    The files.
    """
    estimate = fit.estimates[0]
    draws = estimate.draws
    assert draws is not None
    caption = (
        "Posterior of every parameter (diagonal: density, with mean and equal-tailed 95 % "
        "interval dashed) and of every pair (contours hold 50 and 95 % of the draws)."
    )
    figures = [
        Figure("corner", corner(draws, {s.key: s.unit for s in quantities}), caption),
        *(figure for figure in figures_of(fit) if figure.name != "time"),
    ]
    page = render(
        "posterior.html",
        title="Posterior of a pilot model",
        fit=fit,
        summary=summary(fit),
        remarked=remarked(fit),
        quantities=quantity_table(quantities),
        notes=loop_words(fit),
        convergence=convergence_words(draws),
        figures=figures,
    )
    rows = [
        (s.key, s.unit, s.value, s.std_error, s.lower, s.upper, s.effective, s.r_hat)
        for s in quantities
    ]
    contents = {
        "report.html": page.encode("utf-8", "replace"),
        "draws.npy": draws_bytes(draws),
        "summary.csv": table_bytes(CSV_COLUMNS, rows),
        "estimate.json": strict_json(estimate.to_dict()).encode(),
    }
    for name, content in contents.items():
        write_file(folder / name, content)
    return [*(folder / name for name in contents), *save_figures(folder, figures)]


def draws_bytes(draws: Draws) -> bytes:
    """A structured array for `numpy.load`: a field for each parameter, and ``log_density``."""
    columns = np.column_stack([draws.values, draws.log_density]).reshape(*draws.chains, -1)
    stream = io.BytesIO()
    np.save(stream, unstructured_to_structured(columns, names=[*draws.keys, "log_density"]))
    return stream.getvalue()


def convergence_words(draws: Draws) -> list[str]:
    """What says whether the chains have converged, and what the draws are worth: sentences."""
    ensembles, steps, walkers = draws.chains
    least, most = int(np.argmin(draws.effective)), int(np.argmax(draws.r_hat))
    return [
        f"{ensembles} ensembles of {walkers} walkers ran with a start of their own each; {steps} "
        f"steps were kept, {100.0 * draws.acceptance:.0f} % of the proposals accepted.",
        f"R-hat across ensembles is largest for {draws.keys[most]}, {draws.r_hat[most]:.4f}; up to "
        "1.01 the ensembles agree.",
        f"The autocorrelation time is at most {np.max(draws.autocorrelation):.1f} steps; the draws "
        f"are worth at least {draws.effective[least]:.0f} independent ones ({draws.keys[least]}), "
        "of which the ends of 95 % intervals need 400.",
    ]
