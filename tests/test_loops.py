"""Open loops, margins and stability of pilot and controlled element."""

from __future__ import annotations

import control
import numpy as np
import pytest
from helpers import NOMINAL, PILOTS, SINGLE_LOOP, differences

from pilotid.model.catalogue import MODELS, MULTI, SINGLE
from pilotid.model.element import ControlledElement, element_named
from pilotid.model.loops import is_stable, loop_slopes, margin, margins, open_loops
from pilotid.model.model import PilotModel
from pilotid.support.types import FloatArray

pytestmark = pytest.mark.numerical

OMEGA = np.geomspace(0.05, 50.0, 50)
VALUES = {
    "single": SINGLE_LOOP.values,
    "multi": NOMINAL.values,
    "gain": np.array([0.5, 0.3, 12.0, 0.3]),
    "pursuit": PILOTS["pursuit"].values,
}


def of_control(system: control.TransferFunction, omega: FloatArray) -> FloatArray:
    return np.asarray(control.frequency_response(system, omega).complex)


# ------------------------------------------------------------------ the loops of the paper


@pytest.mark.parametrize(
    ("model", "target", "disturbance"),
    [
        (MULTI, (2.38, 59.0), (3.18, 27.0)),
        (SINGLE, (2.29, 17.5), (2.29, 17.5)),
    ],
    ids=["multi", "single"],
)
def test_margins_of_the_paper_s_loops(
    model: PilotModel, target: tuple[float, float], disturbance: tuple[float, float]
) -> None:
    found = margins(model, VALUES[model.name], element_named("4/s^2"))
    for loop, (crossover, phase_margin) in zip(found, (target, disturbance), strict=True):
        assert loop.crossover == pytest.approx(crossover, abs=0.005)
        assert loop.phase_margin == pytest.approx(phase_margin, abs=0.5)


def test_open_loops_follow_their_formulas() -> None:
    element = element_named("4/s^2")
    visual, vestibular = MULTI.response(OMEGA, NOMINAL.values)
    plant = 4.0 / (1j * OMEGA) ** 2
    target, disturbance = open_loops(MULTI, NOMINAL.values, element, OMEGA)
    np.testing.assert_allclose(target, visual * plant / (1.0 + vestibular * plant), rtol=1e-12)
    np.testing.assert_allclose(disturbance, plant * (visual + vestibular), rtol=1e-12)


def test_margins_of_an_integrator_with_delay_by_hand() -> None:
    # L = 2 e^{-0.3 s}/s crosses at 2 rad/s with 90 deg - 0.6 rad of phase margin.
    omega = np.geomspace(0.05, 60.0, 4000)
    found = margin(omega, 2.0 * np.exp(-0.3j * omega) / (1j * omega))
    assert found.crossover == pytest.approx(2.0, rel=1e-6)
    assert found.phase_margin == pytest.approx(90.0 - np.degrees(0.6), abs=1e-4)


def test_crossover_is_the_first_crossing_and_the_others_are_listed() -> None:
    # A resonance at 10 rad/s lifts |L| over one once more.
    omega = np.geomspace(0.05, 60.0, 20_000)
    s = 1j * omega
    found = margin(omega, 100.0 / (s * (s**2 + 0.2 * s + 100.0)))
    # |L|^2 = 1 in w^2: it falls through one at the least and the largest, and rises between.
    roots = np.sqrt(np.sort(np.roots([1.0, 0.2**2 - 200.0, 100.0**2, -(100.0**2)]).real))
    assert roots.size == 3
    assert found.crossover == pytest.approx(roots[0], rel=1e-4)
    assert found.others == pytest.approx((roots[2],), rel=1e-4)
    # Below the resonance the phase is that of an integrator.
    lag = np.degrees(np.arctan2(0.2 * roots[0], 100.0 - roots[0] ** 2))
    assert found.phase_margin == pytest.approx(90.0 - lag, abs=1e-3)


def test_rise_through_one_is_no_crossover() -> None:
    # |L| = 2 w/(1 + w^2/16)^2 rises through one near 0.5 rad/s and falls once, by hand at its
    # larger root.
    omega = np.geomspace(0.05, 60.0, 20_000)
    found = margin(omega, 2.0j * omega / (1.0 + 0.25j * omega) ** 4)
    roots = np.roots([1.0 / 256.0, 0.0, 1.0 / 8.0, -2.0, 1.0])
    real = np.sort(roots[np.abs(roots.imag) < 1e-9].real)
    assert real.size == 2
    assert found.crossover == pytest.approx(real[1], rel=1e-6)
    assert found.others == ()


