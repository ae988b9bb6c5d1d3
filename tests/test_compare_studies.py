"""What changed between two studies: known changes are found, and nothing else."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from helpers import Run
from stores import finish

from pilotid.study.comparison import find_changes, read_study
from pilotid.study.store import Result, ScenarioEntry, Store
from pilotid.support.types import InputError

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
    found, left_out = find_changes(read_study(first), read_study(first))
    assert len(found) == 9 * 6
    assert {c.ratio for c in found if math.isfinite(c.ratio.value)} == {(1.0, 1.0, 1.0)}
    assert left_out == []


def test_known_changes_are_found_and_no_others(first: Path, tmp_path: Path) -> None:
    other = changed(first, tmp_path / "b", shifted)
    found, _ = find_changes(read_study(first), read_study(other))
    worse = {c[:3] for c in found if c.ratio.lower > 1.0}
    assert {("first", "mle", "tlead"), ("first", "mle", "all"), ("any", "mle", "tlead")} <= worse
    assert {c[1] for c in found if c.ratio.value != 1.0} == {"mle"}
    assert not any(c.ratio.upper < 1.0 for c in found)


def test_recordings_of_both_count(first: Path, tmp_path: Path) -> None:
    def fewer(result: Result) -> Result | None:
        return None if result.unit.replication < 5 else result

    found, _ = find_changes(read_study(first), read_study(changed(first, tmp_path / "b", fewer)))
    assert {c.ratio.value for c in found if math.isfinite(c.ratio.value)} == {1.0}


def test_other_seeds_are_refused(first: Path, tmp_path: Path) -> None:
    other = changed(first, tmp_path / "b", seed="2")
    with pytest.raises(InputError, match="has the seed 2 and other recordings than"):
        find_changes(read_study(first), read_study(other))


def test_scenarios_that_differ_are_left_out_and_named(first: Path, tmp_path: Path) -> None:
    def other(entry: ScenarioEntry) -> ScenarioEntry:
        return replace(entry, settings={"other": 1}) if entry.name == "second" else entry

    one, two = read_study(first), read_study(changed(first, tmp_path / "b", scenario=other))
    found, left_out = find_changes(one, two)
    assert {c.scenario for c in found} == {"first", "any"}
    assert left_out == ["second is left out: its settings differ"]


def test_bounds_of_the_first_study_count(first: Path, tmp_path: Path) -> None:
    def wider(entry: ScenarioEntry) -> ScenarioEntry:
        known = tuple(replace(p, bound=1.0) for p in entry.parameters)
        return replace(entry, parameters=known)

    other = changed(first, tmp_path / "b", scenario=wider)
    found, _ = find_changes(read_study(first), read_study(other))
    values = [c.ratio.value for c in found if math.isfinite(c.ratio.value)]
    assert values == pytest.approx([1.0] * len(values))


def test_nothing_in_common_is_refused(first: Path, tmp_path: Path) -> None:
    def renamed(entry: ScenarioEntry) -> ScenarioEntry:
        return replace(entry, settings={"other": 1})

    other = changed(first, tmp_path / "b", scenario=renamed)
    with pytest.raises(InputError, match=r"has no fits of the recordings.*settings differ"):
        find_changes(read_study(first), read_study(other))


def test_the_command_prints_the_ratios(run: Run, first: Path, tmp_path: Path) -> None:
    other = changed(first, tmp_path / "b", shifted)
    done = run("compare-studies", first, other)
    assert (done.status, done.err) == (0, "")
    (line,) = (x for x in done.out.splitlines() if x.split()[:3] == ["first", "mle", "tlead"])
    assert line.split()[-1] == "worse"
    done = run("compare-studies", first, tmp_path / "nothing")
    assert (done.status, done.err.count("\n")) == (2, 1)
