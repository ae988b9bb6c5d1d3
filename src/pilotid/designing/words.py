"""What a design is, in sentences."""

from __future__ import annotations

from dataclasses import fields

from pilotid.designing.design import Design
from pilotid.designing.limits import Limits
from pilotid.designing.planning import Plan


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
        f"that variance (optimality gap, {made.optimum.steps} Newton steps)."
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
