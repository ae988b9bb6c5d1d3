"""Plots over frequency: describing functions of the pilot, and open loops with the element."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from pilotid.estimate.estimate import Estimate
from pilotid.estimate.parts import FrequencyResponse
from pilotid.model.element import ControlledElement, as_element
from pilotid.model.loops import Margin, loop_slopes, margins, open_loops
from pilotid.model.model import PilotModel
from pilotid.plots.style import (
    INK,
    Dash,
    draw_grid,
    leading,
    legend,
    log_ticks,
    named,
    new_columns,
    new_pair,
    ratio_unit,
    with_unit,
)
from pilotid.recording.recording import Recording
from pilotid.support.numbers import Z95
from pilotid.support.types import ComplexArray, FloatArray, InputError, IntArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes


POINTS = 120  # of a curve over frequency
USUAL = (0.2, 20.0)  # rad/s, the frequencies shown where there are no points
OF_LOOPS = (0.3, 20.0)  # rad/s, the frequencies of open loops
BANDS = 4  # fitted responses whose bands can be told apart
LATER: Dash = (0, (1.0, 1.5))  # a pilot after a change
NO_UNITS: Mapping[str, str] = MappingProxyType({})
#: Name, colour, stroke and marker of the target and the disturbance loop.
LOOP_STYLES: tuple[tuple[str, str, Dash, str], ...] = (
    ("target", "#0072B2", "-", "o"),
    ("disturbance", "#D55E00", (0, (5.0, 1.5)), "s"),
)


def describing_function(
    *estimates: Estimate,
    channel: str | None = None,
    truth: FloatArray | None = None,
    points: FrequencyResponse | Recording | None = None,
    units: Mapping[str, str] = NO_UNITS,
    axes: Sequence[Axes] | None = None,
) -> tuple[Axes, ...]:
    """Frequency responses of the channels: the model's with 95 % bands, a first step's as points.

    Bands follow from the covariance of the parameters to first order, for the logarithm of
    the magnitude and for the phase; bars of points hold 95 %, too.  Of more than four estimates
    the `leading` one alone has a band.

    Parameters
    ----------
    estimates
        At least one estimate.
    channel
        Name of a channel; None for all of the first estimate's model.
    truth
        True parameters of a simulation, in the order of the first estimate's model, shape
        (parameters,).
    points
        The recording, whose Fourier coefficients are drawn behind the estimates, or responses
        without a model of the pilot, such as ``Fourier().first_step(recording, model)``.
    units
        Of the recording's signals, for the label of the magnitude.
    axes
        Magnitude and phase of each channel in turn; a pair has one channel, the first unless
        `channel` names it.  None makes a new figure by pyplot.

    Returns
    -------
    The axes, magnitude and phase of each channel in turn.

    Raises
    ------
    InputError
        If there is no estimate, or a model has no such channel.
    """
    if not estimates:
        raise InputError("name at least one estimate whose describing function is to be drawn")
    names = [channel] if channel else [c.name for c in estimates[0].model.channels]
    for name in names:
        _channel(estimates[0], name)
    axes = new_columns(len(names)) if axes is None else axes
    if isinstance(points, Recording):
        from pilotid.methods.fourier import first_step_of

        units, points = units or points.units, first_step_of(points, estimates[0].model)
    for name, above, below in zip(names, axes[::2], axes[1::2], strict=False):
        _draw_channel(estimates, name, truth, points, units, (above, below))
    return tuple(axes)


def _draw_channel(
    estimates: Sequence[Estimate],
    channel: str,
    truth: FloatArray | None,
    points: FrequencyResponse | None,
    units: Mapping[str, str],
    axes: tuple[Axes, Axes],
) -> None:
    bode = Bode(axes, np.geomspace(*_shown(estimates, points), POINTS))
    several = leading(estimates) if len(estimates) > BANDS else None
    first: ComplexArray | None = None
    for own in named(estimates):
        estimate, index = own.estimate, _channel(own.estimate, channel)
        found, response = estimate.frequency_response, None
        if own.known:
            for number, end in enumerate(_ends(estimate.model)):
                response, errors = fitted_response(estimate, index, bode.omega, end)
                first = response if first is None else first
                label = f"{own.label}, after the change" if number else own.label
                bode.line(
                    response, own.colour, "" if found else label, LATER if number else own.dash
                )
                if np.isfinite(errors).all() and several in (None, estimate):
                    bode.band(response, errors, own.colour)
        if found:
            value, std = found.value[index], found.std[index]
            bode.points(
                found.omega, value, std, response, own.colour, own.marker,
                "" if own.known else own.label,
            )  # fmt: skip
            if own.known:  # one entry of the legend for line and points
                axes[0].plot([], [], color=own.colour, linestyle=own.dash, marker=own.marker,
                             markersize=4.0, markerfacecolor="white", label=own.label)  # fmt: skip
    model, index = estimates[0].model, _channel(estimates[0], channel)
    if points is not None:
        value, std = points.value[index], points.std[index]
        bode.points(points.omega, value, std, first, INK, "o", "Fourier coefficients")
    if truth is not None:
        for number, end in enumerate(_ends(model)):
            response = model.constant.response(bode.omega, truth[end])[index]
            bode.line(response, "black", "" if number else "truth", "--")
    bode.frame()
    drawn = model.channels[index]
    axes[0].set_title(f"{drawn.name} channel", loc="left")
    magnitude = f"magnitude |u/{drawn.on}|"
    axes[0].set_ylabel(with_unit(magnitude, ratio_unit(units, drawn.on)))
    legend(axes[0])


def open_loop(
    estimate: Estimate, element: ControlledElement | str, axes: tuple[Axes, Axes] | None = None
) -> tuple[Axes, Axes]:
    """Target and disturbance open loops with 95 % bands, crossovers and phase margins.

    A dot marks where each loop first falls through a magnitude of one, a bar the margin of its
    phase over -180 deg there; the legend has both in numbers.  Bands follow from the covariance
    of the parameters to first order.

    Parameters
    ----------
    estimate
        An estimate with values.
    element
        The controlled element, or a text for one, such as ``15/s^2``.
    axes
        Of magnitude and phase; None makes a new figure by pyplot.

    Raises
    ------
    InputError
        If the estimate has no values, or its loop is not known.
    """
    if estimate.model.no_loop:
        raise InputError(f"no loop of model {estimate.model.name}: {estimate.model.no_loop}")
    if not np.isfinite(estimate.values).all():
        raise InputError(f"{estimate.method} has no values, so that there is no loop to draw")
    element = as_element(element)
    axes = axes or new_pair()
    above, below = axes
    bode = Bode(axes, np.geomspace(*OF_LOOPS, 2 * POINTS))
    model, values = estimate.model, estimate.values
    loops = np.array(open_loops(model, values, element, bode.omega))
    errors = loop_errors(estimate, element, bode.omega)
    same = bool(np.allclose(loops[0], loops[1]))
    above.axhline(1.0, color=INK, linewidth=0.6)
    pairs = [*zip(loops, errors, margins(model, values, element), LOOP_STYLES, strict=True)]
    for loop, error, margin, (own, colour, dash, marker) in pairs[: 1 if same else 2]:
        name = "target and disturbance" if same else own
        if not np.abs(loop).min() > 0.0:
            continue  # no channel acts on what this loop needs
        bode.line(loop, colour, f"{name}: {_margin_words(margin)}", dash)
        phase = np.asarray(below.get_lines()[-1].get_ydata(), float)
        if np.isfinite(error).all():
            bode.band(loop, error, colour)
        if OF_LOOPS[0] < margin.crossover < OF_LOOPS[1]:
            at = float(np.interp(np.log(margin.crossover), np.log(bode.omega), phase))
            limit = at - margin.phase_margin
            below.plot([margin.crossover] * 2, [at, limit], color=colour, linewidth=2.5,
                       zorder=3.0, solid_capstyle="butt")  # fmt: skip
            below.axhline(limit, color=INK, linewidth=0.6)
            for panel, height in ((above, 1.0), (below, at)):
                panel.plot(margin.crossover, height, marker, color=colour, markersize=4.0)
    bode.frame()
    above.set_ylabel("magnitude |L| [-]")
    above.set_title("open loop" if same else "open loops", loc="left")
    legend(above)
    return axes


def _margin_words(margin: Margin) -> str:
    if not np.isfinite(margin.crossover):
        return "no crossover"
    return f"crossover {margin.crossover:.2f} rad/s, phase margin {margin.phase_margin:.0f}°"


def loop_errors(estimate: Estimate, element: ControlledElement, omega: FloatArray) -> FloatArray:
    """Errors of log-magnitude and phase [rad] of both open loops, shape (2 loops, 2, n)."""
    with np.errstate(invalid="ignore", divide="ignore"):  # a loop without a channel is zero
        slopes = np.array(loop_slopes(estimate.model, estimate.values, element, omega))
    return np.array([_errors(own, estimate.covariance) for own in slopes])


def _errors(slopes: ComplexArray, covariance: FloatArray) -> FloatArray:
    """Errors of log-magnitude and phase [rad], shape (2, n).

    Parameters
    ----------
    slopes
        Derivatives of the logarithm of a response, shape (parameters, n).
    covariance
        Of the parameters, shape (parameters, parameters).
    """
    parts = np.stack([slopes.real, slopes.imag])
    variances = np.einsum("kpn,pq,kqn->kn", parts, covariance, parts)
    return np.asarray(np.sqrt(np.maximum(variances, 0.0)))


def _shown(estimates: Sequence[Estimate], points: FrequencyResponse | None) -> tuple[float, float]:
    """Range of frequencies [rad/s] that holds all points of first steps."""
    responses = [*(e.frequency_response for e in estimates), points]
    found = [response.omega for response in responses if response is not None]
    if not found:
        return USUAL
    every = np.concatenate(found)
    return float(0.8 * every.min()), float(1.25 * every.max())


def _channel(estimate: Estimate, name: str) -> int:
    """Index of a channel by its name."""
    names = [c.name for c in estimate.model.channels]
    if name not in names:
        raise InputError(
            f"model {estimate.model.name} has no channel {name}: choose from {', '.join(names)}"
        )
    return names.index(name)


def _ends(model: PilotModel) -> tuple[IntArray, ...]:
    """The parameters of the constant pilots that a model is: one, or those before and after."""
    return model.ends if model.changes else model.ends[:1]


def fitted_response(
    estimate: Estimate, channel: int, omega: FloatArray, end: IntArray
) -> tuple[ComplexArray, FloatArray]:
    """A channel's response, shape (n,), and errors of its log-magnitude and phase, (2, n)."""
    values, covariance = estimate.values[end], estimate.covariance[np.ix_(end, end)]
    responses, jacobians = estimate.model.constant.response_and_jacobian(omega, values)
    return responses[channel], _errors(jacobians[channel] / responses[channel], covariance)


