"""Plots of recordings and estimates that take and return matplotlib axes.

For notebooks and for pages alike::

    plot.signals(recording, mle, fourier)
    plot.describing_function(mle, fourier, channel="visual")

Every function takes one estimate or several; of those that failed it draws what there is.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pilotid.estimates.estimate import Estimate
from pilotid.pilot.frozen import ends, frozen
from pilotid.pilot.model import PilotModel
from pilotid.recordings.recording import Recording
from pilotid.show.bode import Bode
from pilotid.show.style import GRID, INK, STYLES, log_ticks, style_of
from pilotid.time_domain.output_error import OutputErrors
from pilotid.time_domain.prediction import predict
from pilotid.time_domain.prepare import prepare
from pilotid.types import ComplexArray, FloatArray, InputError, IntArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

POINTS = 120  # of a curve over frequency
USUAL = (0.2, 20.0)  # rad/s, the frequencies shown where there are no points
#: Lines of a pilot before and after a change, and what the legend adds to the method's name.
ENDS = (("-", ""), ("--", ", after the change"))
INSIDE = 0.8  # share of an analysis band that its filter leaves alone
BAND = 30.0  # rad/s, up to which a residual's spectrum is shown where no model says how far
#: A periodogram is averaged over this share of the frequency, and over so many lines at least.
SMOOTHING, FEWEST = 1.0 / 6.0, 4


def signals(
    recording: Recording, *estimates: Estimate, run: int = 0, axes: Axes | None = None
) -> Axes:
    """The recorded control of a run, and what the models make of the recorded inputs.

    Parameters
    ----------
    recording
        The recording.
    estimates
        Estimates from it.
    run
        Number of the run, from 0.
    axes
        Where to draw; None makes a new figure by pyplot.
    """
    axes = axes if axes is not None else _new_axes()
    time, control = recording.time[recording.run_in :], recording.window(recording.u)[run]
    axes.plot(time, control, color=INK, linewidth=0.9, label="recorded")
    for (estimate, label, (colour, _)), width in zip(*_nested(estimates), strict=True):
        if np.isfinite(estimate.values).all():
            scored, output, _ = _simulated(recording, estimate)
            axes.plot(scored, output[run], color=colour, linewidth=width, label=label)
    return _over_time(axes, recording, "control u")


def residual(
    recording: Recording, *estimates: Estimate, run: int = 0, axes: Axes | None = None
) -> Axes:
    """What the models leave of the control of a run: remnant, and what they do not describe.

    Parameters
    ----------
    recording
        The recording.
    estimates
        Estimates from it.
    run
        Number of the run, from 0.
    axes
        Where to draw; None makes a new figure by pyplot.
    """
    axes = axes if axes is not None else _new_axes()
    axes.axhline(0.0, color=INK, linewidth=0.5)
    for (estimate, label, (colour, _)), width in zip(*_nested(estimates), strict=True):
        if np.isfinite(estimate.values).all():
            scored, _, left = _simulated(recording, estimate)
            axes.plot(scored, left[run], color=colour, linewidth=width, label=label)
    return _over_time(axes, recording, "residual")


def describing_function(
    *estimates: Estimate,
    channel: str | None = None,
    truth: FloatArray | None = None,
    axes: tuple[Axes, Axes] | None = None,
) -> tuple[Axes, Axes]:
    """A channel's frequency response: the model's with its 95 % band, a first step's as points.

    Bands follow from the covariance of the parameters to first order, for the logarithm of
    the magnitude and for the phase; bars of points hold 95 %, too.

    Parameters
    ----------
    estimates
        At least one estimate.
    channel
        Name of the channel; None for the model's first.
    truth
        True parameters of a simulation, in the order of the first estimate's model.
    axes
        Of magnitude and phase; None makes a new figure by pyplot.

    Raises
    ------
    InputError
        If there is no estimate, or a model has no such channel.
    """
    if not estimates:
        raise InputError("name at least one estimate whose describing function is to be drawn")
    if axes is None:
        from matplotlib import pyplot

        _, (above, below) = pyplot.subplots(
            2, 1, sharex=True, height_ratios=(3, 2), figsize=(6.0, 5.0), layout="constrained"
        )
        axes = above, below
    bode = Bode(axes, np.geomspace(*_shown(estimates), POINTS))
    for estimate, label, (colour, marker) in _named(estimates):
        index, found = _channel(estimate, channel), estimate.frequency_response
        response = None
        if np.isfinite(estimate.values).all():
            for end, (style, words) in zip(_ends(estimate.model), ENDS, strict=False):
                response, errors = _fitted(estimate, index, bode.omega, end)
                bode.line(response, colour, "" if found else f"{label}{words}", style)
                if np.isfinite(errors).all():
                    bode.band(response, errors, colour)
        if found:
            value, std = found.value[index], found.std[index]
            bode.points(found.omega, value, std, response, colour, marker, label)
    model, index = estimates[0].model, _channel(estimates[0], channel)
    if truth is not None:
        for number, end in enumerate(_ends(model)):
            response = frozen(model).response(bode.omega, truth[end])[index]
            bode.line(response, "black", "" if number else "truth", "--")
    bode.frame()
    drawn = model.channels[index]
    axes[0].set_title(f"{drawn.name} channel", loc="left")
    axes[0].set_ylabel(f"magnitude |u/{'e' if drawn.input == 'error' else 'x'}|")
    _legend(axes[0])
    return axes


def remnant(
    *estimates: Estimate, recording: Recording | None = None, axes: Axes | None = None
) -> Axes:
    """The remnant's power density as the methods model it, and that of their residuals.

    Parameters
    ----------
    estimates
        Estimates; without a recording, at least one of them has a model of the remnant.
    recording
        What they were estimated from, for smoothed periodograms of the residuals (points).
    axes
        Where to draw; None makes a new figure by pyplot.

    Raises
    ------
    InputError
        If there is nothing to draw.
    """
    if recording is None and all(e.remnant is None for e in estimates):
        raise InputError(
            "none of these estimates has a model of the remnant; name the recording, too, to see "
            "the spectra of their residuals"
        )
    axes = axes if axes is not None else _new_axes()
    for estimate, label, (colour, marker) in _named(estimates):
        own, highest = estimate.remnant, BAND
        if own is not None:
            highest = INSIDE * float(own.omega[-1])
            shown = own.omega <= highest
            model = own.omega[shown], own.density[shown]
            axes.plot(*model, color=colour, linewidth=1.4, label=label)
        if recording is not None and np.isfinite(estimate.values).all():
            omega, density = _periodogram(recording, estimate)
            shown = omega <= highest
            axes.plot(omega[shown], density[shown], marker, color=colour, markersize=3.0,
                      alpha=0.6, label=f"{label}: residual")  # fmt: skip
    unit = recording.units.get("u", "") if recording is not None else ""
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.grid(color=GRID, linewidth=0.5)
    axes.set_axisbelow(True)
    log_ticks(axes, "x")
    axes.set_xlabel("frequency [rad/s]")
    axes.set_ylabel(f"power density [{f'({unit})' if '/' in unit else unit or 'u'}² s/rad]")
    _legend(axes)
    return axes


def _new_axes() -> Axes:
    """Axes of a new figure, which pyplot shows and keeps."""
    from matplotlib import pyplot

    return pyplot.subplots(figsize=(9.0, 3.0), layout="constrained")[1]


def _named(estimates: Sequence[Estimate]) -> Iterator[tuple[Estimate, str, tuple[str, str]]]:
    """Estimates with labels, colours and markers, by method or, if these repeat, by number."""
    methods, models = [e.method for e in estimates], [e.model.name for e in estimates]
    alike = len(set(methods)) < len(methods)
    named = list(zip(methods, models, strict=True))
    for number, (method, model) in enumerate(named):
        style = list(STYLES.values())[-number % len(STYLES)] if alike else style_of(method)
        label = f"{method}, {model}" if len(set(models)) > 1 else method
        if named.count((method, model)) > 1:
            label += f" {named[: number + 1].count((method, model))}"
        yield estimates[number], label, style


def _nested(
    estimates: Sequence[Estimate],
) -> tuple[list[tuple[Estimate, str, tuple[str, str]]], list[float]]:
    """The same, and widths of lines that leave the first to be seen beneath the last."""
    count = len(estimates)
    return list(_named(estimates)), np.linspace(min(0.5 + 0.4 * count, 2.0), 0.9, count).tolist()


def _simulated(
    recording: Recording, estimate: Estimate
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Time of the scored samples, the model's output and what it leaves, (runs, samples) each."""
    prepared = prepare(recording, estimate.model)
    problem = OutputErrors(predict(recording, estimate.model))
    left = problem.residual(estimate.values)
    return prepared.time[prepared.first :], problem.prediction.control - left, left


