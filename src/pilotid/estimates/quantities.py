"""What `fit` hands to tables, JSON and reports: estimates, quantity by quantity."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from pilotid.chance import Z95
from pilotid.estimates.draws import spread_of
from pilotid.estimates.estimate import Estimate
from pilotid.estimates.method import Method, identify
from pilotid.pilot.model import PilotModel
from pilotid.recordings.recording import Recording
from pilotid.seeds import fit_rng


@dataclass(frozen=True, eq=False)
class Fitted:
    """All estimates of one model from one recording."""

    recording: Recording
    model: PilotModel
    estimates: tuple[Estimate, ...]


@dataclass(frozen=True)
class Quantity:
    """One number with its standard error and 95 % interval; NaN where the fit failed."""

    key: str
    unit: str
    value: float
    std_error: float
    lower: float
    upper: float


def fit_all(
    recording: Recording, model: PilotModel, methods: Mapping[str, Method], seed: int
) -> Fitted:
    """Run methods, by their labels, on a recording, each with its own random generator."""
    estimates = [
        replace(identify(method, recording, model, fit_rng(seed, label)), method=label)
        for label, method in methods.items()
    ]
    return Fitted(recording, model, tuple(estimates))


def parameters(estimate: Estimate) -> list[Quantity]:
    """The model's parameters, in model order."""
    return [
        Quantity(p.key, p.unit, float(value), float(error), float(low), float(high))
        for p, value, error, (low, high) in zip(
            estimate.model.parameters,
            estimate.values,
            estimate.std_error,
            estimate.intervals,
            strict=True,
        )
    ]


def derived(estimate: Estimate) -> list[Quantity]:
    """Functions of the parameters that are better known than the parameters themselves.

    Gain and lead time of the visual channel are correlated at about -0.99; their product,
    the gain on the error's rate, is known several times more accurately than either.
    """
    keys = estimate.model.keys
    if not {"Kvis", "tlead"} <= set(keys):
        return []
    gain, lead = keys.index("Kvis"), keys.index("tlead")
    draws = estimate.draws
    if draws is not None:
        product = draws.values[:, gain] * draws.values[:, lead]
        known = spread_of("Kvis*tlead", "s", product, draws.weights)
        low, high = known.equal_tailed.tolist()
        return [Quantity(known.key, known.unit, known.mean, known.deviation, low, high)]
    slope = np.zeros(len(keys))
    slope[gain], slope[lead] = estimate.values[lead], estimate.values[gain]
    value = float(estimate.values[gain] * estimate.values[lead])
    error = float(np.sqrt(slope @ estimate.covariance @ slope))
    return [Quantity("Kvis*tlead", "s", value, error, value - Z95 * error, value + Z95 * error)]
