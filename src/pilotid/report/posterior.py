"""What `pilotid posterior` prints and writes: its tables, page, figures and files."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from pilotid.estimate.method import Fitted
from pilotid.estimate.quantities import UNDETERMINED, Draws, Quantity
from pilotid.model.element import ControlledElement
from pilotid.plots.plots import corner, predictive_band
from pilotid.posterior.predictive import PredictiveBand
from pilotid.report.fit import figures_of, words_of
from pilotid.report.page import Figure, render, save_figures
from pilotid.support.disk import strict_json, table_bytes, write_file
from pilotid.support.format import Line, Table, make_console, show, table, to_error

CSV_COLUMNS = (
    *("quantity", "unit", "mean", "std", "equal_tailed_lower", "equal_tailed_upper"),
    *("highest_density_lower", "highest_density_upper", "effective_size", "r_hat"),
)
#: R-hat up to which ensembles agree (Vehtari et al. 2021), and independent draws that an interval
#: needs for its ends to be known.
AGREE, ENOUGH = 1.01, 400.0


def quantity_table(quantities: Sequence[Quantity]) -> Table:
    """A row for each quantity."""

    def ends(low: float, high: float, error: float) -> str:
        return f"{to_error(low, error, 9)} .. {to_error(high, error, 9)}"

    def mean(value: float, error: float, determined: bool) -> str:
        known = f"{to_error(value, error, 9)} ± {to_error(error, error, 9)}"
        return known if determined else UNDETERMINED

    rows = [
        (
            *(s.key, s.unit, (s.value, s.std_error, s.determined)),
            *((s.lower, s.upper, s.std_error), s.effective, s.r_hat),
        )
        for s in quantities
    ]
    forms: dict[str, Callable[..., str]] = {
        "mean": mean,
        "95 % interval": ends,
        "effective": "{:.0f}".format,
        "R-hat": "{:.4f}".format,
    }
    return table(rows, "", ("quantity", "unit", *forms), forms)


def print_posterior(
    fit: Fitted,
    quantities: Sequence[Quantity] = (),
    predictive: PredictiveBand | None = None,
    notes: Sequence[str] = (),
) -> None:
    """Print the table of a posterior, if it was sampled, and what should be known of it."""
    estimate = fit.estimates[0]
    show(
        make_console(),
        Line(fit.heading, "heading"),
        *[quantity_table(quantities)] * bool(quantities),
        Line(estimate.verdict(), "" if estimate.outcome.usable else "failure"),
        *([] if estimate.draws is None else convergence_words(estimate.draws)),
        *([] if predictive is None else [inside_words(predictive)]),
        *(Line(warning, "warning") for warning in fit.warnings),
        *notes,
    )


def write_posterior(
    folder: Path,
    fit: Fitted,
    quantities: Sequence[Quantity],
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
    quantities, predictive
        What follows from the draws.
    element
        The controlled element, for the open loops; None for that which the recording names.
    notes
        What else a reader should know, a sentence each.

    Returns
    -------
    The files.
    """
    estimate = fit.estimates[0]
    draws = estimate.draws
    assert draws is not None
    figures = posterior_figures(fit, predictive, {s.key: s.unit for s in quantities}, element)
    page = render(
        "posterior.html",
        title="Posterior of a pilot model",
        contents=[],
        fit=words_of(fit),
        quantities=quantity_table(quantities),
        notes=notes,
        convergence=[*convergence_words(draws), inside_words(predictive)],
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


def posterior_figures(
    fit: Fitted,
    predictive: PredictiveBand,
    units: dict[str, str],
    element: ControlledElement | None = None,
) -> list[Figure]:
    """All figures of a posterior, in the order of its page, with units by parameter."""
    draws = fit.estimates[0].draws
    assert draws is not None
    unit = fit.recording.units.get("u", "")
    runs = "the recorded control" if fit.recording.runs == 1 else "the control of the first run"
    return [
        Figure(
            "corner",
            corner(draws, units),
            "Posterior of every parameter (diagonal: density, with mean and equal-tailed 95 % "
            "interval dashed) and of every pair (contours hold 50 and 95 % of the draws).",
        ),
        Figure(
            "predictive",
            predictive_band(predictive, unit),
            f"First seconds of {runs} in its posterior predictive band: of the model's answer to "
            "the recorded inputs, and with the remnant.",
        ),
        *(f for f in figures_of(fit, element=element) if f.name != "time"),
    ]


def convergence_words(draws: Draws) -> list[str]:
    """Whether the chains have converged, and what the draws are worth: a sentence each."""
    ensembles, steps, walkers = draws.chains
    least, most = int(np.argmin(draws.effective)), int(np.argmax(draws.r_hat))
    effective, r_hat = float(draws.effective[least]), float(draws.r_hat[most])
    agree = (
        f"at most {AGREE:g}: the ensembles agree"
        if r_hat <= AGREE
        else f"above {AGREE:g}: the ensembles do not agree, and nothing here is to be used"
    )
    enough = (
        "enough for the ends of 95 % intervals"
        if effective >= ENOUGH
        else f"fewer than the {ENOUGH:g} that the ends of 95 % intervals need"
    )
    return [
        f"{ensembles} ensembles of {walkers} walkers ran with a start of their own each; {steps} "
        f"steps were kept, {100.0 * draws.acceptance:.0f} % of the proposals accepted.",
        f"R-hat across ensembles is largest for {draws.keys[most]}, {r_hat:.4f}, {agree}.",
        f"The autocorrelation time is at most {np.max(draws.autocorrelation):.1f} steps; the draws "
        f"are worth at least {effective:.0f} independent ones ({draws.keys[least]}), {enough}.",
    ]


def inside_words(predictive: PredictiveBand) -> str:
    """How much of the recording lies where the posterior says."""
    share = f"{100.0 * predictive.inside:.1f} % of the recorded control lies inside"
    return f"{share} the 95 % posterior predictive band."
