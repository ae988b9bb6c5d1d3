"""Margins of the loops that an estimate makes, their errors, and how fit shows them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import (
    NOMINAL,
    PILOTS,
    SINGLE_LOOP,
    Run,
    differences,
    estimate_at,
    fit_of,
    monte_carlo,
    recording_of,
    strict,
)

from pilotid.datasets import Scenario
from pilotid.estimate.estimate import Outcome, failed
from pilotid.estimate.loops import both_loops, margin_slopes
from pilotid.methods.mle import MLE
from pilotid.model.catalogue import MODELS, SINGLE
from pilotid.model.element import ControlledElement, element_named
from pilotid.model.loops import margin, margins, open_loops
from pilotid.plots.responses import open_loop
from pilotid.recording.files import save_recording
from pilotid.support.types import FloatArray

pytestmark = pytest.mark.numerical

#: A pilot whose neuromuscular resonance crosses over once more, and standard errors.
RESONANT = np.array([0.629, 0.156, 0.2556, 13.36, 0.184])
ERRORS = np.array([0.018, 0.012, 0.0053, 0.25, 0.021])


def gaussian(values: FloatArray, errors: FloatArray, count: int = 400) -> FloatArray:
    return values + errors * np.random.default_rng(5).standard_normal((count, values.size))


# ------------------------------------------------------------------ to first order


@pytest.mark.parametrize(
    "scenario", [SINGLE_LOOP, NOMINAL, PILOTS["pursuit"]], ids=lambda s: s.name
)
def test_slopes_of_margins_are_their_differences(scenario: Scenario) -> None:
    model, values, element = scenario.model, scenario.values, scenario.element
    omega = np.geomspace(1.0, 6.0, 20_000)

    def margins_at(point: FloatArray) -> FloatArray:
        loops = [margin(omega, loop) for loop in open_loops(model, point, element, omega)]
        return np.array([(own.crossover, own.phase_margin) for own in loops])

    expected = differences(margins_at, values, 1e-4 * values)
    for which, (crossover, _) in enumerate(margins_at(values)):
        slopes = margin_slopes(model, values, element, crossover)[which]
        np.testing.assert_allclose(slopes.T, expected[:, which], rtol=2e-3, atol=1e-3)


def test_a_pilot_of_the_target_alone_has_no_disturbance_loop() -> None:
    model = MODELS["following"]
    target, disturbance = margin_slopes(model, model.start, element_named("2"), 3.0)
    assert np.isfinite(target).all()
    assert np.isnan(disturbance).all()
    own = estimate_at(model, model.start, np.eye(5)).loops("2").target
    assert own.remark.startswith("it acts on the target alone")


def test_quantities_have_keys_units_and_the_margins_of_the_values() -> None:
    element = NOMINAL.element
    estimate = fit_of(MLE(), NOMINAL)
    quantities = estimate.loops(element).quantities
    assert [(q.key, q.unit) for q in quantities] == [
        ("target_crossover", "rad/s"),
        ("target_phase_margin", "deg"),
        ("disturbance_crossover", "rad/s"),
        ("disturbance_phase_margin", "deg"),
    ]
    target, disturbance = margins(NOMINAL.model, estimate.values, element)
    assert [q.value for q in quantities] == pytest.approx(
        [target.crossover, target.phase_margin, disturbance.crossover, disturbance.phase_margin]
    )
    for q in quantities:
        assert q.upper - q.value == pytest.approx(1.959964 * q.std_error, rel=1e-6)
        assert q.lower < q.value < q.upper


def test_the_effective_delay_is_that_of_the_crossover_model_with_its_error() -> None:
    scenario, errors = SINGLE_LOOP, 0.02 * SINGLE_LOOP.values
    loop = estimate_at(SINGLE, scenario.values, np.diag(errors**2)).loops(scenario.element).target
    wc, margin_of, late = loop.crossover.value, loop.phase_margin.value, loop.effective_delay
    model = np.exp(-1j * wc * late.value) / 1j
    assert np.degrees(np.angle(model)) + 180.0 == pytest.approx(margin_of)
    sets, covariance = gaussian(scenario.values, errors), np.diag(errors**2)
    own = both_loops(SINGLE, scenario.values, scenario.element, covariance, sets)[0]
    assert own.effective_delay.value == pytest.approx(late.value, rel=0.02)
    assert late.std_error == pytest.approx(own.effective_delay.std_error, rel=0.15)


def test_a_loop_whose_crossover_is_not_told_has_no_numbers() -> None:
    scenario = SINGLE_LOOP
    known, unknown = (
        estimate_at(SINGLE, scenario.values, np.diag(spread)).loops(scenario.element).target
        for spread in ((0.02 * scenario.values) ** 2, (5.0 * scenario.values) ** 2)
    )
    for what in ("crossover", "phase_margin", "effective_delay"):
        assert getattr(known, what).determined
        assert getattr(unknown, what).shown()[0] == "not determined"
    assert unknown.crossover.lower == 0.0 < unknown.crossover.upper


@pytest.mark.long
def test_an_estimate_makes_loops_and_transfer_functions_and_draws_them() -> None:
    own = estimate_at(SINGLE, RESONANT, np.diag(ERRORS**2))
    named = [q.value for q in own.loops("15/s^2").quantities]
    assert named == [q.value for q in own.loops(element_named("15/s^2")).quantities]
    above, _ = open_loop(own, "15/s^2")
    drawn, _ = open_loop(own, element_named("15/s^2"))
    lines = [axes.get_lines()[-2].get_ydata() for axes in (above, drawn)]
    np.testing.assert_array_equal(*lines)
    (function,) = own.to_control(9).values()
    omega = np.array([0.5, 2.0, 6.0])
    wanted = SINGLE.response(omega, RESONANT)[0]
    np.testing.assert_allclose(function(1j * omega), wanted, rtol=1e-6)


@pytest.mark.long
def test_claimed_errors_are_the_scatter_over_replications() -> None:
    count = 100
    fits = monte_carlo(MLE(), SINGLE_LOOP, count)
    found = [fit.loops(SINGLE_LOOP.element).quantities[:2] for fit in fits]
    target, _ = margins(SINGLE, SINGLE_LOOP.values, SINGLE_LOOP.element)
    for i, truth in enumerate((target.crossover, target.phase_margin)):
        values = np.array([pair[i].value for pair in found])
        claimed = np.sqrt(np.mean([pair[i].std_error ** 2 for pair in found]))
        scatter = values.std(ddof=1)
        # The scatter is known to 1/sqrt(2 n) = 7 %: three of those.
        assert abs(claimed / scatter - 1.0) < 0.21
        assert abs(values.mean() - truth) < 3.5 * scatter / np.sqrt(count)
        covered = np.mean([pair[i].lower < truth < pair[i].upper for pair in found])
        assert covered > 0.95 - 3.5 * np.sqrt(0.95 * 0.05 / count)


# ------------------------------------------------------------------ several crossings


def test_draws_keep_to_the_estimate_s_crossing() -> None:
    element = element_named("4/s")
    at, _ = margins(SINGLE, RESONANT, element)
    assert at.crossover == pytest.approx(2.88, abs=0.01)
    assert at.others == pytest.approx((14.4,), abs=0.1)
    # Some draws cross over once and some twice, which is what used to mix them.
    sets = gaussian(RESONANT, ERRORS * np.array([1.0, 1.0, 1.0, 1.0, 3.0]))
    counts = {len(margins(SINGLE, own, element)[0].others) for own in sets[:100]}
    assert counts == {0, 1}
    target, _ = both_loops(SINGLE, RESONANT, element, np.diag(ERRORS**2), sets)
    assert target.remark == ""
    assert np.abs(np.array(target.crossover.interval) / at.crossover - 1.0).max() < 0.25
    # To first order the same.
    errors = ERRORS * np.array([1.0, 1.0, 1.0, 1.0, 3.0])
    crossover, phase_margin = (
        estimate_at(SINGLE, RESONANT, np.diag(errors**2)).loops(element).quantities[:2]
    )
    assert crossover.std_error == pytest.approx(target.crossover.std_error, rel=0.2)
    assert phase_margin.std_error == pytest.approx(target.phase_margin.std_error, rel=0.2)
    assert phase_margin.std_error < 10.0
    loop = estimate_at(SINGLE, RESONANT, np.diag(ERRORS**2)).loops(element).target
    assert loop.notes == [f"the target loop falls through one again at {at.others[0]:.3g} rad/s"]


def test_phase_margins_are_continuous_where_the_phase_wraps() -> None:
    # A delay of the element turns the phase at the crossover to within a degree of -360 deg.
    plain = element_named("4/s^2")
    at, _ = margins(SINGLE, SINGLE_LOOP.values, plain)
    late = (np.radians(at.phase_margin + 179.0)) / at.crossover
    element = ControlledElement(plain.numerator, plain.denominator, late, "late")
    here, _ = margins(SINGLE, SINGLE_LOOP.values, element)
    assert here.phase_margin == pytest.approx(-179.0, abs=0.1)
    errors = np.array([0.0, 0.0, 0.03, 0.0, 0.0])
    sets = gaussian(SINGLE_LOOP.values, errors)
    target, _ = both_loops(SINGLE, SINGLE_LOOP.values, element, np.diag(errors**2), sets)
    assert target.phase_margin.lower < -180.0
    expected = np.degrees(here.crossover * gaussian(SINGLE_LOOP.values, errors)[:, 2].std())
    assert target.phase_margin.std_error == pytest.approx(expected, rel=1e-3)


# ------------------------------------------------------------------ where there are none


def test_it_is_said_why_there_are_none() -> None:
    estimate = estimate_at(SINGLE, RESONANT, np.diag(ERRORS**2))
    weak = estimate.loops(element_named("0.01"))
    assert all(np.isnan(q.value) for q in weak.quantities)
    assert weak.notes[0].startswith(
        "target loop: no crossing: the magnitude does not fall through one"
    )
    lost = failed("by hand", SINGLE, Outcome.SINGULAR).loops(element_named("4/s^2"))
    assert all(np.isnan(q.value) for q in lost.quantities)
    assert lost.notes == ["target loop: the fit failed", "disturbance loop: the fit failed"]


def test_an_unstable_fitted_loop_is_said_to_be() -> None:
    estimate = estimate_at(SINGLE, SINGLE_LOOP.values, np.diag(ERRORS**2))
    assert estimate.loops(element_named("4/s^2")).remarks == ()
    (remark,) = estimate.loops(element_named("6/s^2")).remarks
    assert "the fitted loop with 6/s^2 is unstable" in remark


# ------------------------------------------------------------------ pilotid fit


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One recording that names its element, that does not, and that misses its disturbance."""
    folder = tmp_path_factory.mktemp("loops")
    named = recording_of(SINGLE_LOOP)
    unnamed = replace(named, controlled_element="")
    recordings = {"named": named, "unnamed": unnamed, "poor": replace(unnamed, fd=None)}
    for name, recording in recordings.items():
        save_recording(recording, folder / f"{name}.csv")
    return {name: folder / f"{name}.csv" for name in recordings}


