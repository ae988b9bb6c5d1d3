"""Independent tasks on local processes or on a Dask cluster, whatever happens to one of them.

A task whose process dies or that takes too long is given up, and costs the others nothing.
"""

from __future__ import annotations

import enum
import logging
import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from functools import cache, partial
from importlib import import_module
from importlib.metadata import version
from itertools import islice
from multiprocessing import spawn
from multiprocessing.context import SpawnContext, SpawnProcess
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from pilotid.support.naming import LIBRARIES, digest_of
from pilotid.support.types import InputError, reason

Task = TypeVar("Task")
Answer = TypeVar("Answer")

THREADS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
TIME_LIMIT = 600.0  # s


class Loss(enum.Enum):
    """Why a task has no answer."""

    DIED = "its process died"
    TIMED_OUT = "it took longer than the time limit"


class Workers(NamedTuple):
    """Processes that do tasks.

    Attributes
    ----------
    room
        How many tasks to hand over at once.
    submit
        Hands over a function, what it may take on a local process [s], and its task.
    died
        The error of a task whose process died.
    active
        Whether answers still come.
    """

    room: int
    submit: Callable[..., Future[Any]]
    died: type[Exception]
    active: Callable[[], bool] = lambda: True


def run_tasks(
    function: Callable[[Task], Answer],
    tasks: Sequence[Task],
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
        What to do it to.
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
    if not tasks:
        return
    available = getattr(os, "sched_getaffinity", lambda _: range(os.cpu_count() or 1))
    count = min(workers or len(available(0)), len(tasks))
    remaining, running = iter(tasks), dict[Future[Any], Task]()
    with _processes(count) if scheduler is None else _cluster(scheduler) as pool:
        while True:
            for task in islice(remaining, pool.room - len(running)):
                running[pool.submit(function, seconds, task)] = task
            if not running:
                return
            done = wait(running, 0.5, FIRST_COMPLETED).done
            if not (done or pool.active()):  # a pool that gives up may leave tasks without an end
                raise BrokenProcessPool
            for future in done:
                task = running.pop(future)
                try:
                    answer: Answer = future.result()
                except TimeoutError:
                    answer = given_up(task, Loss.TIMED_OUT, f"{seconds or 0:g} s")
                except pool.died as error:
                    code = getattr(error, "exitcode", "unknown")
                    answer = given_up(task, Loss.DIED, f"exit code {code}")
                yield answer


@cache
def own_digest() -> str:
    """A short digest of this package's source."""
    packages = map(import_module, ("pilotid", "pilotid.methods", "pilotid.datasets"))
    folders = [folder for package in packages for folder in package.__path__]
    return digest_of(file.read_bytes() for f in folders for file in sorted(Path(f).rglob("*.py")))


def about_this(seed: int) -> dict[str, str]:
    """Code, versions and seed: what two results must share to be compared."""
    return {
        "seed": str(seed),
        "code": own_digest(),
        "python": "{}.{}".format(*sys.version_info),
        **{name: version(name) for name in ("pilotid", *LIBRARIES)},
    }


# ------------------------------------------------------------------------- local processes


@contextmanager
def _processes(workers: int) -> Iterator[Workers]:
    """Processes of this machine."""
    from pebble import ProcessExpired, ProcessPool

    pool = ProcessPool(workers, initializer=_set_up, context=_Context())
    try:
        yield Workers(2 * workers, pool.submit, ProcessExpired, lambda: pool.active)
    except BrokenProcessPool:
        raise InputError("processes for the fits end as they start; try fewer, --workers") from None
    finally:
        pool.stop()  # type: ignore[no-untyped-call]
        pool.join()


_PREPARE = spawn.get_preparation_data


class _Context(SpawnContext):
    """Starts processes of one thread in linear algebra, which never import the user's script."""

    class Process(SpawnProcess):
        def start(self) -> None:
            """Start; numpy reads the numbers of threads as it is imported, before code of ours.

            A script without a main guard would start itself again, and Python does not know
            joblib's way to start processes by itself.
            """
            from unittest.mock import patch  # it imports much, and is for processes alone

            without_main = patch.object(spawn, "get_preparation_data", _without_main)
            with patch.dict(os.environ, THREADS), without_main:
                super().start()

        @property
        def exitcode(self) -> int | None:
            """How it ended; never 0, by which a pool would take its task for done."""
            code = super().exitcode
            return 256 if code == 0 else code


def _without_main(name: str) -> dict[str, object]:
    left_out = ("init_main_from_name", "init_main_from_path", "start_method")
    return {key: value for key, value in _PREPARE(name).items() if key not in left_out}


def _set_up() -> None:
    """Leave Ctrl-C to the process that started this one, and keep what methods print apart."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.dup2(2, 1)


# ------------------------------------------------------------------------------------ Dask


@contextmanager
def _cluster(scheduler: str) -> Iterator[Workers]:
    """The workers of a Dask scheduler."""
    logging.disable()  # what is wrong is said in a sentence; Dask would tell it in a hundred
    try:
        from distributed import Client, KilledWorker

        client: Any = Client(scheduler, timeout=10.0, set_as_default=False)
        if not client.ncores():
            sys.stderr.write(f"pilotid: {scheduler} has no workers; waiting for some\n")
        # Not as a context: on leaving that would wait for fits that nobody does.
        executor = client.get_executor(retries=0, pure=False)
        try:
            # So many tasks keep all workers busy.
            yield Workers(1000, partial(executor.submit, _same_code, own_digest()), KilledWorker)
        finally:
            with suppress(Exception):  # there may be nobody to take leave of
                client.close(timeout=2.0)
    except Exception as error:
        raise InputError(
            f"--scheduler {scheduler}: {reason(error)}; start it, and workers with this "
            "pilotid[distributed], and run the same command again: what is done is kept"
        ) from error
    finally:
        logging.disable(logging.NOTSET)


def _same_code(digest: str, function: Callable[[Task], Answer], _: object, task: Task) -> Answer:
    """An answer of the code that asks."""
    if own_digest() != digest:
        raise InputError(f"it runs other code, digest {own_digest()}, here {digest}")
    return function(task)
