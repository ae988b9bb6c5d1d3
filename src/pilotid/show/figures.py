"""The figures of a recording's fits, each made of `plots`: for pages, and as files of their own."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from pilotid.disk import write_file
from pilotid.estimates.estimate import Estimate
from pilotid.estimates.fitted import Fitted
from pilotid.estimates.parts import FrequencyResponse
from pilotid.pilot.element import ControlledElement, parsed_element
from pilotid.recordings.recording import INPUTS, Recording
from pilotid.show.named import leading
from pilotid.show.panels import (
    band_figure,
    correlation_figure,
    open_loop_figure,
    remnant_figure,
    response_figure,
    time_figure,
    trajectory_figure,
    whiteness_figure,
)
from pilotid.show.responses import BANDS
from pilotid.show.spectra import RESIDUALS
from pilotid.show.svg import svg
from pilotid.show.words import listed
from pilotid.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Correlation matrices in one figure, which a page of paper holds.
MATRICES = 6


class Shown(NamedTuple):
    """A figure with its name, which files are called by, and its caption."""

    name: str
    caption: str
    figure: Figure


def figures_of(
    fit: Fitted,
    *,
    points: FrequencyResponse | None = None,
    element: ControlledElement | None = None,
    truth: FloatArray | None = None,
) -> list[Shown]:
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
    truth
        True parameters of a simulation, shape (parameters,).
    """
    found = list(_figures(fit, points, element, truth))
    for shown in found:
        _lay_out(shown.figure)
    return found


def save_figures(
    folder: Path,
    figures: Sequence[Shown],
    prefix: str = "",
    kinds: Sequence[Literal["svg", "pdf"]] = ("svg", "pdf"),
) -> list[Path]:
    """Write each figure as SVG and as PDF; equal figures give equal bytes.

    Parameters
    ----------
    folder
        Where to; it exists.
    figures
        What `figures_of` gave.
    prefix
        Before the names of all files, such as ``subject1-C3-``.
    kinds
        Which files to write; most of the time goes into the fonts of PDF.

    Returns
    -------
    The files.
    """
    written = []
    for name, caption, figure in figures:
        for kind in kinds:
            own = f"{prefix}{name}"
            content = pdf(figure) if kind == "pdf" else svg(figure, own, caption).encode()
            path = folder / f"{own}.{kind}"
            write_file(path, content)
            written.append(path)
    return written


def _lay_out(figure: Figure) -> None:
    """Find places for all axes once and for all: each drawing would find them anew."""
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
        figure.set_layout_engine("none")


def pdf(figure: Figure) -> bytes:
    """A figure as PDF, its text as text, without a date."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_pdf import FigureCanvasPdf

    stream = io.BytesIO()
    nothing = dict.fromkeys(("Creator", "Producer", "CreationDate"))
    with rc_context({"pdf.fonttype": 42}):
        # Not `savefig`, which draws everything twice; matplotlib's backends have no types.
        FigureCanvasPdf(figure).print_pdf(stream, metadata=nothing)  # type: ignore[no-untyped-call]
    return stream.getvalue()


def _figures(
    fit: Fitted,
    points: FrequencyResponse | None,
    element: ControlledElement | None,
    truth: FloatArray | None,
) -> Iterator[Shown]:
    recording = fit.recording
    shown = [e for e in fit.estimates if np.isfinite(e.values).all()]
    first_steps = [e for e in fit.estimates if e.frequency_response is not None]
    chosen = leading(shown)
    if chosen is not None:
        yield Shown("time", _time_words(recording, chosen), time_figure(recording, shown, chosen))
    if shown or first_steps:
        drawn = [e for e in fit.estimates if e in shown or e in first_steps]
        behind = None if first_steps else points
        figure = response_figure(drawn, truth, points=behind, units=recording.units)
        yield Shown("describing-function", _response_words(drawn, first_steps, behind), figure)
    followed = [e for e in shown if e.trajectory is not None]
    if followed:
        yield Shown("trajectories", _track_words(followed), trajectory_figure(followed, truth))
    if chosen is None:
        return
    plant = element or _element_of(fit)
    if plant is not None and not chosen.model.changes:
        caption = (
            f"Open loops of the pilot ({chosen.method}) with the controlled element "
            f"{plant.name or 'given'}, with 95 % bands: that which the target sees and that which "
            "the disturbance sees. Marks: first crossovers; bars: phase margins."
        )
        yield Shown("open-loop", caption, open_loop_figure(chosen, plant))
    modelled = [e for e in shown if e.remnant is not None] or [chosen]
    yield Shown("remnant", _remnant_words(modelled), remnant_figure(recording, modelled))
    if chosen.band is not None:
        yield Shown("band", _band_words(chosen), band_figure(recording, chosen))
    yield Shown("residual-tests", _test_words(chosen), whiteness_figure(recording, chosen))
    known = [e for e in shown if np.isfinite(e.covariance).all() and len(e.values) > 1]
    for begin in range(0, len(known), MATRICES):
        some = known[begin : begin + MATRICES]
        number = f"-{1 + begin // MATRICES}" if begin else ""
        names = listed([e.method for e in some])
        caption = f"Correlations of errors, claimed by {names}: the darker, the stronger."
        yield Shown(f"correlations{number}", caption, correlation_figure(some))


def _element_of(fit: Fitted) -> ControlledElement | None:
    if fit.loop_element is not None:
        return fit.loop_element.element
    return parsed_element(fit.recording.controlled_element)


def _time_words(recording: Recording, chosen: Estimate) -> str:
    which = "The run" if recording.runs == 1 else f"Run 1 of {recording.runs}"
    return (
        f"{which}, its first seconds: the control and the response of the model ({chosen.method}) "
        "to the recorded inputs with 95 % of its remnant about it; below, what each method leaves."
    )


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


def _track_words(drawn: Sequence[Estimate]) -> str:
    chosen = leading(drawn) or drawn[0]
    return (
        "Parameters of the pilot over time, from the start of the measurement window, with the "
        f"95 % band of {chosen.method}."
    )


def _remnant_words(drawn: Sequence[Estimate]) -> str:
    modelled = drawn[0].remnant is not None
    if len(drawn) > RESIDUALS and (chosen := leading(drawn)) is not None:
        whose = f"the model of the pilot by {chosen.method} leaves"
    else:
        whose = (
            "the models of the pilot leave" if len(drawn) > 1 else "the model of the pilot leaves"
        )
    if not modelled:
        return f"Power density of what {whose} of the control (smoothed periodogram)."
    return (
        f"Power density of the remnant as modelled (lines), and of what {whose} of the control "
        "(points; smoothed periodogram)."
    )


def _band_words(chosen: Estimate) -> str:
    caption = (
        "Spectra of what the pilot acts on and of the control (running medians over the variance; "
        "thin lines: the recorder's floors), and the weight of each frequency in the fit of "
        f"{chosen.method}; marks: lines of the forcing functions."
    )
    if chosen.band is None or not chosen.band.element:
        return caption
    return f"{caption} The loop of the likelihood is closed by {chosen.band.element}."


def _test_words(chosen: Estimate) -> str:
    by = (
        "its own model of the remnant"
        if chosen.remnant is not None
        else "a model of the remnant that was fitted to what it leaves"
    )
    inputs = " and ".join(dict.fromkeys(INPUTS[c.input] for c in chosen.model.channels))
    return (
        f"Prediction errors of {chosen.method}, whitened by {by}: their autocorrelation, their "
        f"correlation with {inputs} some time before (shaded: after, which the loop explains), and "
        "their distribution against a normal one. Dashed: 95 % of white errors lie within."
    )
