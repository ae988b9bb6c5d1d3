"""What `pilotid design` prints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from pilotid.designing.design import Design
from pilotid.designing.planning import Plan
from pilotid.designing.words import chance_sentence, pilots_sentence, sentences
from pilotid.terminal import make_console, make_table, print_table

if TYPE_CHECKING:
    from rich.table import Table


def show(made: Design, plans: Sequence[tuple[str, Plan]], subjects: int) -> None:
    """Print what a design gives, and the plans by the name of their forcing functions."""
    console, runs = make_console(), made.scenario.runs
    print_table(console, _table(made))
    costs = ", ".join(f"{name} {cost:.2f}" for name, cost in made.costs.items())
    crests = ", ".join(f"{name} {crest:.2f}" for name, (crest, _) in made.crest.items())
    console.print(
        f"Variances over the reference's: {costs}. Crest factors: {crests}.", soft_wrap=True
    )
    for sentence in sentences(made):
        console.print(sentence, soft_wrap=True)
    if len(made.gains) > 1:
        console.print(pilots_sentence(made), soft_wrap=True)
    for name, found in plans:
        console.print(chance_sentence(name, found, subjects, runs), soft_wrap=True)
        print_table(console, _plan_table(found, name))


def _table(made: Design) -> Table:
    table = make_table()
    table.title = (
        f"predicted standard errors, {made.scenario.runs} x {made.scenario.duration:.2f} s"
    )
    table.title_justify, table.title_style = "left", ""
    for title in ("parameter", "design %", "reference %", "ratio"):
        table.add_column(title, justify="left" if title == "parameter" else "right")
    for key, error in made.errors.items():
        before = made.reference_errors[key]
        table.add_row(key, f"{100 * error:.2f}", f"{100 * before:.2f}", f"{error / before:.2f}")
    return table


def _plan_table(found: Plan, name: str) -> Table:
    table = make_table()
    table.title = f"subjects for 80 %, {name}"
    table.title_justify, table.title_style = "left", ""
    for title in ("window", *(f"{runs} run{'s' if runs > 1 else ''}" for runs in found.choices)):
        table.add_column(title, justify="right")
    for row in found.rows("-"):
        table.add_row(*row)
    return table
