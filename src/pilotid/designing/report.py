"""The report of a design: spectra, predicted errors, price, signals, wrong pilots, plan."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pilotid.designing.design import OFF, Design, wrong_pilots
from pilotid.designing.figures import signals_figure, spectra_figure
from pilotid.designing.planning import Plan
from pilotid.designing.summary import chance_sentence, limits_kept, pilots_sentence, sentences
from pilotid.disk import write_file
from pilotid.numbers import MINUS, NONE, number
from pilotid.report.content import (
    Block,
    Bullets,
    Column,
    Command,
    Picture,
    Section,
    Table,
    Text,
    entries,
    web_page,
)

#: What the summary shows beside, by what the remnant's power is taken for.
OTHERWISE = {
    "held": ("design %, remnant grows", "if the remnant's power is a share of the control's"),
    "share": ("design %, remnant held", "if the remnant has the power that it has now"),
}
COSTS = {"e": "error e", "u": "control u", "de": "rate of e", "du": "rate of u"}


def write_report(
    folder: Path,
    made: Design,
    command: str,
    version: str,
    plans: Sequence[tuple[str, Plan]] = (),
    subjects: int = 8,
) -> Path:
    """Write report.html.

    Parameters
    ----------
    folder
        Where to write.
    made
        The design.
    command
        The command that made it.
    version
        Of this package.
    plans, subjects
        Plans by the name of their forcing functions, and how many subjects there are.
    """
    sections = [_summary(made), _spectra(made), _price(made), _signals(made), _wrong(made)]
    if len(made.gains) > 1:
        sections.append(_pilots(made))
    if plans:
        sections.append(_planning(plans, subjects, made.scenario.runs))
    sections.append(_origin(folder, command, version, alternating=made.scenario.alternating))
    path = folder / "report.html"
    title = f"Forcing functions for {made.reference.name}"
    write_file(path, web_page(title, sections).encode("utf-8", "replace"))
    return path


def _summary(made: Design) -> Section:
    columns = [
        Column("parameter", text=True),
        Column("design %"),
        Column("reference %"),
        Column("ratio"),
        Column(OTHERWISE[made.remnant][0], hint=OTHERWISE[made.remnant][1]),
    ]
    other = made.errors_if_scaled if made.remnant == "held" else made.errors_if_held
    rows = [
        [
            key,
            number(100.0 * error),
            number(100.0 * made.reference_errors[key]),
            f"{error / made.reference_errors[key]:.2f}",
            number(100.0 * other[key]),
        ]
        for key, error in made.errors.items()
    ]
    runs = made.scenario.runs
    caption = (
        f"Predicted standard errors in % of the true values, from the Cramer-Rao bounds of "
        f"{runs} run{'s' if runs > 1 else ''} of {made.scenario.duration:.2f} s, the remnant's own "
        "parameters estimated too"
    )
    blocks: list[Block] = [
        Bullets(sentences(made)),
        Table(caption, columns, entries(rows)),
        _asked(made),
    ]
    return Section("summary", "Summary", blocks)


def _asked(made: Design) -> Table:
    """Pilot, loop and limits that the design is for."""
    scenario, remnant = made.reference, made.scenario.remnant
    values = ", ".join(
        f"{key} {number(value)}"
        for key, value in zip(scenario.model.keys, scenario.truth, strict=True)
    )
    rows = [
        ["pilot", f"model {scenario.model.name}: {values}"],
        ["controlled element", scenario.element.name],
        [
            "remnant",
            f"{remnant.shape} of order {remnant.order}, {number(remnant.frequency)} rad/s, power "
            + ("held" if made.remnant == "held" else "a share of the control's"),
        ],
        ["reference", f"{scenario.name}, {scenario.runs} x {scenario.duration:.2f} s"],
        ["limits", limits_kept(made.limits)],
    ]
    columns = [Column("what", text=True), Column("value", text=True)]
    return Table("What the design is for", columns, entries(rows), folded=True)


def _spectra(made: Design) -> Section:
    picture = Picture.of(
        spectra_figure(made),
        "spectra",
        "Amplitudes of the lines of the design and of the reference, and predicted errors",
        "Amplitudes of the design and of the reference, and the standard errors predicted",
    )
    columns = [
        Column("signal", text=True),
        Column("line"),
        Column("rad/s"),
        Column("amplitude"),
        Column("share %", hint="of the signal's power"),
        Column("phase rad"),
    ]
    rows: list[list[str]] = []
    for name, at in made.lines.signals:
        forcing = made.scenario.target if name == "ft" else made.scenario.disturbance
        assert forcing is not None
        phases = getattr(forcing, "phases", ())
        powers = made.powers[at]
        for line, omega, power, phase in zip(
            forcing.lines, made.lines.omega[at], powers, phases, strict=True
        ):
            share = 100.0 * power / powers.sum()
            rows.append(
                [
                    name,
                    str(line),
                    number(float(omega)),
                    number(math.sqrt(2.0 * power), 4),
                    number(share),
                    f"{phase:.3f}".replace("-", MINUS),
                ]
            )
    table = Table("The lines", columns, entries(rows), heads=2, folded=True)
    return Section("spectra", "Spectra", [picture, table])


def _price(made: Design) -> Section:
    columns = [Column("signal", text=True), Column("variance over the reference's")]
    rows = [[COSTS[name], f"{cost:.2f}"] for name, cost in made.costs.items()]
    whose = "is held" if made.remnant == "held" else "grows with the control"
    text = f"What the pilot pays for it: variances with the remnant's part, which {whose}."
    return Section(
        "price",
        "Price",
        [Text(text), Table("Variances over those of the reference", columns, entries(rows))],
    )


def _signals(made: Design) -> Section:
    columns = [
        Column("signal", text=True),
        Column("crest factor"),
        Column("reference", hint="with the phases that it has"),
        Column("peak"),
        Column("rms"),
    ]
    rows = []
    for name, at in made.lines.signals:
        rms = math.sqrt(float(made.powers[at].sum()))
        crest, before = made.crest[name]
        rows.append([name, f"{crest:.2f}", f"{before:.2f}", number(crest * rms), number(rms)])
    picture = Picture.of(
        signals_figure(made),
        "signals",
        "The forcing functions over time",
        "The forcing functions in the first seconds of the measurement window",
    )
    return Section(
        "signals",
        "Signals",
        [picture, Table("Peaks of the forcing functions", columns, entries(rows))],
    )


def _wrong(made: Design) -> Section:
    keys = list(made.errors)
    columns = [
        Column("pilot", text=True),
        *(Column(key) for key in keys),
        Column("e"),
        Column("u"),
    ]
    rows = []
    for wrong in wrong_pilots(made):
        name = f"{wrong.key} {'+' if wrong.share > 0 else MINUS}{100.0 * abs(wrong.share):.0f} %"
        shown = (
            [NONE] * len(keys)
            if wrong.errors is None
            else [f"{ratio:.2f}" for ratio in np.asarray(wrong.errors)]
        )
        costs = (wrong.error_cost, wrong.control_cost)
        rows.append([name, *shown, *(NONE if math.isnan(c) else f"{c:.2f}" for c in costs)])
    caption = (
        f"Standard errors, and variances of e and u, over those of the reference if one parameter "
        f"of the pilot is {100.0 * OFF:.0f} % off; a dash: the loop is unstable"
    )
    return Section("wrong", "Another pilot", [Table(caption, columns, entries(rows))])


def _pilots(made: Design) -> Section:
    return Section("pilots", "Pilots", [Text(pilots_sentence(made))])


def _planning(plans: Sequence[tuple[str, Plan]], subjects: int, runs: int) -> Section:
    first = plans[0][1]
    blocks: list[Block] = [
        Text(
            f"Difference sought: {first.key} {100.0 * first.effect:+g} % between two conditions, "
            "the same subjects in both; two-sided paired t test at 5 %. Spread between subjects "
            f"{100.0 * first.between:g} % of the value (of the difference), from run to run "
            f"{100.0 * first.within:g} %."
        ),
        Bullets([f"{chance_sentence(name, found, subjects, runs)}." for name, found in plans]),
    ]
    for name, found in plans:
        columns = [
            Column("window", text=True),
            *(Column(f"{runs} run{'s' if runs > 1 else ''}") for runs in found.choices),
        ]
        caption = (
            f"Subjects that see it with 80 %, forcing functions of the {name}, runs a condition"
        )
        blocks.append(Table(caption, columns, entries(found.rows(NONE))))
    return Section("plan", "Subjects, runs and time", blocks)


def _origin(folder: Path, command: str, version: str, *, alternating: bool) -> Section:
    design = folder / "design.json"
    turned = "; `fd_2` is the disturbance of every other run" if alternating else ""
    return Section(
        "origin",
        "Files",
        [
            Command("To make it again:", command),
            Command("A recording of it:", f"pilotid simulate {design} --out F.csv"),
            Command("Methods on it:", f"pilotid compare --scenario {design} --out DIR"),
            Text(
                "`forcing.csv` holds both signals for the apparatus, faded in before and out after "
                f"the measurement window, which begins at t = 0{turned}. Version: "
                f"pilotid {version}."
            ),
        ],
    )
