"""Quantities of several estimates side by side: for the terminal and for notebooks."""

from __future__ import annotations

import html
from collections.abc import Sequence
from typing import TYPE_CHECKING

from pilotid.estimates.quantities import Quantity
from pilotid.terminal import make_table

if TYPE_CHECKING:
    from rich.table import Table

#: What stands side by side: a name, and quantities with the same keys for all.
Columns = Sequence[tuple[str, Sequence[Quantity]]]
INTERVAL = "95 % interval"


def quantity_table(columns: Columns, plus_minus: str = "±", what: str = "parameter") -> Table:
    """A row for each quantity, two columns for each estimate."""
    table = make_table()
    table.add_column(what, no_wrap=True)
    table.add_column("unit", no_wrap=True)
    for name, _ in columns:
        table.add_column(name, justify="right", no_wrap=True)
        table.add_column(INTERVAL, justify="right", no_wrap=True)
    for row in zip(*(quantities for _, quantities in columns), strict=True):
        cells = [cell for quantity in row for cell in quantity.shown(plus_minus)]
        table.add_row(row[0].key, row[0].unit, *cells)
    return table


def quantity_html(columns: Columns) -> str:
    """The same as an HTML table."""
    heads = ["parameter", "unit", *(text for name, _ in columns for text in (name, INTERVAL))]
    rows = [
        [row[0].key, row[0].unit, *(cell for quantity in row for cell in quantity.shown())]
        for row in zip(*(quantities for _, quantities in columns), strict=True)
    ]
    body = "".join(f"<tr>{_cells('td', row)}</tr>" for row in rows)
    return f"<table><thead><tr>{_cells('th', heads)}</tr></thead><tbody>{body}</tbody></table>"


def _cells(tag: str, texts: Sequence[str]) -> str:
    return "".join(f"<{tag}>{html.escape(text)}</{tag}>" for text in texts)


def side_by_side(columns: Columns, width: int) -> list[Columns]:
    """As many estimates side by side as the width allows."""
    # Beside the two columns in front, an estimate takes some 40 characters.
    size = max(1, (width - 20) // 40)
    return [columns[i : i + size] for i in range(0, len(columns), size)]
