"""Time and memory of a fit over length, runs and rate of the recording."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from cases import recorded
from pytest_benchmark.fixture import BenchmarkFixture

from pilotid.datasets import scenario_named
from pilotid.estimates.method import identify
from pilotid.methods import method_named
from pilotid.recordings.recording import SIGNALS

PERIOD = 81.92  # s, of the forcing functions
#: What is varied, and its values; nominal has a window of one period, one run and 50 Hz.
AXES = {
    "duration": [PERIOD * n for n in (0.25, 1, 4, 16, 44)],
    "runs": [1, 3, 10, 30, 100],
    "dt": [0.04, 0.02, 0.01, 0.005, 0.001],
}
METHODS = ("mle-white", "mle", "fourier", "arx")
CASES = [(axis, value) for axis, values in AXES.items() for value in values]

#: Fits an hour at 1 kHz in a process of its own, and tells the memory that it took.
ALONE = """
import resource, sys
import numpy as np
from pilotid.estimates.method import identify
from pilotid.methods import method_named
from pilotid.pilot.catalogue import MODELS
from pilotid.recordings.recording import Recording
signals = np.load(sys.argv[1])
data = Recording(dt=0.001, run_in=0, **{name: signals[name] for name in signals.files})
del signals
estimate = identify(method_named(sys.argv[2]), data, MODELS["multi"], np.random.default_rng(1))
assert estimate.values is not None, estimate.message
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize(("axis", "value"), CASES, ids=[f"{a}={v:g}" for a, v in CASES])
def test_scaling(benchmark: BenchmarkFixture, axis: str, value: float, name: str) -> None:
    benchmark.group = f"scaling: {axis}"
    data = recorded(f"nominal({axis}={value!r})")
    method, model = method_named(name), scenario_named("nominal").model
    objection = method.objection(data, model)
    if objection:
        pytest.skip(objection)
    fit = (method, data, model, np.random.default_rng(1))
    estimate = benchmark.pedantic(identify, fit, rounds=3, warmup_rounds=1)
    assert estimate.outcome.usable
    size = data.runs * data.samples
    benchmark.extra_info |= {"method": name, "axis": axis, "value": value, "samples": size}


@pytest.mark.parametrize("name", METHODS)
def test_an_hour_at_1_khz(benchmark: BenchmarkFixture, name: str, tmp_path: Path) -> None:
    benchmark.group = "an hour at 1 kHz, in a process of its own"
    parts = [recorded("nominal(dt=0.001)", seed) for seed in range(4)]
    # Forty-four windows one after the other: as long as a recording gets, whatever the seams.
    file = tmp_path / "hour.npz"
    whole = {
        signal: np.tile(np.hstack([p.window(getattr(p, signal)) for p in parts]), 11)
        for signal in SIGNALS
    }
    np.savez(file, **whole)
    command = [sys.executable, "-c", ALONE, str(file), name]
    done = benchmark.pedantic(
        subprocess.run,
        (command,),
        {"check": True, "capture_output": True, "text": True},
        rounds=1,
    )
    benchmark.extra_info["peak_megabytes"] = round(int(done.stdout) / 1024.0)
