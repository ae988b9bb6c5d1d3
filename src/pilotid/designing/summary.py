"""What a design is, in sentences and on the terminal."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import fields

from pilotid.designing.design import Design
from pilotid.designing.limits import Limits
from pilotid.designing.planning import Plan
from pilotid.terminal import make_console, make_table, print_table


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


def chance_sentence(name: str, plan: Plan, subjects: int, runs: int) -> str:
    """The chance of a plan with the forcing functions of this name."""
    return (
        f"{name}: {subjects} subjects with {runs} run{'s' if runs > 1 else ''} in each condition "
        f"see {plan.key} {100.0 * plan.effect:+g} % with a chance of "
        f"{100.0 * plan.chance(subjects, runs):.0f} %"
    )


def print_design(made: Design, plans: Sequence[tuple[str, Plan]], subjects: int) -> None:
    """Print what a design gives, and the plans by the name of their forcing functions."""
    console, runs = make_console(), made.scenario.runs

    def print_rows(title: str, columns: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
        table = make_table()
        table.title, table.title_justify, table.title_style = title, "left", ""
        for place, column in enumerate(columns):
            table.add_column(column, justify="right" if place else "left")
        for row in rows:
            table.add_row(*row)
        print_table(console, table)

    errors = [
        (key, error, made.reference_errors[key], error / made.reference_errors[key])
        for key, error in made.errors.items()
    ]
    print_rows(
        f"predicted standard errors, {runs} x {made.scenario.duration:.2f} s",
        ("parameter", "design %", "reference %", "ratio"),
        [(k, f"{100 * own:.2f}", f"{100 * other:.2f}", f"{r:.2f}") for k, own, other, r in errors],
    )
    costs = ", ".join(f"{name} {cost:.2f}" for name, cost in made.costs.items())
    crests = ", ".join(f"{name} {crest:.2f}" for name, (crest, _) in made.crest.items())
    told = [f"Variances over the reference's: {costs}. Crest factors: {crests}.", *sentences(made)]
    for sentence in told + ([pilots_sentence(made)] if len(made.gains) > 1 else []):
        console.print(sentence, soft_wrap=True)
    for name, found in plans:
        console.print(chance_sentence(name, found, subjects, runs), soft_wrap=True)
        columns = [f"{n} run{'s' if n > 1 else ''}" for n in found.choices]
        print_rows(f"subjects for 80 %, {name}", ("window", *columns), found.rows("-"))
