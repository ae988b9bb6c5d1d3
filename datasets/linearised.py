"""Bounds of pilots who change: by linearisation around the truth, averaged over recordings.

Such a loop has no spectra.  But the prediction's derivatives by the parameters, at the truth and
whitened by the remnant's own spectrum, are the information of each recording; its mean is
Fisher's, since inputs hold nothing of the remnant that is still to come.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from pilotid.datasets.scenarios import Scenario
from pilotid.datasets.simulation import remnant_shaping, simulate, white_level
from pilotid.time_domain.prediction import predict
from pilotid.types import FloatArray, InputError

RECORDINGS, SEED = 24, 20160501
BAND = 120.0  # rad/s, beyond which no pilot answers


@lru_cache(maxsize=64)
def _bound(scenario: Scenario) -> tuple[float, ...]:
    level = white_level(scenario)
    if level == 0.0:
        raise InputError(f"scenario {scenario.name}: without a remnant every bound is zero")
    rng = np.random.default_rng(SEED)
    count = len(scenario.truth)
    information = np.zeros((count, count))
    for _ in range(RECORDINGS):
        prediction = predict(simulate(scenario, rng), scenario.model, BAND)
        shaping = level * remnant_shaping(scenario.constant_ends[0][0], prediction.s.imag)
        spectra = prediction.row_spectra(scenario.values[None])[0, :-1] / shaping
        rows = prediction.samples_of(spectra).reshape(count, -1)
        # White noise of variance 1 at the recording's samples has less at fewer of them.
        information += prediction.dt / scenario.dt * (rows @ rows.T) / RECORDINGS
    return tuple(np.sqrt(np.diag(np.linalg.inv(information))).tolist())


def bound_of(scenario: Scenario) -> FloatArray:
    """Standard errors that no unbiased method undercuts, the remnant's spectrum known.

    Parameters
    ----------
    scenario
        A scenario whose pilot or element changes.

    Returns
    -------
    FloatArray
        Shape (parameters,).
    """
    return np.array(_bound(scenario))
