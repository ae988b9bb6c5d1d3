"""The terminal: consoles and bars."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any, TypeVar

from pilotid.support.types import one_line

if TYPE_CHECKING:
    from rich.console import Console

T = TypeVar("T")

PLAIN_WIDTH = 120  # columns of output that does not go to a terminal


def make_console(*, errors: bool = False) -> Console:
    """A console that neither colours nor breaks lines where it does not face a terminal."""
    from rich.console import Console

    console = Console(stderr=errors, highlight=False, markup=False, emoji=False)
    if not console.is_terminal:
        asked = os.environ.get("COLUMNS", "")
        width = int(asked) if asked.isdecimal() and int(asked) else PLAIN_WIDTH
        console = Console(stderr=errors, highlight=False, markup=False, emoji=False, width=width)
    return console


def with_bar(items: Iterable[T], what: str, total: int) -> Iterator[T]:
    """The items, with a bar on standard error while they come, if that is a terminal."""
    from rich.progress import track

    console = make_console(errors=True)
    hidden = not console.is_terminal or total < 2
    yield from track(items, what, total, console=console, transient=True, disable=hidden)


def show_warning(message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
    """Print a warning as one sentence; a plug-in's needs no name."""
    kind = "" if category.__name__ == "PluginWarning" else f"{category.__name__}: "
    sys.stderr.write(f"pilotid: {kind}{one_line(str(message))}\n")
