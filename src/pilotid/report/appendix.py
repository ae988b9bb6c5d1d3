"""The parts of a study's report that follow its experiments."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from shlex import quote

from pilotid.naming.settings import shown
from pilotid.report import tables as study_tables
from pilotid.report.content import Block, Bullets, Column, Command, Section, Table, Text, entries
from pilotid.report.paper import PAPER
from pilotid.study.comparison import Comparison
from pilotid.study.entries import TRAJECTORY
from pilotid.study.store import Store

#: Facts on a study that are no versions.
OWN_FACTS = ("format", "seed", "mixed", "code", "sparing")


def command(
    study: Comparison, about: Mapping[str, str], scenarios: Sequence[str], folder: str
) -> str:
    """What to type for these scenarios and the methods that were tried on them.

    Where methods for pilots who change were left out of other scenarios, the whole study is that
    of all methods, which `compare` chooses by itself.
    """
    methods = [
        study.typed[method]
        for method in study.methods
        if any(cell.method == method for name in scenarios for cell in study.tried_on(name))
    ]
    names = dict.fromkeys(study.entry(name).typed or name for name in scenarios)
    chosen = f"--method {quote(','.join(methods))} "
    if "sparing" in about and set(scenarios) == set(study.all_names):
        chosen = ""
    return (
        f"pilotid compare --scenario {quote(','.join(names))} {chosen}"
        f"--replications {study.replications(scenarios)} --seed {about.get('seed', '?')} "
        f"--out results/{folder}"
    )


def posterior(study: Comparison) -> list[Section]:
    """Posterior spread against scatter and bound; nothing if no method has a posterior."""
    several = [e.name for e in study.scenarios if not e.one_recording]
    table = study_tables.posterior_table(study, several)
    if table is None:
        return []
    text = Text(
        "Mean standard deviation of the posterior, beside the real scatter of its mean over "
        "recordings and the Cramér-Rao bound. A ratio far below 1 is a posterior that is too sure."
    )
    return [Section("posterior", "Posterior spread, scatter and bound", [text, table])]


def failures(study: Comparison) -> Section:
    """Which fits failed, and why."""
    table = study_tables.failure_table(study)
    text = (
        "The paper leaves failed fits out of its means. So do the columns of bias, standard "
        "deviation, rmse and coverage here; the columns marked **all** count every fit that gave "
        "values, converged or not, and take a failed fit for an interval that missed. A recording "
        "that a method cannot treat is no try."
    )
    blocks: list[Block] = [Text(text)]
    if table.rows:
        blocks.append(table)
    else:
        blocks.append(Text("Every fit of this study converged."))
    return Section("failures", "Failures and their reasons", blocks)


def settings(study: Comparison, store: Store) -> Section:
    """All that defines methods and scenarios."""
    columns = [Column("method", text=True), Column("settings", text=True)]
    held = store.methods()
    rows = [[label, f"`{shown(held[label].settings)}`"] for label in study.methods]
    scenarios = [
        [e.name, e.description, e.model, e.start, f"`{shown(e.settings)}`"]
        for e in map(study.entry, study.all_names)
    ]
    heads = [
        Column(t, text=True)
        for t in ("scenario", "description", "model", "start", "all that defines it")
    ]
    tables = [
        Table("Methods", columns, entries(rows)),
        Table("Scenarios", heads, entries(scenarios), folded=True),
    ]
    starts = Text(
        "No method is told the truth. All methods of a replication are handed the same **start**: "
        "that of the model (for models of the catalogue a generic one, round numbers in the middle "
        "of published values) or, where the start is what a scenario varies, one drawn at random "
        "about the truth. Methods are free to draw others."
    )
    notes = [starts, *([notes_on_inference(study)] if study.scenarios else [])]
    return Section("settings", "Methods and scenarios", [*tables, *notes])


def notes_on_inference(study: Comparison) -> Text:
    """What the paper does not state and these scenarios had to assume."""
    entry = next((e for e in study.scenarios if e.name == "nominal"), study.scenarios[0])
    frequency, damping = entry.number("remnant.frequency"), entry.number("remnant.damping")
    given = math.isfinite(frequency) and math.isfinite(damping)
    shape = f" at {frequency:g} rad/s with damping {damping:g}" if given else ""
    return Text(
        "Two things the paper does not state are **inferred**. The controlled element is K/s² with "
        "K = 4: there both forcing functions, whose amplitudes the paper does give, cause the same "
        f"variance of the output. The remnant's filter is a second-order low-pass{shape}, with a "
        "level at which gains 0.1 and 0.8 give about the 3 % and 32 % of the control's power that "
        "the paper names. Biases of methods that assume a white residual depend on this filter."
    )


def origin(study: Comparison, about: Mapping[str, str]) -> Section:
    """Seed, versions, and how to make the numbers again."""
    facts = [["seed", about.get("seed", "?")], ["code digest", about.get("code", "?")]]
    skipped = (
        *OWN_FACTS,
        *(key for key in about if key.startswith(("remnant ratio", TRAJECTORY))),
    )
    facts += [[key, value] for key, value in about.items() if key not in skipped]
    table = Table("Seed and versions", [Column("what", text=True), Column("value", text=True)],
                  entries(facts))  # fmt: skip
    whole = Command(
        "The whole study (resumes where it stopped; the same numbers for any number of workers):",
        command(study, about, study.all_names, "compare"),
    )
    again = Command("This report again, from the store alone:", "pilotid report DIR")
    blocks: list[Block] = [table, whole, again]
    if "mixed" in about:
        blocks.insert(0, Text(f"**{mixed(about['mixed'])}**"))
    return Section("origin", "Where the numbers come from", blocks)


def mixed(what: str) -> str:
    """The warning on a store with results of different code."""
    return (
        f"this store mixes results of different code or settings ({what}); differences between "
        "methods may be differences between versions."
    )


def reading() -> Section:
    """What the words and numbers mean."""
    return Section(
        "reading",
        "How to read the numbers",
        [
            Bullets(
                [
                    "**Percentages** are of the parameter's true value.",
                    "**Bias**, **std**, **rmse**: mean error, sample standard deviation and root "
                    "mean square error over the fits that count. After ± stands the Monte "
                    "Carlo standard error; bars in figures are 1.96 of it to each side.",
                    "**Bound**: the Cramér-Rao bound on the standard deviation of an unbiased "
                    "estimate from the whole record with the remnant's spectrum known.",
                    "**Claimed**: the mean of the standard errors that the method itself reports.",
                    "**Coverage**: share of 95 % intervals that hold the truth, with its 95 % "
                    "(Wilson) interval. An honest method lies near 95 %.",
                    f"**Paper**: {PAPER}, Berger, Zaal, Mulder and van Paassen, Time Domain Pilot "
                    "Model Identification Using Maximum Likelihood Estimation, 2008. Its means "
                    "leave out failed fits.",
                    "Clicking a table's heading sorts it; a third click restores its order.",
                ]
            )
        ],
    )
