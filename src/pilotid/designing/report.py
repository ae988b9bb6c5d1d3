"""What a design is: its report and what the terminal shows of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

from pilotid.designing.design import OFF, Design, Wrong, wrong_pilots
from pilotid.designing.figures import signals_figure, spectra_figure
from pilotid.designing.limits import Limits
from pilotid.designing.planning import Plan
from pilotid.document import (
    Block,
    Bullets,
    Column,
    Command,
    Figure,
    Section,
    Table,
    Text,
    print_blocks,
    write_page,
)
from pilotid.numbers import NONE, number
from pilotid.terminal import make_console

#: What the summary shows beside, by what the remnant's power is taken for.
OTHERWISE = {
    "held": ("design %, remnant grows", "if the remnant's power is a share of the control's"),
    "share": ("design %, remnant held", "if the remnant has the power that it has now"),
}
COSTS = {"e": "error e", "u": "control u", "de": "rate of e", "du": "rate of u"}
two_decimals = "{:.2f}".format
#: Plans by the name of their forcing functions.
Plans = Sequence[tuple[str, Plan]]


def write_report(
    folder: Path,
    made: Design,
    command: str,
    version: str,
    plans: Plans = (),
    subjects: int = 8,
) -> Path:
    """Write report.html, with the command and the version that made the design."""
    path = folder / "report.html"
    sections = report_sections(made, plans, subjects)
    sections.append(_origin(folder, command, version, alternating=made.scenario.alternating))
    write_page(path, f"Forcing functions for {made.reference.name}", sections)
    return path


def print_design(made: Design, plans: Plans, subjects: int) -> None:
    """Print what a design gives, and the plans."""
    costs = ", ".join(f"{name} {cost:.2f}" for name, cost in made.costs.items())
    crests = ", ".join(f"{name} {crest:.2f}" for name, (crest, _) in made.crest.items())
    told = [f"Variances over the reference's: {costs}. Crest factors: {crests}.", *sentences(made)]
    told += [pilots_sentence(made)] if len(made.gains) > 1 else []
    print_blocks(
        make_console(),
        error_table(made),
        Bullets([*told, *_chances(plans, subjects, made.scenario.runs)]),
        *(plan_table(name, found) for name, found in plans),
    )


def report_sections(made: Design, plans: Plans, subjects: int) -> list[Section]:
    """Summary, spectra, price, signals, wrong pilots, and plans if there are any."""
    summary: list[Block] = [Bullets(sentences(made)), error_table(made), purpose_table(made)]
    spectra = Figure(
        "spectra",
        spectra_figure(made),
        "Amplitudes of the design and of the reference, and the standard errors predicted",
    )
    signals = Figure(
        "signals",
        signals_figure(made),
        "The forcing functions in the first seconds of the measurement window",
    )
    whose = "is held" if made.remnant == "held" else "grows with the control"
    price = Text(f"What the pilot pays for it: variances with the remnant's part, which {whose}.")
    sections = [
        Section("summary", "Summary", summary),
        Section("spectra", "Spectra", [spectra, line_table(made)]),
        Section("price", "Price", [price, cost_table(made)]),
        Section("signals", "Signals", [signals, peak_table(made)]),
        Section("wrong", "Another pilot", [wrong_table(made)]),
    ]
    if len(made.gains) > 1:
        sections.append(Section("pilots", "Pilots", [Text(pilots_sentence(made))]))
    if plans:
        sections.append(_planning(plans, subjects, made.scenario.runs))
    return sections


def error_table(made: Design) -> Table[str]:
    """Predicted standard errors, those of the reference, and with another kind of remnant."""
    other = made.errors_if_scaled if made.remnant == "held" else made.errors_if_held
    reference = made.reference_errors
    title, hint = OTHERWISE[made.remnant]
    columns: list[Column[str]] = [
        Column("parameter", str),
        Column("design %", lambda key: 100.0 * made.errors[key], number),
        Column("reference %", lambda key: 100.0 * reference[key], number),
        Column("ratio", lambda key: made.errors[key] / reference[key], two_decimals),
        Column(title, lambda key: 100.0 * other[key], number, hint),
    ]
    runs = made.scenario.runs
    caption = (
        f"Predicted standard errors in % of the true values, from the Cramer-Rao bounds of "
        f"{runs} run{'s' if runs > 1 else ''} of {made.scenario.duration:.2f} s, the remnant's own "
        "parameters estimated too"
    )
    return Table(caption, columns, list(made.errors))


def purpose_table(made: Design) -> Table[tuple[str, str]]:
    """Pilot, loop and limits that the design is for."""
    scenario, remnant = made.reference, made.scenario.remnant
    known = zip(scenario.model.keys, scenario.truth, strict=True)
    values = ", ".join(f"{key} {number(value)}" for key, value in known)
    power = "held" if made.remnant == "held" else "a share of the control's"
    rows = [
        ("pilot", f"model {scenario.model.name}: {values}"),
        ("controlled element", scenario.element.name),
        (
            "remnant",
            f"{remnant.shape} of order {remnant.order}, {number(remnant.frequency)} rad/s, power "
            f"{power}",
        ),
        ("reference", f"{scenario.name}, {scenario.runs} x {scenario.duration:.2f} s"),
        ("limits", limits_kept(made.limits)),
    ]
    columns: list[Column[tuple[str, str]]] = [
        Column("what", lambda row: row[0]),
        Column("value", lambda row: row[1]),
    ]
    return Table("What the design is for", columns, rows, folded=True)


def line_table(made: Design) -> Table[tuple[str, int, float, float, float, float]]:
    """The lines of the forcing functions: number, frequency, power, share of power, phase."""
    rows = []
    for name, at in made.lines.signals:
        forcing = made.scenario.target if name == "ft" else made.scenario.disturbance
        assert forcing is not None
        powers = made.powers[at]
        rows += [
            (name, line, float(omega), float(power), float(power / powers.sum()), phase)
            for line, omega, power, phase in zip(
                forcing.lines,
                made.lines.omega[at],
                powers,
                getattr(forcing, "phases", ()),
                strict=True,
            )
        ]
    columns: list[Column[tuple[str, int, float, float, float, float]]] = [
        Column("signal", lambda row: row[0]),
        Column("line", lambda row: row[1], str),
        Column("rad/s", lambda row: row[2], number),
        Column("amplitude", lambda row: (math.sqrt(2.0 * row[3]), 4), number),
        Column("share %", lambda row: 100.0 * row[4], number, "of the signal's power"),
        Column("phase rad", lambda row: row[5], "{:.3f}".format),
    ]
    return Table("The lines", columns, rows, heads=2, folded=True)


def cost_table(made: Design) -> Table[str]:
    """Variances of error and control."""
    columns: list[Column[str]] = [
        Column("signal", lambda name: COSTS[name]),
        Column("variance over the reference's", lambda name: made.costs[name], two_decimals),
    ]
    return Table("Variances over those of the reference", columns, list(made.costs))


def peak_table(made: Design) -> Table[tuple[str, float]]:
    """Crest factors, peaks and root mean squares of the forcing functions."""
    rows = [(name, math.sqrt(float(made.powers[at].sum()))) for name, at in made.lines.signals]
    columns: list[Column[tuple[str, float]]] = [
        Column("signal", lambda row: row[0]),
        Column("crest factor", lambda row: made.crest[row[0]][0], two_decimals),
        Column("reference", lambda row: made.crest[row[0]][1], two_decimals, "with its phases"),
        Column("peak", lambda row: made.crest[row[0]][0] * row[1], number),
        Column("rms", lambda row: row[1], number),
    ]
    return Table("Peaks of the forcing functions", columns, rows)


def wrong_table(made: Design) -> Table[Wrong]:
    """What the design is worth for pilots with one other parameter."""

    def ratio(place: int, key: str) -> Column[Wrong]:
        return Column(
            key, lambda w: None if w.errors is None else float(w.errors[place]), two_decimals
        )

    def cost(value: float) -> str:
        return NONE if math.isnan(value) else two_decimals(value)

    columns: list[Column[Wrong]] = [
        Column("pilot", lambda w: f"{w.key} {100.0 * w.share:+.0f} %"),
        *(ratio(place, key) for place, key in enumerate(made.errors)),
        Column("e", lambda w: w.error_cost, cost),
        Column("u", lambda w: w.control_cost, cost),
    ]
    caption = (
        f"Standard errors, and variances of e and u, over those of the reference if one parameter "
        f"of the pilot is {100.0 * OFF:.0f} % off; a dash: the loop is unstable"
    )
    return Table(caption, columns, list(wrong_pilots(made)))


def plan_table(name: str, found: Plan) -> Table[list[str]]:
    """Subjects that suffice, by the length of a run and the number of runs."""

    def of_runs(place: int, runs: int) -> Column[list[str]]:
        return Column(f"{runs} run{'s' if runs > 1 else ''}", lambda row: row[place], str)

    columns = [
        Column("window", lambda row: row[0]),
        *(of_runs(place, runs) for place, runs in enumerate(found.choices, start=1)),
    ]
    caption = f"Subjects that see it with 80 %, forcing functions of the {name}, runs a condition"
    return Table(caption, columns, found.rows(NONE))


def _planning(plans: Plans, subjects: int, runs: int) -> Section:
    first = plans[0][1]
    text = (
        f"Difference sought: {first.key} {100.0 * first.effect:+g} % between two conditions, "
        "the same subjects in both; two-sided paired t test at 5 %. Spread between subjects "
        f"{100.0 * first.between:g} % of the value (of the difference), from run to run "
        f"{100.0 * first.within:g} %."
    )
    chances = Bullets([f"{words}." for words in _chances(plans, subjects, runs)])
    tables = [plan_table(name, found) for name, found in plans]
    return Section("plan", "Subjects, runs and time", [Text(text), chances, *tables])


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


# ---------------------------------------------------------------------------------- words


def objective(made: Design) -> str:
    """What a design makes small, in words."""
    whose = "" if len(made.loops) == 1 else f", the {made.over} of {len(made.loops)} pilots"
    if made.wanted:
        wish = ", ".join(f"{key} to {100.0 * share:g} %" for key, share in made.wanted.items())
        return f"shortest time for {wish}{whose}"
    words = {
        "A": "mean relative variance of all parameters (A)",
        "D": "volume of the confidence ellipsoid (D)",
        "E": "longest axis of the confidence ellipsoid (E)",
    }
    return words.get(made.minimise, f"mean relative variance of {made.minimise}") + whose


def sentences(made: Design) -> list[str]:
    """What to know of a design, a sentence each."""
    told = [f"Minimised: {objective(made)}.", gap_sentence(made)]
    if made.remnant == "share":
        told.append(
            "The remnant's power is taken for a share of the control's, as large as with the "
            "reference; limits on e and u count what it then is."
        )
    if made.lines.shared:
        told.append(
            "Target and disturbance share their lines: in every other run the disturbance has the "
            "other sign, which tells the answers to both apart."
        )
    if made.wanted:
        told.append(
            f"The shortest window is {made.unrounded:.1f} s; with whole periods it is "
            f"{made.scenario.duration:.2f} s."
        )
    if made.binding:
        prices = ", ".join(
            f"{name} ({100.0 * price / abs(made.optimum.value):.2g} %)"
            for name, price in made.optimum.prices[:4]
        )
        told.append(
            "Limits that bind, with the share of the variance that each would save, to first "
            f"order, if it were doubled: {prices}."
        )
    return told


def gap_sentence(made: Design) -> str:
    """How near the optimum the design is."""
    return (
        f"No design within the limits has more than {100.0 * max(made.gap, 1e-5):.1g} % less of "
        f"that variance (optimality gap)."
    )


def limits_kept(limits: Limits) -> str:
    """The limits, as they are typed."""
    told = []
    for field in fields(limits):
        value = getattr(limits, field.name)
        if isinstance(value, bool):
            told.append(f"{field.name}={str(value).lower()}")
        elif value is not None:
            told.append(f"{field.name}={value:g}")
    return ", ".join(told)


def pilots_sentence(made: Design) -> str:
    """For how many pilots a design is better, and what keeps it from more."""
    gains = sorted(made.gains)
    told = (
        f"Better than the reference for {made.better} of {len(gains)} pilots: errors "
        f"{gains[0]:.2f} to {gains[-1]:.2f} of the reference's, median "
        f"{gains[len(gains) // 2]:.2f}."
    )
    if made.better < len(gains):
        held = f"what binds is {', '.join(made.binding[:3])}" if made.binding else "no limit binds"
        told += (
            " The powers that some pilots could spare others need, and there are no more within "
            f"the limits; {held}."
        )
    return told


def _chances(plans: Plans, subjects: int, runs: int) -> list[str]:
    """The chances of plans."""
    return [
        f"{name}: {subjects} subjects with {runs} run{'s' if runs > 1 else ''} in each condition "
        f"see {plan.key} {100.0 * plan.effect:+g} % with a chance of "
        f"{100.0 * plan.chance(subjects, runs):.0f} %"
        for name, plan in plans
    ]
