"""What `pilotid posterior` prints and writes: its tables, page, figures and files."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from pilotid.estimate.loops import COUNT
from pilotid.estimate.method import Fitted
from pilotid.estimate.quantities import Draws, Quantity, sampled
from pilotid.likelihood.estimates import VAF_BAND, simulated_vaf
from pilotid.likelihood.prediction import predict
from pilotid.plots.plots import corner
from pilotid.report.fit import figures_of, tables_of, words_of
from pilotid.report.page import Figure, render, save_figures
from pilotid.support.disk import strict_json, table_bytes, write_file
from pilotid.support.format import Line, Table, make_console, show, table

CSV_COLUMNS = (
    *("quantity", "unit", "mean", "std", "equal_tailed_lower", "equal_tailed_upper"),
    *("highest_density_lower", "highest_density_upper", "effective_size", "r_hat"),
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
    parameters = [
        sampled(
            key,
            units.get(key, ""),
            draws.values[:, i],
            effective=float(draws.effective[i]),
            r_hat=float(draws.r_hat[i]),
            positive=bool(draws.positive[i]),
        )
        for i, key in enumerate(draws.keys)
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
        contents=[],
        fit=words_of(fit),
        quantities=quantity_table(quantities),
        notes=loop_words(fit),
        convergence=convergence_words(draws),
        figures=figures,
    )
    rows = []
    for s in quantities:
        ends = s.lower, s.upper, *s.highest_density
        rows.append((s.key, s.unit, s.value, s.std_error, *ends, s.effective, s.r_hat))
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
    names = (*draws.keys, "log_density")
    array = np.empty(draws.chains, dtype=[(name, float) for name in names])
    for i, key in enumerate(draws.keys):
        array[key] = draws.values[:, i].reshape(draws.chains)
    array["log_density"] = draws.log_density.reshape(draws.chains)
    stream = io.BytesIO()
    np.save(stream, array)
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
