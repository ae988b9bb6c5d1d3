"""The store: what was committed is there, once, and in order, whatever becomes of its file."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from helpers import Answer, Run
from stores import finish

from pilotid.study.table import OF_METHODS, OF_SCENARIOS, Entry, Fit, Store
from pilotid.support.store import STORE, Rows
from pilotid.support.types import InputError

NUMBERS = (
    ("Kvis", "", 0.17, 0.04, 0.2, 0.1, 0.0, 0.4),
    ("tlead", "s", 0.1 + 0.2, None, 3.0, None, None, 1e-300),
)


def entry(name: str, position: int) -> Entry:
    settings = {"class": "Scenario", "truth": [0.1, 1e-300], "remnant": {"level": 0.4}}
    return Entry(name, position, settings, "c0de", "s", "a scenario", "gain", "kin", False, 0.1)


def method(label: str, position: int) -> Entry:
    return Entry(label, position, {"class": "Mine", "memory": None}, "", f"f.py:{label}")


def filled(folder: Path) -> Store:
    store = Store(folder, create=True)
    scenarios = [entry("late", 2), entry("early", 1)]
    store.enter(scenarios, [method("second", 1), method("first", 0)])
    return store


def result(scenario: str, method: str, replication: int) -> Fit:
    key, ended = (scenario, method, replication), ("converged", "why", True, 80.5, 7, 0.25)
    last = {"excess": 1e-3, "remarks": "recording: u drifts | mind the gap", "model": "own"}
    facts = {"element": "K/s", "dt": 0.01}
    return Fit(*key, *ended, True, facts=facts, estimates=NUMBERS, **last)


def test_what_goes_in_comes_out_in_the_order_of_the_catalogues(tmp_path: Path) -> None:
    keys = [("late", "first", 0), ("early", "second", 1), ("early", "second", 0)]
    with filled(tmp_path) as store:
        for key in keys:
            store.add(result(*key))
        store.add(Fit("early", "first", 0, "crashed", "why"))
    with Store(tmp_path) as store:
        found = {fit.key: fit for fit in store.fits()}
        assert found == {
            ("early", "first", 0): Fit("early", "first", 0, "crashed", "why"),
            **{key: result(*key) for key in keys},
        }
        assert list(store.entries(OF_SCENARIOS).values()) == [entry("early", 1), entry("late", 2)]
        assert list(store.entries(OF_METHODS).values()) == [
            method("first", 0),
            method("second", 1),
        ]
        frame = store.comparison().frame
        fits = zip(frame.scenario, frame.method, frame.replication, strict=True)
        assert list(dict.fromkeys(fits)) == [
            ("early", "first", 0),
            ("early", "second", 0),
            ("early", "second", 1),
            ("late", "first", 0),
        ]


def test_a_fit_is_kept_once(tmp_path: Path) -> None:
    with filled(tmp_path) as store:
        store.add(result("early", "first", 0))
        store.add(Fit("early", "first", 0, "other"))
        (only,) = store.fits()
        assert only == result("early", "first", 0)


def test_what_is_committed_is_there_without_closing(tmp_path: Path) -> None:
    store = filled(tmp_path)
    store.add(result("early", "first", 0))
    with Store(tmp_path) as other:
        assert [fit.key for fit in other.fits()] == [("early", "first", 0)]
    store.close()


def test_a_store_of_another_format_or_command_is_refused(tmp_path: Path) -> None:
    filled(tmp_path).close()
    with closing(sqlite3.connect(tmp_path / STORE)) as base:
        base.execute(f"PRAGMA user_version = {Store.format + 1}")
    for create in (False, True):
        with pytest.raises(InputError, match="another version"):
            Store(tmp_path, create=create)
    (other := tmp_path / "other").mkdir()
    Rows(other, create=True).close()
    for create in (False, True):
        with pytest.raises(InputError, match="of another command"):
            Store(other, create=create)


def test_files_that_are_no_store_are_refused_in_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file; name a folder"):
        Store(tmp_path)
    (tmp_path / STORE).write_bytes(b"no database" * 100)
    for create in (False, True):
        with pytest.raises(InputError, match="cannot be read or written"):
            Store(tmp_path, create=create)


def test_numbers_that_are_not_known_are_kept(tmp_path: Path) -> None:
    with Rows(tmp_path, create=True) as rows:
        rows.put(("a", "b", 0), {"value": float("nan")})
    with Rows(tmp_path) as rows:
        held = rows.get(dict[str, float], ("a", "b", 0))
    assert np.isnan(held["value"])


# ---------------------------------------------------------------------- changed bytes


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("finished")
    finish(folder).close()
    return folder


def copied(finished: Path, folder: Path) -> Path:
    folder.mkdir(exist_ok=True)
    shutil.copy(finished / STORE, folder / STORE)
    return folder


def refused(answer: Answer, *words: str) -> None:
    """One sentence on standard error that has these words, and status 2."""
    assert answer.status == 2, answer
    assert len(answer.err.splitlines()) == 1, answer.err
    for word in words:
        assert word in answer.err


@pytest.mark.parametrize("command", ["report", "compare"])
def test_commands_refuse_a_damaged_store_and_leave_it_as_it_is(
    finished: Path, tmp_path: Path, run: Run, command: str
) -> None:
    folder = copied(finished, tmp_path / "study")
    content = bytearray((folder / STORE).read_bytes())
    content[-9000:] = bytes(9000)
    (folder / STORE).write_bytes(content)
    options = ("report", folder) if command == "report" else ("compare", "--out", folder)
    refused(run(*options), STORE, "cannot be read or written")
    assert (folder / STORE).read_bytes() == content


@pytest.mark.parametrize("content", ["", "{}", '{"scenario": "first"}'])
def test_rows_that_are_none_are_refused(
    finished: Path, tmp_path: Path, run: Run, content: str
) -> None:
    folder = copied(finished, tmp_path / "stranger")
    with closing(sqlite3.connect(folder / STORE)) as base:
        base.execute("UPDATE rows SET content=? WHERE replication = 3", (content,))
        base.commit()
    refused(run("report", folder), STORE)
