"""Progress on the terminal; Ctrl-C: one sentence on standard error and status 130."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from pilotid.support.terminal import make_console

if TYPE_CHECKING:
    from pilotid.study.table import Fit


LONG = 10.0  # minutes from which a job says what would make it shorter
STATUS = 130  # what shells say of a program that Ctrl-C ended


class StoppedError(Exception):
    """Ctrl-C, and what the user should know then."""


@contextmanager
def heeding_interruptions() -> Iterator[None]:
    """End the program with a sentence if it is interrupted in here."""
    try:
        yield
    except (KeyboardInterrupt, StoppedError) as stop:
        with suppress(OSError):
            sys.stderr.write(f"pilotid: {str(stop) or 'stopped'}\n")
            sys.stderr.flush()
        raise SystemExit(STATUS) from None


def with_progress(
    results: Iterable[Fit], counts: Mapping[str, int], workers: int | None = None
) -> Iterator[Fit]:
    """The results, with a bar for each method and the time left while they come.

    The bars go to standard error, and only if that is a terminal; `counts` says how many fits
    there will be of each method.  One fit by each tells how long all will take.
    """
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    console = make_console(errors=True)
    total = sum(counts.values())
    results = _with_forecast(results, counts, workers)
    if not console.is_terminal or total < 2:
        yield from results
        return
    bars = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[failed]}"),
        TimeRemainingColumn(compact=True),
        console=console,
        transient=True,
    )
    failed: Counter[str] = Counter()
    with bars:
        tasks = {name: bars.add_task(name, total=n, failed="") for name, n in counts.items() if n}
        whole = bars.add_task("all", total=total, failed="")
        for result in results:
            method = result.method
            failed[method] += not result.usable
            words = f"{failed[method]} failed" if failed[method] else ""
            bars.update(tasks[method], advance=1, failed=words)
            bars.update(whole, advance=1)
            yield result


def _with_forecast(
    results: Iterable[Fit], counts: Mapping[str, int], workers: int | None
) -> Iterator[Fit]:
    """The results; after the first of them a line on about how long a long study will take."""
    from pilotid.jobs import processors

    processes = workers or processors()
    took: dict[str, float] = {}
    for number, result in enumerate(results, start=1):
        yield result
        took.setdefault(result.method, result.seconds or 0.0)
        if number == len(counts):
            minutes = sum(took.get(name, 0.0) * n for name, n in counts.items()) / processes / 60.0
            words = f"{sum(counts.values())} fits, about {minutes:.0f} min on {processes} processes"
            if minutes > LONG:
                words += "; fewer --replications or methods take less, and what is done is kept"
            if minutes > 1.0:
                make_console(errors=True).print(words, soft_wrap=True)
