"""What changed between two studies: known changes are found, and nothing else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import Run
from stores import finish

from pilotid.study.table import (
    OF_METHODS,
    OF_SCENARIOS,
    Entry,
    Fit,
    Store,
    find_changes,
    read_study,
)
from pilotid.support.types import InputError

REPLICATIONS = 25


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("first")
    finish(folder, REPLICATIONS).close()
    return folder


def same(result: Fit) -> Fit:
    return result


def changed(
    first: Path,
    folder: Path,
    edit: Callable[[Fit], Fit | None] = same,
    scenario: Callable[[Entry], Entry] = lambda entry: entry,
    seed: str = "1",
) -> Path:
    """The same study with its fits or scenarios edited; a fit that is None is not there."""
    folder.mkdir()
    with Store(first) as store, Store(folder, create=True) as other:
        other.describe({**store.about(), "seed": seed})
        other.enter(
            map(scenario, store.entries(OF_SCENARIOS).values()), store.entries(OF_METHODS).values()
        )
        for result in store.fits():
            edited = edit(result)
            if edited is not None:
                other.add(edited)
    return folder


def shifted(result: Fit) -> Fit:
    """Of mle on `first` and `any`: Kvis a bound higher, intervals of tlead that never hold."""
    if result.method != "mle" or result.scenario == "second":
        return result
    rows = []
    for key, unit, truth, bound, value, error, low, high in result.estimates:
        moved = value and value + 0.1 * (key == "Kvis")
        ends = (9.0, 9.1) if key == "tlead" else (low, high)
        rows.append((key, unit, truth, bound, moved, error, *ends))
    return replace(result, estimates=tuple(rows))


def test_the_same_study_has_not_changed(first: Path) -> None:
    found, left_out = find_changes(read_study(first), read_study(first))
    assert len(found) == 9 * 6
    assert np.all(found[["loss", "loss_lower", "loss_upper"]] == 1.0)
    assert left_out == []


def test_known_changes_are_found_and_no_others(first: Path, tmp_path: Path) -> None:
    other = changed(first, tmp_path / "b", shifted)
    found, _ = find_changes(read_study(first), read_study(other))
    rows = found[found.loss_lower > 1.0][["scenario", "method", "parameter"]]
    worse = set(rows.itertuples(index=False, name=None))
    assert {("first", "mle", "tlead"), ("first", "mle", "all"), ("any", "mle", "tlead")} <= worse
    assert set(found.method[found.loss != 1.0]) == {"mle"}
    assert not np.any(found.loss_upper < 1.0)


def test_recordings_of_both_and_bounds_of_the_first_count(first: Path, tmp_path: Path) -> None:
    def fewer(result: Fit) -> Fit | None:
        return None if result.replication < 5 else result

    def wider(result: Fit) -> Fit:
        rows = tuple((*row[:3], 1.0, *row[4:]) for row in result.estimates)
        return replace(result, estimates=rows)

    for edit, within in ((fewer, 0.0), (wider, 1e-6)):
        other = changed(first, tmp_path / edit.__name__, edit)
        found, _ = find_changes(read_study(first), read_study(other))
        assert found.loss.to_list() == pytest.approx([1.0] * len(found), rel=within, abs=0.0)


def test_other_seeds_are_refused(first: Path, tmp_path: Path) -> None:
    other = changed(first, tmp_path / "b", seed="2")
    with pytest.raises(InputError, match="has the seed 2 and other recordings than"):
        find_changes(read_study(first), read_study(other))


def test_scenarios_that_differ_are_left_out_and_named(first: Path, tmp_path: Path) -> None:
    def other(entry: Entry) -> Entry:
        return replace(entry, settings={"other": 1}) if entry.name == "second" else entry

    one, two = read_study(first), read_study(changed(first, tmp_path / "b", scenario=other))
    found, left_out = find_changes(one, two)
    assert set(found.scenario) == {"first", "any"}
    assert left_out == ["second is left out: its settings differ"]


def test_nothing_in_common_is_refused(first: Path, tmp_path: Path) -> None:
    def renamed(entry: Entry) -> Entry:
        return replace(entry, settings={"other": 1})

    other = changed(first, tmp_path / "b", scenario=renamed)
    with pytest.raises(InputError, match=r"lacks recordings or methods.*settings differ"):
        find_changes(read_study(first), read_study(other))


def test_the_command_prints_the_ratios(run: Run, first: Path, tmp_path: Path) -> None:
    other = changed(first, tmp_path / "b", shifted)
    done = run("compare-studies", first, other)
    assert (done.status, done.err) == (0, "")
    (line,) = (x for x in done.out.splitlines() if x.split()[:3] == ["first", "mle", "tlead"])
    assert float(line.split()[3]) > 1.0
    done = run("compare-studies", first, tmp_path / "nothing")
    assert (done.status, done.err.count("\n")) == (2, 1)
