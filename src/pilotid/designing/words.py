"""What a design is, in sentences."""

from __future__ import annotations

from pilotid.designing.design import Design


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
        f"No design within the limits has more than {100.0 * max(made.gap, 1e-8):.1g} % less of "
        f"that variance (optimality gap, {made.optimum.steps} Newton steps)."
    )
