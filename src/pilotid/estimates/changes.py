"""What must be known of an estimate of a pilot who changes, in words."""

from __future__ import annotations

import numpy as np

from pilotid.estimates.estimate import Estimate
from pilotid.pilot.courses import STEEP
from pilotid.remarks import Remark


def steps(estimate: Estimate) -> list[Remark]:
    """Changes that are a step for all that the recording tells."""
    found, told_of = [], set()
    for channel, when in zip(estimate.model.channels, estimate.model.whens, strict=True):
        if not when or when in told_of:
            continue
        told_of.add(when)
        middle, rate = when
        if estimate.values[rate] <= STEEP:
            continue
        key, least = estimate.model.keys[rate], float(estimate.intervals[rate, 0])
        at = float(estimate.values[middle])
        told = f", at least {least:.2g} 1/s" if np.isfinite(least) else ""
        found.append(
            Remark(
                "step-change",
                f"the {channel.name} channel changes in a step at {at:.4g} s: {key} above "
                f"{STEEP:g} 1/s means no more than fast{told}",
            )
        )
    return found