def _over_time(axes: Axes, recording: Recording, what: str) -> Axes:
    """Labels of a signal in the unit of the control."""
    unit = recording.units.get("u", "")
    axes.set_ylabel(f"{what} [{unit}]" if unit else what)
    axes.set_xlabel("time [s]")
    axes.set_xlim(0.0, recording.time[-1])
    # Above the axes, since signals are everywhere inside them.
    _legend(axes, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=5, borderaxespad=0.1)
    return axes


def _legend(axes: Axes, **where: Any) -> None:
    """A legend, if anything has a name."""
    if axes.get_legend_handles_labels()[1]:
        axes.legend(frameon=False, **where)


def _shown(estimates: Sequence[Estimate]) -> tuple[float, float]:
    """Range of frequencies [rad/s] that holds all points of first steps."""
    found = [e.frequency_response.omega for e in estimates if e.frequency_response is not None]
    if not found:
        return USUAL
    every = np.concatenate(found)
    return float(0.8 * every.min()), float(1.25 * every.max())


def _channel(estimate: Estimate, name: str | None) -> int:
    """Index of a channel by its name."""
    names = [c.name for c in estimate.model.channels]
    if name is None:
        return 0
    if name not in names:
        raise InputError(
            f"model {estimate.model.name} has no channel {name}: choose from {', '.join(names)}"
        )
    return names.index(name)


