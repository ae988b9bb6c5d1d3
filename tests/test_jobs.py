"""Processes that die lose nothing but, at worst, the task that kills them."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from multiprocessing import resource_tracker
from pathlib import Path

import pytest

from pilotid.support.jobs import Loss, run_tasks
from pilotid.support.types import InputError


def doubled(task: int) -> int:
    return 2 * task


def deadly(task: int) -> int:
    """Tasks 3 and 5 end whatever process runs them, 5 as STOP in Fortran does."""
    if task == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    if task == 5:
        os._exit(0)
    return 2 * task


def slow(task: int) -> int:
    """Task 3 takes for ever."""
    if task == 3:
        time.sleep(600.0)
    return 2 * task


def broken(task: int) -> int:
    raise LookupError(str(task))


def threads(_: int) -> str | None:
    return os.environ.get("OMP_NUM_THREADS")


def nested(task: int) -> tuple[list[int], str]:
    """Tasks on a process of this one, and how this one then starts others."""
    answers = list(run_tasks(doubled, [task], never, workers=1))
    return answers, multiprocessing.get_start_method()


def given_up(task: int, loss: Loss, why: str) -> int:
    assert loss is Loss.DIED
    assert why in ("exit code -9", "exit code 256")
    return -task


def never(task: object, loss: Loss, why: str) -> int:
    raise AssertionError((task, loss, why))


@pytest.mark.long
def test_processes_of_joblib_start_processes_too() -> None:
    """Their way to start processes is one that Python does not know by itself."""
    joblib = pytest.importorskip("joblib")
    answers = joblib.Parallel(n_jobs=2)(joblib.delayed(nested)(task) for task in (1, 2))
    assert answers == [([2], "loky"), ([4], "loky")]


def test_a_task_that_kills_its_process_is_given_up_and_the_others_are_done() -> None:
    answers = list(run_tasks(deadly, range(12), given_up, 2))
    assert sorted(answers) == sorted([-3, -5, *(2 * i for i in range(12) if i not in (3, 5))])


def test_a_task_that_takes_too_long_is_given_up_alone() -> None:
    def late(task: int, loss: Loss, why: str) -> int:
        assert (loss, why) == (Loss.TIMED_OUT, "1.5 s")
        return -task

    tasks = [0, 1, 2, 3, 4, 6, 7]
    answers = list(run_tasks(slow, tasks, late, 2, seconds=1.5))
    assert sorted(answers) == [-3, 0, 2, 4, 8, 12, 14]


def test_an_error_of_a_task_comes_out() -> None:
    with pytest.raises(LookupError, match="7"):
        list(run_tasks(broken, [7], never, 1))


def test_processes_have_one_thread_each_and_the_environment_is_left_as_it_was() -> None:
    before = os.environ.get("OMP_NUM_THREADS")
    assert list(run_tasks(threads, [0], never, 1)) == ["1"]
    assert os.environ.get("OMP_NUM_THREADS") == before


def test_processes_that_end_as_they_start_are_a_sentence(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    resource_tracker.ensure_running()  # a process of its own, which would end too
    (tmp_path / "sitecustomize.py").write_text("import os; os._exit(3)")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with pytest.raises(InputError, match="end as they start"):
        list(run_tasks(doubled, range(4), never, 2))
