"""Plots of recordings and estimates: what they draw, where, and how they name it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import NOMINAL, PILOTS, estimate_at, recording_of
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pilotid.estimate.estimate import Estimate, Outcome, failed
from pilotid.estimate.quantities import FrequencyResponse
from pilotid.likelihood.second_step import first_step_of
from pilotid.model.catalogue import MODELS, MULTI, SINGLE
from pilotid.model.model import PilotModel
from pilotid.plots import plots
from pilotid.recording.recording import Recording
from pilotid.support.types import FloatArray

RECORDING = recording_of(NOMINAL)


def estimate(
    model: PilotModel = MULTI,
    method: str = "mle",
    errors: FloatArray | None = None,
    **fields: object,
) -> Estimate:
    """An estimate at a pilot's truth with errors that are not correlated, 1 % of the values."""
    values = PILOTS[model.name].values
    covariance = np.diag((0.01 * values if errors is None else errors) ** 2)
    return estimate_at(model, values, covariance, method=method, **fields)


def first_step(model: PilotModel = MULTI) -> FrequencyResponse:
    """The model's own response, known to 10 %."""
    omega = np.geomspace(0.5, 17.0, 12)
    value = model.response(omega, PILOTS[model.name].values)
    half = 0.5 * 0.1**2 * np.abs(value).ravel() ** 2
    return FrequencyResponse(omega, value, np.diag(np.tile(half, 2)))


def new_axes() -> Axes:
    return Figure().subplots()


def pair() -> tuple[Axes, Axes]:
    above, below = Figure().subplots(2, 1)
    return above, below


def line(axes: Axes, label: str) -> tuple[FloatArray, FloatArray]:
    """Abscissa and ordinate of the line with a label."""
    (found,) = (own for own in axes.get_lines() if own.get_label() == label)
    return np.asarray(found.get_xdata()), np.asarray(found.get_ydata())


def band(axes: Axes, at: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lower and upper edge of the first shade."""
    vertices = axes.collections[0].get_paths()[0].vertices
    edges = [[np.sort(vertices[np.isclose(vertices[:, 0], w), 1])[[0, -1]]] for w in at]
    low, high = np.concatenate(edges).T
    return low, high


# ----------------------------------------------------------------------------- over time


def test_the_model_s_response_is_drawn_over_the_recorded_control() -> None:
    axes = new_axes()
    assert plots.signals(RECORDING, estimate(), band=True, axes=axes) is axes
    time, control = line(axes, "recorded")
    np.testing.assert_array_equal(control, RECORDING.window(RECORDING.u)[0])
    assert time[0] == 0.0
    scored, response = line(axes, "mle")
    left = np.interp(scored, time, control) - response
    assert np.std(left) < 0.6 * np.std(control)
    low, high = band(axes, scored[:5])
    np.testing.assert_allclose(high - low, 2.0 * 1.96 * np.std(left), rtol=1e-3)


# ------------------------------------------------------------------------ over frequency


def test_the_curve_is_the_model_s_response() -> None:
    above, below = plots.describing_function(estimate(), axes=(*pair(), *pair()))[2:]
    omega, size = line(above, "mle")
    response = MULTI.response(omega, NOMINAL.values)[1]
    np.testing.assert_allclose(size, np.abs(response))
    turned = np.deg2rad(line(below, "mle")[1])
    np.testing.assert_allclose(np.exp(1j * turned), response / np.abs(response), atol=1e-9)
    assert above.get_ylabel() == "magnitude |u/x|"
    assert (below.get_ylabel(), below.get_xlabel()) == ("phase [deg]", "frequency [rad/s]")


def test_all_channels_are_drawn_with_the_coefficients_of_the_recording() -> None:
    axes = plots.describing_function(estimate(), points=RECORDING)
    assert len(axes) == 2 * len(MULTI.channels)
    known = first_step_of(RECORDING, MULTI)
    for index, above in enumerate(axes[::2]):
        assert above.get_title(loc="left") == f"{MULTI.channels[index].name} channel"
        (points,) = above.containers
        np.testing.assert_allclose(points[0].get_ydata(), np.abs(known.value[index]))
    pyplot.close(axes[0].figure)


def test_the_band_of_an_uncertain_delay_is_one_of_phase_alone() -> None:
    (index,) = SINGLE.delays
    errors = np.zeros(len(SINGLE.keys))
    errors[index] = 0.02
    above, below = plots.describing_function(estimate(SINGLE, errors=errors), axes=pair())
    omega, phase = line(below, "mle")
    low, high = band(below, omega[-5:])
    reach = np.rad2deg(1.96 * 0.02 * omega[-5:])
    np.testing.assert_allclose(high - phase[-5:], reach, rtol=1e-3)
    np.testing.assert_allclose(phase[-5:] - low, reach, rtol=1e-3)
    np.testing.assert_allclose(np.divide(*band(above, omega[-5:])), 1.0)


def test_points_lie_on_the_curve_s_turn_with_bars_of_95_percent() -> None:
    found = estimate(frequency_response=first_step())
    above, below = plots.describing_function(found, axes=pair())
    (points,), (turned,) = above.containers, below.containers
    omega, size = np.asarray(points[0].get_data())
    np.testing.assert_allclose(size, np.abs(MULTI.response(omega, NOMINAL.values)[0]))
    segment = points[2][0].get_segments()[0]
    # The error's power is shared by real and imaginary part: 10 % / sqrt(2) each.
    assert segment[1][1] / size[0] - 1.0 == pytest.approx(0.196 / np.sqrt(2.0), rel=1e-3)
    drawn = below.get_lines()[0]
    curve = np.interp(omega, drawn.get_xdata(), drawn.get_ydata())
    np.testing.assert_allclose(turned[0].get_ydata(), curve, atol=1.0)
    assert curve[-1] < -360.0


def test_points_of_a_failed_fit_are_drawn_and_points_without_a_phase_only_above() -> None:
    response = first_step()
    vague = replace(response, covariance=400.0 * response.covariance)
    lost = replace(failed("arx", MULTI, Outcome.SINGULAR), frequency_response=vague)
    above, below = plots.describing_function(lost, axes=pair())
    assert len(above.containers[0][0].get_ydata()) == response.omega.size
    assert len(below.containers[0][0].get_ydata()) == 0


# ----------------------------------------------------------------------------- the remnant


def white(dt: float = 0.1, runs: int = 4) -> tuple[Recording, Estimate]:
    """White noise of variance 4 as control, and a model that explains nothing of it."""
    rng = np.random.default_rng(2)
    e, u = rng.normal(size=(2, runs, 2000))
    made = Recording(dt=dt, e=e, u=2.0 * u, x=-e, units={"u": "N"})
    model = MODELS["gain"]
    nothing = estimate(model)
    values = nothing.values.copy()
    values[0] = 1e-9
    return made, replace(nothing, values=values)


def test_the_spectrum_of_a_white_residual_is_its_variance_over_the_band() -> None:
    made, nothing = white()
    axes = plots.remnant(nothing, recording=made, axes=new_axes())
    omega, density = line(axes, "mle: residual")
    assert omega.max() <= 30.0
    # Variance 4 spread evenly over 0 to pi / dt rad/s.
    assert np.mean(density[omega > 5.0]) == pytest.approx(4.0 * 0.1 / np.pi, rel=0.05)
    assert axes.get_ylabel() == "power density [N² s/rad]"
