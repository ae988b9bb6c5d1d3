"""A process that does one task after the other, seen from outside and from inside."""

from __future__ import annotations

import enum
import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import (
    get_all_start_methods,
    get_context,
    get_start_method,
    parent_process,
    resource_tracker,
    set_start_method,
)
from multiprocessing.connection import Connection
from threading import Thread
from typing import Any, Generic, TypeVar

Task = TypeVar("Task")
Answer = TypeVar("Answer")

GIGABYTE = 2**30


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


@dataclass(frozen=True, eq=False)
class Try(Generic[Task]):
    """A task, and whether a process died of it before."""

    task: Task
    again: bool = False


class Worker(Generic[Task, Answer]):
    """A process, and the task that it has."""

    def __init__(self, function: Callable[[Task], Answer], limits: Limits) -> None:
        self.seconds = limits.seconds or float("inf")
        self.ready = False
        self.has: Try[Task] | None = None
        self.deadline = float("inf")
        context = get_context("spawn")
        self.connection, other = context.Pipe()
        # A daemon, so that no exit of this process waits for it.
        self.process = context.Process(
            target=_serve, args=(other, function, limits.gigabytes), daemon=True
        )
        with _one_thread_each(), _usual_start_method(), _interruptions_held_back():
            self.process.start()
        other.close()

    def begin(self, new: Try[Task]) -> None:
        """Give it a task; its time counts once the process has started."""
        self.has = new
        if self.ready:
            self.deadline = time.monotonic() + self.seconds
        with suppress(OSError):  # it is dead, which the next look at it tells
            self.connection.send(new.task)

    def heard(self) -> Iterator[Answer]:
        """The answer to its task, nothing if it has but started; EOFError if it died."""
        try:
            kind, answer = self.connection.recv()
        except OSError as error:
            raise EOFError from error
        if kind == "ready":
            self.ready, self.deadline = True, time.monotonic() + self.seconds
            return
        self.has, self.deadline = None, float("inf")
        if kind == "error":
            raise answer
        yield answer

    def end(self, *, patience: float = 0.0) -> str:
        """End it with all processes that it started; how it ended, if it did so by itself."""
        self.connection.close()
        if patience:
            self.process.join(patience)
        with suppress(OSError):
            if hasattr(os, "killpg") and self.process.pid is not None:
                os.killpg(self.process.pid, signal.SIGKILL)  # a group of its own, see `_settle`
        self.process.kill()
        self.process.join()
        code = self.process.exitcode or 0
        try:
            return f"exit status {code}" if code >= 0 else f"signal {signal.Signals(-code).name}"
        except ValueError:
            return f"signal {-code}"


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Processes that start in here have one thread each in linear algebra.

    They read these variables when they import numpy, before any code of ours runs.
    """
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value


@contextmanager
def _usual_start_method() -> Iterator[None]:
    """Processes that start in here are told of a way to start others that Python knows.

    In a process of joblib's it would be joblib's own, and they would end as they start.
    """
    before = get_start_method(allow_none=True)
    if before in (None, *get_all_start_methods()):
        yield
        return
    set_start_method("spawn", force=True)
    try:
        yield
    finally:
        set_start_method(before, force=True)


@contextmanager
def _interruptions_held_back() -> Iterator[None]:
    """A process that starts in here never gets Ctrl-C; this one gets it afterwards.

    One that is interrupted before any code of ours runs would print what it was doing.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # when it has to start, it lets interruptions through
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _serve(
    connection: Connection, function: Callable[[Any], object], gigabytes: float | None
) -> None:
    """The life of a process: one task after the other until nobody has any more."""
    _settle(gigabytes)
    connection.send(("ready", None))
    while True:
        try:
            task = connection.recv()
        except (EOFError, OSError):
            return
        try:
            answer = "answer", function(task)
        except Exception as error:
            answer = "error", error
        connection.send(answer)


def _settle(gigabytes: float | None) -> None:
    """Leave interruptions to the process that started this one, and end when it is gone.

    Ctrl-C reaches all processes of a terminal; a worker without a parent would wait for ever.
    It is the head of a group, so that what a method starts ends with it.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(OSError):
        os.dup2(2, 1)  # what a method prints is no part of a command's output
    if hasattr(os, "setpgrp"):
        os.setpgrp()
    parent = parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            if hasattr(os, "killpg"):
                os.killpg(0, signal.SIGKILL)
            os._exit(1)

    Thread(target=watch, daemon=True).start()
    if gigabytes:
        with suppress(ImportError, ValueError, OSError):  # not every system has it
            import resource

            _, most = resource.getrlimit(resource.RLIMIT_AS)
            wanted = int(gigabytes * GIGABYTE)
            limit = wanted if most == resource.RLIM_INFINITY else min(wanted, most)
            resource.setrlimit(resource.RLIMIT_AS, (limit, most))
