"""A study gives the same numbers however it is run, stopped and started again."""

from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pilotid.datasets import scenario_named
from pilotid.estimates.estimate import Outcome
from pilotid.study.store import STORE, Store, Unit
from pilotid.study.study import Study, _started, entry_of, remaining_seconds, run_unit
from pilotid.study.summary import groups_of, summaries_of, write_tables
from pilotid.types import InputError

STUDY = Study(("single", "starts"), ("mle-white", "fourier"), 3, 5)


def run(folder: Path, study: Study = STUDY, workers: int = 2) -> bytes:
    """The summary of a study run to its end."""
    folder.mkdir(exist_ok=True)
    with Store(folder, create=True) as store:
        for _ in study.run(store, study.enter(store), workers):
            pass
        groups = groups_of(store)
        write_tables(folder, groups, summaries_of(groups))
    return (folder / "summary.csv").read_bytes()


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("study")
    run(folder)
    return folder


def test_one_process_and_two_give_the_same_bytes(finished: Path, tmp_path: Path) -> None:
    assert run(tmp_path, workers=1) == (finished / "summary.csv").read_bytes()


def test_a_study_that_grows_is_the_one_that_was_large_at_once(
    finished: Path, tmp_path: Path
) -> None:
    run(tmp_path, replace(STUDY, scenarios=("starts",), methods=("fourier",), replications=2))
    assert run(tmp_path) == (finished / "summary.csv").read_bytes()


def test_a_finished_study_has_nothing_left_to_do(finished: Path) -> None:
    with Store(finished) as store:
        assert STUDY.enter(store) == []
        assert remaining_seconds(store, [], 2) == 0.0
        units = [Unit("single", "fourier", 9)] * 10
        one = remaining_seconds(store, units, 1)
        assert one > 0.0
        assert remaining_seconds(store, units, 2) == pytest.approx(one / 2.0)


@pytest.mark.parametrize(
    ("change", "word"),
    [("UPDATE about SET value = 'x' WHERE key = 'code'", "code"),
     ("UPDATE about SET value = '6' WHERE key = 'seed'", "seed"),
     ("UPDATE methods SET label = 'Fourier(neighbours=3)' WHERE name = 'fourier'", "fourier"),
     ("UPDATE scenarios SET details = 'x' WHERE name = 'single'", "single")],
)  # fmt: skip
def test_results_of_other_code_or_settings_are_not_mixed(
    tmp_path: Path, change: str, word: str
) -> None:
    with Store(tmp_path, create=True) as store:
        STUDY.enter(store)
    base = sqlite3.connect(tmp_path / STORE)
    base.execute(change)
    base.commit()
    base.close()
    with Store(tmp_path) as store:
        with pytest.raises(InputError, match=rf"other code or settings \(different: {word}\)"):
            STUDY.enter(store)
        assert len(STUDY.enter(store, mix=True)) == 12
        assert word in store.about()["mixed"]


def test_a_replication_has_its_own_recording_and_start_and_every_method_the_same() -> None:
    nominal, starts = scenario_named("single"), scenario_named("starts")
    assert _started(nominal, 1, 4) is nominal.model
    first, same, other = (_started(starts, 1, r).start for r in (0, 0, 1))
    np.testing.assert_array_equal(first, same)
    assert np.all(first != other)
    assert np.all(np.abs(first / starts.values - 1.0) <= 0.4)
    # All replications of `starts` are of one recording, whose optimum every start reaches.
    ends = [run_unit(1, Unit("starts", "mle", r)).estimates for r in range(3)]
    assert ends[1][2][1] == pytest.approx(ends[0][2][1], rel=1e-3)
    assert ends[2][2][1] == pytest.approx(ends[0][2][1], rel=1e-3)


