"""Leads that a lag, or an overdamped neuromuscular system, cancels."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from pilotid.chance import Z95
from pilotid.estimates.estimate import Estimate
from pilotid.pilot.factors import Factor, Lag, Lead, Neuromuscular
from pilotid.remarks import Remark
from pilotid.types import FloatArray

#: Standard error of the logarithm of a ratio of two times above which it tells nothing.
VAGUE = 0.7


def cancellations(estimate: Estimate) -> list[Remark]:
    """A sentence for each zero and pole of a channel that are closer than their errors."""
    found = []
    index = {key: i for i, key in enumerate(estimate.model.keys)}
    for channel in estimate.model.channels:
        leads = dict.fromkeys(f for f in channel.factors if isinstance(f, Lead))
        poles = [p for f in channel.dynamics for p in _poles(f, index, estimate.values)]
        for lead in leads:
            for name, logarithm, slope in poles:
                i = index[lead.key]
                off = math.log(float(estimate.values[i])) - logarithm
                gradient = -slope
                gradient[i] += 1.0 / estimate.values[i]
                error = math.sqrt(max(float(gradient @ estimate.covariance @ gradient), 0.0))
                if abs(off) < Z95 * error and error < VAGUE:
                    found.append(
                        Remark(
                            "pole-zero-cancellation",
                            f"{lead.key} and {name} cancel to within their errors "
                            f"({math.exp(off):.2f} +- {math.exp(off) * error:.2f} times as long): "
                            "a model without the two would describe this recording as well",
                        )
                    )
    return found


def _poles(
    factor: Factor, index: dict[str, int], values: FloatArray
) -> Iterator[tuple[str, float, FloatArray]]:
    """Real poles: name, logarithm of the time constant, and its slope by all parameters."""
    slope = np.zeros(len(index))
    if isinstance(factor, Lag):
        i = index[factor.key]
        slope[i] = 1.0 / values[i]
        yield factor.key, math.log(float(values[i])), slope
    if isinstance(factor, Neuromuscular):
        f, d = index[factor.frequency_key], index[factor.damping_key]
        frequency, damping = float(values[f]), float(values[d])
        if damping > 1.0:
            # T = (d + sqrt(d^2 - 1))/f is the slow one: d ln T/dd = 1/sqrt(d^2 - 1)
            root = math.sqrt(damping**2 - 1.0)
            slope[f], slope[d] = -1.0 / frequency, 1.0 / root
            yield (
                f"the neuromuscular system ({factor.frequency_key}, {factor.damping_key})",
                math.log((damping + root) / frequency),
                slope,
            )
