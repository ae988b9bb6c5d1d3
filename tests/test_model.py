"""Factors and models: responses, derivatives, composition and rational forms."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from helpers import NOMINAL, SINGLE_LOOP, differences

from pilotid.datasets import SCENARIOS, simulate
from pilotid.estimate.warnings import made_for, motionless_input
from pilotid.likelihood.prediction import predict
from pilotid.model.catalogue import MODELS, MULTI, SINGLE
from pilotid.model.channel import Channel
from pilotid.model.element import Rational, element_named, pade
from pilotid.model.factors import (
    Canals,
    Delay,
    Differentiator,
    Factor,
    Gain,
    Inverse,
    Lag,
    Lead,
    Neuromuscular,
    Parameter,
    Values,
)
from pilotid.model.model import PilotModel
from pilotid.support.types import ComplexArray, FloatArray, InputError

pytestmark = pytest.mark.numerical

OMEGA = np.geomspace(0.05, 50.0, 41)


@dataclass(frozen=True)
class Washout(Factor):
    """A user's own factor: first-order washout T s / (1 + T s), with a fixed pole beside it."""

    key: str = "tw"
    fixed_poles = (-0.25,)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (Parameter(self.key, "s", 0.1, 20.0, 2.0, (0.5, 8.0)),)

    def response(self, s: ComplexArray, values: Values) -> ComplexArray:
        return values[0] * s / (1.0 + values[0] * s)

    def rational(self, values: Sequence[float], pade_order: int) -> Rational:
        return [float(values[0]), 0.0], [float(values[0]), 1.0]


#: The model of the documentation of `PilotModel`, and one with a factor from outside.
LAGGED = PilotModel(
    "lagged",
    (Channel("visual", "error", 1, (Gain("Kvis"), Lag("tlag"), Delay("tdvis"), Neuromuscular())),),
)
WASHED = PilotModel(
    "washed",
    (
        Channel("visual", "error", 1, (Gain("Kvis"), Lead("tlead"), Neuromuscular())),
        Channel("motion", "output", -1, (Differentiator(1), Gain("Km"), Washout(), Delay("tdm"))),
    ),
)

FACTORS: tuple[Factor, ...] = (
    Gain("K"),
    Lead(),
    Lag(),
    Delay(),
    Differentiator(1),
    Differentiator(2),
    Canals(),
    Inverse(element_named("6/(s(s+0.5))")),
    Inverse(element_named("3")),
    Neuromuscular(),
    Washout(),
)
#: Those that vary in time have no frequency response, see test_changing.
EVERY_MODEL = (*(m for m in MODELS.values() if not m.changes), LAGGED, WASHED)


def points(parameters: Sequence[Parameter], count: int, seed: int) -> FloatArray:
    """Random points in the usual ranges, shape (count, parameters)."""
    low, high = np.array([p.usual for p in parameters]).reshape(-1, 2).T
    return low + (high - low) * np.random.default_rng(seed).uniform(size=(count, low.size))


def name_of(thing: object) -> str:
    return getattr(thing, "name", repr(thing))


# ------------------------------------------------------------------ derivatives


@pytest.mark.parametrize("model", EVERY_MODEL, ids=name_of)
def test_jacobian_of_a_model_equals_central_differences(model: PilotModel) -> None:
    for point in points(model.parameters, 4, seed=3):
        jacobian = model.response_and_jacobian(OMEGA, point)[1]
        assert jacobian.shape == (len(model.channels), len(point), OMEGA.size)
        # Of two steps, so that the difference itself errs by the fourth power of the step.
        whole, twice = (
            differences(lambda v: model.response(OMEGA, v), point, step * point)
            for step in (1e-4, 2e-4)
        )
        expected = (4.0 * whole - twice) / 3.0
        scale = np.abs(model.response(OMEGA, point)) / point[:, None, None]
        assert np.all(np.abs(jacobian.swapaxes(0, 1) - expected) <= 1e-7 * scale)


