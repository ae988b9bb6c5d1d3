"""Recordings with names: those of people as they were published, and fixed tasks."""

from __future__ import annotations

import csv
import hashlib
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import SINGLE_LOOP, Run

import pilotid
from pilotid.datasets import fixed_tasks, load_task, named, scenario_named, simulate
from pilotid.datasets.named import PEOPLE, TASKS, fetch, published
from pilotid.recording.files import save_recording
from pilotid.study.run import recording_of, scenario_of, truths_of
from pilotid.support.types import InputError

CONTENT = {"a.mat": b"first", "b.mat": b"second"}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where files are fetched to; every experiment has two small ones."""
    monkeypatch.setenv("PILOTID_DATA", str(tmp_path / "data"))
    files = {name: hashlib.sha256(content).hexdigest() for name, content in CONTENT.items()}
    monkeypatch.setattr(named, "published", lambda _: files)
    return tmp_path


def write(place: Path, **changed: bytes) -> Path:
    place.mkdir(parents=True, exist_ok=True)
    for name, content in CONTENT.items():
        (place / name).write_bytes(changed.get(name[0], content))
    return place


def test_the_table_has_every_experiment() -> None:
    for name in PEOPLE:
        assert all(re.fullmatch("[0-9a-f]{64}", digest) for digest in published(name).values())
        assert published(name)


def test_files_that_are_there_are_not_fetched(folder: Path) -> None:
    there = write(folder / "data" / "yaw")
    assert fetch("yaw") == there
    assert {file.name: file.read_bytes() for file in there.iterdir()} == CONTENT


def test_other_files_than_the_published_are_refused(folder: Path) -> None:
    there = write(folder / "data" / "adaptation", b=b"seconD")
    with pytest.raises(InputError, match=r"b\.mat cannot be had .*put them into .*adaptation"):
        fetch("adaptation")
    (there / "a.mat").unlink()
    with pytest.raises(InputError, match=r"a\.mat cannot be had .*doi 10\.2514/1\.G001592"):
        fetch("adaptation")
    with pytest.raises(InputError, match="choose from yaw, adaptation, preview, following"):
        fetch("nobody")


def test_command(folder: Path, run: Run) -> None:
    told = run("fetch-data")
    assert told.status == 0
    assert [name for name in PEOPLE if f"\n{name}\n" in f"\n{told.out}"] == list(PEOPLE)
    for name in PEOPLE:
        write(folder / "data" / name)
        told = run("fetch-data", name)
        assert told.status == 0, told.err
    words = " ".join(told.out.split())
    assert f"The files are in {folder}/data/following: pilotid compare --people following" in words


@pytest.mark.numerical
@pytest.mark.long
def test_methods_are_compared_on_people(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PILOTID_DATA", str(tmp_path))
    (tmp_path / "yaw").mkdir()
    recording = simulate(replace(SINGLE_LOOP, runs=2), np.random.default_rng(1))
    path = tmp_path / "yaw" / "subj1_C1.mat"
    save_recording(recording, path)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    monkeypatch.setattr(named, "published", lambda _: {path.name: digest})
    monkeypatch.setitem(PEOPLE, "yaw", {**PEOPLE["yaw"], "model": "single"})
    told = run(
        *("compare", "--people", "yaw", "--method", "mle-white,fourier"),
        *("--workers", 1, "--out", tmp_path / "out"),
    )
    assert told.status == 0, told.err
    with (tmp_path / "out" / "left_out.csv").open() as stream:
        assert {(row["run"], row["method"]) for row in csv.DictReader(stream)} == {
            (run, method) for run in "12" for method in ("mle-white", "fourier")
        }
    assert run("compare", "--people", "yaw", "--scenario", "nominal").status == 2


@pytest.mark.parametrize("name", PEOPLE)
def test_measured_files_are_the_published(measured: Path, name: str) -> None:
    for file, digest in published(name).items():
        assert hashlib.sha256((measured / name / file).read_bytes()).hexdigest() == digest


# -------------------------------------------------------------------- fixed tasks

ROUNDING = 2.0**-23  # of numbers in single precision


def test_there_are_five_of_each_and_they_are_small() -> None:
    names = [name.rpartition("-")[0] for name in fixed_tasks()]
    assert {name: names.count(name) for name in names} == {
        **{"nominal": 5, "single": 5},
        **{"target-step": 5, "population-usual": 5},
    }
    assert sum(file.stat().st_size for file in TASKS.iterdir()) < 3e6
    with pytest.raises(InputError, match="unknown task 'nominal-5': choose from nominal-0"):
        load_task("nominal-5")


@pytest.mark.parametrize("name", fixed_tasks())
def test_the_simulation_makes_them_still(name: str) -> None:
    held = json.loads((TASKS / "truth.json").read_text())[name]
    task, origin = load_task(name), scenario_named(held["scenario"])
    recording = recording_of(origin, 1, held["replication"])
    assert list(task.recording.arrays) == list(recording.arrays)
    for signal, known in recording.arrays.items():
        stored = task.recording.arrays[signal]
        assert np.all(np.abs(stored - known) <= ROUNDING * np.abs(known) + 1e-12)
    facts = [(r.dt, r.run_in, r.units, r.lines) for r in (task.recording, recording)]
    assert facts[0] == facts[1]
    assert task.recording.controlled_element == recording.controlled_element
    known = truths_of(scenario_of(origin, 1, held["replication"]))
    assert [*held["truth"]] == list(task.model.keys)
    assert np.allclose(task.truth, [truth for *_, truth, _ in known], rtol=1e-12, atol=0.0)
    assert np.allclose(task.bound, [bound for *_, bound in known], rtol=1e-5, atol=0.0)


def test_a_method_finds_the_truth() -> None:
    for name in ("nominal-0", "single-1", "target-step-2"):
        task = load_task(name)
        estimate = pilotid.identify("mle", task.recording, task.model)
        assert np.all(np.abs(estimate.values - task.truth) < 4.0 * task.bound)
