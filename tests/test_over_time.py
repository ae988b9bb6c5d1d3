"""Methods that follow a pilot over time, and what their trajectories lead to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import without_remnant

from pilotid.datasets import SCENARIOS, simulate
from pilotid.estimates.estimate import Outcome
from pilotid.estimates.method import Method, identify
from pilotid.estimates.parts import Trajectory, times_of
from pilotid.frequency.regression import Structure, arx_response
from pilotid.methods.mle_windowed import MLEWindowed
from pilotid.methods.rarx import RARX, forgetting
from pilotid.pilot.catalogue import ADAPTING, MULTI, SINGLE
from pilotid.solve.least_squares import minimise_each
from pilotid.time_domain.over_time import TrajectoryFit, estimated_over_time
from pilotid.types import FloatArray, IntArray

pytestmark = pytest.mark.numerical

SLOW = SCENARIOS["adapting-slow"]
#: The pilot of that experiment before the change, who stays as he is.
CONSTANT = without_remnant(SLOW.constant_ends[0][0])
#: The delay of a polynomial in q is whole samples, and two poles are no pilot.
ERROR = {"rarx": 0.12, "mle-windowed": 0.01}
following = pytest.mark.parametrize("method", [RARX(), MLEWindowed()], ids=lambda m: m.name)


@following
def test_a_constant_pilot_without_remnant_is_found_at_all_times(method: Method) -> None:
    recording = simulate(CONSTANT, np.random.default_rng(1))
    estimate = identify(method, recording, SINGLE, np.random.default_rng(2))
    assert estimate.outcome.usable, estimate.sentence
    np.testing.assert_allclose(estimate.values, CONSTANT.values, rtol=ERROR[method.name])
    found = estimate.trajectory
    assert found is not None
    assert found.keys == SINGLE.keys
    off = found.values / CONSTANT.values[:, None] - 1.0
    assert np.nanmedian(np.abs(off), axis=1) == pytest.approx(0.0, abs=ERROR[method.name])


@pytest.mark.parametrize(
    "method", [RARX(), MLEWindowed(window=10.0, step=1.0)], ids=lambda m: m.name
)
def test_a_slow_change_without_remnant_is_followed(method: Method) -> None:
    slower = replace(SLOW, truth=(*SLOW.truth[:5], 0.15, *SLOW.truth[6:]))
    assert slower.change is not None
    slower = without_remnant(replace(slower, change=replace(slower.change, rate=0.15)))
    recording = simulate(slower, np.random.default_rng(1))
    estimate = identify(method, recording, ADAPTING, np.random.default_rng(2))
    assert estimate.outcome.usable, estimate.sentence
    gained = estimate.values / slower.values
    ends = [ADAPTING.keys.index(key) for key in ("Kvis1", "Kvis2", "tlead1", "tlead2", "tdvis")]
    assert gained[ends] == pytest.approx(1.0, abs=0.15)
    late = estimate["tmid"].value - 41.92
    # What is put in the middle of a window is not late; what remembers is, by its memory.
    assert (0.0 < late < 8.0) if method.name == "rarx" else abs(late) < 2.0


@following
def test_bands_hold_the_truth_most_of_the_time_and_grow_with_the_remnant(method: Method) -> None:
    scenario = SLOW.constant_ends[0][0]
    widths = []
    for level in (0.3, 1.0):
        own = replace(
            scenario, remnant=replace(scenario.remnant, level=level * scenario.remnant.level)
        )
        recording = simulate(own, np.random.default_rng(1))
        found = identify(method, recording, SINGLE, np.random.default_rng(2)).trajectory
        assert found is not None
        delay = found.keys.index("tdvis")
        inside = (found.lower[delay] <= own.values[delay]) & (
            own.values[delay] <= found.upper[delay]
        )
        assert np.mean(inside[np.isfinite(found.values[delay])]) > 0.7
        widths.append(np.nanmedian(found.upper[delay] - found.lower[delay]))
    assert widths[1] > 1.5 * widths[0]


def test_without_a_run_in_nothing_is_known_until_the_memory_is_filled() -> None:
    recording = replace(simulate(CONSTANT, np.random.default_rng(1)), run_in=0)
    found = identify(RARX(memory=5.0), recording, SINGLE, np.random.default_rng(2)).trajectory
    assert found is not None
    known = np.isfinite(found.values).all(axis=0)
    assert not known[found.time < 3.0].any()
    assert known[found.time > 6.0].all()


def test_forgetting_weighs_rows_by_their_age() -> None:
    rng = np.random.default_rng(3)
    rows = rng.standard_normal((2, 40, 3))
    at = np.array([10, 39])
    found = forgetting(rows, 0.9, at)
    assert found is not None
    for place, (last, coefficients) in enumerate(zip(at, found[0], strict=True)):
        weight = np.sqrt(0.9 ** (last - np.arange(last + 1.0)))
        table = (rows[:, : last + 1] * weight[:, None]).reshape(-1, 3)
        expected = np.linalg.lstsq(table[:, :2], table[:, 2], rcond=None)[0]
        np.testing.assert_allclose(coefficients, expected, rtol=1e-6)
        assert np.linalg.eigvalsh(found[1][place])[0] > 0.0


def test_errors_of_forgetting_are_those_that_white_errors_have() -> None:
    rng = np.random.default_rng(4)
    inputs = rng.standard_normal((400, 1))
    found, claimed = [], []
    for _ in range(400):
        output = 2.0 * inputs[:, 0] + rng.standard_normal(400)
        answer = forgetting(np.column_stack([inputs, output])[None], 0.97, np.array([399]))
        assert answer is not None
        found.append(answer[0][0, 0])
        claimed.append(answer[1][0, 0, 0])
    assert np.mean(found) == pytest.approx(2.0, abs=0.03)
    assert np.sqrt(np.mean(claimed)) == pytest.approx(np.std(found), rel=0.15)


def test_a_polynomial_s_response_and_its_slopes() -> None:
    structure = Structure(1, (2,), (3,))
    values = np.array([[-0.5, 1.0, 0.25]])
    shift = np.exp(-1j * np.array([0.0, 0.7]))
    response, slopes = arx_response(structure, values, shift)
    expected = (shift**3 + 0.25 * shift**4) / (1.0 - 0.5 * shift)
    np.testing.assert_allclose(response[0, 0], expected)
    for i, step in enumerate(1e-6 * np.eye(3)):
        moved = arx_response(structure, values + step, shift)[0]
        np.testing.assert_allclose(slopes[0, i], (moved - response)[0] / 1e-6, rtol=1e-4)


def _made(values: FloatArray, noise: float, memory: float, seed: int) -> Trajectory:
    """A trajectory with errors that are correlated over a memory, on the logarithm."""
    time = times_of(81.92)
    rng = np.random.default_rng(seed)
    factor = np.exp(-0.25 / memory)
    error = np.zeros((5, time.size))
    error[:, 0] = rng.standard_normal(5)
    for i in range(1, time.size):
        error[:, i] = factor * error[:, i - 1] + np.sqrt(1 - factor**2) * rng.standard_normal(5)
    truth = ADAPTING.over_time(values, time)
    middle = truth * np.exp(noise * error)
    return Trajectory(
        SINGLE.keys, time, middle, middle * np.exp(-1.96 * noise), middle * np.exp(1.96 * noise)
    )


def test_an_exact_trajectory_leads_to_the_parameters_that_made_it() -> None:
    made = _made(SLOW.values, 1e-5, 3.0, 1)
    recording = simulate(SLOW, np.random.default_rng(1))
    estimate = estimated_over_time("x", recording, ADAPTING, made, 3.0)
    np.testing.assert_allclose(estimate.values, SLOW.values, rtol=1e-3)
    assert estimate.trajectory is made


@pytest.mark.long
def test_errors_allow_for_the_memory() -> None:
    recording = simulate(SLOW, np.random.default_rng(1))
    fits = [
        estimated_over_time("x", recording, ADAPTING, _made(SLOW.values, 0.1, 3.0, seed), 3.0)
        for seed in range(40)
    ]
    known = [i for i, key in enumerate(ADAPTING.keys) if key != "rate"]
    scatter = np.std([fit.values for fit in fits], axis=0)[known]
    claimed = np.sqrt(np.mean([fit.std_error**2 for fit in fits], axis=0))[known]
    np.testing.assert_allclose(claimed, scatter, rtol=0.45)


def test_what_is_known_at_few_times_gives_no_estimate() -> None:
    made = _made(SLOW.values, 0.1, 3.0, 1)
    some = made.values.copy()
    some[1, 5:] = np.nan
    recording = simulate(SLOW, np.random.default_rng(1))
    estimate = estimated_over_time("x", recording, ADAPTING, replace(made, values=some), 3.0)
    assert estimate.outcome is Outcome.UNSTABLE_MODEL
    assert TrajectoryFit(ADAPTING, replace(made, values=some)).known.sum(axis=1)[1] == 5


def test_objections_are_said_in_words() -> None:
    recording = simulate(SLOW, np.random.default_rng(1))
    assert "one channel on the error" in (RARX().objection(recording, MULTI) or "")
    assert MLEWindowed().objection(recording, MULTI) is None
    assert "windows" in (MLEWindowed(window=70.0).objection(recording, SINGLE) or "")
    assert "at least" in (MLEWindowed(window=2.0).objection(recording, SINGLE) or "")


def test_many_problems_are_minimised_each_by_itself() -> None:
    aims = np.array([[0.3, 8.0], [2.0, 1.0], [0.5, 5.0]])

    class Space:
        lower, upper = np.array([0.1, 0.1]), np.array([10.0, 10.0])
        positive = np.array([True, False])

    def gram(values: FloatArray, which: IntArray) -> FloatArray:
        rows = np.zeros((len(values), 3, 2))
        rows[:, :2] = np.eye(2)
        rows[:, 2] = aims[which] - values
        return np.asarray(rows @ rows.swapaxes(1, 2))

    end = minimise_each(gram, np.ones((3, 2)), Space())
    np.testing.assert_allclose(end.values, aims, rtol=1e-6)