def test_parameter_used_twice_in_a_channel_by_hand() -> None:
    model = PilotModel("twice", (Channel("only", "error", 1, (Lag("T"), Lag("T"))),))
    assert model.keys == ("T",)
    # 1/(1 + T s)^2 at T = 1, s = j is -j/2; by T it is -2 s/(1 + T s)^3 = -1/2 + j/2.
    one = np.ones(1)
    np.testing.assert_allclose(model.response(one, one), [[-0.5j]], atol=1e-12)
    np.testing.assert_allclose(
        model.response_and_jacobian(one, one)[1], [[[-0.5 + 0.5j]]], rtol=1e-9
    )


# ------------------------------------------------------------------ responses and composition


def test_multi_response_is_the_formula_of_the_paper() -> None:
    s = 1j * OMEGA
    neuromuscular = 12.0**2 / (12.0**2 + 2.0 * 0.3 * 12.0 * s + s**2)
    visual = 0.17 * (1.0 + 2.93 * s) * np.exp(-0.32 * s) * neuromuscular
    canals = (1.0 + 0.1 * s) / (1.0 + 6.0 * s)
    vestibular = s**2 * canals * 1.59 * np.exp(-0.29 * s) * neuromuscular
    response = MULTI.response(OMEGA, NOMINAL.values)
    np.testing.assert_allclose(response, [visual, vestibular], rtol=1e-12)


@pytest.mark.parametrize(
    ("model", "keys"),
    [
        (SINGLE, "Kvis tlead tdvis fnm dnm"),
        (MULTI, "Kvis tlead tdvis Kvest tdvest fnm dnm"),
        (MODELS["gain"], "Kvis tdvis fnm dnm"),
        (MODELS["lead-lag"], "Kvis tlead tlag tdvis fnm dnm"),
        (MODELS["rate"], "Kvis tlead tdvis Km tdm fnm dnm"),
        (LAGGED, "Kvis tlag tdvis fnm dnm"),
        (WASHED, "Kvis tlead Km tw tdm fnm dnm"),
    ],
    ids=name_of,
)
def test_shared_parameters_appear_once_and_neuromuscular_ones_last(
    model: PilotModel, keys: str
) -> None:
    assert model.keys == tuple(keys.split())


def test_user_factor_has_the_response_of_its_formula_and_its_fixed_pole() -> None:
    values = WASHED.start
    by_key = dict(zip(WASHED.keys, values, strict=True))
    s = 1j * OMEGA
    washout = by_key["tw"] * s / (1.0 + by_key["tw"] * s)
    expected = s * by_key["Km"] * washout * np.exp(-by_key["tdm"] * s)
    np.testing.assert_allclose(WASHED.response(OMEGA, values)[1], expected, rtol=1e-12)
    assert WASHED.fixed_poles == (-0.25,)


def test_indices_of_delays_and_linear_parameters_and_fixed_poles() -> None:
    assert [MULTI.keys[i] for i in MULTI.delays] == ["tdvis", "tdvest"]
    assert [MULTI.keys[i] for i in MULTI.linear] == ["Kvis", "Kvest"]
    assert MULTI.fixed_poles == (-1.0 / 6.0,)
    assert SINGLE.fixed_poles == ()


@pytest.mark.parametrize("model", EVERY_MODEL, ids=name_of)
def test_linear_parameters_are_those_that_the_response_is_proportional_to(
    model: PilotModel,
) -> None:
    base = model.response(OMEGA, model.start)
    jacobian = model.response_and_jacobian(OMEGA, model.start)[1]
    proportional = [
        i
        for i in range(len(model.keys))
        if any(np.allclose(jacobian[c, i] * model.start[i], base[c]) for c in range(len(base)))
    ]
    searched = [model.index[key] for key in ("Kf",) if key in model.index]  # one gain a channel
    assert sorted([*model.linear, *searched]) == proportional


# ------------------------------------------------------------------ rational forms


@pytest.mark.parametrize("factor", [f for f in FACTORS if not isinstance(f, Delay)], ids=repr)
def test_rational_form_of_a_factor_without_delay_is_exact(factor: Factor) -> None:
    s = 1j * OMEGA
    for point in points(factor.parameters, 3, seed=5):
        top, bottom = factor.rational(list(point), 5)
        np.testing.assert_allclose(
            np.polyval(top, s) / np.polyval(bottom, s),
            np.broadcast_to(factor.response(s, list(point)), s.shape),
            rtol=1e-12,
        )


