"""How long a complete fit takes, beside what a user would write with python-control."""

from __future__ import annotations

import itertools
from functools import cache

import control
import numpy as np
import pytest
from helpers import NOMINAL
from pytest_benchmark.fixture import BenchmarkFixture
from scipy.optimize import least_squares

from pilotid.datasets import scenario_named, simulate
from pilotid.estimates.method import identify
from pilotid.frequency.regression import Regression, signals
from pilotid.frequency.structures import Structure, StructureSearch
from pilotid.methods.arx import ARX
from pilotid.methods.bayes import Bayes
from pilotid.methods.mle import MLE
from pilotid.methods.mle_white import MLEWhite
from pilotid.pilot.catalogue import MULTI
from pilotid.pilot.model import PilotModel
from pilotid.recordings.recording import Recording
from pilotid.time_domain.prediction import predict
from pilotid.types import FloatArray

PADE = 5


@cache
def recording() -> Recording:
    """One run of 4096 samples whose remnant is white, as both fits assume."""
    return simulate(scenario_named("white-remnant"), np.random.default_rng(1))


@cache
def coloured() -> Recording:
    """One run of 4096 samples whose remnant is coloured, as in the paper's simulations."""
    return simulate(scenario_named("nominal"), np.random.default_rng(1))


@cache
def far_model() -> PilotModel:
    """The pilot with every initial guess 40 % off."""
    sign = np.array([1, -1, 1, -1, 1, -1, 1])
    start = NOMINAL.values * (1.0 + 0.4 * sign)
    return MULTI.with_start(dict(zip(MULTI.keys, start.tolist(), strict=True)))


def by_hand(data: Recording, start: FloatArray) -> FloatArray:
    """Output error as one would write it: state space, Pade delays, finite differences."""
    time = data.time - data.time[0]
    scored = slice(data.run_in, None)

    def predicted(values: FloatArray) -> FloatArray:
        gain, lead, visual_delay, motion_gain, motion_delay, frequency, damping = values
        muscles = control.tf([frequency**2], [1.0, 2.0 * damping * frequency, frequency**2])
        visual = (
            control.tf([gain * lead, gain], [1.0]) * control.tf(*control.pade(visual_delay, PADE))
        ) * muscles
        motion = (
            control.tf([0.1, 1.0, 0.0, 0.0], [6.0, 1.0])
            * control.tf(*control.pade(motion_delay, PADE))
            * muscles
            * motion_gain
        )
        total = control.append(control.tf2ss(visual), control.tf2ss(motion))
        answers = control.forced_response(total, time, np.stack([data.e[0], data.x[0]])).outputs
        return np.asarray(answers[0] - answers[1])

    def residual(values: FloatArray) -> FloatArray:
        return (data.u[0] - predicted(values))[scored]

    scale = np.abs(start)
    found = least_squares(residual, start, x_scale=scale, bounds=(1e-3 * scale, 10.0 * scale))
    return np.asarray(found.x)


@pytest.mark.benchmark(group="fit of 7 parameters to 4096 samples from 40 % off")
def test_mle_white(benchmark: BenchmarkFixture) -> None:
    estimate = benchmark(
        lambda: identify(MLEWhite(), recording(), far_model(), np.random.default_rng(1))
    )
    assert estimate.outcome.usable


@pytest.mark.benchmark(group="fit of 7 parameters to 4096 samples from 40 % off")
def test_mle(benchmark: BenchmarkFixture) -> None:
    estimate = benchmark(lambda: identify(MLE(), coloured(), far_model(), np.random.default_rng(1)))
    assert estimate.outcome.usable


@pytest.mark.benchmark(group="posterior of 7 parameters and the remnant's, 4096 samples")
def test_bayes_by_importance_sampling(benchmark: BenchmarkFixture) -> None:
    estimate = benchmark(
        lambda: identify(Bayes(), coloured(), far_model(), np.random.default_rng(1))
    )
    assert estimate.outcome.usable
    assert estimate.draws is not None
    assert estimate.draws.sampler == "importance"


@pytest.mark.benchmark(group="posterior of 7 parameters and the remnant's, 4096 samples")
def test_bayes_by_emcee(benchmark: BenchmarkFixture) -> None:
    fit = (Bayes(sampler="emcee"), coloured(), far_model(), np.random.default_rng(1))
    estimate = benchmark.pedantic(identify, fit, rounds=1)
    assert estimate.draws is not None
    assert estimate.draws.effective.min() >= 2000.0


@pytest.mark.benchmark(group="fit of 7 parameters to 4096 samples from 40 % off")
def test_what_a_user_would_write(benchmark: BenchmarkFixture) -> None:
    values = benchmark.pedantic(by_hand, (recording(), far_model().start), rounds=3)
    estimate = identify(MLEWhite(), recording(), far_model(), np.random.default_rng(1))
    # Both reach the same optimum, so that the times are those of the same work.
    assert values == pytest.approx(estimate.values, rel=0.05)


@pytest.mark.benchmark(group="search among 2205 structures in 2048 samples")
def test_arx_search(benchmark: BenchmarkFixture) -> None:
    prediction = predict(coloured(), MULTI, 78.0)
    output, inputs = signals(prediction)
    structures = [
        Structure(poles, (4, 4), delays)
        for poles in range(2, 7)
        for delays in itertools.product(range(3, 24), repeat=2)
    ]

    def searched() -> StructureSearch:
        regression = Regression(output, inputs, 6, [(3, 26)] * 2, prediction.first)
        return regression.search(structures)

    assert benchmark(searched).cost.size == 2205
    if benchmark.enabled:
        assert benchmark.stats.stats.min < 0.15


@pytest.mark.benchmark(group="fit of 7 parameters to 4096 samples with a coloured remnant")
def test_arx(benchmark: BenchmarkFixture) -> None:
    estimate = benchmark(lambda: identify(ARX(), coloured(), far_model(), np.random.default_rng(1)))
    assert estimate.outcome.usable
