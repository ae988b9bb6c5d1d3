"""Frequency responses of every recording: describing functions and open loops, as numbers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from pilotid.estimates.fitted import Fitted
from pilotid.estimates.loops import NAMES
from pilotid.estimates.parts import FrequencyResponse
from pilotid.pilot.loops import open_loops
from pilotid.show.responses import fitted_response, loop_errors
from pilotid.support.types import ComplexArray, FloatArray

#: Frequencies of fitted responses [rad/s].
OMEGA = np.geomspace(0.2, 20.0, 40)
#: The method of coefficients at the lines, which no model is behind.
LINES = "lines"


class Response(NamedTuple):
    """A response over frequency, with standard errors; angles in degrees.

    Attributes
    ----------
    what
        A channel's name, with ``, before`` or ``, after`` if the pilot changes, or that of an open
        loop.
    method
        The estimate's, or `LINES`.
    omega, magnitude, phase, magnitude_error, phase_error
        Shape (n,).
    """

    what: str
    method: str
    omega: list[float]
    magnitude: list[float]
    phase: list[float]
    magnitude_error: list[float | None]
    phase_error: list[float | None]


#: Columns of frf.csv behind the fields of recordings.
COLUMNS = ("model", "method", "response", *Response._fields[2:])


def responses_of(fitted: Fitted, points: FrequencyResponse | None) -> list[Response]:
    """The responses of fits, and the coefficients at the lines.

    Of a pilot who changes they are those of the channels before and after the change.
    """
    model, element = fitted.model, fitted.loop_element
    stages = (", before", ", after") if model.changes else ("",)
    found: list[Response] = []
    for place, e in enumerate(fitted.estimates):
        if not e.outcome.usable:
            continue
        for stage, end in zip(stages, model.ends, strict=False):
            for index, channel in enumerate(model.channels):
                value, errors = fitted_response(e, index, OMEGA, end)
                found.append(_response(channel.name + stage, e.method, OMEGA, value, errors))
        if element and element.element and not model.no_loop:
            excited = fitted.loops[place].excited
            loops = open_loops(model, e.values, element.element, OMEGA)
            errors_of = loop_errors(e, element.element, OMEGA)
            for name, value, errors in zip(NAMES, loops, errors_of, strict=True):
                if name in excited:
                    found.append(_response(f"{name} loop", e.method, OMEGA, value, errors))
    for place, channel in enumerate(model.channels):
        if points is None or model.changes:
            break
        value = points.value[place]
        errors = np.tile(points.std[place] / np.abs(value) / np.sqrt(2.0), (2, 1))
        own = _response(channel.name, LINES, points.omega, value, errors)
        fit = next((r for r in found if r.what == channel.name), None)
        if fit:  # on the fit's turn
            off = np.subtract(own.phase, np.interp(points.omega, fit.omega, fit.phase))
            own = own._replace(phase=(np.array(own.phase) - 360.0 * np.round(off / 360.0)).tolist())
        found.append(own)
    return found


def _response(
    what: str, method: str, omega: FloatArray, value: ComplexArray, errors: FloatArray
) -> Response:
    size, phase = np.abs(value), np.degrees(np.unwrap(np.angle(value)))
    off = [own.tolist() for own in (size * errors[0], np.degrees(errors[1]))]
    told = [[x if np.isfinite(x) else None for x in own] for own in off]
    return Response(what, method, omega.tolist(), size.tolist(), phase.tolist(), told[0], told[1])


def response_cells(content: Mapping[str, Any]) -> Iterator[list[object]]:
    """Lines of frf.csv of one fit, behind the fields of its recording."""
    for held in content.get("responses", ()):
        own = Response(*held)
        for row in zip(*own[2:], strict=True):
            yield [content["model"], own.method, own.what, *("" if x is None else x for x in row)]


def over_subjects(found: Sequence[Response]) -> tuple[FloatArray, FloatArray]:
    """Mean and standard deviation of log-magnitudes and phases [deg], each of shape (2, n).

    Phases are put on the first one's turn; without a second the deviation is zero.
    """
    sizes = np.log(np.array([own.magnitude for own in found]))
    phases = np.array([own.phase for own in found])
    phases = phases - 360.0 * np.round((phases - phases[0]).mean(axis=1, keepdims=True) / 360.0)
    both = np.array([sizes, phases])
    deviation = both.std(axis=1, ddof=1) if len(found) > 1 else np.zeros_like(both[:, 0])
    return both.mean(axis=1), deviation
