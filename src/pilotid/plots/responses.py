"""Plots over frequency: describing functions of the pilot, and open loops with the element."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pilotid.estimate.estimate import Estimate
from pilotid.estimate.quantities import FrequencyResponse
from pilotid.model.element import ControlledElement, as_element
from pilotid.model.loops import loop_slopes, margins, open_loops
from pilotid.model.model import PilotModel
from pilotid.plots.style import (
    INK,
    Dash,
    Named,
    Style,
    draw_grid,
    leading,
    legend,
    log_ticks,
    named,
    new_columns,
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
LATER: Dash = (0, (1.0, 1.5))  # a pilot after a change
#: Name and style of the target and the disturbance loop.
LOOP_STYLES = (
    ("target", Style("#0072B2", "o")),
    ("disturbance", Style("#D55E00", "o", (0, (5.0, 1.5)))),
)


def describing_function(
    *estimates: Estimate,
    truth: FloatArray | None = None,
    points: FrequencyResponse | Recording | None = None,
    units: Mapping[str, str] = {},
    axes: Sequence[Axes] | None = None,
) -> tuple[Axes, ...]:
    """Frequency responses of the channels: the models' as lines, a first step's as points.

    The `leading` estimate has a 95 % band, from the covariance of its parameters to first order,
    for the logarithm of the magnitude and for the phase; bars of points hold 95 %, too.

    Parameters
    ----------
    estimates
        At least one estimate.
    truth
        True parameters of a simulation, in the order of the first estimate's model, shape
        (parameters,).
    points
        The recording, whose Fourier coefficients are drawn behind the estimates, or responses
        without a model of the pilot, such as ``Fourier().first_step(recording, model)``.
    units
        Of the recording's signals, for the label of the magnitude.
    axes
        Magnitude and phase of each channel of the first estimate's model in turn; of fewer axes
        the first channels.  None makes a new figure by pyplot.

    Returns
    -------
    The axes, magnitude and phase of each channel in turn.

    Raises
    ------
    InputError
        If there is no estimate.
    """
    if not estimates:
        raise InputError("name at least one estimate whose describing function is to be drawn")
    model = estimates[0].model
    axes = new_columns(len(model.channels)) if axes is None else axes
    if isinstance(points, Recording):
        from pilotid.likelihood.second_step import first_step_of

        units, points = units or points.units, first_step_of(points, model)
    omega, banded = np.geomspace(*_shown(estimates, points), POINTS), leading(estimates)
    pairs = zip(model.channels, axes[::2], axes[1::2], strict=False)
    for index, (channel, above, below) in enumerate(pairs):
        bode = Bode((above, below), omega)
        for shown in named(estimates):
            _draw_estimate(bode, shown, channel.name, banded=shown.estimate is banded)
        if points is not None:
            bode.points(points, index, Style(INK, "o"), "Fourier coefficients")
        if truth is not None:
            for number, end in enumerate(_ends(model)):
                response = model.constant.response(omega, truth[end])[index]
                bode.line(response, Style("black", "", "--"), "" if number else "truth")
        bode.frame()
        above.set_title(f"{channel.name} channel", loc="left")
        above.set_ylabel(with_unit(f"magnitude |u/{channel.on}|", ratio_unit(units, channel.on)))
        legend(above)
    return tuple(axes)


def _draw_estimate(bode: Bode, shown: Named, channel: str, *, banded: bool) -> None:
    """Lines of an estimate's model and points of its first step, if it has such a channel."""
    estimate, style = shown.estimate, shown.style
    names = [c.name for c in estimate.model.channels]
    if channel not in names:
        return
    index = names.index(channel)
    for number, end in enumerate(_ends(estimate.model) if shown.known else ()):
        response, errors = fitted_response(estimate, index, bode.omega, end)
        label = f"{shown.label}, after the change" if number else shown.label
        look = style._replace(dash=LATER) if number else style
        bode.line(response, look, label, errors if banded else None)
    if (measured := estimate.frequency_response) is not None:
        label = "" if shown.known else shown.label
        bode.points(measured, index, style, label)


