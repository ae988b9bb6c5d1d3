"""Independent tasks on local processes or on a Dask cluster, whatever happens to one of them.

A task whose process dies or that takes too long is given up, and costs the others nothing.
"""

from __future__ import annotations

import enum
import logging
import os
import signal
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, suppress
from itertools import chain, islice
from multiprocessing import spawn
from multiprocessing.context import SpawnContext, SpawnProcess
from threading import Lock
from typing import Any, TypeVar

from pilotid.naming.code import own_digest, reason
from pilotid.support.types import InputError

Task = TypeVar("Task")
Answer = TypeVar("Answer")

THREADS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
TIME_LIMIT = 600.0  # s
POLL_INTERVAL = 0.5  # s
QUIET_EXIT = 256  # in place of 0


class Loss(enum.Enum):
    """Why a task has no answer."""

    DIED = "its process died"
    TIMED_OUT = "it took longer than the time limit"


def run_tasks(
    function: Callable[[Task], Answer],
    tasks: Iterable[Task],
    given_up: Callable[[Task, Loss, str], Answer],
    workers: int | None = None,
    scheduler: str | None = None,
    seconds: float | None = TIME_LIMIT,
) -> Iterator[Answer]:
    """The answers to all tasks, in the order in which they come.

    Parameters
    ----------
    function
        What to do; importable, as tasks and answers cross process boundaries.
    tasks
        What to do it to; they are taken as they are needed.
    given_up
        Makes the answer to a task that has none, given why, also in words.
    workers
        Number of local processes; None for one for each processor.  All work is done in
        them, even by a single one, so that the numbers are the same for any number.
    scheduler
        Address of a Dask scheduler to use instead.
    seconds
        What a task on a local process may take; None for no limit.

    Raises
    ------
    InputError
        If processes cannot start, the scheduler does not answer, or a worker of it runs other code.
    """
    remaining = iter(tasks)
    first = list(islice(remaining, workers or processors()))
    if not first:
        return
    remaining, running = chain(first, remaining), dict[Future[Any], Task]()
    chosen = _Processes(len(first), seconds) if scheduler is None else _Cluster(scheduler)
    with closing(chosen) as executor:
        while True:
            for task in islice(remaining, max(0, executor.room - len(running))):
                running[executor.submit(function, task)] = task
            if not running:
                return
            for future in wait(running, POLL_INTERVAL, FIRST_COMPLETED).done:
                task = running.pop(future)
                try:
                    answer: Answer = future.result()
                except Exception as error:
                    answer = given_up(task, *executor.loss(error))
                yield answer


def processors() -> int:
    """Number of processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


# ------------------------------------------------------------------------- local processes


class _Processes:
    """Processes of this machine."""

    def __init__(self, workers: int, seconds: float | None) -> None:
        from pebble import ProcessPool

        self.room, self.seconds = 2 * workers, seconds
        self.pool = ProcessPool(workers, initializer=_set_up, context=_Context())

    def submit(self, function: Callable[[Task], Any], task: Task) -> Future[Any]:
        try:
            return self.pool.schedule(function, [task], timeout=self.seconds)
        except RuntimeError:  # the pool has given up
            raise _cannot_start() from None

    def loss(self, error: Exception) -> tuple[Loss, str]:
        from pebble import ProcessExpired

        if isinstance(error, TimeoutError):
            return Loss.TIMED_OUT, f"{self.seconds:g} s"
        if isinstance(error, ProcessExpired):
            return Loss.DIED, f"exit code {error.exitcode}"
        if isinstance(error, BrokenProcessPool):
            raise _cannot_start() from None
        raise error

    def close(self) -> None:
        self.pool.stop()  # type: ignore[no-untyped-call]
        self.pool.join()


def _cannot_start() -> InputError:
    return InputError(
        "processes for the fits end as they start, for the reason that they print; there may be "
        "too many of them for the memory (--workers)"
    )


_STARTING = Lock()
_PREPARE = spawn.get_preparation_data


class _Process(SpawnProcess):
    """A process of one thread in linear algebra, which never imports the user's script."""

    def start(self) -> None:
        """Start; numpy reads the numbers of threads as it is imported, before any code of ours.

        A script without a main guard would start itself again, and Python does not know joblib's
        way to start processes by itself.
        """
        with _STARTING:
            usual = dict(os.environ)
            os.environ.update(THREADS)
            spawn.get_preparation_data = _without_main
            try:
                super().start()
            finally:
                spawn.get_preparation_data = _PREPARE
                for name in THREADS:
                    os.environ.pop(name)
                os.environ.update(usual)

    @property
    def exitcode(self) -> int | None:
        """How it ended; never 0, by which a pool would take the task that ended it for done."""
        code = super().exitcode
        return QUIET_EXIT if code == 0 else code


class _Context(SpawnContext):
    Process = _Process


def _without_main(name: str) -> dict[str, object]:
    left_out = ("init_main_from_name", "init_main_from_path", "start_method")
    return {key: value for key, value in _PREPARE(name).items() if key not in left_out}


def _set_up() -> None:
    """Leave Ctrl-C to the process that started this one, and keep what methods print apart."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.dup2(2, 1)


# ------------------------------------------------------------------------------------ Dask


class _Cluster:
    """The workers of a Dask scheduler."""

    room = 1000  # enough to keep all busy

    def __init__(self, scheduler: str) -> None:
        try:
            from distributed import Client
        except ImportError:
            raise InputError(
                "--scheduler needs Dask: install pilotid[distributed], or leave the option out"
            ) from None
        make: Callable[..., Any] = Client
        self.place = f"--scheduler {scheduler}"
        logging.disable()  # what is wrong is said in a sentence; Dask would tell it in a hundred
        try:
            self.client = make(scheduler, timeout=10.0, set_as_default=False)
        except (OSError, ValueError) as error:
            raise InputError(
                f"{self.place}: no Dask scheduler answers ({error}); start one, `dask scheduler`"
            ) from error
        if not self.client.ncores():
            sys.stderr.write(f"pilotid: {self.place} has no workers; waiting for some\n")
        # Not as a context: on leaving that would wait for fits that nobody does.
        self.executor = self.client.get_executor(retries=0, pure=False)

    def submit(self, function: Callable[[Task], Any], task: Task) -> Future[Any]:
        future: Future[Any] = self.executor.submit(_same_code, own_digest(), function, task)
        return future

    def loss(self, error: Exception) -> tuple[Loss, str]:
        from distributed.scheduler import KilledWorker

        if isinstance(error, KilledWorker):
            return Loss.DIED, "again and again"
        if isinstance(error, CancelledError):  # that is how a lost connection ends them
            told = "the scheduler ended or cannot be reached any more; what is done is kept"
        else:
            told = f"a worker cannot do a fit ({reason(error)}); install the same pilotid there"
        raise InputError(f"{self.place}: {told}, and run the same command again") from error

    def close(self) -> None:
        with suppress(Exception):  # there may be nobody to take leave of
            self.client.close(timeout=2.0)
        logging.disable(logging.NOTSET)


def _same_code(digest: str, function: Callable[[Task], Answer], task: Task) -> Answer:
    """An answer of the code that asks."""
    if own_digest() != digest:
        raise InputError(f"it runs other code, digest {own_digest()}, here {digest}")
    return function(task)
