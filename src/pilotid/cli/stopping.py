"""Ctrl-C: one sentence on standard error and status 130, whenever it comes."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from threading import current_thread, main_thread
from types import FrameType

STATUS = 130  # what shells say of a program that Ctrl-C ended


class StoppedError(Exception):
    """Ctrl-C, and what the user should know then."""


@contextmanager
def heeding_interruptions() -> Iterator[None]:
    """End the program if it is interrupted in here; at once, if that happens again.

    Where interruptions are ignored, as in jobs in the background, they stay ignored.
    """
    usual = signal.getsignal(signal.SIGINT)
    ours = usual is signal.default_int_handler and current_thread() is main_thread()
    told: list[str] = []

    def tell(sentence: str) -> None:
        if not told:
            told.append(sentence)
            sys.stderr.write(f"pilotid: {sentence}\n")
            sys.stderr.flush()

    def again(_: int, __: FrameType | None) -> None:
        tell("stopped")
        os._exit(STATUS)

    def first(_: int, __: FrameType | None) -> None:
        signal.signal(signal.SIGINT, again)
        raise KeyboardInterrupt

    if ours:
        signal.signal(signal.SIGINT, first)
    try:
        yield
    except (KeyboardInterrupt, StoppedError) as stop:
        tell(str(stop) or "stopped")
        if ours:  # all that is left is to end
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        raise SystemExit(STATUS) from None
    else:
        if ours:
            signal.signal(signal.SIGINT, usual)
