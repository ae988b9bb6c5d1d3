"""The estimates of one machine on another: docs/machines.md says what is promised."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from helpers import fit_of

from pilotid.datasets import scenario_named
from pilotid.estimates.estimate import Outcome
from pilotid.methods import method_named

pytestmark = pytest.mark.numerical

#: Written by `nox -s check -- machines --store`, to be run again when estimates change on purpose.
STORED = json.loads((Path(__file__).parent / "machines.json").read_text(encoding="utf-8"))
PROMISED = 1e-3  # claimed standard errors
ENDS = 0.02  # the same, of ends of intervals, which are sought less closely


@pytest.mark.parametrize("key", STORED)
def test_estimates_are_those_of_another_machine(key: str) -> None:
    method, scenario, replication = key.split()
    expected = STORED[key]
    estimate = fit_of(method_named(method), scenario_named(scenario), int(replication))
    assert estimate.outcome.slug == expected["outcome"]
    if expected["outcome"] == "not-applicable":
        return
    assert estimate.outcome is Outcome.CONVERGED
    apart = np.abs(estimate.values - expected["values"]) / expected["std_error"]
    assert apart.max() < PROMISED
    np.testing.assert_allclose(estimate.std_error, expected["std_error"], rtol=PROMISED)
    moved = np.abs(estimate.intervals - expected["intervals"]).max(axis=1)
    assert (moved / expected["std_error"]).max() < ENDS
