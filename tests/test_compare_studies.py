"""What changed between two studies: known changes are found, and nothing else."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from helpers import Run
from stores import finish

from pilotid.publishing.changes import COLUMNS, find_changes, read_study
from pilotid.study.entries import MethodEntry, Result, ScenarioEntry
from pilotid.study.store import STORE, Store
from pilotid.types import InputError

REPLICATIONS = 25


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("first")
    finish(folder, REPLICATIONS).close()
    return folder


def same(result: Result) -> Result:
    return result


def changed(
    first: Path,
    folder: Path,
    edit: Callable[[Result], Result | None] = same,
    scenario: Callable[[ScenarioEntry], ScenarioEntry] = lambda entry: entry,
    seed: str = "1",
) -> Path:
    """The same study with its fits or scenarios edited; a fit that is None is not there."""
    folder.mkdir()
    with Store(first) as store, Store(folder, create=True) as other:
        other.describe({**store.about(), "seed": seed})
        for entry in store.scenarios():
            other.add_scenario(scenario(entry))
        for method in store.methods().values():
            other.add_method(method)
        for result in store.results():
            edited = edit(result)
            if edited is not None:
                other.add(edited)
    return folder


def shifted(result: Result) -> Result:
    """Of mle on `first` and `any`: Kvis a bound higher, intervals of tlead that never hold."""
    if result.unit.method != "mle" or result.unit.scenario == "second":
        return result
    rows = []
    for key, value, error, low, high in result.estimates:
        assert value is not None
        value += 0.1 * (key == "Kvis")
        rows.append((key, value, error, *((9.0, 9.1) if key == "tlead" else (low, high))))
    return replace(result, estimates=tuple(rows))


def test_the_same_study_has_not_changed(first: Path) -> None:
    found = find_changes(read_study(first), read_study(first))
    assert found.words.startswith("Nothing changed: all ")
    assert found.fits == found.same == 9 * REPLICATIONS
    assert not found.changed
    assert not found.notes
    assert {c.score for c in found.all} == {"loss", "bias", "coverage", "failures", "time"}


def test_known_changes_are_found_and_no_others(first: Path, tmp_path: Path) -> None:
    other = changed(first, tmp_path / "b", shifted)
    found = find_changes(read_study(first), read_study(other))
    named = {(c.scenario, c.method, c.parameter, c.score) for c in found.changed}
    assert {key for key in named if key[3] == "bias"} == {
        ("first", "mle", "Kvis", "bias"),
        ("any", "mle", "Kvis", "bias"),
    }
    assert {(*key[:3],) for key in named if key[3] == "coverage"} == {
        ("first", "mle", "tlead"),
        ("any", "mle", "tlead"),
    }
    worse = {key[:3] for key in named if key[3] == "loss"}
    assert {("first", "mle", "tlead"), ("first", "mle", "all"), ("any", "mle", "tlead")} <= worse
    assert {method for _, method, _ in worse} == {"mle"}
    (bias,) = (c for c in found.all if (c.scenario, c.method, c.parameter, c.score)
               == ("first", "mle", "Kvis", "bias"))  # fmt: skip
    assert bias.change == pytest.approx(1.0)
    assert bias.change_se == pytest.approx(0.0, abs=1e-12)
    assert bias.better == "no"
    assert bias.verdict_first != bias.verdict_second
    assert found.words.startswith(f"{len(found.changed)} of {len(found.all)} ")


def test_failures_and_times(first: Path, tmp_path: Path) -> None:
    def edit(result: Result) -> Result:
        if result.unit.method == "arx" and result.unit.scenario == "second":
            return Result(result.unit, "crashed", "why")
        return replace(result, seconds=None if result.seconds is None else 3.0 * result.seconds)

    other = changed(first, tmp_path / "b", edit)
    found = find_changes(read_study(first), read_study(other))
    failures = [c for c in found.changed if c.score == "failures"]
    assert [(c.scenario, c.method) for c in failures] == [("second", "arx")]
    assert failures[0].second == 1.0
    times = [c for c in found.changed if c.score == "time"]
    assert len(times) == 8
    assert times[0].change == pytest.approx(3.0)
    lost = [c for c in found.changed if c.score == "loss" and c.parameter == "all"]
    assert [(c.scenario, c.method, c.better) for c in lost] == [
        ("second", "arx", "yes")
    ]  # it was sure and wrong


def test_other_seeds_are_not_paired(first: Path, tmp_path: Path) -> None:
    other = changed(first, tmp_path / "b", shifted, seed="2")
    found = find_changes(read_study(first), read_study(other))
    assert "Seeds differ (1, 2): recordings are not paired." in found.notes
    assert found.fits == 0
    assert ("first", "mle", "tlead", "coverage") in {
        (c.scenario, c.method, c.parameter, c.score) for c in found.changed
    }
    apart = next(c for c in found.all if (c.parameter, c.score) == ("Kvis", "bias"))
    paired = find_changes(read_study(first), read_study(changed(first, tmp_path / "c", shifted)))
    together = next(c for c in paired.all if (c.parameter, c.score) == ("Kvis", "bias"))
    assert apart.change_se > 2.0 * together.change_se


def test_scenarios_that_differ_are_left_out_and_named(first: Path, tmp_path: Path) -> None:
    def other_truth(entry: ScenarioEntry) -> ScenarioEntry:
        known = tuple(replace(p, truth=2.0 * p.truth) for p in entry.parameters)
        return replace(entry, parameters=known) if entry.name == "second" else entry

    def edit(result: Result) -> Result | None:
        return None if result.unit.method == "fourier" else result

    other = changed(first, tmp_path / "b", edit, other_truth)
    found = find_changes(read_study(first), read_study(other))
    assert {c.scenario for c in found.all} == {"first", "any"}
    assert "Left out, since they differ: second (another truth)." in found.notes
    assert "In the first study alone: fourier." in found.notes


def test_bounds_of_the_first_study_count(first: Path, tmp_path: Path) -> None:
    def wider(entry: ScenarioEntry) -> ScenarioEntry:
        known = tuple(replace(p, bound=1.0) for p in entry.parameters)
        return replace(entry, parameters=known)

    other = changed(first, tmp_path / "b", scenario=wider)
    found = find_changes(read_study(first), read_study(other))
    assert found.notes == ["Bounds differ in first, second: those of the first study count."]
    assert not found.changed


def test_nothing_in_common_is_refused(first: Path, tmp_path: Path) -> None:
    def renamed(entry: ScenarioEntry) -> ScenarioEntry:
        return replace(entry, settings={"other": 1})

    other = changed(first, tmp_path / "b", scenario=renamed)
    with pytest.raises(InputError, match=r"no scenario and method in common.*other settings"):
        find_changes(read_study(first), read_study(other))


def test_the_command_prints_what_changed_and_writes_all(
    run: Run, first: Path, tmp_path: Path
) -> None:
    other = changed(first, tmp_path / "b", shifted)
    table, plain = tmp_path / "all.csv", tmp_path / "all.json"
    done = run("compare-studies", first, other, "--csv", table, "--json", plain)
    assert (done.status, done.err) == (0, "")
    (line,) = (x for x in done.out.splitlines() if "Kvis" in x and "first" in x and "bias" in x)
    assert line.split()[-1] == "worse"
    rows = list(csv.reader(io.StringIO(table.read_text())))
    assert tuple(rows[0]) == COLUMNS
    held = json.loads(plain.read_text())
    assert len(rows) - 1 == len(held["comparisons"]) > 90
    assert held["first"]["seed"] == "1"
    printed = run("compare-studies", first, other, "--csv", "-")
    assert list(csv.reader(io.StringIO(printed.out))) == rows
    nothing = run("compare-studies", first, first)
    assert nothing.status == 0
    assert "Nothing changed: all" in nothing.out


def test_bad_input_is_a_sentence(run: Run, first: Path, tmp_path: Path) -> None:
    for arguments, words in (
        ((first, tmp_path / "nothing"), "there is no such file"),
        ((first, first, "--csv", tmp_path / "no" / "f.csv"), "there is no folder"),
        ((first, first, "--csv", "-", "--json", "-"), "would print both"),
    ):
        done = run("compare-studies", *arguments)
        assert done.status == 2
        assert words in done.err
        assert done.err.count("\n") == 1


def test_a_method_s_settings_may_have_changed(first: Path, tmp_path: Path) -> None:
    # The two versions that are compared have the same label.
    other = changed(first, tmp_path / "b")
    with Store(other, create=True) as store:
        assert (other / STORE).exists()
        store.add_method(MethodEntry("new", 9, {}))
    assert find_changes(read_study(first), read_study(other)).words.startswith("Nothing changed")