def open_loop(
    estimate: Estimate, element: ControlledElement | str, axes: tuple[Axes, Axes] | None = None
) -> tuple[Axes, Axes]:
    """Target and disturbance open loops with 95 % bands, crossovers and phase margins.

    A dot marks where each loop first falls through a magnitude of one; the legend has crossover
    and phase margin in numbers.  Bands follow from the covariance of the parameters to first order.

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
    model, values = estimate.model, estimate.values
    if why := model.no_loop or ("" if np.isfinite(values).all() else "the fit has no values"):
        raise InputError(f"{estimate.method}, {model.name}: no loop to draw: {why}")
    element = as_element(element)
    above, below = axes or new_columns(1)
    bode = Bode((above, below), np.geomspace(*OF_LOOPS, 2 * POINTS))
    loops = np.array(open_loops(model, values, element, bode.omega))
    with np.errstate(invalid="ignore", divide="ignore"):  # a loop without a channel is zero
        slopes = np.array(loop_slopes(model, values, element, bode.omega))
    errors = [_errors(slope, estimate.covariance) for slope in slopes]
    same = bool(np.allclose(loops[0], loops[1]))
    above.axhline(1.0, color=INK, linewidth=0.6)
    drawn = [*zip(loops, errors, margins(model, values, element), LOOP_STYLES, strict=True)]
    for loop, error, margin, (name, style) in drawn[: 1 if same else 2]:
        if not np.abs(loop).min() > 0.0:
            continue  # no channel acts on what this loop needs
        words = "no crossover"
        if np.isfinite(margin.crossover):
            words = f"crossover {margin.crossover:.2f} rad/s"
            words += f", phase margin {margin.phase_margin:.0f}°"
        label = f"{'target and disturbance' if same else name}: {words}"
        bode.line(loop, style, label, error)
        if OF_LOOPS[0] < margin.crossover < OF_LOOPS[1]:
            above.plot(margin.crossover, 1.0, style.marker, color=style.colour, markersize=4.0)
    bode.frame()
    above.set_ylabel("magnitude |L| [-]")
    legend(above)
    return above, below


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
    frequencies = [response.omega for response in responses if response is not None]
    if not frequencies:
        return USUAL
    every = np.concatenate(frequencies)
    return float(0.8 * every.min()), float(1.25 * every.max())


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
        #: Frequencies and phase of what was drawn first, on whose turn all others are.
        self._first: tuple[FloatArray, FloatArray] | None = None

    def line(
        self, response: ComplexArray, style: Style, label: str, errors: FloatArray | None = None
    ) -> None:
        """Draw a response at `omega`, and 95 % about it where its errors are known.

        Parameters
        ----------
        response
            The response, shape (n,).
        style, label
            How it looks, and what it is called.
        errors
            Standard errors of log-magnitude and phase [rad], shape (2, n).
        """
        size, phase = np.abs(response), np.unwrap(np.angle(response))
        self._first = self._first or (self.omega, phase)
        phase += 2.0 * np.pi * np.round((self._first[1][0] - phase[0]) / (2.0 * np.pi))
        for axes, y in ((self.above, size), (self.below, np.rad2deg(phase))):
            axes.plot(self.omega, y, color=style.colour, linestyle=style.dash, linewidth=1.2,
                      label=label)  # fmt: skip
        if errors is not None and np.isfinite(errors).all():
            # Further than this the axes never reach, and exponentials might.
            ratio, reach = np.exp(np.minimum(Z95 * errors[0], 50.0)), Z95 * errors[1]
            ends = np.rad2deg(phase - reach), np.rad2deg(phase + reach)
            shade: dict[str, Any] = {"color": style.colour, "alpha": 0.2, "lw": 0.0}
            self.above.fill_between(self.omega, size / ratio, size * ratio, **shade)
            self.below.fill_between(self.omega, *ends, **shade)

    def points(self, measured: FrequencyResponse, channel: int, style: Style, label: str) -> None:
        """Draw a channel's estimated response with bars that hold 95 %."""
        omega, response = measured.omega, measured.value[channel]
        # Each part, real and imaginary, has half of the error's power.
        size, reach = np.abs(response), Z95 * measured.std[channel] / np.sqrt(2.0)
        self._first = self._first or (omega, np.unwrap(np.angle(response)))
        line = np.interp(omega, *self._first)
        phase = line + np.angle(response * np.exp(-1j * line))
        colour, marker, _ = style
        look: dict[str, Any] = {"color": colour, "ecolor": (colour, 0.5), "elinewidth": 0.8}
        look |= {"fmt": marker, "markersize": 4.0, "markerfacecolor": "white"}
        # A bar that reached down to zero would reach to minus infinity here.
        bars = np.array([np.minimum(reach, 0.98 * size), reach])
        self.above.errorbar(omega, size, bars, label=label or None, **look)
        known = reach < size  # others say nothing of the phase
        turned, bars = np.rad2deg(phase[known]), np.rad2deg((reach / size)[known])
        self.below.errorbar(omega[known], turned, bars, **look)

    def frame(self) -> None:
        """Scales, labels and limits; lines and points decide on these, bands and bars do not."""
        from matplotlib.ticker import MaxNLocator

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
            self.below.set_ylim(np.min(phases) - 20.0, np.max(phases) + 20.0)
        self.below.yaxis.set_major_locator(MaxNLocator(6, steps=[1.0, 1.5, 3.0, 4.5, 9.0, 10.0]))
        log_ticks(self.above, "y")
        self.above.tick_params(axis="x", labelbottom=False)
        self.below.set(ylabel="phase [deg]", xlabel="frequency [rad/s]")


def _drawn(axes: Axes) -> FloatArray:
    """All ordinates of lines and points."""
    every = [np.asarray(line.get_ydata(), float) for line in axes.get_lines()]
    return np.concatenate([np.zeros(0), *every])
