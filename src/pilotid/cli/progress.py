"""Progress of a study on the terminal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping

from pilotid.study.entries import Result
from pilotid.terminal import make_console


def with_progress(results: Iterable[Result], counts: Mapping[str, int]) -> Iterator[Result]:
    """The results, with a bar for each method and the time left while they come.

    Parameters
    ----------
    results
        The fits as they come.
    counts
        How many there will be of each method.

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
    total = sum(counts.values())
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
            method = result.unit.method
            failed[method] += not result.usable
            words = f"{failed[method]} failed" if failed[method] else ""
            bars.update(tasks[method], advance=1, failed=words)
            bars.update(whole, advance=1)
            yield result
