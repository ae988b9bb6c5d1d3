"""The report of fits: a summary in words, tables, and figures, for each recording."""

from __future__ import annotations

import math
import re
from collections.abc import Container, Iterator, Sequence
from dataclasses import replace
from operator import itemgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from pilotid.estimate.estimate import Estimate, Outcome, is_at_bound
from pilotid.estimate.fitted import Fitted
from pilotid.estimate.parts import FrequencyResponse
from pilotid.estimate.quantities import Quantity, quantity_tables
from pilotid.estimate.quantities import abreast as beside
from pilotid.model.element import ControlledElement, parsed_element
from pilotid.plots import plots
from pilotid.plots.responses import BANDS
from pilotid.plots.spectra import RESIDUALS
from pilotid.plots.style import leading
from pilotid.report.page import Figure, render
from pilotid.support.format import Line, show
from pilotid.support.remarks import counted_grades

if TYPE_CHECKING:
    from rich.console import Console

#: Estimates side by side in a table, as many as a page of paper holds.
ABREAST = 3
#: Correlation matrices in one figure, which a page of paper holds.
MATRICES = 6
#: Half of a 95 % interval over the value from which on a parameter is poorly identified.
POORLY = 0.5


def html_report(
    fits: Sequence[Fitted], points: Sequence[FrequencyResponse | None] | None = None
) -> str:
    """The report as one HTML text that needs no network; equal fits give equal bytes.

    Parameters
    ----------
    fits
        What was fitted.
    points
        For each fit an estimate of the responses without a model of the pilot, or None; see
        `figures_of`.
    """
    shown = []
    behind = points or [None] * len(fits)
    for number, (fit, own) in enumerate(zip(fits, behind, strict=True), start=1):
        figures = [replace(f, name=f"{f.name}-{number}") for f in figures_of(fit, own)]
        content = {**words_of(fit), **tables_of(fit, ABREAST)}
        shown.append({"key": f"recording-{number}", **content, "figures": figures})
    contents = [(own["key"], own["heading"]) for own in shown]
    return render("fit.html", title="Identified pilot models", contents=contents, fits=shown)


def words_of(fit: Fitted) -> dict[str, Any]:
    """The sentences of a page on a fit, by the names that templates have for them."""
    return {
        "heading": fit.heading,
        "summary": " ".join(summary(fit)),
        "warnings": fit.warnings,
        "warned": _warned(fit),
        "verdicts": [e.verdict(timed=False) for e in fit.estimates],
    }


def tables_of(fit: Fitted, abreast: int) -> dict[str, Any]:
    """The numbers of a fit and what is said beside them, for pages and the terminal.

    Parameters
    ----------
    fit
        What was fitted.
    abreast
        How many estimates stand side by side.
    """
    known = [(e.method, e.quantities) for e in fit.estimates if np.isfinite(e.values).any()]
    return {
        "specifications": [
            (f"{e.method}: {e.specification.sentence}", e.specification.agrees)
            for e in fit.estimates
            if e.specification
        ],
        "tables": quantity_tables(known, abreast),
        "held": fit.model.held_words,
        **_loops(fit, abreast),
    }


def _warned(fit: Fitted) -> str:
    """How many remarks of each grade there are, and what they ask."""
    grave = any(remark.grade != "note" for remark in fit.graded)
    what = "read before you use the numbers" if grave else "for information, no doubts"
    return f"{counted_grades(fit.graded)}: {what}"


