"""Published recordings of people: fetched once, whole, and as they were published."""

from __future__ import annotations

import hashlib
import re
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers import SINGLE_LOOP, Run

from pilotid.analysis.agreement import agreements
from pilotid.analysis.halves import (
    HalvesApart,
    fit_halves,
    halves_blocks,
    halves_of,
    halves_rows,
)
from pilotid.analysis.recordings import Part
from pilotid.analysis.rows import Row
from pilotid.datasets import people, simulate
from pilotid.datasets.people import PEOPLE, Published, fetch, published
from pilotid.document import Table
from pilotid.methods import method_named
from pilotid.recordings.files import save_recording
from pilotid.types import InputError

CONTENT = {"a.mat": b"first", "b.mat": b"second"}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where files are fetched to; yaw has two small ones."""
    monkeypatch.setenv("PILOTID_DATA", str(tmp_path / "data"))
    files = tuple(
        Published(name, len(content), hashlib.sha256(content).hexdigest())
        for name, content in CONTENT.items()
    )
    monkeypatch.setattr(people, "published", lambda: dict.fromkeys(PEOPLE, files))
    return tmp_path


def write(place: Path, **changed: bytes) -> Path:
    place.mkdir(parents=True, exist_ok=True)
    for name, content in CONTENT.items():
        (place / name).write_bytes(changed.get(name[0], content))
    return place


def test_the_table_has_every_experiment_and_no_file_twice() -> None:
    assert list(published()) == list(PEOPLE)
    for files in published().values():
        names = [file.name for file in files]
        assert len(set(names)) == len(names)
        assert all(re.fullmatch("[0-9a-f]{64}", file.digest) and file.size for file in files)


@pytest.mark.parametrize("below", ["", "yaw"])
def test_files_are_taken_from_a_folder_and_then_there(folder: Path, below: str) -> None:
    source = write(folder / "lab" / below)
    found = fetch("yaw", folder / "lab")
    assert found == folder / "data" / "yaw"
    assert {file.name: file.read_bytes() for file in found.iterdir()} == CONTENT
    for file in source.iterdir():
        file.unlink()
    assert fetch("yaw") == found


def test_other_files_than_the_published_are_refused(folder: Path) -> None:
    source = write(folder / "lab", b=b"seconD")
    with pytest.raises(InputError, match=r"b\.mat: is not the file that was published"):
        fetch("yaw", source)
    (source / "b.mat").unlink()
    with pytest.raises(InputError, match="there is no such file"):
        fetch("yaw", source)
    with pytest.raises(InputError, match="choose from yaw, adaptation, preview, following"):
        fetch("nobody")


def test_what_is_not_there_is_downloaded_or_a_sentence_says_how(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pooch", None)
    with pytest.raises(InputError, match=r"pip install pooch.*--from FOLDER"):
        fetch("yaw")
    with pytest.raises(InputError, match=r"no address.*doi 10\.2514/1\.G001592.*--from FOLDER"):
        fetch("adaptation")
    asked: list[tuple[Any, ...]] = []
    pooch = SimpleNamespace(retrieve=lambda *arguments: asked.append(arguments))
    monkeypatch.setitem(sys.modules, "pooch", pooch)
    write(folder / "data" / "yaw", b=b"half")
    place = fetch("yaw")
    digest = hashlib.sha256(CONTENT["b.mat"]).hexdigest()
    assert asked == [(f"{PEOPLE['yaw'].address}b.mat", f"sha256:{digest}", "b.mat", place)]

    def fail(*_: object) -> None:
        raise ValueError("the hash differs")

    pooch.retrieve = fail
    with pytest.raises(InputError, match=r"b\.mat cannot be downloaded \(the hash differs\)"):
        fetch("yaw")


def test_command(folder: Path, run: Run) -> None:
    told = run("fetch-data")
    assert told.status == 0
    assert [name for name in PEOPLE if f"\n{name}\n" in f"\n{told.out}"] == list(PEOPLE)
    assert run("fetch-data", "preview", "--from", folder / "nowhere").status == 2
    for name in PEOPLE:
        told = run("fetch-data", name, "--from", write(folder / "lab"))
        assert told.status == 0, told.err
    told = run("fetch-data", "following")
    words = " ".join(told.out.split())
    files = f"{folder}/data/following/data.mat::sigma={{11,13,17,21,25,29}}"
    assert f"{files} --pattern 'sigma={{condition}}'" in words


def test_distances_from_consistent_estimates() -> None:
    def row(method: str, parameter: str, value: float, error: float, run: int | None = None) -> Row:
        return Row("F", (), run, "single", method, parameter, "", value, error, 0.0, 0.0, "", True)

    rows = [
        *(row("fourier", "a", 1.0, 0.5), row("fourier", "b", 2.0, 0.1)),
        *(row("mle", "a", 1.1, 0.2), row("mle", "b", 2.06, 0.05)),  # apart by .2 and .6 errors
        *(row("mle-white", "a", 2.0, 0.1), row("mle-white", "b", 1.6, 0.05)),  # by 2 and 4
        *(row("mle", "a", 9.0, 0.1, 1), replace(row("arx", "a", 9.0, 0.1), usable=False)),
        row("mle", "only here", 9.0, 0.1),
    ]
    found = [(own.method, own.reference, own.estimates, own.distance) for own in agreements(rows)]
    assert found == [
        ("mle", "fourier", 2, pytest.approx(0.4 / 0.6745)),
        ("mle-white", "fourier", 2, pytest.approx(3.0 / 0.6745)),
    ]


def test_differences_of_halves_by_hand() -> None:
    def line(file: str, parameter: str, *numbers: float) -> HalvesApart:
        part = Part((Path(file),), (("subject", file), ("condition", "C1")))
        return HalvesApart(part, "single", "mle", parameter, numbers)  # type: ignore[arg-type]

    rows = [
        line("1", "a", 1.0, 0.3, 1.5, 0.4),  # apart by 1 error
        line("1", "b", 2.0, 0.3, 1.0, 0.4),  # by 2
        line("1", "c", 9.0, 3.0, 9.0, 4.0),  # by none
        line("2", "a", 6.5, 0.6, 3.5, 0.8),  # by 3
    ]
    assert [row.apart for row in rows] == pytest.approx([-1.0, 2.0, 0.0, 3.0])
    _, table = halves_blocks(rows)
    assert isinstance(table, Table)
    ((*head, mean),) = table.items
    assert head == ["C1", "single", "mle", 2]
    assert mean == pytest.approx((2.0 / 0.6745, 1.0 / 0.6745))  # of 1 and 3
    assert len(halves_blocks([])) == 1


def test_halves_are_of_runs_or_of_the_window() -> None:
    runs = simulate(replace(SINGLE_LOOP, runs=5), np.random.default_rng(1))
    first, second = halves_of(runs)
    assert np.array_equal(first.u, runs.u[:2])
    assert np.array_equal(second.u, runs.u[3:])
    one = simulate(SINGLE_LOOP, np.random.default_rng(1))
    first, second = halves_of(one)
    assert first.duration == second.duration == pytest.approx(one.duration / 2)
    assert np.array_equal(second.window(second.u)[:, -9:], one.u[:, -9:])
    assert halves_of(one.cut(0.0, 19.0)) == ()


@pytest.mark.numerical
def test_halves_of_a_simulation_differ_by_what_is_claimed() -> None:
    runs = simulate(replace(SINGLE_LOOP, runs=4), np.random.default_rng(2))
    found = fit_halves(runs, SINGLE_LOOP.model, {"mle": method_named("mle")}, 0)
    assert [key for _, key, *_ in found] == list(SINGLE_LOOP.model.keys)
    rows = list(halves_rows(Part((Path("F"),), ()), {"model": "single", "halves": found}))
    assert max(abs(row.apart) for row in rows) < 4.5


@pytest.mark.numerical
@pytest.mark.long
def test_methods_are_compared_on_people(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PILOTID_DATA", str(tmp_path))
    files = []
    (tmp_path / "yaw").mkdir()
    for subject in (1,):
        recording = simulate(replace(SINGLE_LOOP, runs=2), np.random.default_rng(subject))
        path = tmp_path / "yaw" / f"subj{subject}_C1.mat"
        save_recording(recording, path)
        content = path.read_bytes()
        digest = hashlib.sha256(content).hexdigest()
        files.append(Published(path.name, len(content), digest))
    monkeypatch.setattr(people, "published", lambda: dict.fromkeys(PEOPLE, tuple(files)))
    monkeypatch.setitem(PEOPLE, "yaw", replace(PEOPLE["yaw"], model="single"))
    told = run(
        *("compare", "--people", "yaw", "--method", "mle-white,fourier"),
        *("--workers", 1, "--out", tmp_path / "out"),
    )
    assert told.status == 0, told.err
    page = (tmp_path / "out" / "people.html").read_text()
    for text in (
        "pilots 1, 3, 4 and 6",
        "Runs left out",
        "Differences from consistent estimates",
        "Halves of recordings",
    ):
        assert text in page
    assert run("compare", "--people", "yaw", "--scenario", "nominal").status == 2


@pytest.mark.parametrize("name", PEOPLE)
def test_measured_files_are_the_published(
    measured: Path, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PILOTID_DATA", str(tmp_path))
    assert len([*fetch(name, measured).iterdir()]) == len(published()[name])