@pytest.mark.parametrize("model", [m for m in EVERY_MODEL if not m.ahead], ids=name_of)
def test_rational_form_approaches_the_exact_response_as_the_pade_order_rises(
    model: PilotModel,
) -> None:
    omega = np.geomspace(0.1, 10.0, 60)
    values = model.start
    exact = model.response(omega, values)

    def error(order: int, below: float) -> FloatArray:
        rational = np.array([tf(1j * omega) for tf in model.rational(values, order)])
        return np.abs(rational / exact - 1.0)[:, omega <= below].max(axis=1)

    for channel, dynamics in enumerate(c.factors for c in model.channels):
        if any(isinstance(f, Delay) for f in dynamics):
            falling = [error(order, below=5.0)[channel] for order in (1, 2, 3, 4, 5)]
            assert all(b < 0.1 * a for a, b in itertools.pairwise(falling))
    assert np.all(error(5, below=3.0) < 1e-9)
    assert np.all(error(5, below=5.0) < 3e-7)
    assert np.all(error(5, below=10.0) < 5e-4)


@pytest.mark.parametrize("order", range(1, 9))
def test_pade_approximants_are_those_of_python_control(order: int) -> None:
    import control

    for own, theirs in zip(pade(0.23, order), control.pade(0.23, order), strict=True):
        np.testing.assert_allclose(own, theirs, rtol=1e-12)


def test_negative_delay_gives_the_reciprocal_pade_approximant() -> None:
    forward, backward = pade(0.3, 5), pade(-0.3, 5)
    assert backward == (forward[1], forward[0])
    s = 1j * np.linspace(0.1, 5.0, 20)
    advance = np.polyval(backward[0], s) / np.polyval(backward[1], s)
    np.testing.assert_allclose(advance, np.exp(0.3 * s), rtol=1e-7)
    assert np.all(np.roots(forward[1]).real < 0.0)
    assert np.all(np.roots(backward[1]).real > 0.0)


# ------------------------------------------------------------------ parameters


def test_with_start_changes_the_guesses_named_and_nothing_else() -> None:
    before = MULTI.start.copy()
    changed = MULTI.with_start({"tdvis": 0.35, "fnm": 9.0})
    expected = dict(zip(MULTI.keys, MULTI.start, strict=True)) | {"tdvis": 0.35, "fnm": 9.0}
    assert dict(zip(changed.keys, changed.start, strict=True)) == expected
    np.testing.assert_array_equal(changed.lower, MULTI.lower)
    np.testing.assert_array_equal(changed.upper, MULTI.upper)
    np.testing.assert_array_equal(MULTI.start, before)
    again = changed.with_start({"fnm": 8.0})
    assert (again.start[2], again.start[5]) == (0.35, 8.0)
    for wrong in (np.array([1.0, 0.4]), None, {"fnm": "a"}, {"fnm": np.ones(2)}):
        with pytest.raises(InputError, match="starts are numbers"):
            MULTI.with_start(wrong)  # type: ignore[arg-type]


def test_overrides_replace_bounds_in_place() -> None:
    tight = Parameter("tdvis", "s", 0.2, 0.3, 0.25, (0.2, 0.3), positive=False)
    model = replace(MULTI, overrides=(tight,))
    assert model.keys == MULTI.keys
    assert (model.lower[2], model.start[2], model.upper[2]) == (0.2, 0.25, 0.3)
    others = [i for i in range(7) if i != 2]
    np.testing.assert_array_equal(model.upper[others], MULTI.upper[others])


@pytest.mark.parametrize("model", MODELS.values(), ids=name_of)
def test_catalogue_parameters_are_usable_for_a_search(model: PilotModel) -> None:
    for p in model.parameters:
        assert p.lower < p.start < p.upper
        assert p.lower <= p.usual[0] <= p.start <= p.usual[1] <= p.upper, p.key
        # Positive parameters move on a logarithmic scale.
        assert not p.positive or p.lower > 0.0
        assert math.isfinite(p.upper)


