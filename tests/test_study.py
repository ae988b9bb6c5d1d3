"""A study gives the same numbers however it is run, stopped and started again."""

from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import NOMINAL, PROGRAM, estimate_at, python, recording_of

from pilotid.datasets import scenario_named
from pilotid.estimate.warnings import LONGEST_TOLD, told
from pilotid.methods.fourier import Fourier
from pilotid.methods.mle import MLE
from pilotid.methods.mle_white import MLEWhite
from pilotid.study.run import run_task, started, truths_of
from pilotid.study.study import Study, method_entry, scenario_entry
from pilotid.study.table import OF_FITS, Fit, Store, frame_of, read_study
from pilotid.support.store import STORE
from pilotid.support.types import InputError

STUDY = Study(("single", "starts"), ("mle-white", "fourier"), 3, 5)


def run(folder: Path, study: Study = STUDY, workers: int = 2) -> bytes:
    """The summary of a study run to its end."""
    study.run_in(folder, workers).write(folder)
    return (folder / "summary.csv").read_bytes()


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("study")
    run(folder)
    return folder


def test_one_process_and_two_give_the_same_bytes(finished: Path, tmp_path: Path) -> None:
    assert run(tmp_path, workers=1) == (finished / "summary.csv").read_bytes()


FOURIER = method_entry(Fourier())
SINGLE = scenario_entry(scenario_named("single"))


@pytest.mark.parametrize(
    ("before", "word"),
    [
        (lambda store: store.describe({"code": "x"}), "code"),
        (lambda store: store.describe({"seed": "6"}), "seed"),
        (lambda store: store.enter([], [replace(FOURIER, settings={})]), "fourier"),
        (lambda store: store.enter([], [replace(FOURIER, code="x")]), "fourier"),
        (lambda store: store.enter([replace(SINGLE, settings={})]), "single"),
    ],
)
def test_results_of_other_code_or_settings_are_not_mixed(
    tmp_path: Path, before: Callable[[Store], None], word: str
) -> None:
    with Store(tmp_path, create=True) as store:
        before(store)
    words = rf"other code or settings \(different: {word}\)"
    with Store(tmp_path, create=True) as store, pytest.raises(InputError, match=words):
        STUDY.enter(store)


def test_a_replication_has_its_own_recording_and_start_and_every_method_the_same() -> None:
    nominal, starts = scenario_named("single"), scenario_named("starts")
    assert started(nominal, 1, 4) is nominal.model
    first, same, other = (started(starts, 1, r).start for r in (0, 0, 1))
    np.testing.assert_array_equal(first, same)
    assert np.all(first != other)
    assert np.all(np.abs(first / starts.values - 1.0) <= 0.4)
    # All replications of `starts` are of one recording, whose optimum every start reaches.
    tasks = Study("starts", "mle", 3, 1)
    ends = [run_task(task).estimates for task in tasks.tasks(tasks.keys)]
    assert ends[1][2][4] == pytest.approx(ends[0][2][4], rel=1e-3)
    assert ends[2][2][4] == pytest.approx(ends[0][2][4], rel=1e-3)


def test_a_label_of_one_s_own_names_a_method_and_moves_no_number() -> None:
    study = Study("single", ["short=bayes(effective=50)", "bayes(effective=50)"], 1)
    assert study.labels == ("short", "bayes(effective=50)")
    short, usual = (run_task(task) for task in study.tasks(study.keys))
    assert short.method == "short"
    assert short.estimates == usual.estimates


# ------------------------------------------------------------------------ objects, not names


@pytest.mark.parametrize(
    ("scenarios", "methods", "words"),
    [
        ("single", ["mle", MLE()], "two of the methods are called 'mle'"),
        (["single", "single"], "mle", "two of the scenarios are called 'single'"),
        (replace(scenario_named("single"), runs=2), "mle", "the name 'single' of another one"),
        (replace(scenario_named("single"), name="a b"), "mle", "must be of letters"),
        (replace(scenario_named("single"), name="own", truth=(1.0,)), "mle", "must be 5 numbers"),
        (3, "mle", "is no Scenario"),
        ("single", 3, "is no method"),
    ],
)
def test_what_cannot_be_compared_is_a_sentence(scenarios: Any, methods: Any, words: str) -> None:
    with pytest.raises(InputError) as refusal:
        Study(scenarios, methods)
    assert words in str(refusal.value)