@pytest.mark.parametrize("model", [SINGLE, MULTI], ids=["single", "multi"])
def test_slopes_of_loops_are_their_differences(model: PilotModel) -> None:
    values, element = VALUES[model.name], element_named("4/s^2")
    found = loop_slopes(model, values, element, OMEGA)
    expected = differences(
        lambda v: np.log(open_loops(model, v, element, OMEGA)), values, 1e-6 * values
    )
    np.testing.assert_allclose(np.swapaxes(found, 0, 1), expected, rtol=1e-5, atol=1e-6)


def test_loop_without_crossover_has_no_margin() -> None:
    found = margin(OMEGA, np.full(OMEGA.size, 0.5 + 0.0j))
    assert np.isnan(found.crossover)
    assert np.isnan(found.phase_margin)


# ------------------------------------------------------------------ controlled elements


def test_delay_of_a_controlled_element_is_exact_in_its_response_and_pade_in_its_rational_form() -> (
    None
):
    element = ControlledElement((2.0,), (1.0, 0.0), delay=0.25)
    exact = 2.0 / (1j * OMEGA) * np.exp(-0.25j * OMEGA)
    np.testing.assert_allclose(element.response(OMEGA), exact, rtol=1e-12)
    low = OMEGA <= 5.0
    rational = of_control(element.rational(5), OMEGA[low])
    np.testing.assert_allclose(rational, exact[low], rtol=1e-8)
    assert np.max(np.abs(of_control(element.rational(1), OMEGA[low]) / exact[low] - 1.0)) > 0.01


# ------------------------------------------------------------------ stability


def poles_of_control(model: PilotModel, element: ControlledElement) -> int:
    """Right-half-plane poles of the loop closed in python-control, delays as Pade of order 8."""
    paths = model.rational(VALUES[model.name], 8)
    # A channel on the target stands outside the loop.
    within = [i for i, c in enumerate(model.channels) if c.on != "ft"]
    paths = [paths[i] for i in within]
    channels = [model.channels[i] for i in within]
    signs = [c.sign if c.on == "e" else -c.sign for c in channels]
    pilot = control.ss(signs[0] * paths[0])
    for sign, path in zip(signs[1:], paths[1:], strict=True):
        pilot = control.parallel(pilot, control.ss(sign * path))
    loop = control.feedback(control.series(pilot, control.ss(element.rational(8))), 1)
    return int(np.sum(loop.poles().real > 1e-6))


@pytest.mark.parametrize(
    ("model", "element", "boundary"),
    [
        (SINGLE, "K/s", 1.421),
        (SINGLE, "K/s^2", 5.388),
        (MULTI, "K/s", 0.868),
        (MULTI, "K/s^2", 5.448),
        (MODELS["gain"], "K/s", 7.866),
        (MODELS["pursuit"], "K/s", 2.485),
    ],
    ids=["single K/s", "single K/s^2", "multi K/s", "multi K/s^2", "gain K/s", "pursuit K/s"],
)
def test_loops_are_stable_as_those_of_python_control_on_both_sides_of_the_boundary(
    model: PilotModel, element: str, boundary: float
) -> None:
    for share in (0.3, 0.8, 0.99, 1.01, 1.2, 2.0, 4.0):
        plant = element_named(element.replace("K", f"{share * boundary!r}"))
        assert is_stable(model, VALUES[model.name], plant) == (share < 1.0)
        assert (poles_of_control(model, plant) == 0) == (share < 1.0)


@pytest.mark.parametrize("delay", [0.0, 0.05, 0.1, 0.3])
def test_delay_of_the_controlled_element_counts_towards_stability(delay: float) -> None:
    plant = ControlledElement((4.0,), (1.0, 0.0, 0.0), delay=delay)
    assert is_stable(SINGLE, SINGLE_LOOP.values, plant) == (delay <= 0.1)
    assert (poles_of_control(SINGLE, plant) == 0) == (delay <= 0.1)


@pytest.mark.parametrize(("gain", "poles"), [(2.0, 1), (6.0, 0), (10.0, 2), (40.0, 4)])
def test_unstable_element_is_stabilised_by_the_pilot_within_a_range_of_gains(
    gain: float, poles: int
) -> None:
    plant = ControlledElement((gain,), (1.0, 1.0, -1.0))
    assert poles_of_control(SINGLE, plant) == poles
    assert is_stable(SINGLE, SINGLE_LOOP.values, plant) == (poles == 0)
