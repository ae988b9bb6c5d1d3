"""A global search under a white residual: what it finds, and what it does not mend."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import NOMINAL, SINGLE_LOOP, fit_of, without_remnant

from pilotid.datasets import Scenario, scenario_named
from pilotid.estimate.estimate import Outcome
from pilotid.methods.mle_genetic import MLEGenetic
from pilotid.methods.mle_white import MLEWhite
from pilotid.model.channel import Channel
from pilotid.model.factors import Delay, Gain
from pilotid.model.model import PilotModel
from pilotid.solve.least_squares import minimise
from pilotid.support.types import FloatArray

pytestmark = pytest.mark.numerical


@pytest.mark.parametrize("scenario", [SINGLE_LOOP, NOMINAL], ids=["single", "multi"])
def test_a_recording_without_remnant_gives_the_truth(scenario: Scenario) -> None:
    pilot = without_remnant(scenario)
    estimate = fit_of(MLEGenetic(), pilot)
    assert estimate.outcome is Outcome.CONVERGED
    assert estimate.values == pytest.approx(pilot.values, rel=2e-3)


def test_it_ends_where_several_starts_end() -> None:
    white = scenario_named("white-remnant")
    for i in range(3):
        genetic, several = fit_of(MLEGenetic(), white, i), fit_of(MLEWhite(), white, i)
        assert np.all(np.abs(genetic.values - several.values) < 0.2 * several.std_error)
        np.testing.assert_allclose(genetic.std_error, several.std_error, rtol=0.2)


# ----------------------------------------------------------------------- evolution by itself

TIME = np.linspace(0.0, 6.0, 400)
TONE = PilotModel("tone", (Channel("visual", "error", 1, (Gain("K"), Delay("pitch"))),))


def gram(values: FloatArray) -> FloatArray:
    """Fit a gain and a pitch to 0.7 sin(12 t): a local minimum at every other pitch."""
    gain, omega = values[:, :1], 20.0 * values[:, 1:]
    wave = np.sin(omega * TIME)
    slopes = [wave, 20.0 * gain * TIME * np.cos(omega * TIME)]
    rows = np.stack([*slopes, 0.7 * np.sin(12.0 * TIME) - gain * wave], axis=1)
    return rows @ rows.transpose(0, 2, 1)


@pytest.mark.parametrize("seed", range(3))
def test_evolution_finds_the_lowest_of_many_optima(seed: int) -> None:
    near = minimise(gram, np.array([[1.0, 0.3]]), TONE)
    assert near.converged[0]
    assert near.cost[0] > 50.0
    end = MLEGenetic().search(gram, TONE, np.random.default_rng(seed))
    np.testing.assert_allclose(end.values, [[0.7, 0.6]], rtol=1e-6)
    assert end.values.shape == (1, 2)
