"""Where a report's numbers come from: settings, seed, versions, and what to type for them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from shlex import quote

from pilotid.naming.settings import shown
from pilotid.report.content import Block, Column, Command, Section, Table, Text, entries
from pilotid.report.tables import failure_table
from pilotid.study.comparison import Comparison
from pilotid.study.entries import TRAJECTORY
from pilotid.study.store import Store

#: Facts on a study that are no versions.
OWN_FACTS = ("format", "seed", "mixed", "code", "sparing")


def command(
    study: Comparison, about: Mapping[str, str], scenarios: Sequence[str], folder: str
) -> str:
    """What to type for these scenarios and the methods that were tried on them.

    Where methods for time-varying pilots were left out of other scenarios, the whole study is
    that of all methods, which `compare` chooses by itself.
    """
    tried = {cell.method for name in scenarios for cell in study.of(name)}
    methods = [study.typed[method] for method in study.methods if method in tried]
    names = dict.fromkeys(study.entry(name).typed or name for name in scenarios)
    chosen = f"--method {quote(','.join(methods))} "
    if "sparing" in about and set(scenarios) == set(study.names):
        chosen = ""
    return (
        f"pilotid compare --scenario {quote(','.join(names))} {chosen}"
        f"--replications {study.replications(scenarios)} --seed {about.get('seed', '?')} "
        f"--out results/{folder}"
    )


def mixed(what: str) -> str:
    """The warning on a store with results of different code."""
    return (
        f"this store mixes results of different code or settings ({what}); differences between "
        "methods may be differences between versions."
    )


def failures(study: Comparison) -> Section:
    """Which fits failed, and why."""
    table = failure_table(study)
    text = (
        "A failure counts in the loss as the interval from zero to twice the true value; bias, "
        "scatter, rmse and coverage are those of the fits that count. A recording that a method "
        "cannot treat is no try."
    )
    every = Text("Every fit of this study converged.")
    return Section("failures", "Failures and their reasons",
                   [Text(text), table if table.rows else every], folded=True)  # fmt: skip


def provenance(study: Comparison, store: Store, about: Mapping[str, str]) -> Section:
    """All that defines methods and scenarios, seed, versions, and how to make the numbers again."""
    held = store.methods()
    methods = [[label, f"`{shown(held[label].settings)}`"] for label in study.methods]
    scenarios = [
        [e.name, e.description, e.model, e.start, f"`{shown(e.settings)}`"] for e in study.scenarios
    ]
    titles = ("scenario", "description", "model", "start", "all that defines it")
    skipped = (
        *OWN_FACTS,
        *(key for key in about if key.startswith(("remnant ratio", TRAJECTORY))),
    )
    facts = ", ".join(f"{key} {value}" for key, value in about.items() if key not in skipped)
    seed = f"Seed {about.get('seed', '?')}, code digest {about.get('code', '?')}; {facts}."
    blocks: list[Block] = [
        Command(
            "The whole study (resumes an interrupted one; the same numbers for any number of "
            "workers):",
            command(study, about, study.names, "compare"),
        ),
        Command("This report again, from the store alone:", "pilotid report DIR"),
        Text(
            "No method is told the truth. All methods have the same recordings and are handed the "
            "same **start**: that of the model, or one drawn at random where the scenarios say so. "
            f"{seed}"
        ),
        Table("Methods", _columns("method", "settings"), entries(methods), folded=True),
        Table("Scenarios", _columns(*titles), entries(scenarios), folded=True),
    ]
    if "mixed" in about:
        blocks.insert(0, Text(f"**{mixed(about['mixed'])}**"))
    return Section("provenance", "Provenance", blocks)


def _columns(*titles: str) -> list[Column]:
    return [Column(title, text=True) for title in titles]
