"""Recordings and models that benchmarks share."""

from __future__ import annotations

from functools import cache

import numpy as np
from helpers import NOMINAL

from pilotid.datasets import Scenario, scenario_named, simulate
from pilotid.model.catalogue import MULTI
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording


@cache
def recorded(scenario: str, seed: int = 1) -> Recording:
    """A recording of a scenario, named with its settings."""
    return simulate(scenario_named(scenario), np.random.default_rng(seed))


@cache
def position_control() -> tuple[Scenario, Recording]:
    """A pilot of a position control loop, drawn from a population, and six runs of him."""
    pilots = scenario_named("population-exotic(runs=(6,), models=(lead-lag,), intervals=(0.01,))")
    scenario = pilots.drawn(np.random.default_rng(2001))
    return scenario, simulate(scenario, np.random.default_rng(2001))


@cache
def far_model() -> PilotModel:
    """The paper's pilot with every initial guess 40 % off."""
    sign = np.array([1, -1, 1, -1, 1, -1, 1])
    start = NOMINAL.values * (1.0 + 0.4 * sign)
    return MULTI.with_start(dict(zip(MULTI.keys, start.tolist(), strict=True)))
