"""Time and memory of a fit of the longest recording."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from pilotid.datasets import scenario_named, simulate
from pilotid.recording.recording import SIGNALS

METHODS = ("mle-white", "mle", "fourier", "arx")

#: Fits an hour at 1 kHz in a process of its own, and tells the memory that it took.
ALONE = """
import resource, sys
import numpy as np
from pilotid.estimate.method import identify
from pilotid.methods import method_named
from pilotid.model.catalogue import MODELS
from pilotid.recording.recording import Recording
signals = np.load(sys.argv[1])
data = Recording(dt=0.001, run_in=0, **{name: signals[name] for name in signals.files})
del signals
estimate = identify(method_named(sys.argv[2]), data, MODELS["multi"], np.random.default_rng(1))
assert estimate.values is not None, estimate.message
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


@pytest.mark.parametrize("name", METHODS)
def test_an_hour_at_1_khz(benchmark: BenchmarkFixture, name: str, tmp_path: Path) -> None:
    benchmark.group = "an hour at 1 kHz, in a process of its own"
    # Forty-four periods of the forcing functions, simulated at once: no seams.
    scenario = scenario_named("nominal(dt=0.001)")
    scenario = replace(scenario, duration=44.0 * scenario.duration)
    whole = simulate(scenario, np.random.default_rng(1))
    file = tmp_path / "hour.npz"
    np.savez(file, **{signal: whole.window(getattr(whole, signal)) for signal in SIGNALS})
    command = [sys.executable, "-c", ALONE, str(file), name]
    done = benchmark.pedantic(
        subprocess.run,
        (command,),
        {"check": True, "capture_output": True, "text": True},
        rounds=1,
    )
    benchmark.extra_info["peak_megabytes"] = round(int(done.stdout) / 1024.0)
