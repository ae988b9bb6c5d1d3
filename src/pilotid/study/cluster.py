"""Running tasks on the workers of a Dask cluster."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from contextlib import contextmanager, suppress
from functools import cache
from itertools import islice
from typing import Any, TypeVar

from pilotid.naming.code import reason
from pilotid.study.facts import own_digest
from pilotid.study.process import Loss
from pilotid.types import InputError

Task = TypeVar("Task")
Answer = TypeVar("Answer")

AHEAD = 4  # tasks waiting for each worker: enough to keep it busy
LOOK = 0.5  # s between looks at the scheduler
PATIENCE = 5.0  # s without a worker until the user is told
LOUD = ("distributed", "tornado", "asyncio")
LOST = 10.0  # s without the scheduler until it is given up


def on_dask(
    function: Callable[[Task], Answer],
    tasks: Iterable[Task],
    given_up: Callable[[Task, Loss, str], Answer],
    scheduler: str,
) -> Iterator[Answer]:
    """The answers to all tasks; see `pilotid.study.workers.run_tasks`.

    Raises
    ------
    InputError
        If the scheduler does not answer, or no longer, or a worker runs other code.
    """
    try:
        from distributed.scheduler import KilledWorker
    except ImportError:
        raise InputError(
            "--scheduler needs Dask: install pilotid[distributed], or leave the option out"
        ) from None
    with _client(scheduler) as client:
        # Not as a context: on leaving that would wait for fits that nobody does.
        executor = client.get_executor(retries=0, pure=False)
        same: set[str] = set()  # workers whose code is known to be ours
        looked = -LOOK
        remaining = iter(tasks)
        running: dict[Future[tuple[str, Answer]], Task] = {}
        while True:
            if time.monotonic() - looked >= LOOK:
                workers = _workers(client, scheduler)
                if workers - same:
                    same |= _of_same_code(client, workers - same)
                looked = time.monotonic()
            ahead = AHEAD * len(workers)
            for task in islice(remaining, max(0, ahead - len(running))):
                running[executor.submit(_signed, function, task)] = task
            if not running:
                return
            done, _ = wait(running, LOOK, return_when=FIRST_COMPLETED)
            for future in done:
                task = running.pop(future)
                try:
                    digest, answer = future.result()
                except KilledWorker:
                    answer = given_up(task, Loss.DIED, "again and again")
                except CancelledError:  # that is how a lost connection ends them
                    raise _gone(scheduler) from None
                except Exception as error:  # a fit's own are answers
                    raise InputError(
                        f"--scheduler {scheduler}: a worker cannot do a fit ({reason(error)}); "
                        "see what it runs"
                    ) from error
                else:
                    _require_ours("a worker", digest)
                yield answer


def _signed(function: Callable[[Task], Answer], task: Task) -> tuple[str, Answer]:
    """An answer with the digest of the code that it is from.

    A worker that comes while others work has tasks before anybody can ask it.
    """
    return _digest(), function(task)


@cache
def _digest() -> str:
    return own_digest()


@contextmanager
def _client(scheduler: str) -> Iterator[Any]:
    """A connection to a scheduler, which is left at once whatever happens."""
    from distributed import Client

    # What is wrong is said in a sentence; Dask would tell it in a hundred lines besides.
    # Its loggers have levels of their own each.
    names = [n for n in logging.root.manager.loggerDict if n.split(".")[0] in LOUD]
    loggers = [logging.getLogger(name) for name in names]
    levels = [logger.level for logger in loggers]
    make: Callable[..., Any] = Client
    try:
        for logger in loggers:
            logger.setLevel(logging.CRITICAL + 1)
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
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


def _workers(client: Any, scheduler: str) -> set[str]:
    """Addresses of the workers, once there are any."""
    told = False
    start = time.monotonic()
    while True:
        try:
            found = client.sync(client.scheduler.ncores, workers=None, callback_timeout=LOST)
        except (OSError, TimeoutError, AttributeError):  # the last once the client has given up
            raise _gone(scheduler) from None
        if found:
            return set(found)
        if not told and time.monotonic() - start > PATIENCE:
            told = True
            sys.stderr.write(
                f"pilotid: the scheduler {scheduler} has no workers; waiting for some "
                f"(`dask worker {scheduler}` starts one)\n"
            )
        time.sleep(LOOK)


def _of_same_code(client: Any, workers: set[str]) -> set[str]:
    """Those that run our code; one of other code is refused, one that has ended is not."""
    try:
        digests = client.run(_digest, workers=sorted(workers), on_error="return")
    except Exception:  # one ended as it was asked
        return set()
    digests = {address: d for address, d in digests.items() if not isinstance(d, OSError)}
    for address, digest in digests.items():
        _require_ours(f"the worker {address}", digest)
    return set(digests)


def _require_ours(worker: str, digest: object) -> None:
    """Refuse results that would not be of the code that the store names."""
    if digest == _digest():
        return
    what = f"other code of pilotid (digest {digest}, here {_digest()})"
    if isinstance(digest, Exception):
        what = f"no such pilotid as runs here ({reason(digest)})"
    raise InputError(
        f"--scheduler: {worker} runs {what}; install the same version there and start it again"
    )


def _gone(scheduler: str) -> InputError:
    return InputError(
        f"--scheduler {scheduler}: the scheduler ended or cannot be reached any more; what is "
        "done is kept, and the same command goes on from there once one runs"
    )