def fitted(run: Run, *arguments: object) -> dict[str, dict[str, object]]:
    answer = run("fit", *arguments, "--method", "mle-white", "--json", "-")
    assert answer.status == 0, answer.err
    result: dict[str, dict[str, object]] = strict(answer.out)
    return result


@pytest.mark.parametrize(
    ("name", "options", "origin"),
    [
        ("named", [], "recording"),
        ("unnamed", [], "identified"),
        ("poor", ["--element", "4/s^2"], "given"),
    ],
)
def test_fit_writes_loops(
    run: Run, files: dict[str, Path], name: str, options: list[str], origin: str
) -> None:
    result = fitted(run, files[name], *options)
    (estimate,) = result["estimates"]
    loops = estimate["loops"]
    assert loops["element"] == "4/s^2"
    assert loops["origin"] == origin
    assert loops["remarks"] == []
    if name == "poor":  # nothing excites the other loop
        assert loops["disturbance"]["crossover"]["value"] is None
    for which in ("target", "disturbance")[: 1 if name == "poor" else 2]:
        crossover, phase_margin = (loops[which][k] for k in ("crossover", "phase_margin"))
        assert crossover["unit"] == "rad/s"
        assert crossover["value"] == pytest.approx(2.29, abs=0.3)
        assert crossover["interval_95"][0] < crossover["value"] < crossover["interval_95"][1]
        assert phase_margin["value"] == pytest.approx(17.5, abs=10.0)
        assert 0.1 < phase_margin["std_error"] < 10.0
        assert loops[which]["others"] == []
        assert loops[which]["remark"] == ""
    assert result["recording"]["remarks"] == []