def test_a_class_of_one_s_own_crosses_and_what_cannot_is_a_sentence() -> None:
    class Local(MLEWhite):
        """Nobody else can find it."""

        name = "local"

    study = Study("single", Local())
    assert run_task(next(study.tasks(study.keys))).outcome == "converged"
    object.__setattr__(study.methods[0], "candidates", (number for number in (3,)))
    with pytest.raises(InputError, match="cannot be pickled"):
        next(study.tasks(study.keys))


#: A study at the top of a script, without a guard, of a class that the script defines.
SCRIPT = """
import sys
from pathlib import Path
from pilotid.methods.mle_white import MLEWhite
from pilotid.study.study import Study

class Mine(MLEWhite):
    name = "mine"

print("once")
study = Study("single", [Mine(band=20.0)], 2).run_in(Path(sys.argv[1]), 2)
print(study.frame.method[0])
"""


def test_a_script_without_a_main_guard_runs_once(tmp_path: Path) -> None:
    file = tmp_path / "script.py"
    file.write_text(SCRIPT)
    done = python(file, tmp_path / "out", check=True)
    assert done.stdout.split() == ["once", "mine(band=20)"]
    assert done.stderr == ""


def test_what_failed_for_outside_reasons_is_tried_again_if_asked(tmp_path: Path) -> None:
    ends = ["converged", "died", "timed-out", "out-of-memory", "crashed", "singular", "died"]
    study = Study("single", "mle", 6)
    with Store(tmp_path, create=True) as store:
        study.enter(store)
        for replication, end in enumerate(ends):  # the last is not of this study
            store.add(Fit("single", "mle", replication, end))
        assert study.enter(store) == []
        pending = study.enter(store, retry=True)
        assert [number for *_, number in pending] == [1, 2, 3, 4]
        assert len(store.fits()) == 3


def test_a_comparison_holds_the_store_s_numbers(finished: Path) -> None:
    found = read_study(finished)
    assert list(dict.fromkeys(zip(found.frame.scenario, found.frame.method, strict=True))) == [
        ("single", "mle-white"),
        ("single", "fourier"),
        ("starts", "mle-white"),
        ("starts", "fourier"),
    ]
    row = found.scored("single", "mle-white").iloc[3]
    assert (row.parameter, row.failures) == ("tdvis", 0)
    values = found.cell("single", "mle-white").query("parameter == 'tdvis'").value
    assert row.bias == pytest.approx(values.mean() - 0.39)
    assert row.crlb == truths_of(scenario_named("single"))[2][3]
    assert np.isnan(row.posterior_std)


def test_what_a_recording_does_not_determine_is_marked() -> None:
    study = Study("disturbance-only", "mle", 1, 3)
    (task,) = study.tasks(study.keys)
    fit = run_task(task)
    frame = frame_of([fit, replace(fit, replication=1, estimates=(), undetermined=())])
    told = frame.set_index("parameter").determined
    assert not told["tlead"]  # its interval begins at the bound and is 300 times as long
    assert told["fnm"]
    assert not told[""]  # of a fit without numbers
    assert told.sum() == len(fit.estimates) - len(fit.undetermined)


def test_a_study_keeps_what_a_user_is_told() -> None:
    sound, fit = recording_of(NOMINAL), estimate_at(NOMINAL.model, NOMINAL.values, np.eye(7))
    assert told(sound, fit) == ""
    drifting = replace(sound, u=sound.u + 0.01 * sound.time)
    line = told(drifting, replace(fit, remarks=("mind the gap", "and the step")))
    assert line.startswith("recording: u drifts by")
    assert "take it out with --detrend | " in line
    assert line.endswith(" | mind the gap | and the step") or line.endswith(" ...")
    assert len(told(sound, replace(fit, remarks=("long " * 100,)))) == LONGEST_TOLD


