"""Bad arguments in Python, fits that nobody answers, files in the way, and Ctrl-C."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import Run

import pilotid
from pilotid.datasets import scenario_named, simulate
from pilotid.model.channel import Channel
from pilotid.recording.files import save_recording
from pilotid.support.types import InputError

RECORDING = simulate(scenario_named("single"), np.random.default_rng(1))
FIT = ("--model", "single", "--method", "mle-white")


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    save_recording(RECORDING, tmp_path / "s.csv")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def started(*arguments: str, **options: Any) -> subprocess.Popen[str]:
    program = [sys.executable, "-c", "from pilotid.cli import start; start()", *arguments]
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **options}
    return subprocess.Popen(program, text=True, **options)


@pytest.mark.long
def test_fits_are_kept_where_figures_cannot_be_written(run: Run, place: Path) -> None:
    (place / "o").mkdir()
    (place / "o" / "figures").touch()  # where the figures go
    answer = run("analyse", "s.csv", *FIT, "--out", "o", "--workers", "1")
    assert answer.status == 2
    assert b"converged" in (place / "o" / "estimates.csv").read_bytes()


@pytest.mark.parametrize(
    "call",
    [
        lambda: pilotid.design(minimise="foo"),
        lambda: pilotid.design(limits={"e": -1.0}),
        lambda: pilotid.design(limits={"e": float("nan")}),
        lambda: pilotid.compare(["single"], ["mle-white"], 0, out="c"),
        lambda: pilotid.compare(["single"], ["mle-white"], 1, workers=0, out="c"),
        lambda: pilotid.identify("mle-white", RECORDING, "single", -1),
        lambda: pilotid.identify("mle-white", RECORDING, "single", "a"),  # type: ignore[arg-type]
        lambda: pilotid.identify("mle-white", 3, "single"),  # type: ignore[arg-type]
        lambda: pilotid.identify("mle-white", RECORDING, 3),  # type: ignore[arg-type]
        lambda: pilotid.simulate(3),  # type: ignore[arg-type]
        lambda: Channel("v", "error", 1, ()),
    ],
)
def test_python_is_as_careful(call: Any, place: Path) -> None:
    with pytest.raises(InputError):
        call()


@pytest.mark.long
@pytest.mark.parametrize("after", [0.15, 0.3, 0.6, 1.2])
def test_an_interruption_is_a_sentence_at_any_moment(place: Path, after: float) -> None:
    process = started("check", "s.csv")
    time.sleep(after)
    process.send_signal(signal.SIGINT)
    _, told = process.communicate(timeout=60)
    early = process.returncode == -signal.SIGINT  # Python itself was not there yet
    assert early or (process.returncode in (0, 130) and "Traceback" not in told)
