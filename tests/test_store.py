"""The store: what was committed is there, once, and in order."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pilotid.study.store import (
    Draw,
    MethodEntry,
    ParameterTruth,
    Result,
    ScenarioEntry,
    Store,
    Unit,
)
from pilotid.support.store import STORE, Rows
from pilotid.support.types import InputError

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
        assert store.about() == {"seed": "2", "code": "x"}


def test_what_is_forgotten_is_gone_whole_and_can_come_again(tmp_path: Path) -> None:
    with filled(tmp_path) as store:
        store.add(result("early", "first", 0))
        store.add(Result(Unit("early", "first", 1), "died", estimates=NUMBERS))
        store.forget([Unit("early", "first", 1)])
        assert store.done() == {Unit("early", "first", 0): "converged"}
        store.add(result("early", "first", 1))  # its numbers are not there twice
        assert [len(r.estimates) for r in store.results()] == [2, 2]


def test_a_pilot_that_was_drawn_is_kept_with_the_fit(tmp_path: Path) -> None:
    truth = (ParameterTruth("b", "s", 0.1 + 0.2, None), ParameterTruth("a", "", 1e-300, 0.4))
    draw = Draw("own", truth, {"element": "K/s", "dt": 0.01})
    numbers = (("b", 0.2, 0.1, 0.0, 0.4), ("a", 3.0, None, None, None))
    whole = replace(result("any", "first", 7), estimates=numbers, excess=1e-3, draw=draw,
                    remarks="recording: u drifts | mind the gap")  # fmt: skip
    with filled(tmp_path) as store:
        store.add_scenario(replace(entry("any", 3), parameters=()))
        store.add(whole)
    with Store(tmp_path) as store:
        found = list(store.results())
        assert found == [whole]
        assert [e.population for e in store.scenarios()] == [False, False, True]


def test_a_store_of_another_format_is_refused(tmp_path: Path) -> None:
    filled(tmp_path).close()
    with closing(sqlite3.connect(tmp_path / STORE)) as base:
        base.execute(f"PRAGMA user_version = {Store.format + 1}")
    for create in (False, True):
        with pytest.raises(InputError, match="another version"):
            Store(tmp_path, create=create)


def test_the_store_of_an_analysis_is_none_of_a_study(tmp_path: Path) -> None:
    Rows(tmp_path, create=True).close()
    for create in (False, True):
        with pytest.raises(InputError, match="no such store"):
            Store(tmp_path, create=create)


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
    with pytest.raises(InputError, match="no such store"):
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
        with pytest.raises(InputError, match=r"sqlite3 .*\.recover"):
            Store(tmp_path, create=create)


def test_numbers_that_are_not_known_are_kept(tmp_path: Path) -> None:
    with Rows(tmp_path, create=True) as rows:
        rows.put(("a", "b", 0), {"value": float("nan")})
    with Rows(tmp_path) as rows:
        held = rows.get(dict[str, float], ("a", "b", 0))
    assert held is not None
    assert np.isnan(held["value"])
