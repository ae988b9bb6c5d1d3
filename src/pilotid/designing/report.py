"""What a design is: its report and what the terminal shows of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pilotid.datasets.remnant import TabulatedRemnant
from pilotid.designing.design import OFF, Design, wrong_pilots
from pilotid.designing.limits import Limits
from pilotid.designing.lines import sines_of
from pilotid.designing.planning import Plan
from pilotid.document import (
    Block,
    Bullets,
    Command,
    Figure,
    Section,
    Table,
    Text,
    print_blocks,
    table_of,
    write_page,
)
from pilotid.numbers import NONE, number
from pilotid.show.style import INK, draw_grid, journal_figure, log_ticks
from pilotid.terminal import make_console

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Drawing

DESIGN, REFERENCE = ("#0072B2", "o"), ("#999999", "s")
NAMES = {"ft": "target ft", "fd": "disturbance fd"}
SECONDS = 20.0  # of the signals are shown
#: What the summary shows beside, by what the remnant's power is taken for.
OTHERWISE = {
    "held": ("design %, remnant grows", "if the remnant's power is a share of the control's"),
    "share": ("design %, remnant held", "if the remnant has the power that it has now"),
}
COSTS = {
    **{"e": "error e", "u": "control u", "de": "rate of e", "du": "rate of u"},
    **{"x": "output x", "dx": "rate of x", "ddx": "acceleration of x"},
}
OBJECTIVES = {
    "A": "mean relative variance of all parameters (A)",
    "D": "volume of the confidence ellipsoid (D)",
    "E": "longest axis of the confidence ellipsoid (E)",
}
two_decimals = "{:.2f}".format
#: Plans by the name of their forcing functions.
Plans = Sequence[tuple[str, Plan]]


def write_report(
    folder: Path, made: Design, command: str, version: str, plans: Plans = (), subjects: int = 8
) -> Path:
    """Write report.html, with the command and the version that made the design."""
    path, design = folder / "report.html", folder / "design.json"
    turned = "; `fd_2` is the disturbance of every other run" if made.scenario.alternating else ""
    files: list[Block] = [
        Command("To make it again:", command),
        Command("A recording of it:", f"pilotid simulate {design} --out F.csv"),
        Command("Methods on it:", f"pilotid compare --scenario {design} --out DIR"),
        Text(
            "`forcing.csv` holds both signals for the apparatus, faded in before and out after the "
            f"measurement window, which begins at t = 0{turned}. Version: pilotid {version}."
        ),
    ]
    sections = [*report_sections(made, plans, subjects), Section("origin", "Files", files)]
    write_page(path, f"Forcing functions for {made.reference.name}", sections)
    return path


def print_design(made: Design, plans: Plans, subjects: int) -> None:
    """Print what a design gives, and the plans."""
    costs = ", ".join(f"{name} {cost:.2f}" for name, cost in made.costs.items())
    crests = ", ".join(f"{name} {crest:.2f}" for name, (crest, _) in made.crest.items())
    first = " for its own pilot" if len(made.loops) > 1 else ""
    told = [
        reference_sentence(made),
        f"Variances over the reference's{first}: {costs}. Crest factors: {crests}.",
        *sentences(made),
    ]
    told += [pilots_sentence(made)] if len(made.gains) > 1 else []
    print_blocks(
        make_console(),
        error_table(made),
        Bullets([*told, *_chances(plans, subjects, made.scenario.runs)]),
        *(plan_table(name, found) for name, found in plans),
    )


def report_sections(made: Design, plans: Plans, subjects: int) -> list[Section]:
    """Summary, spectra, price, signals, wrong pilots, and plans if there are any."""
    caption = "Amplitudes of the design and of the reference, and the standard errors predicted"
    spectra = Figure("spectra", spectra_figure(made), caption)
    caption = "The forcing functions in the first seconds of the measurement window"
    signals = Figure("signals", signals_figure(made), caption)
    whose = "is held" if made.remnant == "held" else "grows with the control"
    price = Text(f"What the pilot pays for it: variances with the remnant's part, which {whose}.")
    told = Bullets([reference_sentence(made), *sentences(made)])
    summary: list[Block] = [told, error_table(made), purpose_table(made)]
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
        first = plans[0][1]
        text = Text(
            f"Difference sought: {first.key} {100.0 * first.effect:+g} % between two conditions, "
            "the same subjects in both; two-sided paired t test at 5 %. Spread between subjects "
            f"{100.0 * first.between:g} % of the value (of the difference), from run to run "
            f"{100.0 * first.within:g} %."
        )
        chances = Bullets([f"{c}." for c in _chances(plans, subjects, made.scenario.runs)])
        tables = [plan_table(name, found) for name, found in plans]
        sections.append(Section("plan", "Subjects, runs and time", [text, chances, *tables]))
    return sections


# --------------------------------------------------------------------------------- tables


def error_table(made: Design) -> Table[Any]:
    """Predicted standard errors, those of the reference, and with another kind of remnant."""
    other = made.errors_if_scaled if made.remnant == "held" else made.errors_if_held
    runs = made.scenario.runs
    caption = (
        f"Predicted standard errors in % of the true values, from the Cramer-Rao bounds of "
        f"{runs} run{'s' if runs > 1 else ''} of {made.scenario.duration:.2f} s, the remnant's own "
        "parameters estimated too"
    )
    title, hint = OTHERWISE[made.remnant]
    usual = made.reference_errors
    rows = [
        (key, 100.0 * own, 100.0 * usual[key], own / usual[key], 100.0 * other[key])
        for key, own in made.errors.items()
    ]
    heads = [
        *(("parameter",), ("design %", number), ("reference %", number)),
        *(("ratio", two_decimals), (title, number, hint)),
    ]
    return table_of(caption, heads, rows)


def purpose_table(made: Design) -> Table[Any]:
    """Pilot, loop and limits that the design is for."""
    scenario, remnant = made.reference, made.scenario.remnant
    known = zip(scenario.model.keys, scenario.truth, strict=True)
    values = ", ".join(f"{key} {number(value)}" for key, value in known)
    power = "held" if made.remnant == "held" else "a share of the control's"
    shape = (
        "of the estimated spectrum"
        if isinstance(remnant, TabulatedRemnant)
        else f"{remnant.shape} of order {remnant.order}, {number(remnant.frequency)} rad/s"
    )
    rows = [
        ("pilot", f"model {scenario.model.name}: {values}"),
        ("controlled element", scenario.element.name),
        ("remnant", f"{shape}, power {power}"),
        ("reference", f"{scenario.name}, {scenario.runs} x {scenario.duration:.2f} s"),
        ("limits", limits_kept(made.limits)),
    ]
    return table_of("What the design is for", [("what",), ("value",)], rows, folded=True)


def line_table(made: Design) -> Table[Any]:
    """The lines of the forcing functions: number, frequency, amplitude, share of power, phase."""
    rows = []
    for name, at in made.lines.signals:
        sines, omega, powers = sines_of(made.scenario, name), made.lines.omega[at], made.powers[at]
        assert sines is not None
        for own in zip(sines.lines, omega, powers, sines.phases, strict=True):
            line, frequency, power, phase = own
            amplitude, share = math.sqrt(2.0 * power), 100.0 * power / powers.sum()
            rows.append((name, line, frequency, (amplitude, 4), share, phase))
    heads = [
        *(("signal",), ("line", str), ("rad/s", number), ("amplitude", number)),
        *(("share %", number, "of the signal's power"), ("phase rad", "{:.3f}".format)),
    ]
    return table_of("The lines", heads, rows, number_of_heads=2, folded=True)


def cost_table(made: Design) -> Table[Any]:
    """Variances of error, control and output, and root mean squares in their units."""
    rows = []
    for name, cost in made.costs.items():
        rms = made.rms[name]
        rows.append((COSTS[name], cost, rms, rms / math.sqrt(cost), unit_of(made, name)))
    heads = [
        *(("signal",), ("variance over the reference's", two_decimals)),
        *(("rms", number), ("reference", number), ("unit",)),
    ]
    return table_of("Variances over those of the reference", heads, rows)


def unit_of(made: Design, signal: str) -> str:
    """Unit of a signal or of a rate of it; empty where none is known."""
    unit = dict(made.scenario.units).get(signal.lstrip("d"), "")
    return unit and unit + ("", "/s", "/s²")[len(signal) - len(signal.lstrip("d"))]


def peak_table(made: Design) -> Table[Any]:
    """Crest factors, peaks and root mean squares of the forcing functions."""
    rms = {name: math.sqrt(float(made.powers[at].sum())) for name, at in made.lines.signals}
    rows = [(n, *made.crest[n], made.crest[n][0] * own, own) for n, own in rms.items()]
    heads = [
        *(("signal",), ("crest factor", two_decimals)),
        *(("reference", two_decimals, "with its phases"), ("peak", number), ("rms", number)),
    ]
    return table_of("Peaks of the forcing functions", heads, rows)


def wrong_table(made: Design) -> Table[Any]:
    """What the design is worth for pilots with one other parameter."""
    unknown = [math.nan] * len(made.errors)
    rows = [
        (f"{w.key} {100.0 * w.share:+.0f} %", *(w.errors or unknown), *w.costs)
        for w in wrong_pilots(made)
    ]
    caption = (
        f"Standard errors, and variances of e and u, over those of the reference if one parameter "
        f"of the pilot is {100.0 * OFF:.0f} % off; a dash: the loop is unstable"
    )

    def ratio(value: float) -> str:
        return NONE if math.isnan(value) else two_decimals(value)

    return table_of(
        caption, [("pilot",), *((key, ratio) for key in (*made.errors, "e", "u"))], rows
    )


def plan_table(name: str, found: Plan) -> Table[Any]:
    """Subjects that suffice, by the length of a run and the number of runs."""
    caption = f"Subjects that see it with 80 %, forcing functions of the {name}, runs a condition"
    heads = [("window",), *((f"{n} run{'s' if n > 1 else ''}", str) for n in found.choices)]
    rows = [(f"{window:.2f} s", *subjects) for window, subjects in found.table()]
    return table_of(caption, heads, rows)


# -------------------------------------------------------------------------------- figures


def spectra_figure(made: Design) -> Drawing:
    """Amplitudes of both signals' lines, and the predicted errors, beside the reference's."""
    with journal_figure(4.4) as figure:
        above, below = figure.subfigures(2, 1, squeeze=False).ravel()
        names = [name for name, _ in made.lines.signals]
        panels = above.subplots(1, len(names), squeeze=False).ravel()
        for axes, name in zip(panels, names, strict=True):
            for scenario, style, label in (
                (made.reference, REFERENCE, "reference"),
                (made.scenario, DESIGN, "design"),
            ):
                if sines := sines_of(scenario, name):
                    axes.plot(sines.omega, sines.amplitudes, color=style[0], marker=style[1],
                              markersize=4.0, linewidth=0.7, label=label)  # fmt: skip
            unit = dict(made.scenario.units).get(name, "")
            axes.set(xscale="log", yscale="log", xlabel="rad/s", ylabel=unit)
            axes.set_title(f"amplitudes of {NAMES[name]}")
            log_ticks(axes, "x")
            draw_grid(axes)
            axes.legend(frameon=False)
        _draw_errors(below.subplots(), made)
    return figure


def _draw_errors(axes: Axes, made: Design) -> None:
    """Predicted standard errors in %, design and reference, on a logarithmic axis."""
    places = np.arange(len(made.errors))
    for errors, (colour, marker), label, shift in (
        (made.reference_errors, REFERENCE, "reference", -0.12),
        (made.errors, DESIGN, "design", 0.12),
    ):
        percents = 100.0 * np.array(list(errors.values()))
        axes.plot(places + shift, percents, color=colour, marker=marker, markersize=5.0,
                  linestyle="none", label=label)  # fmt: skip
    axes.set_xticks(places, list(made.errors))
    axes.set(yscale="log", title="predicted standard errors [%]")
    log_ticks(axes, "y")
    draw_grid(axes, "y")
    axes.legend(frameon=False)


def signals_figure(made: Design) -> Drawing:
    """The first seconds of both forcing functions, with their peaks over the whole period."""
    names = [name for name, _ in made.lines.signals]
    step = made.scenario.dt
    with journal_figure(1.5 * len(names)) as figure:
        panels = figure.subplots(len(names), 1, squeeze=False).ravel()
        for axes, name in zip(panels, names, strict=True):
            sines = sines_of(made.scenario, name)
            assert sines is not None
            time = np.arange(0.0, min(SECONDS, made.scenario.duration), step)
            peak = float(np.max(np.abs(sines.at(np.arange(0.0, made.lines.period, step)))))
            for level in (-peak, peak):
                axes.axhline(level, color=INK, linewidth=0.5, linestyle=":")
            axes.plot(time, sines.at(time), color=DESIGN[0], linewidth=0.8)
            unit = dict(made.scenario.units).get(name, "")
            axes.set(xlabel="s", ylabel=unit, title=f"{NAMES[name]}; dotted: peaks of a period")
    return figure


# ---------------------------------------------------------------------------------- words


def reference_sentence(made: Design) -> str:
    """What the design is compared with: whose forcing functions, pilot and remnant."""
    reference, pilots = made.reference, [loop.scenario for loop in made.loops]
    told = f"Reference: {reference.name}, {reference.description}"
    if len(pilots) > 1:
        drawn = "of that file" if pilots[0] == reference else "drawn at random"
        told += f"; {len(pilots)} pilots and remnants {drawn}"
    return f"{told}; controlled element {reference.element.name}."


def sentences(made: Design) -> list[str]:
    """What to know of a design, a sentence each."""
    whose = "" if len(made.loops) == 1 else f", the {made.over} of {len(made.loops)} pilots"
    objective = OBJECTIVES.get(made.minimise, f"mean relative variance of {made.minimise}")
    if made.wanted:
        wish = ", ".join(f"{key} to {100.0 * share:g} %" for key, share in made.wanted.items())
        objective = f"shortest time for {wish}"
    told = [
        f"Minimised: {objective}{whose}.",
        f"No design within the limits has more than {100.0 * max(made.gap, 1e-5):.1g} % less of "
        f"that variance (optimality gap).",
    ]
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


def limits_kept(limits: Limits) -> str:
    """The limits, as they are typed."""
    held = {field.name: getattr(limits, field.name) for field in fields(limits)}
    return ", ".join(
        f"{name}={str(value).lower()}" if isinstance(value, bool) else f"{name}={value:g}"
        for name, value in held.items()
        if value is not None
    )


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
