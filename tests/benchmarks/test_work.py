"""What users wait for beside a fit: starting, files, studies, analyses."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from pilotid import Study, load_recording, save_recording
from pilotid.recording.recording import Recording

PROGRAM = "from pilotid.cli.main import main; main()"
#: Runs Python with other arguments, and tells the most memory that any process of it took.
PEAK = """
import resource, subprocess, sys
subprocess.run([sys.executable, *sys.argv[1:]], check=True)
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
"""
REPLICATIONS = 1000
CSV_MEGABYTES = 100


def run(*command: str | Path, cwd: Path | None = None) -> None:
    subprocess.run([sys.executable, *map(str, command)], check=True, capture_output=True, cwd=cwd)


@pytest.mark.parametrize("what", ["import numpy", "import pilotid"])
def test_import(benchmark: BenchmarkFixture, what: str) -> None:
    benchmark.group = "starting"
    benchmark.pedantic(run, ("-c", what), rounds=5, warmup_rounds=1)


def test_reading_a_large_csv(benchmark: BenchmarkFixture, tmp_path: Path) -> None:
    benchmark.group = "reading"
    samples = int(CSV_MEGABYTES * 1e6 / 67.0)  # bytes of a row, about
    e, u, x = np.random.default_rng(1).normal(size=(3, 1, samples))
    long = Recording(dt=0.01, e=e, u=u, x=x, run_in=0)
    file = tmp_path / "large.csv"
    save_recording(long, file)
    benchmark.extra_info["megabytes"] = round(file.stat().st_size / 1e6, 1)
    assert benchmark.pedantic(load_recording, (file,), rounds=1).samples == samples


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("method", ["mle-white", "mle"])
def test_study(benchmark: BenchmarkFixture, tmp_path: Path, method: str, workers: int) -> None:
    benchmark.group = f"study: {REPLICATIONS} recordings of nominal, simulated and fitted"
    study = Study(["nominal"], [method], replications=REPLICATIONS, seed=1)
    result = benchmark.pedantic(study.run_in, (tmp_path / "study", workers), rounds=1)
    assert result.replications() == REPLICATIONS
    if benchmark.stats:  # nothing is timed where tests run side by side
        benchmark.extra_info["per_second"] = round(REPLICATIONS / benchmark.stats.stats.min, 1)


def test_analyse_people(benchmark: BenchmarkFixture, measured: Path, tmp_path: Path) -> None:
    benchmark.group = "analyse: recordings of people, 4 subjects, 6 conditions, 5 runs"
    files = sorted((measured / "yaw").glob("*.mat"))
    command = ("-c", PROGRAM, "analyse", *files, "--pattern", "subj{subject}_{condition}")
    benchmark.pedantic(run, (*command, "--out", tmp_path / "results"), rounds=1)
    assert (tmp_path / "results" / "report.html").is_file()


def test_compare(benchmark: BenchmarkFixture, tmp_path: Path) -> None:
    """The quick comparison, and the largest memory that any of its processes took."""
    benchmark.group = "compare, quick profile"
    command = (sys.executable, "-c", PEAK, "-c", PROGRAM, "compare", "--out", tmp_path / "out")
    done = benchmark.pedantic(
        subprocess.run,
        (list(map(str, command)),),
        {"check": True, "capture_output": True, "text": True},
        rounds=1,
    )
    benchmark.extra_info["peak_megabytes"] = round(int(done.stdout.split()[-1]) / 1024.0)
