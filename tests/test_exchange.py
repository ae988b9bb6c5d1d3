"""A study's recordings in files for other languages, and the estimates that come back."""

from __future__ import annotations

import csv
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from helpers import Run, rows_of
from test_docs import FENCE

from pilotid.datasets import scenario_named
from pilotid.recording.files import load_recording
from pilotid.study.exchange import export
from pilotid.study.run import recording_of
from pilotid.study.table import read_study

OCTAVE = shutil.which("octave-cli") or shutil.which("octave")
#: Estimates a pilot of the model `single` from exported text files, with numpy alone.
STRANGER = """
import csv, json, sys, time
import numpy as np
folder = sys.argv[1]
held = json.load(open(folder + "/manifest.json"))
rows = [("scenario", "replication", "parameter", "value", "std_error", "lower", "upper", "seconds")]
for own in held["recordings"]:
    begin = time.time()
    data = np.genfromtxt(folder + "/" + own["file"], delimiter=",", names=True)
    part = data[data["t"] >= 0]
    e, u, ft, fd = (np.fft.rfft(part[name]) for name in ("e", "u", "ft", "fd"))
    forced = np.abs(ft) / np.abs(ft).max() + np.abs(fd) / np.abs(fd).max()
    lines = np.flatnonzero(forced[1:] > 1e-3) + 1
    s = 2j * np.pi * lines / (len(part) * own["dt"])
    def errors(logs):
        gain, lead, delay, f, d = np.exp(logs)
        pilot = gain * (1 + lead * s) * np.exp(-delay * s) * f**2 / (s**2 + 2 * d * f * s + f**2)
        left = u[lines] - pilot * e[lines]
        return np.concatenate([left.real, left.imag])
    def slopes(logs):
        steps = 1e-5 * np.eye(5)
        return np.array([(errors(logs + p) - errors(logs - p)) / 2e-5 for p in steps]).T
    logs = np.log([max(wanted["start"], 1e-3) for wanted in own["parameters"]])
    damping = 1.0
    for _ in range(200):
        left, j = errors(logs), slopes(logs)
        normal = j.T @ j
        step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), -j.T @ left)
        better = np.sum(errors(logs + step) ** 2) < np.sum(left**2)
        logs, damping = (logs + step, damping / 3) if better else (logs, damping * 3)
    j, left = slopes(logs), errors(logs)
    sizes = np.sqrt(np.sum(left**2) / (left.size - 5) * np.diag(np.linalg.inv(j.T @ j)))
    for wanted, log, size in zip(own["parameters"], logs, sizes):
        ends = (np.exp(log - 1.96 * size), np.exp(log + 1.96 * size))
        told = (np.exp(log), np.exp(log) * size, *ends, time.time() - begin)
        rows.append((own["scenario"], own["replication"], wanted["key"], *told))
csv.writer(open(folder + "/stranger.csv", "w", newline="")).writerows(rows)
assert "pilotid" not in sys.modules
"""


@pytest.fixture(scope="module")
def answered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with recordings of `single`, and a stranger's estimates of them."""
    folder: Path = tmp_path_factory.mktemp("export") / "task"
    export(["single"], 3, 2, folder, "csv")
    subprocess.run([sys.executable, "-c", STRANGER, str(folder)], check=True)
    return folder


@pytest.fixture
def folder(answered: Path, tmp_path: Path) -> Path:
    """The same, to be changed."""
    shutil.copytree(answered, tmp_path / "task")
    return tmp_path / "task"


def write(folder: Path, rows: Iterable[dict[str, str]]) -> None:
    kept = list(rows)
    with (folder / "stranger.csv").open("w", newline="") as stream:
        writer = csv.DictWriter(stream, [*kept[0]])
        writer.writeheader()
        writer.writerows(kept)


def compare(run: Run, folder: Path, *more: str) -> tuple[int, str]:
    out = folder.parent / "out"
    given = ("--estimates", folder / "stranger.csv", "--method", "fourier", "--workers", 1)
    told = run("compare", *given, "--seed", 2, *more, "--out", out)
    return told.status, " ".join(f"{told.out} {told.err}".split())


@pytest.mark.parametrize("kind", ["csv", "mat", "npz"])
def test_files_hold_the_recordings_of_the_study(run: Run, tmp_path: Path, kind: str) -> None:
    given = ("single,population-usual", "--replications", 1, "--seed", 3, "--format", kind)
    assert run("export", *given, "--out", tmp_path / "a").status == 0
    manifest = json.loads((tmp_path / "a" / "manifest.json").read_text())
    for own in manifest["recordings"]:
        recording = load_recording(tmp_path / "a" / own["file"])
        known = recording_of(scenario_named(own["scenario"]), 3, own["replication"])
        for name, signal in known.arrays.items():
            assert np.array_equal(recording.arrays[name], signal)
        assert (recording.run_in, recording.dt) == (own["run_in"], own["dt"])
        assert dict(recording.lines) == dict(known.lines)
    # The truth is nowhere but in its folder.
    for file in tmp_path.glob("a/recordings/*"):
        assert b"parameters" not in file.read_bytes()
    held = json.loads((tmp_path / "a" / "truth" / "single-0.json").read_text())
    assert held["parameters"]["tlead"]["value"] == 1.68
    assert run("export", *given, "--out", tmp_path / "a").status == 2  # never over an export


