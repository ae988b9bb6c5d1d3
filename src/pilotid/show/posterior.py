"""What `pilotid posterior` prints and writes."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np

from pilotid.disk import strict_json, write_file
from pilotid.estimates.draws import Draws, Spread
from pilotid.estimates.fitted import Fitted
from pilotid.numbers import decimals
from pilotid.pilot.element import ControlledElement
from pilotid.posterior.predictive import PredictiveBand
from pilotid.terminal import make_console, make_table, print_table

if TYPE_CHECKING:
    from rich.table import Table

COLUMNS = ("mean", "std", "95 % equal-tailed", "95 % highest density", "effective", "R-hat")
CSV_COLUMNS = (
    "quantity",
    "unit",
    "mean",
    "std",
    "equal_tailed_lower",
    "equal_tailed_upper",
    "highest_density_lower",
    "highest_density_upper",
    "effective_size",
    "r_hat",
)


class Watch(Protocol):
    """Is told the share of a run that is done."""

    def __call__(self, share: float) -> None: ...


@contextmanager
def sampling_bar() -> Iterator[Watch]:
    """A bar on standard error while an emcee run goes on, if that is a terminal."""
    from rich.progress import Progress

    console = make_console(errors=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("sampling", total=1.0)
        yield lambda share: progress.update(task, completed=share)


def table(spreads: Sequence[Spread]) -> Table:
    """A row for each quantity."""
    result = make_table()
    result.add_column("quantity", no_wrap=True)
    result.add_column("unit", no_wrap=True)
    for name in COLUMNS:
        result.add_column(name, justify="right", no_wrap=True)
    for spread in spreads:
        result.add_row(spread.key, spread.unit, *_cells(spread))
    return result


def _cells(spread: Spread) -> list[str]:
    error = spread.deviation
    digits = decimals(error) if error > 0.0 else 4

    def interval(ends: tuple[float, float]) -> str:
        return f"{ends[0]:.{digits}f} .. {ends[1]:.{digits}f}"

    return [
        f"{spread.mean:.{digits}f}",
        f"{error:.{digits}f}",
        interval((spread.equal_tailed[0], spread.equal_tailed[1])),
        interval((spread.highest_density[0], spread.highest_density[1])),
        f"{spread.effective:.0f}" if math.isfinite(spread.effective) else "",
        f"{spread.r_hat:.4f}" if math.isfinite(spread.r_hat) else "",
    ]


def print_posterior(
    fit: Fitted, spreads: Sequence[Spread], notes: Sequence[str], predictive: PredictiveBand | None
) -> None:
    """The tables of a posterior, and what should be known of them."""
    console = make_console()
    estimate = fit.estimates[0]
    console.print(fit.heading, style="bold", soft_wrap=True)
    if spreads:
        console.print()
        print_table(console, table(spreads))
    console.print()
    style = None if estimate.outcome.usable else "red"
    console.print(estimate.verdict(), style=style, soft_wrap=True)
    if estimate.draws is not None:
        console.print(_run_words(estimate.draws), soft_wrap=True)
    if predictive is not None:
        share = f"{100.0 * predictive.inside:.1f} % of the recorded control lies inside"
        console.print(f"{share} the 95 % posterior predictive band", soft_wrap=True)
    for warning in fit.warnings:
        console.print(warning, style="yellow", soft_wrap=True)
    for note in notes:
        console.print(note, soft_wrap=True)


def _run_words(draws: Draws) -> str:
    ensembles, steps, walkers = draws.chains
    return (
        f"emcee: {ensembles} ensembles of {walkers} walkers, {steps} steps kept of each, "
        f"{100.0 * draws.acceptance:.0f} % accepted, autocorrelation time at most "
        f"{np.max(draws.autocorrelation):.1f} steps"
    )


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


def summary_bytes(spreads: Sequence[Spread]) -> bytes:
    """The table as CSV."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(CSV_COLUMNS)
    for s in spreads:
        numbers = (s.mean, s.deviation, *s.equal_tailed, *s.highest_density, s.effective, s.r_hat)
        cells = [repr(float(n)) if math.isfinite(n) else "" for n in numbers]
        writer.writerow([s.key, s.unit, *cells])
    return text.getvalue().encode()


def write_posterior(
    folder: Path,
    fit: Fitted,
    spreads: Sequence[Spread],
    predictive: PredictiveBand,
    element: ControlledElement | None = None,
    notes: Sequence[str] = (),
) -> list[Path]:
    """Write draws, summary, figures (SVG and PDF) and page; each file is complete or not there.

    Parameters
    ----------
    folder
        Where to; it exists.
    fit
        What was fitted, with one estimate that has draws.
    spreads, predictive
        What follows from the draws.
    element
        The controlled element, for the open loops; None for that which the recording names.
    notes
        What else a reader should know, a sentence each.

    Returns
    -------
    The files.
    """
    from pilotid.show.figures import save_figures
    from pilotid.show.posterior_page import posterior_figures_of, posterior_html

    estimate = fit.estimates[0]
    draws = estimate.draws
    assert draws is not None
    units = {s.key: s.unit for s in spreads}
    figures = posterior_figures_of(fit, predictive, units, element)
    rows = [(spread, _cells(spread)) for spread in spreads]
    page = posterior_html(fit, rows, COLUMNS, predictive, figures, notes)
    contents = {
        "report.html": page.encode("utf-8", "replace"),
        "draws.npy": draws_bytes(draws),
        "summary.csv": summary_bytes(spreads),
        "estimate.json": strict_json(estimate.to_dict()).encode(),
    }
    for name, content in contents.items():
        write_file(folder / name, content)
    return [*(folder / name for name in contents), *save_figures(folder, figures)]
