"""Progress of a study on the terminal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence

from pilotid.study.store import Result, Unit
from pilotid.terminal import make_console


def with_progress(results: Iterable[Result], pending: Sequence[Unit]) -> Iterator[Result]:
    """The results, with a bar for each method and the time left while they come.

    The bars go to standard error, and only if that is a terminal.
    """
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    console = make_console(errors=True)
    if not console.is_terminal or len(pending) < 2:
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
    counts = Counter(unit.method for unit in pending)
    failed: Counter[str] = Counter()
    with bars:
        tasks = {name: bars.add_task(name, total=n, failed="") for name, n in counts.items()}
        whole = bars.add_task("all", total=len(pending), failed="")
        for result in results:
            method = result.unit.method
            failed[method] += not result.usable
            words = f"{failed[method]} failed" if failed[method] else ""
            bars.update(tasks[method], advance=1, failed=words)
            bars.update(whole, advance=1)
            yield result