TURNS = (15.0, 45.0, 90.0, 180.0, 360.0)  # degrees between ticks


class Bode:
    """Magnitude and phase over frequency.

    Parameters
    ----------
    axes
        Of magnitude and phase.
    omega
        Frequencies of lines and bands [rad/s], ascending, shape (n,).
    """

    def __init__(self, axes: tuple[Axes, Axes], omega: FloatArray) -> None:
        self.above, self.below = axes
        self.omega = omega
        self._phase: FloatArray | None = None

    def line(self, response: ComplexArray, color: str, label: str, linestyle: Dash = "-") -> None:
        """Draw a response at `omega`, shape (n,)."""
        phase = np.rad2deg(self._turned(response))
        for axes, y in ((self.above, np.abs(response)), (self.below, phase)):
            axes.plot(self.omega, y, color=color, linestyle=linestyle, linewidth=1.2, label=label)

    def band(self, response: ComplexArray, errors: FloatArray, color: str) -> None:
        """Shade 95 % about a response at `omega`.

        Parameters
        ----------
        response
            The response, shape (n,).
        errors
            Standard errors of log-magnitude and phase [rad], shape (2, n).
        color
            Of the shade.
        """
        size, phase, reach = np.abs(response), self._turned(response), Z95 * errors
        # Further than this the axes never reach, and exponentials might.
        ratio = np.exp(np.minimum(reach[0], 50.0))
        low, high = np.rad2deg(phase - reach[1]), np.rad2deg(phase + reach[1])
        self.above.fill_between(
            self.omega, size / ratio, size * ratio, color=color, alpha=0.2, lw=0.0
        )
        self.below.fill_between(self.omega, low, high, color=color, alpha=0.2, lw=0.0)

    def points(
        self,
        omega: FloatArray,
        response: ComplexArray,
        errors: FloatArray,
        near: ComplexArray | None,
        color: str,
        marker: str,
        label: str,
    ) -> None:
        """Draw estimated responses with bars that hold 95 %.

        Parameters
        ----------
        omega, response
            Frequencies [rad/s] and responses, shape (points,).
        errors
            Root mean square of |response - true response|, shape (points,).
        near
            Response at `self.omega` on whose turn the points belong; None if there is none.
        color, marker, label
            How they look, and what they are called.
        """
        from matplotlib.axes import Axes

        size = np.abs(response)
        # Each part, real and imaginary, has half of the error's power.
        reach = Z95 * errors / np.sqrt(2.0)
        if near is None:
            phase = self._turned(response)
        else:
            line = np.interp(omega, self.omega, self._turned(near))
            phase = line + np.angle(response * np.exp(-1j * line))
        draw = partial(
            Axes.errorbar,
            color=color,
            fmt=marker,
            markersize=4.0,
            ecolor=(color, 0.5),
            elinewidth=0.8,
            markerfacecolor="white",
        )
        # A bar that reached down to zero would reach to minus infinity here.
        bars = np.array([np.minimum(reach, 0.98 * size), reach])
        draw(self.above, omega, size, bars, label=label or None)
        known = reach < size  # others say nothing of the phase
        turned, share = np.rad2deg(phase[known]), np.rad2deg((reach / size)[known])
        draw(self.below, omega[known], turned, share)

    def _turned(self, response: ComplexArray) -> FloatArray:
        """Phase [rad] without jumps, on the turn on which the first response began."""
        phase = np.unwrap(np.angle(response))
        if self._phase is None:
            self._phase = phase
        turns = np.round((self._phase[0] - phase[0]) / (2.0 * np.pi))
        return np.asarray(phase + 2.0 * np.pi * turns)

    def frame(self) -> None:
        """Scales, labels and limits; lines and points decide on these, bands and bars do not."""
        from matplotlib.ticker import MultipleLocator

        self.above.set_yscale("log")
        for axes in (self.above, self.below):
            axes.set(xscale="log", xlim=(self.omega[0], self.omega[-1]))
            draw_grid(axes)
            axes.minorticks_off()
            log_ticks(axes, "x")
        sizes, phases = _drawn(self.above), _drawn(self.below)
        sizes = sizes[sizes > 0.0]
        if sizes.size:
            self.above.set_ylim(0.6 * np.min(sizes), 1.7 * np.max(sizes))
        if phases.size:
            low, high = np.min(phases) - 20.0, np.max(phases) + 20.0
            self.below.set_ylim(low, high)
            step = next((s for s in TURNS if high - low < 7.0 * s), TURNS[-1])
            self.below.yaxis.set_major_locator(MultipleLocator(step))
        log_ticks(self.above, "y")
        self.above.tick_params(axis="x", labelbottom=False)
        self.below.set(ylabel="phase [deg]", xlabel="frequency [rad/s]")


def _drawn(axes: Axes) -> FloatArray:
    """All ordinates of lines and points."""
    every = [np.asarray(line.get_ydata(), float) for line in axes.get_lines()]
    return np.concatenate([np.zeros(0), *every])
