"""How long a complete fit takes, by method, model and number of runs."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import control
import numpy as np
import pytest
from cases import far_model, position_control, recorded
from pytest_benchmark.fixture import BenchmarkFixture
from scipy.optimize import least_squares

from pilotid import load_recording
from pilotid.estimate.method import identify
from pilotid.methods import method_named
from pilotid.methods.bayes import Bayes
from pilotid.model.catalogue import MODELS
from pilotid.support.types import FloatArray

METHODS = (
    *("mmle3", "mle-white", "mle-genetic", "mle", "bayes-white", "bayes"),
    *("fourier", "arx", "sindy", "mle-reference"),
)
SCENARIOS = {
    ("multi", 1): "nominal",
    ("multi", 5): "nominal(runs=5)",
    ("single", 1): "single",
    ("single", 5): "single(runs=5)",
}


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Complete fits by all methods, and by those of the option --method."""
    if metafunc.definition.originalname == "test_fit":
        metafunc.parametrize("name", [*METHODS, *metafunc.config.getoption("--method")])


@pytest.mark.parametrize("runs", [1, 5])
@pytest.mark.parametrize("model", ["multi", "single"])
def test_fit(
    benchmark: BenchmarkFixture,
    necessary: Callable[[float], None],
    name: str,
    model: str,
    runs: int,
) -> None:
    benchmark.group = f"fit: {model}, {runs} run{'s' if runs > 1 else ''} of 4096 samples"
    method, recording = method_named(name), recorded(SCENARIOS[model, runs])
    # From 40 % off mmle3 ends with a negative delay.
    pilot = far_model() if model == "multi" and name != "mmle3" else MODELS[model]
    estimate = benchmark(lambda: identify(method, recording, pilot, np.random.default_rng(1)))
    assert estimate.outcome.usable
    if name in ("mle", "mle-white") and (model, runs) == ("multi", 1):
        # One descent from one start is what no likelihood can be maximised without.
        necessary(float(estimate.iterations))


def test_what_a_user_would_write(benchmark: BenchmarkFixture) -> None:
    """Output error by python-control, Pade delays and scipy's least squares, from 40 % off."""
    benchmark.group = "fit: multi, 1 run of 4096 samples"
    data, start = recorded("nominal"), far_model().start

    def residual(values: FloatArray) -> FloatArray:
        gain, lead, delay, motion_gain, motion_delay, frequency, damping = values
        s = control.tf("s")
        muscles = frequency**2 / (s**2 + 2.0 * damping * frequency * s + frequency**2)
        visual = gain * (lead * s + 1.0) * control.tf(*control.pade(delay, 5)) * muscles
        sensor = s**2 * (0.1 * s + 1.0) / (6.0 * s + 1.0)
        motion = -motion_gain * sensor * control.tf(*control.pade(motion_delay, 5)) * muscles
        both = control.append(control.tf2ss(visual), control.tf2ss(motion))
        signals = np.concatenate([data.e, data.x])
        answers = control.forced_response(both, data.time - data.time[0], signals).outputs
        return np.asarray(data.u[0] - answers.sum(axis=0))[data.run_in :]

    bounds = 1e-3 * start, 10.0 * start
    found = benchmark(lambda: least_squares(residual, start, x_scale=start, bounds=bounds))
    white = identify(method_named("mle-white"), data, far_model(), np.random.default_rng(1))
    assert found.x == pytest.approx(white.values, rel=0.05)


@pytest.mark.parametrize("name", ["mle-white", "mle", "bayes"])
def test_position_control(benchmark: BenchmarkFixture, name: str) -> None:
    """Where a fit takes longest: the band grows to 300 rad/s, with runs whose remnant is an AR(16).

    Position control answers at once, and the remnant of this draw is in no family.
    """
    benchmark.group = "fit: position control, 6 runs of 60 s at 100 Hz"
    scenario, recording = position_control()
    fit = (method_named(name), recording, scenario.model, np.random.default_rng(1))
    estimate = benchmark.pedantic(identify, fit, rounds=5, warmup_rounds=1)
    assert estimate.outcome.usable


def test_people(benchmark: BenchmarkFixture, measured: Path) -> None:
    """Recordings of people with `multi`, whose true model is another; half a minute in all."""
    benchmark.group = "fit: recordings of people, 5 runs, multi"
    recordings = [load_recording(file) for file in sorted((measured / "yaw").glob("*.mat"))]
    seconds: list[float] = []

    def fit_all() -> None:
        for recording in recordings:
            begin = time.perf_counter()
            identify(method_named("mle"), recording, MODELS["multi"], np.random.default_rng(1))
            seconds.append(time.perf_counter() - begin)

    benchmark.pedantic(fit_all, rounds=1)
    benchmark.extra_info |= {
        "recordings": len(recordings),
        "median": round(float(np.median(seconds)), 3),
        "worst": round(max(seconds), 3),
    }


def test_posterior(benchmark: BenchmarkFixture) -> None:
    benchmark.group = "posterior of seven parameters and the remnant's"
    fit = (Bayes(), recorded("nominal"), far_model(), np.random.default_rng(1))
    estimate = benchmark.pedantic(identify, fit, rounds=5)
    assert estimate.draws is not None
    assert estimate.draws.converged
