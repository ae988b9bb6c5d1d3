"""Independent tasks on local processes or on a Dask cluster, whatever happens to one of them.

A task whose process dies is run once more, since a death may be chance, and then given up; one
that takes too long is given up at once.  Neither costs the other tasks anything.
"""

from __future__ import annotations

import enum
import logging
import os
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache, partial
from itertools import chain, islice
from multiprocessing import parent_process, resource_tracker, spawn
from multiprocessing.context import SpawnContext, SpawnProcess
from threading import Lock, Thread
from typing import Any, TypeVar

from pilotid.naming.code import own_digest, reason
from pilotid.types import InputError

Task = TypeVar("Task")
Answer = TypeVar("Answer")

GIGABYTE = 2**30
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
QUIET_EXIT = 256  # in place of 0
TASKS_PER_WORKER = 4  # submitted at a time: enough to keep each busy
POLL_INTERVAL = 0.5  # s
WARN_WITHOUT_WORKERS = 5.0  # s
SCHEDULER_TIMEOUT = 10.0  # s


class Loss(enum.Enum):
    """Why a task has no answer."""

    DIED = "its process died"
    TIMED_OUT = "it took longer than the time limit"


@dataclass(frozen=True)
class Limits:
    """What a task on a local process may take.

    Attributes
    ----------
    seconds
        Time; None for no limit.
    gigabytes
        Address space of its process, where the system can limit it; None for no limit.
    """

    seconds: float | None = 600.0
    gigabytes: float | None = 4.0


USUAL_LIMITS = Limits()


def run_tasks(
    function: Callable[[Task], Answer],
    tasks: Iterable[Task],
    given_up: Callable[[Task, Loss, str], Answer],
    workers: int | None = None,
    scheduler: str | None = None,
    limits: Limits = USUAL_LIMITS,
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
    limits
        What a task on a local process may take.

    Raises
    ------
    InputError
        If processes cannot start, the scheduler does not answer, or a worker of it runs other code.
    """
    if scheduler is None:
        return _run_locally(function, tasks, given_up, workers or processors(), limits)
    return _run_on_dask(function, tasks, given_up, scheduler)


def processors() -> int:
    """Number of processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _run_all(
    tasks: Iterable[Task],
    submit: Callable[[Task], Future[Any]],
    capacity: Callable[[], int],
    answers_of: Callable[[Task, Future[Any]], Iterable[Answer]],
) -> Iterator[Answer]:
    """Submit tasks as there is room, and give their answers; a task without any runs again."""
    running: dict[Future[Any], Task] = {}
    remaining = iter(tasks)
    while True:
        for task in islice(remaining, max(0, capacity() - len(running))):
            running[submit(task)] = task
        if not running:
            return
        for future in wait(running, POLL_INTERVAL, FIRST_COMPLETED).done:
            task = running.pop(future)
            answers = list(answers_of(task, future))
            if not answers:
                running[submit(task)] = task
            yield from answers


# ------------------------------------------------------------------------- local processes


def _run_locally(
    function: Callable[[Task], Answer],
    tasks: Iterable[Task],
    given_up: Callable[[Task, Loss, str], Answer],
    workers: int,
    limits: Limits,
) -> Iterator[Answer]:
    from pebble import ProcessExpired, ProcessPool

    remaining = iter(tasks)
    first = list(islice(remaining, workers))
    if not first:
        return
    pool = ProcessPool(len(first), initializer=_set_up, context=_Context())
    work = partial(_run_limited, limits.gigabytes, function)
    died: list[Task] = []  # once

    def submit(task: Task) -> Future[Any]:
        try:
            return pool.schedule(work, [task], timeout=limits.seconds)
        except RuntimeError:  # the pool has given up
            raise _cannot_start() from None

    def answers_of(task: Task, future: Future[Any]) -> Iterator[Answer]:
        try:
            yield future.result()
        except TimeoutError:
            yield given_up(task, Loss.TIMED_OUT, f"{limits.seconds:g} s")
        except ProcessExpired as error:
            if any(task is each for each in died):
                code = error.exitcode or 0
                how = f"exit status {code % QUIET_EXIT}" if code >= 0 else f"signal {-code}"
                yield given_up(task, Loss.DIED, f"twice, with {how}")
            died.append(task)
        except BrokenProcessPool:
            raise _cannot_start() from None

    try:
        yield from _run_all(chain(first, remaining), submit, lambda: 2 * len(first), answers_of)
    finally:
        pool.stop()  # type: ignore[no-untyped-call]
        pool.join()


def _cannot_start() -> InputError:
    return InputError(
        "processes for the fits end as they start, for the reason that they print; there may be "
        "too many of them for the memory (--workers)"
    )


_STARTING = Lock()


class _Process(SpawnProcess):
    """A process of one thread in linear algebra, which never imports the user's script."""

    def start(self) -> None:
        with _STARTING, _starting():
            super().start()

    @property
    def exitcode(self) -> int | None:
        """How it ended; never 0, by which a pool would take the task that ended it for done."""
        code = super().exitcode
        return QUIET_EXIT if code == 0 else code

    def terminate(self) -> None:
        """End it at once, with all processes that it started."""
        if hasattr(os, "killpg") and self.pid:
            with suppress(OSError):
                os.killpg(self.pid, signal.SIGKILL)  # it leads a group, see `_set_up`
        self.kill()


class _Context(SpawnContext):
    Process = _Process


@contextmanager
def _starting() -> Iterator[None]:
    """What a new process takes from this one before any code of ours runs in it.

    Numpy reads the numbers of threads as it is imported.  A script without a main guard would
    start itself again, and joblib's way to start processes is one that Python does not know by
    itself.  Ctrl-C reaches all processes of a terminal, and those would print where they were.
    """
    environment, prepare = dict(os.environ), spawn.get_preparation_data
    left_out = ("init_main_from_name", "init_main_from_path", "start_method")
    blocked = None
    if hasattr(signal, "pthread_sigmask"):
        resource_tracker.ensure_running()  # when it has to start, it lets interruptions through
        blocked = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    os.environ.update(dict.fromkeys(THREADS, "1"))
    spawn.get_preparation_data = lambda name: {
        key: value for key, value in prepare(name).items() if key not in left_out
    }
    try:
        yield
    finally:
        spawn.get_preparation_data = prepare
        for name in THREADS:
            os.environ.pop(name)
        os.environ.update({name: environment[name] for name in THREADS if name in environment})
        if blocked is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, blocked)


