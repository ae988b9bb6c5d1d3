"""The store: what was committed is there, once, and in order."""

from __future__ import annotations

import json
import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stores import finish

from pilotid.database import DamagedError
from pilotid.study.entries import (
    Draw,
    MethodEntry,
    ParameterTruth,
    Result,
    ScenarioEntry,
    Unit,
)
from pilotid.study.store import FORMAT, STORE, Store
from pilotid.types import InputError

NUMBERS = (("Kvis", 0.2, 0.1, 0.0, 0.4), ("tlead", 3.0, None, None, None))


def entry(name: str, position: int) -> ScenarioEntry:
    known = (ParameterTruth("Kvis", "", 0.17, 0.04), ParameterTruth("tlead", "s", 2.93, None))
    settings = {"class": "Scenario", "truth": [0.1, 1e-300], "remnant": {"level": 0.4}}
    return ScenarioEntry(name, position, "a scenario", "gain", settings, known, "kin", "c0de", "s")


def method(label: str, position: int) -> MethodEntry:
    return MethodEntry(label, position, {"class": "Mine", "memory": None}, "", f"f.py:{label}")


def filled(folder: Path) -> Store:
    store = Store(folder, create=True)
    for name, position in (("late", 2), ("early", 1)):
        store.add_scenario(entry(name, position))
    for name, position in (("second", 1), ("first", 0)):
        store.add_method(method(name, position))
    return store


def result(scenario: str, method: str, replication: int) -> Result:
    unit = Unit(scenario, method, replication)
    return Result(unit, "converged", "why", True, 80.5, 7, False, 0.25, NUMBERS)


def test_what_goes_in_comes_out_in_the_order_of_the_catalogues(tmp_path: Path) -> None:
    keys = [("late", "first", 0), ("early", "second", 1), ("early", "second", 0)]
    with filled(tmp_path) as store:
        for key in keys:
            store.add(result(*key))
        store.add(Result(Unit("early", "first", 0), "crashed", "why"))
    with Store(tmp_path) as store:
        found = list(store.results())
        assert [r.unit for r in found] == [
            Unit("early", "first", 0),
            Unit("early", "second", 0),
            Unit("early", "second", 1),
            Unit("late", "first", 0),
        ]
        assert found[0] == Result(Unit("early", "first", 0), "crashed", "why")
        assert found[1:] == [result(*key) for key in reversed(keys)]
        assert store.scenarios() == [entry("early", 1), entry("late", 2)]
        assert store.methods() == {"first": method("first", 0), "second": method("second", 1)}
        assert list(store.methods()) == ["first", "second"]
        assert store.done() == {r.unit: r.outcome for r in found}


def test_a_fit_is_kept_once(tmp_path: Path) -> None:
    with filled(tmp_path) as store:
        store.add(result("early", "first", 0))
        store.add(Result(Unit("early", "first", 0), "other"))
        (only,) = store.results()
        assert only.outcome == "converged"
        assert len(only.estimates) == 2


def test_what_is_committed_is_there_without_closing(tmp_path: Path) -> None:
    store = filled(tmp_path)
    store.add(result("early", "first", 0))
    with Store(tmp_path) as other:
        assert other.done() == {Unit("early", "first", 0): "converged"}
    store.close()


def test_facts_are_kept(tmp_path: Path) -> None:
    with filled(tmp_path) as store:
        store.describe({"seed": "1"})
        store.describe({"seed": "2", "code": "x"})
        assert store.about() == {"format": str(FORMAT), "seed": "2", "code": "x"}


def test_what_is_forgotten_is_gone_whole_and_can_come_again(tmp_path: Path) -> None:
    with filled(tmp_path) as store:
        store.add(result("early", "first", 0))
        store.add(Result(Unit("early", "first", 1), "died", estimates=NUMBERS))
        store.forget([Unit("early", "first", 1)])
        assert store.done() == {Unit("early", "first", 0): "converged"}
        store.add(result("early", "first", 1))  # its numbers are not there twice
        assert [len(r.estimates) for r in store.results()] == [2, 2]