def test_a_stranger_is_scored_as_the_others(run: Run, folder: Path) -> None:
    status, words = compare(run, folder)
    assert status == 0, words
    study = read_study(folder.parent / "out")
    frame = study.frame
    own = frame[frame.method == "stranger"].reset_index()
    assert study.replications("single") == 3
    assert own.usable.all()
    assert np.array_equal(
        own.value, [float(row["value"]) for row in rows_of(folder / "stranger.csv")]
    )
    others = frame[frame.method == "fourier"].reset_index()
    assert np.array_equal(own.truth, others.truth)
    assert np.array_equal(own.bound, others.bound)
    scores = study.of("single").loc["stranger"]
    assert 0.5 < scores.loss < 10.0
    assert "--estimates" in (folder.parent / "out" / "report.md").read_text()
    # Another table of the same method takes the place of the first.
    write(folder, [row for row in rows_of(folder / "stranger.csv") if row["replication"] != "1"])
    assert compare(run, folder)[0] == 0
    found = read_study(folder.parent / "out")
    scores = found.of("single").loc["stranger"]
    assert (scores.recordings, scores.failures) == (3, 1)
    told = found.frame[(found.frame.method == "stranger") & (found.frame.replication == 1)]
    assert set(told.message) == {"there is no estimate of this recording"}
    assert told.truth.notna().all()


def test_what_makes_no_sense_is_a_failure(run: Run, folder: Path) -> None:
    rows = rows_of(folder / "stranger.csv")
    changes = {"value": "", "std_error": "-1", "upper": "0"}
    for replication, (name, text) in enumerate(changes.items()):
        row = next(own for own in rows if own["replication"] == str(replication))
        row[name] = text
    write(folder, rows)
    assert compare(run, folder)[0] == 0
    frame = read_study(folder.parent / "out").frame
    told = frame[frame.method == "stranger"].groupby("replication").message.first()
    assert [*told] == [
        "there is no value of Kvis",
        "the standard error of Kvis is not positive",
        "the interval of Kvis does not hold its value",
    ]


def test_values_alone_are_enough_and_methods_have_names(run: Run, folder: Path) -> None:
    kept = ("scenario", "replication", "parameter", "value")
    rows = [{name: row[name] for name in kept} for row in rows_of(folder / "stranger.csv")]
    write(folder, [row | {"method": label} for label in ("a", "b") for row in rows])
    assert compare(run, folder)[0] == 0
    scores = read_study(folder.parent / "out").of("single")
    assert np.isnan(scores.loss["a"])
    assert scores.rmse_over_bound["a"] == scores.rmse_over_bound["b"] > 0.0


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("scenario", "nowhere", "line 2: scenario 'nowhere' is not in the study"),
        ("replication", "7", "line 2: manifest.json has no replication 7 of scenario single"),
        ("replication", "0.5", "line 2: replication '0.5' is no number"),
        ("parameter", "Kvest", "line 2: model single has no parameter 'Kvest'; it has Kvis, tlead"),
        ("parameter", "tlead", "line 3: tlead of replication 0 of single is there twice"),
        ("value", "high", "line 2: value 'high' is no number"),
        ("method", "fourier", "a method of the study is called 'fourier'"),
    ],
)
def test_wrong_tables_are_refused(run: Run, folder: Path, name: str, text: str, words: str) -> None:
    first, *rest = rows_of(folder / "stranger.csv")
    write(folder, [{"method": "mine", **row} for row in ({**first, name: text}, *rest)])
    if name == "method":
        write(folder, [{**row, name: text} for row in (first, *rest)])
    status, told = compare(run, folder)
    assert (status, told.count("pilotid: ")) == (2, 1)
    assert words in told
    assert not (folder.parent / "out" / "study.sqlite").exists()
    (folder / "stranger.csv").write_text("scenario,replication,parameter,value\n")
    assert "holds no row of estimates" in compare(run, folder)[1]


def test_estimates_of_other_recordings_are_refused(run: Run, folder: Path) -> None:
    status, told = compare(run, folder, "--replications", "4")
    assert (status, "3 recordings of single were exported" in told) == (2, True)
    status, told = compare(run, folder, "--seed", "1")
    assert (status, "say --seed 2" in told) == (2, True)
    path = folder / "manifest.json"
    text = path.read_text()
    digests = re.findall('"digest": "(.*?)"', text)
    path.write_text(text.replace(digests[1], digests[0]))
    status, told = compare(run, folder)
    assert (status, "replication 1 of single has another digest" in told) == (2, True)
    path.write_text("{}")
    status, told = compare(run, folder)
    assert (status, "is no manifest" in told) == (2, True)
    path.unlink()
    status, told = compare(run, folder)
    assert (status, "there is no manifest.json beside it" in told) == (2, True)


@pytest.mark.skipif(OCTAVE is None, reason="the script of the MATLAB page needs Octave")
def test_the_script_of_the_matlab_page_is_scored(run: Run, tmp_path: Path) -> None:
    page = (Path(__file__).parent.parent / "docs" / "guide" / "matlab.md").read_text()
    (script,) = [b for _, kind, b in FENCE.findall(page) if kind == "matlab" and "mine.csv" in b]
    assert len(script.strip().splitlines()) <= 30
    export(["single"], 2, 1, tmp_path / "task", "mat")
    (tmp_path / "mine.m").write_text(script)
    command = [str(OCTAVE), "--no-gui", "mine.m"]
    subprocess.run(command, cwd=tmp_path, check=True, timeout=300)
    (tmp_path / "task" / "mine.csv").rename(tmp_path / "task" / "stranger.csv")
    status, words = compare(run, tmp_path / "task", "--seed", "1")
    assert status == 0, words
    scores = read_study(tmp_path / "out").of("single").loc["stranger"]
    assert scores.failures == 0
    assert scores.loss < 10.0