def test_an_error_in_a_method_is_a_row(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(name: str) -> object:
        raise RuntimeError(f"no {name}")

    monkeypatch.setattr("pilotid.study.study.method_named", broken)
    result = run_unit(1, Unit("single", "mle-white", 0))
    assert (result.outcome, result.message) == (Outcome.CRASHED.slug, "RuntimeError: no mle-white")
    assert not result.usable


def test_groups_and_summaries_hold_the_store_s_numbers(finished: Path) -> None:
    with Store(finished) as store:
        groups = groups_of(store)
    assert [(g.scenario.name, g.method) for g in groups] == [
        ("single", "mle-white"),
        ("single", "fourier"),
        ("starts", "mle-white"),
        ("starts", "fourier"),
    ]
    group = groups[0]
    assert group.failures == 0
    values = group.numbers(2)[:, 0]
    summary = summaries_of(groups)[2]
    assert summary.parameter == "tdvis"
    assert summary.bias == pytest.approx(values.mean() - 0.39)
    assert summary.crlb == entry_of("single").parameters[2].bound
    assert np.isnan(summary.posterior_std)


#: As in a shell's foreground: what a background job starts ignores interruptions.
PROGRAM = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)
from pilotid.cli.main import main
main()
"""


def command(folder: Path, *more: str) -> list[str]:
    options = ["--scenario", "single", "--method", "mle-white,fourier", "--replications", "40"]
    return [sys.executable, "-c", PROGRAM, "compare", *options, "--out", str(folder), *more]


def fits_in(folder: Path) -> int:
    try:
        base = sqlite3.connect(f"file:{folder / STORE}?mode=ro", uri=True)
        try:
            return int(base.execute("SELECT count(*) FROM fits").fetchone()[0])
        finally:
            base.close()
    except sqlite3.Error:
        return 0


def wait_for(folder: Path, fits: int) -> int:
    for _ in range(600):
        held = fits_in(folder)
        if held >= fits:
            return held
        time.sleep(0.1)
    raise AssertionError("the study does not get going")


def children(pid: int) -> list[str]:
    """Processes that a process has started."""
    return Path(f"/proc/{pid}/task/{pid}/children").read_text().split()


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="there is no /proc")
def test_a_study_that_was_killed_goes_on_and_ends_as_if_nothing_had_been(tmp_path: Path) -> None:
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    process = subprocess.Popen(
        command(killed), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    wait_for(killed, 5)
    workers = children(process.pid)
    assert len(workers) >= 2
    process.send_signal(signal.SIGKILL)
    process.wait()
    for _ in range(100):
        if not any(Path(f"/proc/{pid}").exists() for pid in workers):
            break
        time.sleep(0.1)
    else:
        raise AssertionError("workers outlive the study")
    held = fits_in(killed)
    assert 5 <= held < 80
    again = subprocess.run(command(killed), capture_output=True, text=True)
    assert again.returncode == 0, again.stderr
    assert f"holds {held} of 80 fits already" in again.stdout
    assert subprocess.run(command(whole), capture_output=True).returncode == 0
    assert (killed / "summary.csv").read_bytes() == (whole / "summary.csv").read_bytes()


def test_an_interruption_is_a_sentence(tmp_path: Path) -> None:
    process = subprocess.Popen(
        command(tmp_path),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    wait_for(tmp_path, 3)
    os.killpg(process.pid, signal.SIGINT)  # as Ctrl-C does: the workers get it too
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 2
    assert errors.startswith("pilotid: stopped;")
    assert len(errors.splitlines()) == 1, errors


@pytest.fixture(scope="module")
def cluster() -> Iterator[object]:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None
    ) as running:
        yield running


@pytest.mark.filterwarnings("ignore")  # those of Dask are not ours
def test_dask_with_a_worker_killed_gives_the_same_bytes(cluster: object, tmp_path: Path) -> None:
    here = tmp_path / "here"
    study = Study(("single",), ("mle-white", "fourier"), 40, 1)
    run(here, study)
    there = tmp_path / "there"
    there.mkdir()
    workers = cluster.workers  # type: ignore[attr-defined]
    address = cluster.scheduler_address  # type: ignore[attr-defined]
    with Store(there, create=True) as store:
        results = study.run(store, study.enter(store), scheduler=address)
        for number, _ in enumerate(results):
            if number == 10:
                os.kill(next(iter(workers.values())).pid, signal.SIGKILL)
        groups = groups_of(store)
        write_tables(there, groups, summaries_of(groups))
    assert (there / "summary.csv").read_bytes() == (here / "summary.csv").read_bytes()


def test_a_scheduler_that_does_not_answer_is_a_sentence(tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    done = subprocess.run(
        command(tmp_path, "--scheduler", "tcp://127.0.0.1:1"), capture_output=True, text=True
    )
    assert done.returncode == 2
    assert "no Dask scheduler answers there" in done.stderr
    assert "Traceback" not in done.stderr