@pytest.mark.numerical
def test_remarks_of_a_study_are_in_its_store(tmp_path: Path) -> None:
    Study(["nominal", "recorder-lost"], "mle", 1).run_in(tmp_path, workers=1)
    with Store(tmp_path) as store:
        kept = {fit.scenario: fit.remarks for fit in store.fits()}
    assert not kept["nominal"]
    assert "samples are lost or spiked" in kept["recorder-lost"]


#: Each fit lasts while a file lies beside it, so that no machine ends the study too soon.
UNHURRIED = """
import time
from pathlib import Path
from pilotid.methods.mle_white import MLEWhite

class Unhurried(MLEWhite):
    "Takes its time while it is told to."

    name = "unhurried"

    def fit(self, recording, model, rng):
        if Path(__file__).with_name("slowly").exists():
            time.sleep(1.0)
        return super().fit(recording, model, rng)
"""


def command(folder: Path, *more: str) -> list[str]:
    options = ["--scenario", "single", "--out", str(folder)]
    return [sys.executable, "-c", PROGRAM, "compare", *options, *more]


@pytest.fixture
def unhurried(tmp_path: Path) -> list[str]:
    """A study of 24 fits, half of which wait while there is a file `slowly` beside."""
    code = tmp_path / "unhurried.py"
    code.write_text(UNHURRIED)
    (tmp_path / "slowly").touch()
    return ["--method", f"mle-white,{code}:Unhurried", "--replications", "12"]


def fits_in(folder: Path) -> int:
    try:
        base = sqlite3.connect(f"file:{folder / STORE}?mode=ro", uri=True)
        try:
            return int(base.execute(f"SELECT count(*) FROM rows WHERE {OF_FITS}").fetchone()[0])
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


@pytest.mark.long
@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="there is no /proc")
def test_a_study_that_was_killed_goes_on_and_ends_as_if_nothing_had_been(
    tmp_path: Path, unhurried: list[str]
) -> None:
    killed = tmp_path / "killed"
    process = subprocess.Popen(
        command(killed, *unhurried), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
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
    assert 5 <= held < 24
    (tmp_path / "slowly").unlink()
    again = python(*command(killed, *unhurried)[1:])
    assert again.returncode == 0, again.stderr
    assert f"holds {held} of 24 fits already" in again.stdout
    methods = unhurried[1].split(",")
    whole = run(tmp_path / "whole", Study("single", methods, 12))
    assert (killed / "summary.csv").read_bytes() == whole


def test_an_interruption_is_a_sentence(tmp_path: Path, unhurried: list[str]) -> None:
    out = tmp_path / "out"
    process = subprocess.Popen(
        command(out, *unhurried),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # In a job in the background interruptions are ignored, and that is passed on.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    wait_for(out, 3)
    os.killpg(process.pid, signal.SIGINT)  # as Ctrl-C does: the workers get it too
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert errors.startswith("pilotid: stopped;")
    assert len(errors.splitlines()) == 1, errors


@pytest.mark.long
@pytest.mark.filterwarnings("ignore")  # those of Dask are not ours
def test_dask_with_a_worker_killed_gives_the_same_bytes(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    here, there = tmp_path / "here", tmp_path / "there"
    # Fits wait for a worker until the end: more are asked for only as answers are taken.
    study = Study(("single",), ("mle-white", "fourier"), 12, 1)
    run(here, study)
    there.mkdir()
    local = {"host": "127.0.0.1", "dashboard_address": None}
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, **local) as cluster,
        Store(there, create=True) as store,
    ):
        results = study.run(store, study.enter(store), scheduler=cluster.scheduler_address)
        for number, _ in enumerate(results):
            if number == 10:
                os.kill(next(iter(cluster.workers.values())).pid, signal.SIGKILL)
        store.comparison().write(there)
    assert (there / "summary.csv").read_bytes() == (here / "summary.csv").read_bytes()
