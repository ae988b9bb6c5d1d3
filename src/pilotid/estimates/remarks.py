"""What a user must know of an estimate, whatever method it comes from."""

from __future__ import annotations

import numpy as np

from pilotid.estimates.cancellation import cancellations
from pilotid.estimates.changes import steps
from pilotid.estimates.estimate import Estimate
from pilotid.estimates.intervals import little_known, short_delays
from pilotid.remarks import Remark, remark_of

#: Variance accounted for [%] below which a model explains next to nothing.  Of 110 recordings
#: of human pilots the least well described, by a pilot with a breakout, has 34 %; with the
#: control recorded a second late the best fit has 12 %.
NOTHING = 20.0


#: Standard error over value from which a parameter is not known.
UNKNOWN = 0.25


def vague(estimate: Estimate) -> bool:
    """Whether a fit failed, or knows little of a parameter."""
    if not estimate.outcome.usable:
        return True
    return bool(np.any(estimate.std_error > UNKNOWN * np.abs(estimate.values)))


def remarks_on(estimate: Estimate, explained: float | None = None) -> tuple[Remark, ...]:
    """The method's own remarks, and those that its numbers call for.

    Parameters
    ----------
    estimate
        The estimate.
    explained
        Share of the control that the model explains [%] where that is known better than by the
        VAF: a slow remnant that the loop suppresses is larger than the control that it is in.
    """
    found = [remark_of(remark) for remark in estimate.remarks]
    if not estimate.outcome.usable:
        return tuple(found)
    explained = estimate.vaf if explained is None else explained
    if explained < NOTHING:
        found.append(
            Remark(
                "little-explained",
                f"the model explains {explained:.1f} % of the control, so the values mean "
                "nothing: see whether u, e and x belong together (one shifted in time, a wrong "
                "name, a wrong sign), or choose another model",
            )
        )
        return tuple(found)
    found += steps(estimate)
    found += [*short_delays(estimate), *cancellations(estimate), *what_is_open(estimate)]
    return tuple(found)


def what_is_open(estimate: Estimate) -> list[Remark]:
    """What the recording leaves open; no fault of recording, model or fit."""
    curves = {estimate.model.keys[i] for curve in estimate.model.curves for i in curve.indices}
    pairs = [p for p in estimate.inseparable if not {p.first, p.second} <= curves]
    along = [p for p in estimate.inseparable if p not in pairs]
    found = [Remark("inseparable", pair.words) for pair in pairs]
    if along:
        named = ", ".join(f"{pair.first} and {pair.second}" for pair in along)
        found.append(
            Remark(
                "inseparable", f"along the curves {named} cannot be told apart: go by their bands"
            )
        )
    return [*found, *little_known(estimate)]
