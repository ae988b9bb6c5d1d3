"""Running many independent tasks on several processes, whatever happens to one of them.

A process that dies takes its task with it, and with a pool all tasks that were under way.
They are run again, one at a time in a process of their own, so that the one at fault is
known: if that process dies too, the task is given up and the others go on.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from itertools import islice
from multiprocessing import get_context, parent_process
from threading import Thread
from typing import TypeVar

from pilotid.types import InputError

Task = TypeVar("Task")
Answer = TypeVar("Answer")

AHEAD = 4  # tasks waiting for each worker: enough to keep it busy, few enough to lose


def run_tasks(
    function: Callable[[Task], Answer],
    tasks: Iterable[Task],
    given_up: Callable[[Task, str], Answer],
    workers: int | None = None,
    scheduler: str | None = None,
) -> Iterator[Answer]:
    """The answers to all tasks, in the order in which they come.

    Parameters
    ----------
    function
        What to do; importable, as tasks and answers cross process boundaries.
    tasks
        What to do it to.
    given_up
        Makes the answer to a task that ended its process twice, given why.
    workers
        Number of local processes; None for one for each processor.  All work is done in
        them, even by a single one, so that the numbers are the same for any number.
    scheduler
        Address of a Dask scheduler to use instead.
    """
    if scheduler is None:
        yield from _locally(function, tasks, given_up, workers or processors())
    else:
        yield from _on_dask(function, tasks, given_up, scheduler)


def processors() -> int:
    """Number of processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _locally(
    function: Callable[[Task], Answer],
    tasks: Iterable[Task],
    given_up: Callable[[Task, str], Answer],
    workers: int,
) -> Iterator[Answer]:
    remaining = iter(tasks)
    suspects: list[Task] = []
    while True:
        with _pool(workers) as pool:
            suspects = yield from _drained(pool, function, remaining, AHEAD * workers)
        if not suspects:
            return
        for task in suspects:
            try:
                with _pool(1) as alone:
                    answer = alone.submit(function, task).result()
            except BrokenProcessPool:
                answer = given_up(task, "its process died twice")
            yield answer


def _drained(
    pool: Executor,
    function: Callable[[Task], Answer],
    remaining: Iterator[Task],
    ahead: int,
) -> Generator[Answer, None, list[Task]]:
    """Answers until all tasks are done or the pool breaks; returns what was lost then."""
    running: dict[Future[Answer], Task] = {}
    lost: list[Task] = []
    while True:
        if not lost:
            for task in islice(remaining, ahead - len(running)):
                try:
                    running[pool.submit(function, task)] = task
                except BrokenProcessPool:
                    lost.append(task)
        if not running:
            return lost
        done, _ = wait(running, return_when=FIRST_COMPLETED)
        for future in done:
            task = running.pop(future)
            try:
                yield future.result()
            except BrokenProcessPool:
                lost.append(task)


@contextmanager
def _pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """A pool of processes with one thread each in linear algebra.

    They read these variables when they import numpy, before any code of ours runs.
    """
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, "1"))
    pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_settle)
    try:
        yield pool
    finally:
        # After an interruption nobody waits for what is under way.
        pool.shutdown(cancel_futures=True)
        for name, value in before.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value


def _settle() -> None:
    """Leave interruptions to the process that started this one, and end when it is gone.

    Ctrl-C reaches all processes of a terminal; a worker without a parent would wait for ever.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    Thread(target=watch, daemon=True).start()


def _on_dask(
    function: Callable[[Task], Answer],
    tasks: Iterable[Task],
    given_up: Callable[[Task, str], Answer],
    scheduler: str,
) -> Iterator[Answer]:
    try:
        from distributed import Client
        from distributed.scheduler import KilledWorker
    except ImportError:
        raise InputError(
            "--scheduler needs Dask: install pilotid[distributed], or leave the option out"
        ) from None
    try:
        client = Client(scheduler, timeout="10s", set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError(
            f"--scheduler {scheduler}: no Dask scheduler answers there ({error}); start one with "
            "`dask scheduler`, and name its address"
        ) from error
    with client, client.get_executor(retries=0, pure=False) as executor:
        remaining = iter(tasks)
        running: dict[Future[Answer], Task] = {}
        while True:
            ahead = AHEAD * max(1, len(client.scheduler_info()["workers"]))
            for task in islice(remaining, max(0, ahead - len(running))):
                running[executor.submit(function, task)] = task
            if not running:
                return
            done, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                task = running.pop(future)
                try:
                    yield future.result()
                except KilledWorker:
                    yield given_up(task, "its worker died again and again")
