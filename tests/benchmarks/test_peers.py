"""The same work by the package and by other means, answers compared first."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Callable
from functools import cache

import control
import emcee
import numpy as np
import pytest
from cases import far_model, recorded
from pytest_benchmark.fixture import BenchmarkFixture
from scipy.optimize import least_squares
from scipy.signal import cont2discrete, dlsim, tf2ss

from pilotid.estimates.method import identify
from pilotid.methods.mle import MLE
from pilotid.methods.mle_white import MLEWhite
from pilotid.pilot.catalogue import MULTI
from pilotid.posterior.likelihood import Likelihood
from pilotid.recordings.recording import Recording
from pilotid.regression import Regression, Structure, lagged_rows, signals
from pilotid.solve.least_squares import minimise
from pilotid.support.types import FloatArray
from pilotid.time_domain.output_error import OutputErrors
from pilotid.time_domain.prediction import predict
from pilotid.time_domain.search import maximise_likelihood

PADE = 5
SCRIPT = "output error of seven parameters, 4096 samples, from 40 % off"
DESCENT = "one descent on our residuals"
SEARCH = "ARX: search among 2205 structures in 2048 samples"
ONE = "ARX: one structure"
WALKERS, STEPS = 32, 25
SAMPLED = f"emcee: {WALKERS} walkers, {STEPS} steps of the likelihood of bayes"


def searched(residual: Callable[[FloatArray], FloatArray], start: FloatArray) -> FloatArray:
    """The least squares of a user: a trust region, finite differences, and wide bounds."""
    scale = np.abs(start)
    found = least_squares(residual, start, x_scale=scale, bounds=(1e-3 * scale, 10.0 * scale))
    return np.asarray(found.x)


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

    return searched(residual, start)


@pytest.mark.benchmark(group=SCRIPT)
def test_what_a_user_would_write(benchmark: BenchmarkFixture) -> None:
    data = recorded("white-remnant")
    values = benchmark.pedantic(by_hand, (data, far_model().start), rounds=3)
    estimate = identify(MLEWhite(), data, far_model(), np.random.default_rng(1))
    # Both reach the same optimum, so that the times are those of the same work.
    assert values == pytest.approx(estimate.values, rel=0.05)


def grey_box(data: Recording, start: FloatArray) -> FloatArray:
    """The same as MATLAB's greyest does it: a discretised state space simulated by scipy."""
    scored = slice(data.run_in, None)

    def delayed(
        numerator: FloatArray, denominator: FloatArray, delay: float
    ) -> tuple[FloatArray, FloatArray]:
        above, below = control.pade(delay, PADE)
        return np.asarray(np.polymul(numerator, above)), np.asarray(np.polymul(denominator, below))

    def answer(channel: tuple[FloatArray, FloatArray], signal: FloatArray) -> FloatArray:
        system = cont2discrete(tf2ss(*channel), data.dt, method="foh")
        return np.asarray(dlsim(system, signal)[1][:, 0])

    def residual(values: FloatArray) -> FloatArray:
        gain, lead, visual_delay, motion_gain, motion_delay, frequency, damping = values
        muscles = np.array([1.0, 2.0 * damping * frequency, frequency**2])
        visual = delayed(gain * frequency**2 * np.array([lead, 1.0]), muscles, visual_delay)
        top = motion_gain * frequency**2 * np.array([0.1, 1.0, 0.0, 0.0])
        motion = delayed(top, np.polymul([6.0, 1.0], muscles), motion_delay)
        told = answer(visual, data.e[0]) - answer(motion, data.x[0])
        return (data.u[0] - told)[scored]

    return searched(residual, start)


@pytest.mark.benchmark(group=SCRIPT)
def test_grey_box(benchmark: BenchmarkFixture) -> None:
    data = recorded("white-remnant")
    values = benchmark.pedantic(grey_box, (data, far_model().start), rounds=3)
    estimate = identify(MLEWhite(), data, far_model(), np.random.default_rng(1))
    assert values == pytest.approx(estimate.values, rel=0.05)


@cache
def white() -> OutputErrors:
    return OutputErrors(predict(recorded("white-remnant"), MULTI))


def near() -> FloatArray:
    """A start from which both searches end in the same optimum."""
    return np.asarray(MULTI.start * 1.2)


def by_scipy() -> FloatArray:
    """scipy's trust region on our residuals and our Jacobian."""
    problem = white()

    def rows(values: FloatArray) -> FloatArray:
        return problem.rows(values[None])[0].reshape(len(values) + 1, -1)

    found = least_squares(
        lambda v: rows(v)[-1],
        near(),
        jac=lambda v: -rows(v)[:-1].T,
        x_scale=np.abs(near()),
        bounds=(MULTI.lower, MULTI.upper),
    )
    return np.asarray(found.x)