def _set_up() -> None:
    """Make a process the leader of a group which ends when the one that started it does."""
    with suppress(OSError):
        os.dup2(2, 1)  # what a method prints is no part of a command's output
    if hasattr(os, "setpgrp"):
        os.setpgrp()
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = parent_process()
    assert parent is not None
    parent.join()
    if hasattr(os, "killpg"):
        os.killpg(0, signal.SIGKILL)
    os._exit(1)


def _run_limited(gigabytes: float | None, function: Callable[[Task], Answer], task: Task) -> Answer:
    """Do a task with no more memory than it may have, where the system can limit that."""
    own = os.getpid()
    try:
        return _limited(gigabytes, function, task)
    finally:
        if os.getpid() != own:  # a task that forked would answer twice
            os._exit(1)


def _limited(gigabytes: float | None, function: Callable[[Task], Answer], task: Task) -> Answer:
    try:
        import resource
    except ImportError:
        return function(task)
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    most = sys.maxsize if hard == resource.RLIM_INFINITY else hard
    try:
        with suppress(ValueError, OSError):
            wanted = min(int(gigabytes * GIGABYTE), most) if gigabytes else soft
            resource.setrlimit(resource.RLIMIT_AS, (wanted, hard))
        return function(task)
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


# ------------------------------------------------------------------------------------ Dask


def _run_on_dask(
    function: Callable[[Task], Answer],
    tasks: Iterable[Task],
    given_up: Callable[[Task, Loss, str], Answer],
    scheduler: str,
) -> Iterator[Answer]:
    try:
        from distributed.scheduler import KilledWorker
    except ImportError:
        raise InputError(
            "--scheduler needs Dask: install pilotid[distributed], or leave the option out"
        ) from None

    def answers_of(task: Task, future: Future[Any]) -> Iterator[Answer]:
        try:
            digest, answer = future.result()
        except KilledWorker:
            yield given_up(task, Loss.DIED, "again and again")
            return
        except CancelledError:  # that is how a lost connection ends them
            raise _scheduler_lost(scheduler) from None
        except Exception as error:  # a fit's own are answers
            raise InputError(
                f"--scheduler {scheduler}: a worker cannot do a fit ({reason(error)}); install "
                "the same version of pilotid there and start it again"
            ) from error
        if digest != _digest():
            raise InputError(
                f"--scheduler {scheduler}: a worker runs other code of pilotid (digest {digest}, "
                f"here {_digest()}); install the same version there and start it again"
            )
        yield answer

    looked, found = -POLL_INTERVAL, 0

    def capacity() -> int:
        nonlocal looked, found
        if time.monotonic() - looked >= POLL_INTERVAL:
            found = _count_workers(client, scheduler)
            looked = time.monotonic()
        return TASKS_PER_WORKER * found

    with _dask_client(scheduler) as client:
        # Not as a context: on leaving that would wait for fits that nobody does.
        executor = client.get_executor(retries=0, pure=False)
        yield from _run_all(
            tasks,
            lambda task: executor.submit(_signed, function, task),
            capacity,
            answers_of,
        )


def _signed(function: Callable[[Task], Answer], task: Task) -> tuple[str, Answer]:
    """An answer with the digest of the code that it is from."""
    return _digest(), function(task)


@cache
def _digest() -> str:
    return own_digest()


@contextmanager
def _dask_client(scheduler: str) -> Iterator[Any]:
    """A connection to a scheduler, which is left at once whatever happens."""
    from distributed import Client

    make: Callable[..., Any] = Client
    before = logging.root.manager.disable
    logging.disable()  # what is wrong is said in a sentence; Dask would tell it in a hundred lines
    try:
        try:
            client = make(scheduler, timeout="10s", set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            raise InputError(
                f"--scheduler {scheduler}: no Dask scheduler answers there ({error}); start one "
                "with `dask scheduler`, and name its address"
            ) from error
        try:
            yield client
        finally:
            with suppress(Exception):  # there may be nobody to take leave of
                client.close(timeout=2.0)
    finally:
        logging.disable(before)


def _count_workers(client: Any, scheduler: str) -> int:
    """The number of workers, once there are any."""
    start = told = time.monotonic()
    while True:
        try:
            found = client.sync(
                client.scheduler.ncores, workers=None, callback_timeout=SCHEDULER_TIMEOUT
            )
        except (OSError, TimeoutError, AttributeError):  # the last once the client has given up
            raise _scheduler_lost(scheduler) from None
        if found:
            return len(found)
        if told == start and time.monotonic() - start > WARN_WITHOUT_WORKERS:
            told = time.monotonic()
            sys.stderr.write(
                f"pilotid: the scheduler {scheduler} has no workers; waiting for some "
                f"(`dask worker {scheduler}` starts one)\n"
            )
        time.sleep(POLL_INTERVAL)


def _scheduler_lost(scheduler: str) -> InputError:
    return InputError(
        f"--scheduler {scheduler}: the scheduler ended or cannot be reached any more; what is "
        "done is kept, and the same command resumes once one runs"
    )
