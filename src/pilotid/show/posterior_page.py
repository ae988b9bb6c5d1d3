"""The page of a posterior: what it says in words, its table, and its figures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pilotid.estimates.draws import Draws, Spread
from pilotid.estimates.fitted import Fitted
from pilotid.pilot.element import ControlledElement
from pilotid.posterior.predictive import PredictiveBand
from pilotid.show.figures import Shown, figures_of
from pilotid.show.page import embedded, templates_of
from pilotid.show.posterior_figures import autocorrelation, band, corner, trace
from pilotid.show.words import summary

#: R-hat up to which ensembles agree (Vehtari et al. 2021), and independent draws that an interval
#: needs for its ends to be known.
AGREE, ENOUGH = 1.01, 400.0
#: Figures of a fit that a posterior's page has, too: between its own.
OF_FITS = ("describing-function", "open-loop", "remnant", "residual-tests")


def posterior_figures_of(
    fit: Fitted,
    predictive: PredictiveBand,
    units: dict[str, str],
    element: ControlledElement | None = None,
) -> list[Shown]:
    """All figures of a posterior, in the order of its page.

    Parameters
    ----------
    fit
        What was fitted, with one estimate that has draws.
    predictive
        The posterior predictive band of the control.
    units
        Unit by parameter.
    element
        The controlled element, for the open loops; see `figures_of`.
    """
    draws = fit.estimates[0].draws
    assert draws is not None
    unit = fit.recording.units.get("u", "")
    runs = "the recorded control" if fit.recording.runs == 1 else "the control of the first run"
    own = [
        Shown(
            "corner",
            "Posterior of every parameter (diagonal: density, with mean and equal-tailed 95 % "
            "interval dashed) and of every pair (contours hold 50 and 95 % of the draws).",
            corner(draws, units),
        ),
        Shown(
            "predictive",
            f"First seconds of {runs} in its posterior predictive band: of the model's answer to "
            "the recorded inputs, and with the remnant.",
            band(predictive, unit),
        ),
    ]
    others = [f for f in figures_of(fit, element=element) if f.name in OF_FITS]
    course = [
        Shown(
            "trace",
            "Course of every parameter: the mean of each ensemble's walkers, over the middle nine "
            "tenths of all (shaded).",
            trace(draws, units),
        ),
        Shown(
            "autocorrelation",
            "Autocorrelation of every parameter along the chains, walkers averaged.",
            autocorrelation(draws),
        ),
    ]
    return [*own, *others, *course]


def posterior_html(
    fit: Fitted,
    spreads: Sequence[tuple[Spread, list[str]]],
    columns: Sequence[str],
    predictive: PredictiveBand,
    figures: Sequence[Shown],
    notes: Sequence[str] = (),
) -> str:
    """The page as one HTML text that needs no network; equal draws give equal bytes.

    Parameters
    ----------
    fit
        What was fitted, with one estimate that has draws.
    spreads
        Quantities, each with the cells of its row under `columns`.
    columns
        Heads of those cells.
    predictive
        The posterior predictive band of the control.
    figures
        What `posterior_figures_of` gave.
    notes
        What else a reader should know, a sentence each.
    """
    draws = fit.estimates[0].draws
    assert draws is not None
    return (
        templates_of("pilotid.show")
        .get_template("posterior.html")
        .render(
            heading=fit.heading,
            summary=summary(fit),
            convergence=[*convergence_words(draws), inside_words(predictive)],
            columns=columns,
            rows=[(spread.key, spread.unit, cells) for spread, cells in spreads],
            verdict=fit.estimates[0].verdict(timed=False),
            remarks=fit.warnings,
            notes=notes,
            figures_shown=embedded(figures, "posterior"),
        )
    )


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
