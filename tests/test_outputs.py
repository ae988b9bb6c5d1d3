"""Where results go: no input is written over, and neither are other files."""

from __future__ import annotations

import os
import threading
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from helpers import Run
from stores import finish

from pilotid.datasets import scenario_named, simulate
from pilotid.recording.files import save_recording

RECORDING = simulate(scenario_named("single"), np.random.default_rng(1))
FIT = ("fit", "s.csv", "--model", "single", "--method", "mle-white")


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a recording, results that look like inputs, and a study."""
    save_recording(RECORDING, tmp_path / "s.csv")
    (tmp_path / "o").mkdir()
    for name in ("estimates", "summary", "models"):
        save_recording(RECORDING, tmp_path / "o" / f"{name}.csv")
    save_recording(RECORDING, tmp_path / "b.csv")
    for name in ("notes.txt", "s.truth.json"):
        (tmp_path / name).write_text("mine")
    (tmp_path / "link.json").symlink_to("s.csv")
    (tmp_path / "A").mkdir()
    finish(tmp_path / "A", 1).close()
    monkeypatch.chdir(tmp_path)
    return tmp_path


def digests(folder: Path) -> dict[Path, str]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path: sha256(path.read_bytes()).hexdigest() for path in files}


@pytest.mark.parametrize(
    "command",
    [
        "analyse o/estimates.csv --out o",
        "analyse o/models.csv --out o",
        "posterior o/summary.csv --out o",
        "compare --scenario single --method mle-white --replications 1 --out o",
        "simulate single --out b.csv",
        "fit s.csv --json a.out --report a.out",
        "fit s.csv --json link.json",
        "fit s.csv --json nowhere/a.json",
        "check s.csv --json s.json",
        "fit s.csv --json s.csv",
        "fit s.csv --json s.truth.json",
    ],
)
def test_what_must_stay_is_refused_before_work_begins(run: Run, place: Path, command: str) -> None:
    before = digests(place)
    answer = run(*command.split())
    assert answer.status == 2
    assert len(answer.err.splitlines()) == 1
    assert "; name a" in answer.err
    assert digests(place) == before


def test_results_are_written_again_and_other_files_are_not(run: Run, place: Path) -> None:
    for _ in range(2):
        assert run(*FIT, "--json", "x.json").status == 0
        assert run("simulate", "single", "--out", "y.csv").status == 0
    assert "notes.txt: is there already" in run(*FIT, "--json", "notes.txt").err
    assert "s.json: is read, or read as notes" in run(*FIT, "--json", "s.json").err
    assert (place / "notes.txt").read_text() == "mine"


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes with names")
def test_pipes_are_written_into_and_the_targets_of_links_replaced(run: Run, place: Path) -> None:
    os.mkfifo(place / "pipe")
    (place / "target").touch()
    (place / "new.json").symlink_to("target")
    found: list[bytes] = []
    reader = threading.Thread(target=lambda: found.append((place / "pipe").read_bytes()))
    reader.start()
    assert run(*FIT, "--json", "pipe").status == 0
    reader.join(10.0)
    assert run(*FIT, "--json", "new.json").status == 0
    assert (place / "pipe").is_fifo()
    assert (place / "new.json").is_symlink()
    assert found[0][:20] == (place / "target").read_bytes()[:20] == b'{\n  "recording": {\n '