def _loops(fit: Fitted, abreast: int) -> dict[str, Any]:
    """With what element loops were drawn, their quantities, and what to know of them."""
    nothing = {"element": "", "loops": [], "loop_notes": []}
    if fit.loop_element is None:
        return nothing
    if fit.loop_element.element is None:
        return {**nothing, "element": fit.loop_element.why}
    pairs = [
        (estimate.method, loops)
        for estimate, loops in zip(fit.estimates, fit.loops, strict=True)
        if np.isfinite(estimate.values).any()
    ]
    if not pairs:
        return nothing
    known = [
        (method, loops.quantities)
        for method, loops in pairs
        if any(math.isfinite(q.value) for q in loops.quantities)
    ]
    return {
        "element": fit.loop_element.words,
        "loops": quantity_tables(known, abreast, "loop"),
        "loop_notes": [f"{method}: {note}" for method, loops in pairs for note in loops.notes],
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
    found = tables_of(fit, beside(console.width))
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


def summary(fit: Fitted) -> list[str]:
    """What was fitted, how well, what is known, and whether methods agree: a sentence each."""
    sentences = [_what(fit), *_outcomes(fit.estimates)]
    chosen = leading(fit.estimates)
    if chosen is not None:
        sentences += _how_well(chosen)
        if chosen.outcome.usable:
            sentences += [*_known(chosen), *_agreement(chosen, fit.estimates)]
        else:
            sentences.append("No numbers here are to be used.")
    if fit.warnings:
        sentences.append(f"Below, {_warned(fit)}.")
    elif chosen is not None:
        sentences.append("No check of recording or fit found a fault.")
    return sentences


def listed(words: Sequence[str]) -> str:
    """Words with commas, and an ``and`` before the last."""
    return " and ".join(part for part in (", ".join(words[:-1]), *words[-1:]) if part)


def _what(fit: Fitted) -> str:
    recording, model = fit.recording, fit.model
    channels = [f"a {c.name} channel on {c.on}" for c in model.channels]
    runs = "one run" if recording.runs == 1 else f"{recording.runs} runs together, each"
    return (
        f"The pilot model {model.name} ({listed(channels)}; {len(model.parameters)} parameters) "
        f"was fitted to {runs} of {recording.duration:.4g} s at {1.0 / recording.dt:.4g} Hz, by "
        f"{listed([e.method for e in fit.estimates])}."
    )


def _outcomes(estimates: Sequence[Estimate]) -> list[str]:
    good = [e.method for e in estimates if e.outcome is Outcome.CONVERGED]
    others = [f"{e.method} {e.sentence}" for e in estimates if e.method not in good]
    if not others:
        return ["The fit converged." if len(good) == 1 else "All fits converged."]
    return [f"{listed(good)} converged."] * bool(good) + [f"{other}." for other in others]


def _how_well(chosen: Estimate) -> list[str]:
    if not math.isfinite(chosen.vaf):
        return []
    told = (
        f"The response of the model by {chosen.method} to the recorded inputs accounts for "
        f"{chosen.vaf:.1f} % of the variance of the control"
    )
    if chosen.remnant is not None:
        told += f"; {chosen.remnant.words}"
    return [f"{told}."]


def _known(chosen: Estimate) -> list[str]:
    there = is_at_bound(chosen.model, chosen.values)
    bound = [key for key, at_bound in zip(chosen.model.keys, there, strict=True) if at_bound]
    shares = {
        q.key: _share(q)
        for q in chosen.quantities
        if not set(re.split(r"[*+]", q.key)) & set(bound)
    }
    if not all(math.isfinite(share) for share in shares.values()):
        return []
    poorly = [key for key, share in shares.items() if share >= POORLY]
    each = [f"{key} {_percent(share)}" for key, share in sorted(shares.items(), key=itemgetter(1))]
    kinds = {
        f"Half of the 95 % interval of {chosen.method} over the value": each,
        f"Poorly identified (above {100.0 * POORLY:.0f} %)": poorly,
        "At a bound": bound,
    }
    return [f"{what}: {listed(keys)}." for what, keys in kinds.items() if keys]


def _share(quantity: Quantity) -> float:
    """Half of the interval over the value."""
    if quantity.value == 0.0:
        return math.inf
    return 0.5 * (quantity.upper - quantity.lower) / abs(quantity.value)


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %" if share < 0.995 else f"{100.0 * share:.0f} %"


def _agreement(chosen: Estimate, estimates: Sequence[Estimate]) -> list[str]:
    others = [
        e for e in estimates
        if e is not chosen and e.outcome.usable and np.isfinite(e.intervals).all()
    ]  # fmt: skip
    if not others or not np.isfinite(chosen.intervals).all():
        return []
    apart = []
    for other in others:
        gap = np.maximum(chosen.intervals[:, 0], other.intervals[:, 0]) > np.minimum(
            chosen.intervals[:, 1], other.intervals[:, 1]
        )
        if gap.any():
            keys = [key for key, far in zip(chosen.model.keys, gap, strict=True) if far]
            apart.append(f"{other.method} ({', '.join(keys)})")
    if not apart:
        return [f"The 95 % intervals of all methods overlap those of {chosen.method}."]
    return [f"95 % intervals that do not overlap those of {chosen.method}: {listed(apart)}."]


# -------------------------------------------------------------------------------- figures


def figures_of(
    fit: Fitted,
    points: FrequencyResponse | None = None,
    element: ControlledElement | None = None,
) -> Iterator[Figure]:
    """All figures that a recording's estimates allow, in the order of a page.

    Parameters
    ----------
    fit
        What was fitted.
    points
        An estimate of the channels' responses without a model of the pilot, to be drawn behind
        the describing functions where no estimate has a first step of its own; such as
        ``Fourier().first_step(recording, model)``.
    element
        The controlled element, for the open loops; None for that of the fit or, where it has
        none, that which the recording names.
    """
    recording = fit.recording
    shown = [e for e in fit.estimates if np.isfinite(e.values).all()]
    first_steps = [e for e in fit.estimates if e.frequency_response is not None]
    chosen = leading(shown)
    if chosen is not None:
        which = "The run" if recording.runs == 1 else f"Run 1 of {recording.runs}"
        caption = (
            f"{which}, its first seconds: the control and the response of the model "
            f"({chosen.method}) to the recorded inputs with 95 % of its remnant about it; below, "
            "what each method leaves."
        )
        yield Figure("time", plots.time_figure(recording, shown, chosen), caption)
    if shown or first_steps:
        either = [e for e in fit.estimates if e in shown or e in first_steps]
        behind = None if first_steps else points
        figure = plots.response_figure(either, points=behind, units=recording.units)
        yield Figure("describing-function", figure, _response_words(either, first_steps, behind))
    if chosen is None:
        return
    drawn = fit.loop_element
    plant = drawn.element if drawn is not None else parsed_element(recording.controlled_element)
    plant = element or plant
    if plant is not None and not chosen.model.no_loop:
        caption = (
            f"Open loops of the pilot ({chosen.method}) with the controlled element "
            f"{plant.name or 'given'}, with 95 % bands: that which the target sees and that which "
            "the disturbance sees. Marks: first crossovers; bars: phase margins."
        )
        yield Figure("open-loop", plots.open_loop_figure(chosen, plant), caption)
    modelled = [e for e in shown if e.remnant is not None] or [chosen]
    yield Figure("remnant", plots.remnant_figure(recording, modelled), _remnant_words(modelled))
    if chosen.band is not None:
        caption = (
            "Spectra of what the pilot acts on and of the control (running medians over the "
            "variance; thin lines: the recorder's floors), and the weight of each frequency in the "
            f"fit of {chosen.method}; marks: lines of the forcing functions."
        )
        if chosen.band.element:
            caption += f" The loop of the likelihood is closed by {chosen.band.element}."
        yield Figure("band", plots.band_figure(recording, chosen), caption)
    by = (
        "its own model of the remnant"
        if chosen.remnant
        else "a model of the remnant fitted to them"
    )
    inputs = " and ".join(dict.fromkeys(c.on for c in chosen.model.channels))
    caption = (
        f"Prediction errors of {chosen.method}, whitened by {by}: their autocorrelation, their "
        f"correlation with {inputs} some time before (shaded: after, which the loop explains), and "
        "their distribution against a normal one. Dashed: 95 % of white errors lie within."
    )
    yield Figure("residual-tests", plots.whiteness_figure(recording, chosen), caption)
    known = [e for e in shown if np.isfinite(e.covariance).all() and len(e.values) > 1]
    for begin in range(0, len(known), MATRICES):
        some = known[begin : begin + MATRICES]
        number = f"-{1 + begin // MATRICES}" if begin else ""
        names = listed([e.method for e in some])
        caption = f"Correlations of errors, claimed by {names}: the darker, the stronger."
        yield Figure(f"correlations{number}", plots.correlation_figure(some), caption)


def _response_words(
    drawn: Sequence[Estimate],
    first_steps: Sequence[Estimate],
    points: FrequencyResponse | None,
) -> str:
    chosen = leading(drawn) if len(drawn) > BANDS else None
    whose = f"the 95 % band of {chosen.method}" if chosen else "their 95 % bands"
    caption = f"Describing functions of the fitted models, with {whose}"
    if first_steps:
        names = ", ".join(e.method for e in first_steps)
        caption += f"; points: the first step of {names}, with bars that hold 95 %"
    if points is not None:
        caption += (
            "; circles: Fourier coefficients at the forcing lines, without a model of the pilot, "
            "with bars that hold 95 %"
        )
    return f"{caption}."


def _remnant_words(drawn: Sequence[Estimate]) -> str:
    chosen = leading(drawn) if len(drawn) > RESIDUALS else None
    who = f"the model of the pilot by {chosen.method} leaves" if chosen else None
    who = who or ("the models of the pilot leave" if drawn[1:] else "the model of the pilot leaves")
    modelled = " of the remnant as modelled (lines), and" if drawn[0].remnant is not None else ""
    return f"Power density{modelled} of what {who} of the control (points; smoothed periodogram)."