# ------------------------------------------------------- factors and channels of one's own


@dataclass(frozen=True)
class HalfDelay(Factor):
    """A user's own delay, whose parameter is twice the time; with or without the fast form."""

    key: str = "twice"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        usual = (0.2, 1.0)
        return (Parameter(self.key, "s", 0.0, 2.0, 0.6, usual, positive=False, delay=True),)

    def response(self, s: ComplexArray, values: Values) -> ComplexArray:
        return np.exp(-0.5 * values[0] * s)

    def rational(self, values: Sequence[float], pade_order: int) -> Rational:
        return pade(0.5 * float(values[0]), pade_order)


class FastHalfDelay(HalfDelay):
    def seconds(self, values: Values) -> FloatArray:
        return 0.5 * values[0]


@pytest.mark.parametrize("factor", [HalfDelay(), FastHalfDelay()], ids=lambda f: type(f).__name__)
def test_a_delay_of_one_s_own_is_a_delay(factor: Factor) -> None:
    channel = Channel("visual", "error", 1, (Gain("Kvis", 0.32), Lead(), factor, Neuromuscular()))
    model = PilotModel("own", (channel,))
    assert [model.keys[i] for i in model.delays] == ["twice"]
    # What samplers evaluate is what everybody else does.
    prediction = predict(simulate(SCENARIOS["single"], np.random.default_rng(1)), model, 26.0)
    sets = np.stack([model.start, 1.1 * model.start])
    fast = prediction.residual_spectra(sets)
    np.testing.assert_allclose(fast, prediction.row_spectra(sets)[:, -1], rtol=1e-9, atol=1e-9)


# ------------------------------------------------------- controlled elements and looks ahead


@pytest.mark.parametrize("text", ["2/s", "4/s^2", "15 exp(-0.1s)/(s(s+3))", "0.5", "3(s+2)/s^2"])
def test_the_crossover_model_makes_an_integrator_of_its_element(text: str) -> None:
    element = element_named(text)
    model = MODELS["crossover"].with_element(element)
    assert MODELS["crossover"].needs_element
    assert not model.needs_element
    omega = np.geomspace(0.3, 20.0, 30)
    loop = model.response(omega, np.array([2.5, 0.3]))[0] * element.response(omega)
    expected = 2.5 / (1j * omega) * np.exp(-1j * omega * (0.3 + element.delay))
    # A gain is given a pole at .01 rad/s in place of an integrator.
    np.testing.assert_allclose(loop, expected, rtol=0.04 if text == "0.5" else 1e-9)


@pytest.mark.parametrize("text", ["", "vehicle", "(1-s)/s^2"])
def test_the_crossover_model_objects_without_an_element_that_can_be_inverted(text: str) -> None:
    recording = simulate(SINGLE_LOOP, np.random.default_rng(1))
    recording = replace(recording, controlled_element=text)
    assert "stable inverse" in (
        motionless_input(recording, made_for(recording, MODELS["crossover"])) or ""
    )


def test_how_far_a_model_looks_ahead_follows_bounds_and_held_values() -> None:
    model = MODELS["preview"]
    assert model.ahead == 2.0
    assert model.with_bounds(tlookf=(0.0, 1.2)).ahead == 1.2
    assert model.with_fixed(tlookf=0.7).ahead == 0.7
    assert MODELS["single"].ahead == 0.0


@pytest.mark.parametrize(
    "omega",
    [np.arange(811) * 0.0767, np.geomspace(0.1, 60.0, 500), np.arange(12.0)],
    ids=["even", "logarithmic", "few"],
)
def test_delays_on_any_grid_are_exponentials(omega: FloatArray) -> None:
    delays, s = np.array([[0.0], [0.2371], [1.0]]), 1j * omega
    assert Delay().response(s, [delays]) == pytest.approx(np.exp(-delays * s), rel=0.0, abs=1e-13)
    assert Delay().response(s, [delays[1, :1]]).shape == omega.shape
