"""Running many independent tasks on several processes, whatever happens to one of them.

Each process has one task at a time, so that it is known which task a process that dies or
hangs had.  A death may be chance: the task is run again, and given up if that process dies
too.  A task that takes too long is given up at once.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Iterator
from multiprocessing.connection import Connection, wait
from typing import TypeVar

from pilotid.study.process import USUAL_LIMITS, Limits, Loss, Try, Worker
from pilotid.types import InputError

Task = TypeVar("Task")
Answer = TypeVar("Answer")

FALSE_STARTS = 3  # processes that end before their first task, until there is no hope


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
        What to do it to.
    given_up
        Makes the answer to a task that has none, given why, also in words.
    workers
        Number of local processes; None for one for each processor.  All work is done in
        them, even by a single one, so that the numbers are the same for any number.
    scheduler
        Address of a Dask scheduler to use instead.
    limits
        What a task on a local process may take.
    """
    if scheduler is None:
        yield from _locally(function, tasks, given_up, workers or processors(), limits)
    else:
        from pilotid.study.cluster import on_dask

        yield from on_dask(function, tasks, given_up, scheduler)


def processors() -> int:
    """Number of processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _locally(
    function: Callable[[Task], Answer],
    tasks: Iterable[Task],
    given_up: Callable[[Task, Loss, str], Answer],
    workers: int,
    limits: Limits,
) -> Iterator[Answer]:
    again: list[Try[Task]] = []
    remaining = (Try(task) for task in tasks)
    crew: list[Worker[Task, Answer]] = []
    false_starts = 0
    try:
        while True:
            idle = [worker for worker in crew if worker.has is None]
            while idle or len(crew) < workers:
                new = again.pop() if again else next(remaining, None)
                if new is None:
                    break
                if not idle:
                    idle.append(Worker(function, limits))
                    crew.append(idle[-1])
                idle.pop().begin(new)
            busy = [worker for worker in crew if worker.has is not None]
            if not busy:
                return
            for worker in _to_look_at(busy):
                had = worker.has
                assert had is not None
                if time.monotonic() >= worker.deadline:
                    crew.remove(worker)
                    worker.end()
                    yield given_up(had.task, Loss.TIMED_OUT, f"{limits.seconds:g} s")
                    continue
                try:
                    yield from worker.heard()
                    false_starts = 0
                except EOFError:
                    crew.remove(worker)
                    how = worker.end(patience=2.0)
                    false_starts += not worker.ready
                    if false_starts >= FALSE_STARTS:
                        raise InputError(
                            f"processes for the fits end as they start ({how}), for the reason "
                            "that they print; they may need more memory (--memory), or be too "
                            "many (--workers)"
                        ) from None
                    if had.again:
                        yield given_up(had.task, Loss.DIED, f"twice, with {how}")
                    else:
                        again.append(Try(had.task, again=worker.ready))
    finally:
        for worker in crew:
            # After an interruption nobody waits for what is under way.
            worker.end(patience=0.0 if worker.has else 2.0)


def _to_look_at(busy: list[Worker[Task, Answer]]) -> list[Worker[Task, Answer]]:
    """The processes that have something to say or are overdue, once there are any."""
    left = max(0.0, min(worker.deadline for worker in busy) - time.monotonic())
    known = {worker.connection: worker for worker in busy}
    heard = wait(list(known), None if left == float("inf") else left)
    late = [worker for worker in busy if worker.deadline <= time.monotonic()]
    return late + [known[c] for c in heard if isinstance(c, Connection) and known[c] not in late]
