"""Running tasks on the workers of a Dask cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from itertools import islice
from typing import TypeVar

from pilotid.study.process import Loss
from pilotid.types import InputError

Task = TypeVar("Task")
Answer = TypeVar("Answer")

AHEAD = 4  # tasks waiting for each worker: enough to keep it busy


def on_dask(
    function: Callable[[Task], Answer],
    tasks: Iterable[Task],
    given_up: Callable[[Task, Loss, str], Answer],
    scheduler: str,
) -> Iterator[Answer]:
    """The answers to all tasks; see `pilotid.study.workers.run_tasks`."""
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
                    yield given_up(task, Loss.DIED, "again and again")