def test_a_pilot_that_was_drawn_is_kept_once_for_all_methods(tmp_path: Path) -> None:
    truth = (ParameterTruth("b", "s", 0.1 + 0.2, None), ParameterTruth("a", "", 1e-300, 0.4))
    draw = Draw("own", truth, {"element": "K/s", "dt": 0.01})
    numbers = (("b", 0.2, 0.1, 0.0, 0.4), ("a", 3.0, None, None, None))
    whole = replace(result("any", "first", 7), estimates=numbers, excess=1e-3, draw=draw,
                    remarks="recording: u drifts | mind the gap")  # fmt: skip
    with filled(tmp_path) as store:
        store.add_scenario(replace(entry("any", 3), parameters=()))
        store.add(whole)
        store.add(Result(Unit("any", "second", 7), "died"))  # nobody can tell what it was of
        near = replace(truth[0], truth=0.3 * (1.0 + 1e-9))  # another processor's rounding
        store.add(replace(whole, unit=Unit("any", "second", 8)))
        store.add(replace(whole, unit=Unit("any", "first", 8),
                          draw=replace(draw, parameters=(near, truth[1]))))  # fmt: skip
        other = replace(draw, parameters=(replace(truth[0], truth=0.31), truth[1]))
        with pytest.raises(InputError, match=r"another pilot for replication 7 of any"):
            store.add(replace(whole, unit=Unit("any", "third", 7), draw=other))
    with Store(tmp_path) as store:
        found = list(store.results())
        assert found[0] == whole
        assert [r.unit for r in found] == [
            Unit("any", method, r) for method in ("first", "second") for r in (7, 8)
        ]
        assert all(r.draw == draw for r in found)
        assert store.draws() == {("any", 7): draw, ("any", 8): draw}
        assert [e.population for e in store.scenarios()] == [False, False, True]


def test_a_store_of_a_later_format_is_refused_by_its_number(tmp_path: Path) -> None:
    filled(tmp_path).close()
    with closing(sqlite3.connect(tmp_path / STORE)) as base:
        base.execute(f"PRAGMA user_version = {FORMAT + 1}")
    for create in (False, True):
        with pytest.raises(InputError, match=f"later version .*format {FORMAT + 1}"):
            Store(tmp_path, create=create)


def test_the_rows_of_a_store_of_an_earlier_format_are_read(tmp_path: Path) -> None:
    """The tables of formats 5 and 6 had a column for each number, and tables of parts."""
    finish(tmp_path, 2).close()
    with Store(tmp_path) as store:
        facts, whole = store.about(), list(store.results())
    with closing(sqlite3.connect(tmp_path / STORE)) as base:
        rows: dict[str, list[Any]] = {
            kind: [] for kind in ("scenarios", "methods", "draws", "fits", "estimates")
        }
        rows |= {"parameters": [], "estimates": [], "about": list(facts.items())}
        for kind, content in base.execute("SELECT kind, content FROM rows WHERE kind != 'about'"):
            row, parts = json.loads(content)
            rows[kind].append([*row, 0])
            rows["parameters"] += parts if kind == "scenarios" else []
            rows["estimates"] += [[*row[:3], *part] for part in parts] if kind == "fits" else []
        base.executescript("DROP TABLE rows; DROP TABLE counts; PRAGMA user_version = 0")
        for name, own in rows.items():
            columns = [f"c{i}" for i in range(len(own[0]))]
            columns = ["key", "value"] if name == "about" else columns
            base.execute(f"CREATE TABLE {name} ({', '.join(columns)})")
            marks = ", ".join("?" * len(columns))
            base.executemany(f"INSERT INTO {name} VALUES ({marks})", own)
        base.commit()
    with Store(tmp_path) as store:
        assert list(store.results()) == whole
        assert store.about() == facts
    with pytest.raises(InputError, match="earlier version"):
        Store(tmp_path, create=True)


@pytest.mark.parametrize(
    "statement",
    [
        "CREATE VIEW v AS WITH RECURSIVE c AS (SELECT 1 UNION ALL SELECT * FROM c) SELECT * FROM c",
        "CREATE TABLE t (a, CHECK (length(zeroblob(900000000)) > 0))",
        "CREATE TRIGGER t AFTER INSERT ON rows BEGIN DELETE FROM rows; END",
    ],
)
def test_a_store_that_computes_is_none(tmp_path: Path, statement: str) -> None:
    filled(tmp_path).close()
    with closing(sqlite3.connect(tmp_path / STORE)) as base:
        base.execute(statement)
    with pytest.raises(InputError, match="no store"):
        Store(tmp_path)


def test_numbers_are_found_among_the_settings() -> None:
    scenario = entry("early", 0)
    assert scenario.number("remnant.level") == 0.4
    for path in ("level", "remnant", "truth", "remnant.level.more", "class"):
        assert np.isnan(scenario.number(path))


def test_files_that_are_no_store_are_refused_in_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file; name a folder"):
        Store(tmp_path)
    (tmp_path / STORE).write_bytes(b"no database" * 100)
    for create in (False, True):
        with pytest.raises(DamagedError, match="--salvage"):
            Store(tmp_path, create=create)
