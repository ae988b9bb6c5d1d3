"""Frequency responses of an analysis, its figures of them, and symbols of quantities."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import NOMINAL

from pilotid.analysis.figures import responses_figure
from pilotid.analysis.responses import (
    LINES,
    OMEGA,
    Response,
    over_subjects,
    responses_of,
)
from pilotid.datasets import simulate
from pilotid.datasets.scenarios import SCENARIOS
from pilotid.estimates.estimate import Outcome, failed
from pilotid.estimates.fitted import Fitted
from pilotid.estimates.loops import LoopElement
from pilotid.estimates.quantities import symbol
from pilotid.methods.fourier import first_step_of
from pilotid.pilot.catalogue import MODELS
from pilotid.pilot.loops import open_loops
from pilotid.recordings.recording import Recording
from pilotid.support.numbers import recording_rng

pytestmark = pytest.mark.numerical
RECORDING: Recording = simulate(replace(NOMINAL, runs=3), recording_rng(1, "responses"))


def fitted(recording: Recording = RECORDING) -> Fitted:
    scale = np.diag((0.05 * NOMINAL.values) ** 2)
    estimate = replace(
        failed("mle", NOMINAL.model, Outcome.CONVERGED), values=NOMINAL.values, covariance=scale
    )
    element = LoopElement(NOMINAL.element, "given")
    return Fitted(recording, NOMINAL.model, (estimate,), loop_element=element)


def test_responses_are_the_models_and_have_its_errors() -> None:
    own = fitted()
    found = {r.what: r for r in responses_of(own, None)}
    assert list(found) == ["visual", "vestibular", "target loop", "disturbance loop"]
    values = own.model.response(OMEGA, NOMINAL.values)
    for name, value in zip(("visual", "vestibular"), values, strict=True):
        assert found[name].magnitude == pytest.approx(np.abs(value))
    rng = np.random.default_rng(0)
    draws = NOMINAL.values * (1.0 + 0.05 * rng.normal(size=(4000, len(NOMINAL.values))))
    visual = np.array([own.model.response(OMEGA, draw)[0] for draw in draws[:, :]])
    # To first order only; the resonance is left out.
    low = OMEGA < 5.0
    scatter = np.std(np.log(np.abs(visual)), axis=0)[low]
    claimed = (np.array(found["visual"].magnitude_error) / found["visual"].magnitude)[low]
    np.testing.assert_allclose(claimed, scatter, rtol=0.1)
    loops = open_loops(own.model, NOMINAL.values, NOMINAL.element, OMEGA)
    assert found["target loop"].magnitude == pytest.approx(np.abs(loops[0]))
    turn = np.exp(1j * np.radians(found["disturbance loop"].phase))
    np.testing.assert_allclose(turn, loops[1] / np.abs(loops[1]), atol=1e-9)


def test_coefficients_at_the_lines_lie_about_the_truth_on_its_turn() -> None:
    points = first_step_of(RECORDING, NOMINAL.model)
    assert points is not None
    found = responses_of(fitted(), points)
    own = next(r for r in found if (r.what, r.method) == ("visual", LINES))
    true = NOMINAL.model.response(np.array(own.omega), NOMINAL.values)[0]
    middle = (np.array(own.omega) > 1.0) & (np.array(own.omega) < 10.0)
    off = np.log(np.array(own.magnitude) / np.abs(true))[middle]
    assert np.median(np.abs(off)) < 0.2
    fit = next(r for r in found if (r.what, r.method) == ("visual", "mle"))
    away = np.array(own.phase) - np.interp(own.omega, fit.omega, fit.phase)
    assert np.abs(away).max() <= 180.0 + 1e-9


def test_a_pilot_who_changes_has_responses_before_and_after() -> None:
    scenario = SCENARIOS["adapting-slow"]
    estimate = replace(
        failed("mle", scenario.model, Outcome.CONVERGED),
        values=scenario.values,
        covariance=np.diag((0.05 * scenario.values) ** 2),
    )
    element = LoopElement(scenario.element, "given")
    own = Fitted(RECORDING, scenario.model, (estimate,), loop_element=element)
    found = responses_of(own, first_step_of(RECORDING, NOMINAL.model))
    assert [r.what for r in found] == ["visual, before", "visual, after"]
    for response, (end, _) in zip(found, scenario.constant_ends, strict=True):
        expected = end.model.response(OMEGA, end.values)[0]
        assert response.magnitude == pytest.approx(np.abs(expected))
    figure = responses_figure([found] * 2)
    assert [axes.get_title(loc="left") for axes in figure.axes] == ["visual", ""]


def test_what_is_not_excited_or_fails_has_none() -> None:
    alone = replace(RECORDING, fd=None, lines={})
    assert "disturbance loop" not in {r.what for r in responses_of(fitted(alone), None)}
    failing = replace(fitted(), estimates=(failed("mle", NOMINAL.model, Outcome.DIED),))
    assert responses_of(failing, None) == []


def test_the_mean_over_subjects_is_of_logarithms_on_one_turn() -> None:
    made = [
        Response("visual", "mle", [1.0, 2.0], [size, size], [phase, phase], [None] * 2, [None] * 2)
        for size, phase in ((1.0, 10.0), (4.0, 370.0 + 20.0))
    ]
    mean, deviation = over_subjects(made)
    np.testing.assert_allclose(np.exp(mean[0]), 2.0)
    np.testing.assert_allclose(mean[1], 20.0)
    np.testing.assert_allclose(deviation[0], np.log(4.0) / np.sqrt(2.0))
    assert over_subjects(made[:1])[1].tolist() == [[0.0, 0.0], [0.0, 0.0]]


@pytest.mark.parametrize(
    ("key", "shown"),
    [
        ("Kvis", "$K_v$"),
        ("tlead2", "$T_{L,2}$"),
        ("Kvis*tlead", r"$K_v\,T_L$"),
        ("tlead2 - tlead1", "$T_{L,2} - T_{L,1}$"),
        ("fnm", r"$\omega_{nm}$"),
        ("var_e_target", r"$\sigma^2_{e,t}$"),
        ("rad/s", "rad/s"),
        ("C1:C2", "C1:C2"),
        ("own_gain", "own_gain"),
        ("", ""),
        ("12", "12"),
    ],
)
def test_symbols(key: str, shown: str) -> None:
    assert symbol(key) == shown


def test_every_parameter_of_the_catalogue_has_a_symbol() -> None:
    keys = {key for model in MODELS.values() if not model.changes for key in model.keys}
    assert {key for key in keys if not symbol(key).startswith("$")} == set()
