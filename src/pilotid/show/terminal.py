"""Estimates as tables on the terminal."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from pilotid.estimates.estimate import Estimate
from pilotid.estimates.quantities import Fitted, derived, parameters
from pilotid.show.numbers import value_and_interval
from pilotid.show.words import heading, verdict

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.table import Table

T = TypeVar("T")

PLAIN_WIDTH = 120  # columns of output that does not go to a terminal


def make_console(*, errors: bool = False) -> Console:
    """A console that neither colours nor breaks lines where it does not face a terminal."""
    from rich.console import Console

    console = Console(stderr=errors, highlight=False, markup=False, emoji=False)
    if not console.is_terminal:
        console = Console(
            stderr=errors, highlight=False, markup=False, emoji=False, width=PLAIN_WIDTH
        )
    return console


def make_table() -> Table:
    """An empty table in the style of all tables here."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    return Table(box=SIMPLE_HEAD, show_edge=False, pad_edge=False)


def print_table(console: Console, table: RenderableType) -> None:
    """Print without the spaces that fill each line up to the console's width."""
    if console.is_terminal:
        console.print(table)
        return
    with console.capture() as captured:
        console.print(table)
    lines = [line.rstrip() for line in captured.get().splitlines()]
    console.file.write("\n".join(lines).strip("\n") + "\n")


def with_bar(items: Iterable[T], what: str, total: int) -> Iterator[T]:
    """The items, with a bar on standard error while they come, if that is a terminal."""
    from rich.progress import track

    console = make_console(errors=True)
    hidden = not console.is_terminal or total < 2
    yield from track(items, what, total, console=console, transient=True, disable=hidden)


def print_fits(console: Console, fits: Sequence[Fitted]) -> None:
    """Print the tables of several fits."""
    for i, fit in enumerate(fits):
        if i:
            console.print()
        print_fit(console, fit)


def print_fit(console: Console, fit: Fitted) -> None:
    """Print the tables of a fit, and a line for each method."""
    console.print(heading(fit), style="bold", soft_wrap=True)
    usable = [e for e in fit.estimates if np.isfinite(e.values).any()]
    for group in side_by_side(usable, console.width):
        console.print()
        print_table(console, fit_table(group, "±" if console.encoding == "utf-8" else "+-"))
    console.print()
    for estimate in fit.estimates:
        style = None if estimate.outcome.usable else "red"
        console.print(verdict(estimate), style=style, soft_wrap=True)


def fit_table(estimates: Sequence[Estimate], plus_minus: str = "±") -> Table:
    """A row for each parameter, two columns for each estimate."""
    table = make_table()
    table.add_column("parameter", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    for estimate in estimates:
        table.add_column(estimate.method, justify="right", no_wrap=True)
        table.add_column("95 % interval", justify="right", no_wrap=True)
    columns = [[*parameters(e), *derived(e)] for e in estimates]
    for row in zip(*columns, strict=True):
        cells = [cell for quantity in row for cell in value_and_interval(quantity, plus_minus)]
        table.add_row(row[0].key, row[0].unit, *cells)
    return table


def side_by_side(estimates: Sequence[Estimate], width: int) -> list[Sequence[Estimate]]:
    """As many estimates side by side as the width allows."""
    # Beside the two columns in front, an estimate takes some 40 characters.
    size = max(1, (width - 20) // 40)
    return [estimates[i : i + size] for i in range(0, len(estimates), size)]
