"""A study on a Dask cluster: what is wrong with it is a sentence."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from helpers import PROGRAM

pytest.importorskip("distributed")

OTHER_CODE = """
import pilotid.support.jobs
pilotid.support.jobs.own_digest = lambda: "0ther"
"""

Process = subprocess.Popen[str]


@pytest.fixture
def started() -> Iterator[Callable[..., Process]]:
    """Start a program that ends with the test."""
    running: list[Process] = []

    def start(*command: object) -> Process:
        pipe: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        process = subprocess.Popen([sys.executable, *map(str, command)], text=True, **pipe)
        running.append(process)
        return process

    yield start
    for process in running:
        process.kill()
        process.communicate()


def scheduler(started: Callable[..., Process], file: Path) -> tuple[Process, str]:
    process = started(
        *("-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0"),
        *("--no-dashboard", "--scheduler-file", file),
    )
    for line in process.stderr:
        if "Scheduler at:" in line:
            return process, line.split()[-1]
    raise AssertionError("the scheduler does not start")


def worker(started: Callable[..., Process], address: str, *more: object) -> Process:
    options = ("--no-nanny", "--nthreads", "1", "--no-dashboard", "--host", "127.0.0.1")
    return started("-m", "distributed.cli.dask_worker", address, *options, *more)


def study(started: Callable[..., Process], address: str, folder: Path) -> Process:
    options = ("--scenario", "single", "--method", "fourier", "--replications", "5000")
    return started(*("-c", PROGRAM, "compare", *options, "--scheduler", address, "--out", folder))


def ended(process: Process) -> tuple[int, list[str]]:
    """Status and lines on standard error."""
    _, errors = process.communicate(timeout=60)
    return process.returncode, errors.splitlines()


def test_no_workers_is_told_and_can_be_ended(
    started: Callable[..., Process], tmp_path: Path
) -> None:
    _, address = scheduler(started, tmp_path / "scheduler")
    process = study(started, address, tmp_path / "out")
    assert "has no workers; waiting" in process.stderr.readline()
    time.sleep(1.0)  # in the middle of handing tasks over Dask would say more
    process.send_signal(signal.SIGINT)
    status, lines = ended(process)
    assert status == 130
    assert len(lines) == 1, lines
    assert lines[0].startswith("pilotid: stopped;")


@pytest.mark.long
def test_a_worker_of_other_code_is_refused(started: Callable[..., Process], tmp_path: Path) -> None:
    _, address = scheduler(started, tmp_path / "scheduler")
    preload = tmp_path / "other_code.py"
    preload.write_text(OTHER_CODE)
    worker(started, address, "--preload", preload)
    status, lines = ended(study(started, address, tmp_path / "out"))
    assert status == 2
    assert len(lines) == 1, lines
    assert "digest 0ther" in lines[0]
