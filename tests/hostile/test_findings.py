"""What a hostile trial found, each as a test: of files, stores, numbers, outputs and Ctrl-C."""

from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import Run

import pilotid
from pilotid.datasets import scenario_named, simulate
from pilotid.pilot.model import Channel
from pilotid.recordings.files import save_recording
from pilotid.study.study import Study
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
@pytest.mark.parametrize("damage", ["bytes", "content", "table"])
def test_a_damaged_store_of_an_analysis_is_refused(run: Run, place: Path, damage: str) -> None:
    given = ("analyse", "s.csv", *FIT, "--out", "o", "--workers", "1")
    assert run(*given).status == 0
    path = place / "o" / "study.sqlite"
    if damage == "bytes":
        path.write_bytes(path.read_bytes()[:4096] + b"\xff" * 8192)
    else:
        with closing(sqlite3.connect(path)) as base:
            if damage == "table":
                base.execute("DROP TABLE rows")
                base.execute("CREATE TABLE rows (a)")
            else:
                base.execute("UPDATE rows SET content = '{'")
            base.commit()
    answer = run(*given)
    assert (answer.status, len(answer.err.splitlines())) == (2, 1)


@pytest.mark.long
def test_a_name_that_is_not_utf8_costs_nothing(run: Run, place: Path) -> None:
    name = os.fsdecode(b"x\xffy.csv")
    (place / "s.csv").rename(name)
    assert run("analyse", name, *FIT, "--out", "o", "--workers", "1").status == 0
    assert b"mle-white" in (place / "o" / "estimates.csv").read_bytes()


@pytest.mark.long
def test_fits_are_kept_where_pages_cannot_be_written(run: Run, place: Path) -> None:
    (place / "o").mkdir()
    (place / "o" / "recordings").touch()  # where the pages go
    answer = run("analyse", "s.csv", *FIT, "--out", "o", "--workers", "1")
    assert answer.status == 2
    assert b"converged" in (place / "o" / "estimates.csv").read_bytes()


def test_a_file_without_rights_costs_no_other(
    run: Run, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (place / "closed.csv").write_bytes((place / "s.csv").read_bytes())
    (place / "closed.csv").chmod(0)
    usual = os.access
    monkeypatch.setattr(  # root may read all
        os, "access", lambda path, mode, **_: "closed" not in str(path) and usual(path, mode)
    )
    answer = run("fit", "closed.csv", "s.csv", *FIT)
    assert "mle-white: converged" in answer.out


@pytest.mark.parametrize(
    "command",
    [
        *(f"fit s.csv --lead-in {s}" for s in ("1e308", "-1", "nan", "86")),
        "fit s.csv --method mle(band=0)",
        "fit s.csv --method arx(memory=-1)",
        "fit s.csv --method arx(memory=1e9)",
        "design nominal --out d --limit e=-3%",
        "compare --out c --replications 1000000000",
        "compare --out c --workers 100000",
        "simulate single --out x.csv --runs 1000000000",
    ],
)
def test_numbers_out_of_range_are_refused_at_once(run: Run, place: Path, command: str) -> None:
    answer = run(*command.split())
    assert (answer.status, len(answer.err.splitlines())) == (2, 1)


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


@dataclass(frozen=True)
class Silent:
    """Stands in for processes that answer nothing."""

    def __call__(self, *_: Any, **__: Any) -> list[Any]:
        return []


def test_a_fit_that_nobody_answered_is_a_row(
    run: Run, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pilotid.study.study.run_tasks", Silent())
    study = Study(["single"], ["mle-white"], 2)
    (cell,) = study.run_in(place / "o").cells
    assert [result.outcome for result in cell.results] == ["died", "died"]
    given = ("--scenario", "single", "--method", "mle-white", "--replications", "1")
    assert run("compare", *given, "--out", "p").status == 1


@pytest.mark.long
@pytest.mark.parametrize("after", [0.15, 0.3, 0.6, 1.2])
def test_an_interruption_is_a_sentence_at_any_moment(place: Path, after: float) -> None:
    process = started("check", "s.csv")
    time.sleep(after)
    process.send_signal(signal.SIGINT)
    _, told = process.communicate(timeout=60)
    early = process.returncode == -signal.SIGINT  # Python itself was not there yet
    assert early or (process.returncode in (0, 130) and "Traceback" not in told)