def _ends(model: PilotModel) -> tuple[IntArray, ...]:
    """The parameters of the constant pilots that a model is: one, or those before and after."""
    return ends(model) if model.changes else ends(model)[:1]


def _fitted(
    estimate: Estimate, channel: int, omega: FloatArray, end: IntArray
) -> tuple[ComplexArray, FloatArray]:
    """A channel's response, shape (n,), and errors of its log-magnitude and phase, (2, n)."""
    own = estimate.values[end], estimate.covariance[np.ix_(end, end)]
    responses, jacobians = frozen(estimate.model).response_and_jacobian(omega, own[0])
    slopes = jacobians[channel] / responses[channel]
    parts = np.stack([slopes.real, slopes.imag])
    variances = np.einsum("kpn,pq,kqn->kn", parts, own[1], parts)
    return responses[channel], np.sqrt(np.maximum(variances, 0.0))


def _periodogram(recording: Recording, estimate: Estimate) -> tuple[FloatArray, FloatArray]:
    """One-sided power density of the residual over frequency [rad/s], all runs averaged."""
    _, _, left = _simulated(recording, estimate)
    count = left.shape[1]
    taper = np.hanning(count)
    spectrum = np.fft.rfft(taper * left)
    power = np.mean(np.abs(spectrum) ** 2, axis=0) * recording.dt / (np.pi * np.sum(taper**2))
    omega = 2.0 * np.pi * np.fft.rfftfreq(count, recording.dt)
    edges = [1]
    while edges[-1] < omega.size:
        edges.append(edges[-1] + max(FEWEST, round(SMOOTHING * edges[-1])))
    sizes = np.diff([*edges[:-1], omega.size])
    places = np.add.reduceat(omega, edges[:-1]) / sizes
    return places, np.add.reduceat(power, edges[:-1]) / sizes