@pytest.mark.benchmark(group=DESCENT)
def test_scipy_least_squares(benchmark: BenchmarkFixture) -> None:
    values = benchmark(by_scipy)
    ours = minimise(white().gram, near()[None], MULTI)
    assert values == pytest.approx(ours.values[0], rel=1e-3)


@pytest.mark.benchmark(group=DESCENT)
def test_our_least_squares(benchmark: BenchmarkFixture) -> None:
    assert benchmark(lambda: minimise(white().gram, near()[None], MULTI)).converged.all()


@cache
def lagged() -> tuple[FloatArray, list[FloatArray], int]:
    prediction = predict(recorded("nominal"), MULTI, 78.0)
    return *signals(prediction), prediction.first


STRUCTURES = [
    Structure(poles, (4, 4), delays)
    for poles in range(2, 7)
    for delays in itertools.product(range(3, 24), repeat=2)
]


def ours(structures: list[Structure]) -> FloatArray:
    output, inputs, first = lagged()
    return Regression(output, inputs, 6, [(3, 26)] * 2, first).costs(structures)


def by_loop(structures: list[Structure]) -> FloatArray:
    """A regression with `lstsq` for each structure, as one would write it."""
    output, inputs, first = lagged()
    costs = []
    for structure in structures:
        lags = [(d, d + n - 1) for d, n in zip(structure.delays, structure.zeros, strict=True)]
        rows = lagged_rows(output, inputs, structure.poles, lags, first)
        rows = (rows - rows.mean(axis=1, keepdims=True)).reshape(-1, rows.shape[-1])
        found = np.linalg.lstsq(rows[:, :-1], rows[:, -1])[0]
        costs.append(np.sum((rows[:, -1] - rows[:, :-1] @ found) ** 2))
    return np.array(costs)


@pytest.mark.benchmark(group=SEARCH)
def test_arx_search(benchmark: BenchmarkFixture) -> None:
    assert benchmark(ours, STRUCTURES).size == len(STRUCTURES)


@pytest.mark.benchmark(group=SEARCH)
def test_arx_by_a_loop(benchmark: BenchmarkFixture) -> None:
    costs = benchmark.pedantic(by_loop, (STRUCTURES,), rounds=1)
    assert costs == pytest.approx(ours(STRUCTURES), rel=1e-9)


@pytest.mark.benchmark(group=ONE)
def test_one_arx(benchmark: BenchmarkFixture) -> None:
    assert benchmark(ours, STRUCTURES[:1]).size == 1


@pytest.mark.benchmark(group=ONE)
def test_one_arx_by_sippy(benchmark: BenchmarkFixture) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # its own of what numpy will do without
        sippy = pytest.importorskip("sippy_unipi")
    output, inputs, _ = lagged()
    structure = STRUCTURES[0]

    def fitted() -> object:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return sippy.system_identification(
                output,
                np.concatenate(inputs),
                "ARX",
                ARX_orders=[[structure.poles], [list(structure.zeros)], [list(structure.delays)]],
            )

    # It fits all samples from its largest lag on, with an input's delay counted from one.
    assert benchmark(fitted) is not None


@cache
def posterior() -> tuple[Likelihood, FloatArray]:
    """The likelihood of `bayes` for one recording, and its maximum."""
    recording = recorded("nominal")
    found = maximise_likelihood(recording, MULTI, np.random.default_rng(1), MLE())
    likelihood = Likelihood(found.joint)
    return likelihood, found.end.values[0, : likelihood.count]


@pytest.mark.parametrize("at_once", [True, False], ids=["at_once", "one_by_one"])
def test_emcee(benchmark: BenchmarkFixture, at_once: bool) -> None:
    benchmark.group = SAMPLED
    benchmark.name = f"test_emcee_{'at_once' if at_once else 'one_by_one'}"
    likelihood, mode = posterior()
    start = mode * (1.0 + 1e-3 * np.random.default_rng(1).normal(size=(WALKERS, mode.size)))

    def density(sets: FloatArray) -> FloatArray:
        inside = np.all((sets > likelihood.lower) & (sets < likelihood.upper), axis=1)
        result = np.full(len(sets), -np.inf)
        result[inside] = likelihood.log(sets[inside])
        return result

    def sampled(*, vectorize: bool) -> FloatArray:
        function = density if vectorize else lambda one: float(density(one[None])[0])
        sampler = emcee.EnsembleSampler(WALKERS, mode.size, function, vectorize=vectorize)
        sampler.random_state = np.random.RandomState(1).get_state()
        sampler.run_mcmc(start, STEPS)
        return np.asarray(sampler.get_log_prob())

    chain = benchmark.pedantic(sampled, kwargs={"vectorize": at_once}, rounds=3)
    # The same walk either way, as far as rounding lets it be: so are its first steps.
    other = sampled(vectorize=not at_once)
    assert chain[:3] == pytest.approx(other[:3], abs=1e-3)
