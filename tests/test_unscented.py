"""The unscented filter and smoother against the plain ones, and pilots who are known."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from helpers import without_remnant
from scipy.linalg import expm

from pilotid.datasets import SCENARIOS, simulate
from pilotid.estimates.estimate import Outcome
from pilotid.estimates.method import identify
from pilotid.methods.ukf import UKF
from pilotid.pilot.catalogue import ADAPTING, LEAD_LAG, SINGLE
from pilotid.pilot.factors import Delay, Gain, Lead, Neuromuscular
from pilotid.pilot.model import Channel, PilotModel
from pilotid.pilot.timevarying import Fading
from pilotid.time_domain.random_walk import muscle_step, walking_pilot
from pilotid.time_domain.unscented import (
    Filtered,
    Levels,
    block_diagonal,
    run_filter,
    run_smoother,
)
from pilotid.types import FloatArray

pytestmark = pytest.mark.numerical

SLOW = SCENARIOS["adapting-slow"]
#: The pilot of that experiment before the change, who stays as he is.
CONSTANT = SLOW.constant_ends[0][0]
#: Another for 20 s, whose gain and two leads walk.
LEADS = PilotModel(
    "two-leads",
    (Channel("visual", "error", 1, (*SINGLE.channels[0].factors, Lead("tlead2", start=0.2))),),
)
BRIEF = replace(CONSTANT, model=LEADS, truth=(0.09, 0.4, 0.28, 0.12, 11.25, 0.35), duration=20.48)
TWO = 2.3  # distance of sigma points


@dataclass(frozen=True, eq=False)
class Linear:
    """Two parameters that drive two states of each of two runs, linearly."""

    measured: FloatArray
    output: FloatArray
    matrix: FloatArray
    drive: FloatArray

    def step(self, k: int, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
        matrix = np.broadcast_to(self.matrix, (*parameters.shape[:2], 2, 2))
        return matrix, np.einsum("rmp,bsp->bsrm", self.drive * np.cos(0.3 * k), parameters)


def _linear(rng: np.random.Generator) -> tuple[Linear, Levels]:
    system = Linear(
        rng.standard_normal((40, 2)),
        np.array([1.0, -0.4]),
        np.array([[0.9, 0.2], [-0.3, 0.7]]),
        rng.standard_normal((2, 2, 2)),
    )
    noise = rng.standard_normal((3, 2, 2))
    spread = rng.standard_normal((3, 6, 6))
    levels = Levels(
        noise=block_diagonal(
            rng.uniform(0.01, 0.1, (3, 2, 1)) * np.eye(2), *[noise @ noise.swapaxes(1, 2)] * 2
        ),
        error=np.array([0.1, 0.5, 1.0]),
        mean=rng.standard_normal((3, 6)),
        covariance=spread @ spread.swapaxes(1, 2) + np.eye(6),
    )
    return system, levels


def _kalman(
    system: Linear, levels: Levels, i: int
) -> tuple[float, FloatArray, FloatArray, FloatArray]:
    """Log-likelihood, smoothed means and covariances by one large Gaussian distribution."""
    steps, size = len(system.measured), 6
    noise = levels.noise[i]
    output = np.zeros((2, size))
    output[0, 2:4] = output[1, 4:] = system.output
    mean, covariance = levels.mean[i], levels.covariance[i]
    means, blocks = [mean], {(0, 0): covariance}
    for k in range(1, steps):
        matrix = np.eye(size)
        matrix[2:4, 2:4] = matrix[4:, 4:] = system.matrix
        matrix[2:, :2] = (system.drive * np.cos(0.3 * (k - 1))).reshape(4, 2)
        mean = matrix @ mean
        means.append(mean)
        for j in range(k):
            blocks[k, j] = matrix @ blocks[k - 1, j]
            blocks[j, k] = blocks[k, j].T
        blocks[k, k] = matrix @ blocks[k - 1, k - 1] @ matrix.T + noise
    whole = np.block([[blocks[k, j] for j in range(steps)] for k in range(steps)])
    observe = np.kron(np.eye(steps), output)
    spread = observe @ whole @ observe.T + levels.error[i] * np.eye(2 * steps)
    left = system.measured.ravel() - observe @ np.ravel(means)
    gain = whole @ observe.T @ np.linalg.inv(spread)
    value = -0.5 * (left @ np.linalg.solve(spread, left) + np.linalg.slogdet(2 * np.pi * spread)[1])
    after = whole - gain @ observe @ whole
    return float(value), (np.ravel(means) + gain @ left).reshape(steps, size), after, whole


def test_a_linear_system_is_filtered_and_smoothed_as_by_its_whole_distribution() -> None:
    system, levels = _linear(np.random.default_rng(1))
    found = run_filter(system, levels, TWO)
    steps: list[Filtered] = []
    np.testing.assert_array_equal(run_filter(system, levels, TWO, steps), found)
    course = run_smoother(steps)
    weights = np.random.default_rng(2).standard_normal((3, 2, 40))
    sums = course.covariance_of(weights)
    for i in range(3):
        value, means, whole, _ = _kalman(system, levels, i)
        assert found[i] == pytest.approx(value, abs=1e-8)
        np.testing.assert_allclose(course.mean[i], means, atol=1e-8)
        own = whole.reshape(40, 6, 40, 6)
        for k in (0, 17, 39):
            np.testing.assert_allclose(course.covariance[i, k], own[k, :, k], atol=1e-8)
        expected = np.einsum("apk,kplq,bql->ab", weights, own[:, :2, :, :2], weights)
        np.testing.assert_allclose(sums[i], expected, rtol=1e-7, atol=1e-7)


def test_a_batch_gives_what_its_sets_give_one_by_one() -> None:
    pilot = walking_pilot(simulate(SLOW, np.random.default_rng(1)), ADAPTING, 26.0)
    levels = np.log([0.06, 0.06, 0.4, 0.2]) + np.array([[0.0], [0.4], [-0.5], [0.2]])
    orders = np.array([0, 1, 2, 1])

    def likelihood(which: slice) -> FloatArray:
        noise = pilot.with_levels(CONSTANT.values, np.eye(5)[3:], levels[which], orders[which])
        return run_filter(*noise, TWO)

    together = likelihood(slice(None))
    alone = [likelihood(slice(i, i + 1))[0] for i in range(4)]
    np.testing.assert_allclose(together, alone, rtol=1e-9)


def test_a_filter_that_breaks_down_leaves_the_others_alone() -> None:
    system, levels = _linear(np.random.default_rng(3))
    broken = levels.covariance.copy()
    broken[1] = -np.eye(6)
    found = run_filter(system, replace(levels, covariance=broken), TWO)
    assert found[1] == -np.inf
    np.testing.assert_allclose(found[[0, 2]], run_filter(system, levels, TWO)[[0, 2]])


@pytest.mark.parametrize("damping", [0.05, 0.35, 1.0, 2.5])
def test_the_step_of_the_neuromuscular_system_is_exact_for_a_parabola(damping: float) -> None:
    frequency, dt = 11.0, 0.06
    matrix, weights = muscle_step(np.array(frequency), np.array(damping), dt)
    # States, and the input, its slope and its curvature, all in one exponential.
    whole = np.zeros((5, 5))
    whole[:2, :2] = [[0.0, 1.0], [-(frequency**2), -2.0 * damping * frequency]]
    whole[1, 2] = frequency**2
    whole[2, 3] = whole[3, 4] = 1.0
    step = expm(whole * dt)
    np.testing.assert_allclose(matrix, step[:2, :2], atol=1e-9)
    for start, slope, bend in ((1.0, 0.0, 0.0), (0.0, 2.0, 0.0), (0.3, -1.0, 30.0)):
        at = np.array([0.0, 0.5 * dt, dt])
        nodes = start + slope * at + 0.5 * bend * at**2
        np.testing.assert_allclose(
            nodes @ weights, step[:2, 2:] @ [start, slope, bend], rtol=1e-7, atol=1e-9
        )


def test_the_true_pilot_leaves_nothing_of_a_control_without_remnant() -> None:
    recording = simulate(without_remnant(CONSTANT), np.random.default_rng(1))
    pilot = walking_pilot(recording, SINGLE, 26.0)
    assert pilot.left(CONSTANT.values) < 1e-5
    assert pilot.left(CONSTANT.values * [1.0, 1.0, 1.02, 1.0, 1.0]) > 3e-5
    # Over a step the filter takes parameters for constant.
    recording = simulate(without_remnant(SLOW), np.random.default_rng(1))
    pilot = walking_pilot(recording, ADAPTING, 26.0)
    assert pilot.left(ADAPTING.over_time(SLOW.values, pilot.time).T) < 1e-4


def test_a_constant_pilot_without_remnant_is_found() -> None:
    scenario = without_remnant(BRIEF)
    recording = simulate(scenario, np.random.default_rng(1))
    estimate = identify(UKF(), recording, LEADS, np.random.default_rng(2))
    assert estimate.outcome.usable, estimate.sentence
    np.testing.assert_allclose(estimate.values, scenario.values, rtol=0.06)
    course = estimate.trajectory
    assert course is not None
    known = np.isfinite(course.values).all(axis=0)
    np.testing.assert_allclose(
        course.values[:, known], np.tile(scenario.values[:, None], known.sum()), rtol=0.1
    )


def test_a_slow_change_without_remnant_is_followed() -> None:
    recording = simulate(without_remnant(SLOW), np.random.default_rng(1))
    estimate = identify(UKF(), recording, ADAPTING, np.random.default_rng(2))
    assert estimate.outcome.usable, estimate.sentence
    course = estimate.trajectory
    assert course is not None
    true = ADAPTING.over_time(SLOW.values, course.time)
    known = np.isfinite(course.values).all(axis=0)
    off = np.sqrt(np.mean((course.values / true - 1.0)[:, known] ** 2, axis=1))
    assert off == pytest.approx(0.0, abs=0.08)
    assert estimate["tmid"].value == pytest.approx(41.92, abs=1.0)


def test_a_delay_that_changes_is_followed_where_all_parameters_walk() -> None:
    sides = [
        Channel(
            side,
            "error",
            1,
            (
                Fading((Gain("Kvis"), Lead("tlead")), after=side == "after"),
                Delay(f"tdvis_{side}"),
                Neuromuscular(),
            ),
        )
        for side in ("before", "after")
    ]
    # Gain, lead, middle and rate of the change, both delays, neuromuscular system.
    truth = (0.09, 0.4, 41.92, 0.5, 0.22, 0.36, 11.25, 0.35)
    slower = replace(SLOW, model=PilotModel("slower", tuple(sides)), truth=truth, change=None)
    recording = simulate(without_remnant(slower), np.random.default_rng(1))
    courses = {}
    for walking in ("all", "gains"):
        method = UKF(walking=walking, rounds=2, candidates=8, remnant="lag")
        estimate = identify(method, recording, SINGLE, np.random.default_rng(2))
        assert estimate.outcome.usable, estimate.sentence
        course = estimate.trajectory
        assert course is not None
        courses[walking] = dict(zip(SINGLE.keys, course.values, strict=True))
    for delay, when in ((0.22, course.time < 30.0), (0.36, course.time > 54.0)):
        found = {key: np.nanmean(values[when]) for key, values in courses["all"].items()}
        assert found["tdvis"] == pytest.approx(delay, abs=0.01)
        assert found["Kvis"] == pytest.approx(0.09, rel=0.1)
        assert found["tlead"] == pytest.approx(0.4, rel=0.1)
    assert np.nanstd(courses["gains"]["tdvis"]) == pytest.approx(0.0, abs=1e-3)


def test_errors_are_as_large_as_claimed_with_a_white_remnant() -> None:
    white = replace(CONSTANT.remnant, order=0, level=0.1)
    scenario = replace(CONSTANT, remnant=white, duration=20.48)
    off = []
    for seed in range(6):
        recording = simulate(scenario, np.random.default_rng(seed))
        fit = identify(UKF(remnant="white"), recording, SINGLE, np.random.default_rng(2))
        assert fit.outcome.usable, fit.sentence
        off.append((fit.values - scenario.values) / fit.std_error)
    # Mean square of 30 numbers; chance gives more than 2.3 once in 10,000.
    assert 0.2 < np.mean(np.square(off)) < 2.3


def test_runs_together_tell_more_than_one() -> None:
    recordings = simulate(replace(SLOW, runs=3), np.random.default_rng(1))
    method = UKF(rounds=2, candidates=12, remnant="lag")
    three = identify(method, recordings, ADAPTING, np.random.default_rng(2))
    alone = replace(
        recordings, **{n: getattr(recordings, n)[:1] for n in ("e", "u", "x", "ft")}, fd=None
    )
    one = identify(method, alone, ADAPTING, np.random.default_rng(2))
    assert three.outcome.usable, three.sentence
    ratio = three["tdvis"].std_error / one["tdvis"].std_error
    assert 0.35 < ratio < 0.85


def test_a_course_that_describes_the_control_worse_is_called_diverged() -> None:
    recording = simulate(SLOW, np.random.default_rng(1))
    far = ADAPTING.with_start({"tdvis": 0.95, "fnm": 39.0, "dnm": 2.9})
    method = UKF(start="model", rounds=2, candidates=8)  # no noise levels make up for that start
    estimate = identify(method, recording, far, np.random.default_rng(2))
    assert estimate.outcome is Outcome.DIVERGED
    assert "constant pilot" in estimate.message


def test_other_dynamics_are_objected_to() -> None:
    recording = simulate(SLOW, np.random.default_rng(1))
    estimate = identify(UKF(), recording, LEAD_LAG, np.random.default_rng(2))
    assert estimate.outcome is Outcome.NOT_APPLICABLE
    assert "has others" in estimate.message
