"""What the 95 % intervals of an estimate say in words where they are not as they should be."""

from __future__ import annotations

import math

import numpy as np

from pilotid.estimates.bounds import at_bounds
from pilotid.estimates.estimate import Estimate
from pilotid.pilot.factors import Parameter
from pilotid.remarks import Remark

#: Shortest delay of people who track [s].
SHORTEST_DELAY = 0.1
#: Ends of an interval that are this many times apart tell the order of magnitude at most.
HARDLY = 10.0
#: How many times longer one side of an interval may be than the other, on the scale of the search.
LOPSIDED = 3.0


def short_delays(estimate: Estimate) -> list[Remark]:
    """Delays that people do not have."""
    found = []
    for i in estimate.model.delays:
        key, value = estimate.model.keys[i], float(estimate.values[i])
        if value < SHORTEST_DELAY:
            end = float(estimate.intervals[i, 1])
            reach = f", though its interval goes up to {end:.3g} s" if end > SHORTEST_DELAY else ""
            found.append(
                Remark(
                    "short-delay",
                    f"{key} is {value:.3g} s, but people's delays are not below "
                    f"{SHORTEST_DELAY:g} s{reach}: another parameter may have taken its part (a "
                    "lag, a slow neuromuscular system), or u was recorded early",
                )
            )
    return found


def little_known(estimate: Estimate) -> list[Remark]:
    """Parameters with an interval that ends at a bound, is wide, or lies to one side."""
    model = estimate.model
    low, high = at_bounds(model, *estimate.intervals.T)
    found, wide, lopsided = [], [], []
    for parameter, value, interval, is_low, is_high in zip(
        model.parameters, estimate.values, estimate.intervals, low, high, strict=True
    ):
        if not parameter.lower <= value <= parameter.upper:
            continue  # of a method without bounds, which says so itself
        if parameter.delay and value < SHORTEST_DELAY and not is_high:
            continue  # `short_delays` says so
        if is_low or is_high:
            found.append(_at_bound(parameter, interval.tolist(), is_low, is_high))
            continue
        ends = np.array([interval[0], value, interval[1]])
        if parameter.positive:
            ratio = float(interval[1] / interval[0])
            if ratio > HARDLY:
                wide.append(f"{parameter.key} ({interval[0]:.2g} .. {interval[1]:.2g})")
                continue
            ends = np.log(ends)
        below, above = np.diff(ends)
        if max(below, above) > LOPSIDED * min(below, above):
            where = "above" if above > below else "below"
            lopsided.append(f"{parameter.key} ({where})")
    if wide:
        found.append(
            Remark(
                "wide-interval",
                f"hardly known is {', '.join(wide)}: the 95 % interval spans more than a factor of "
                f"{HARDLY:g}",
            )
        )
    if lopsided:
        found.append(
            Remark(
                "asymmetric-interval",
                f"the 95 % interval of {', '.join(lopsided)} lies mostly on one side of the value: "
                "go by the interval, not by the standard error",
            )
        )
    return found


def _at_bound(parameter: Parameter, interval: list[float], is_low: bool, is_high: bool) -> Remark:
    key, unit = parameter.key, f" {parameter.unit}" if parameter.unit else ""
    if is_low and is_high:
        span = f"{parameter.lower:g} .. {parameter.upper:g}{unit}"
        return Remark(
            "not-identifiable",
            f"the recording does not tell {key}: its interval holds all values allowed, {span}",
        )
    side, end = ("most", interval[1]) if is_low else ("least", interval[0])
    bound = parameter.lower if is_low else parameter.upper
    if math.isclose(end, bound, rel_tol=1e-3):
        return Remark(
            "at-bound",
            f"{key} is pressed against its bound {bound:g}{unit}: the model does not suit, or the "
            "bound is too narrow",
        )
    told = (
        f"{key} is at {side} {end:.3g}{unit}, and the recording does not tell more: "
        f"its interval reaches the bound {bound:g}{unit}"
    )
    low, high = parameter.usual
    # A lead or lag that is next to none is no wonder; one beyond all that is published is.
    strange = end > high if is_high else end < low and parameter.unit != "s"
    if strange and not parameter.linear:
        told += f"; {low:g} .. {high:g}{unit} are published, so it may stand for something else"
    return Remark("interval-at-bound", told)
